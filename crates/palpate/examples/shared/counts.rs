use std::error::Error;

/// The numbers of a list like `0,5,20`: the word after the flag `--touches`.
pub(crate) fn touch_counts(word: Option<String>) -> Result<Vec<usize>, Box<dyn Error>> {
    let list = word.ok_or("--touches needs a list")?;
    Ok(list.split(',').map(str::parse).collect::<Result<_, _>>()?)
}
