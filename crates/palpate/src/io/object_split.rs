use super::{IoError, read_text};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Use of an object in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplitPart {
    /// Seen by the optimizer.
    Train,
    /// Decides which weights are kept.
    Validation,
    /// Seen by neither.
    Test,
}

impl SplitPart {
    /// Name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }
}

/// Which objects are for training, validation and test: all presses of an object are on the same side.
///
/// An entry is an object's name (`004_sugar_box`), what stands before its first underscore (`004`, `072-a`), a prefix ending in a star
/// (`primitive:*`), or `*` for all objects that no other entry names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSplit {
    /// Name, for weight files and tables.
    pub name: String,
    /// Objects seen by the optimizer.
    pub train: Vec<String>,
    /// Objects that decide which weights are kept.
    pub validation: Vec<String>,
    /// Objects seen by neither.
    #[serde(default)]
    pub test: Vec<String>,
}

/// Reads a split from TOML; an object in two lists is an error.
///
/// # Errors
/// [`IoError::Read`], [`IoError::Malformed`], or [`IoError::Content`] for an object in two lists.
pub fn read_object_split(path: impl AsRef<Path>) -> Result<ObjectSplit, IoError> {
    parse_object_split(path.as_ref(), &read_text(path.as_ref())?)
}

/// [`read_object_split`] from memory; `name` is used in messages.
///
/// # Errors
/// As [`read_object_split`].
pub fn parse_object_split(name: &Path, text: &str) -> Result<ObjectSplit, IoError> {
    let split: ObjectSplit =
        toml::from_str(text).map_err(|e| IoError::malformed(name, "split", e.to_string().trim_end()))?;
    let parts = split.entries();
    for (i, (first, a)) in parts.iter().enumerate() {
        for (second, b) in &parts[i + 1..] {
            if let Some(object) = a.iter().find(|x| b.iter().any(|y| same_object(x, y))) {
                let reason =
                    format!("object '{object}' is in both the {} and the {} part", first.name(), second.name());
                return Err(IoError::content(name, reason));
            }
        }
    }
    Ok(split)
}

impl ObjectSplit {
    fn entries(&self) -> [(SplitPart, &[String]); 3] {
        [(SplitPart::Train, &self.train), (SplitPart::Validation, &self.validation), (SplitPart::Test, &self.test)]
    }

    /// Where an object belongs; `None` if the split does not say. The most particular entry decides.
    pub fn part(&self, object: &str) -> Option<SplitPart> {
        // Name or its number, then prefix, then star.
        let ranks: [fn(&str, &str) -> bool; 3] =
            [same_object, |e, o| e.len() > 1 && e.strip_suffix('*').is_some_and(|p| o.starts_with(p)), |e, _| e == "*"];
        ranks.iter().find_map(|matches| {
            let named = |entries: &[String]| entries.iter().any(|entry| matches(entry, object));
            self.entries().iter().find(|(_, entries)| named(entries)).map(|(part, _)| *part)
        })
    }
}

/// Equal names, or one is what stands before the other's first underscore.
fn same_object(a: &str, b: &str) -> bool {
    let number = |name: &str, object: &str| object.split_once('_').is_some_and(|(n, _)| n == name);
    a == b || number(a, b) || number(b, a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<ObjectSplit, IoError> {
        parse_object_split(Path::new("x.toml"), text)
    }

    #[test]
    fn the_most_particular_entry_decides() {
        let text =
            "name = 'x'\ntrain = ['primitive:*', '*']\nvalidation = ['002', '072-a']\ntest = ['004_sugar_box']\n";
        let split = parse(text).expect("valid");
        let part = |o| split.part(o).expect("assigned");
        assert_eq!(part("002_master_chef_can"), SplitPart::Validation);
        assert_eq!(part("072-a_toy_airplane"), SplitPart::Validation);
        assert_eq!(part("004_sugar_box"), SplitPart::Test);
        assert_eq!([part("primitive:cone"), part("0041_box")], [SplitPart::Train; 2]);
        let narrow = parse("name = 'x'\ntrain = ['003']\nvalidation = []\n").expect("valid");
        assert_eq!(narrow.part("004_sugar_box"), None);
    }

    #[test]
    fn an_object_in_two_parts_is_refused_by_number_too() {
        let text = "name = 'x'\ntrain = ['004_sugar_box']\nvalidation = ['002']\ntest = ['004']\n";
        let error = parse(text).expect_err("overlap").to_string();
        assert!(error.contains("x.toml: object '004_sugar_box' is in both the train and the test part"), "{error}");
        assert!(parse("name = 'x'\ntraining = []\n").expect_err("unknown key").to_string().contains("training"));
    }
}
