//! A CSV file of results, one row a run, written as runs end and read back to resume. Its first line says under which conditions
//! the rows were made: others are never mixed in.

use anyhow::{Context as _, bail};
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// What a row holds.
pub(super) trait Record: Sized {
    /// Which run a row is of; the order of the rows.
    type Key: Ord;
    /// Names of the columns.
    fn columns() -> Vec<&'static str>;
    /// The run of this row.
    fn key(&self) -> &Self::Key;
    /// The texts of all columns.
    fn fields(&self) -> Vec<String>;
    /// Undoes [`Self::fields`]; `None` if they are not those of a row.
    fn from_fields(fields: &[String]) -> Option<Self>;
}

/// The file: its rows so far, open for more.
pub(super) struct RowFile<R> {
    path: PathBuf,
    preamble: String,
    pub(super) rows: Vec<R>,
    file: File,
}

impl<R: Record> RowFile<R> {
    /// Opens or starts a file, with the rows of `others` (shards) too. Of several rows of one run, the first is kept.
    ///
    /// The last row of an interrupted run may be cut short: incomplete rows are dropped, and so are those that `keep` refuses.
    ///
    /// * `conditions` – one line
    pub(super) fn open(
        path: &Path,
        others: &[PathBuf],
        conditions: &str,
        keep: impl Fn(&R) -> bool,
    ) -> anyhow::Result<Self> {
        let preamble = format!("# {}\n{}\n", conditions.replace('\n', " "), R::columns().join(","));
        let mut rows = Vec::new();
        if path.exists() {
            rows = read_rows(path, &preamble)?;
        }
        for other in others {
            rows.extend(read_rows(other, &preamble)?);
        }
        rows.retain(keep);
        sort(&mut rows);
        let file = rewrite(path, &preamble, &rows)?;
        Ok(Self { path: path.to_owned(), preamble, rows, file })
    }

    /// Whether a run is already there.
    pub(super) fn contains(&self, key: &R::Key) -> bool {
        self.rows.iter().any(|row| row.key() == key)
    }

    /// Appends a row and hands it to the system at once.
    pub(super) fn push(&mut self, row: R) -> anyhow::Result<()> {
        let line = csv_line(&row.fields());
        let written = self.file.write_all(line.as_bytes()).and_then(|()| self.file.flush());
        written.with_context(|| format!("writing {}", self.path.display()))?;
        self.rows.push(row);
        Ok(())
    }

    /// Puts the rows in order: the order in which runs ended is of no interest.
    pub(super) fn finish(mut self) -> anyhow::Result<Vec<R>> {
        sort(&mut self.rows);
        rewrite(&self.path, &self.preamble, &self.rows)?;
        Ok(self.rows)
    }
}

fn sort<R: Record>(rows: &mut Vec<R>) {
    rows.sort_by(|a, b| a.key().cmp(b.key()));
    rows.dedup_by(|a, b| a.key() == b.key());
}

fn read_rows<R: Record>(path: &Path, preamble: &str) -> anyhow::Result<Vec<R>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    let Some(body) = text.strip_prefix(preamble) else {
        let found = text.lines().next().unwrap_or_default();
        let needed = preamble.lines().next().unwrap_or_default();
        bail!(
            "{} holds results of another kind:\n  found  {found}\n  needed {needed}\nuse another --output",
            path.display()
        );
    };
    let complete = body.split_inclusive('\n').filter(|line| line.ends_with('\n'));
    Ok(complete.filter_map(|line| R::from_fields(&fields_of(line))).collect())
}

/// Replaces the file by a rename, then opens it for appending.
fn rewrite<R: Record>(path: &Path, preamble: &str, rows: &[R]) -> anyhow::Result<File> {
    let lines: String = rows.iter().map(|row| csv_line(&row.fields())).collect();
    palpate::io::write_text(path, &(preamble.to_owned() + &lines))?;
    File::options().append(true).open(path).with_context(|| format!("opening {}", path.display()))
}

/// A column that may be empty.
pub(super) fn number_text(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| format!("{v:.6}"))
}

/// Undoes [`number_text`] for several columns; `None` if one is no number.
pub(super) fn numbers(fields: &[String]) -> Option<Vec<Option<f64>>> {
    fields.iter().map(|f| if f.is_empty() { Some(None) } else { f.parse().ok().map(Some) }).collect()
}

/// One line of RFC 4180; line breaks within a field become spaces, so that a row is a line.
fn csv_line(fields: &[String]) -> String {
    let quoted: Vec<String> = fields
        .iter()
        .map(|field| {
            let field = field.replace(['\n', '\r'], " ");
            if field.contains([',', '"']) { format!("\"{}\"", field.replace('"', "\"\"")) } else { field }
        })
        .collect();
    quoted.join(",") + "\n"
}

/// The fields of a line that [`csv_line`] wrote.
fn fields_of(line: &str) -> Vec<String> {
    let (mut fields, mut field, mut quoted) = (Vec::new(), String::new(), false);
    let mut chars = line.trim_end_matches('\n').chars().peekable();
    while let Some(c) = chars.next() {
        match (c, quoted) {
            ('"', true) if chars.peek() == Some(&'"') => field.extend(chars.next()),
            ('"', _) => quoted = !quoted,
            (',', false) => fields.push(std::mem::take(&mut field)),
            (c, _) => field.push(c),
        }
    }
    fields.push(field);
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A name and a number.
    #[derive(Debug, PartialEq)]
    struct Pair(String, Option<f64>);

    impl Record for Pair {
        type Key = String;
        fn columns() -> Vec<&'static str> {
            vec!["name", "value"]
        }
        fn key(&self) -> &String {
            &self.0
        }
        fn fields(&self) -> Vec<String> {
            vec![self.0.clone(), number_text(self.1)]
        }
        fn from_fields(fields: &[String]) -> Option<Self> {
            let [name, value] = fields else { return None };
            Some(Self(name.clone(), numbers(std::slice::from_ref(value))?[0]))
        }
    }

    fn pair(name: &str, value: f64) -> Pair {
        Pair(name.to_owned(), Some(value))
    }

    fn open(path: &Path, others: &[PathBuf]) -> anyhow::Result<RowFile<Pair>> {
        RowFile::open(path, others, "two\nlines", |row: &Pair| row.0 != "unwanted")
    }

    #[test]
    fn rows_come_back_sorted_merged_and_once() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (one, two) = (folder.path().join("one.csv"), folder.path().join("two.csv"));
        let mut file = open(&one, &[]).expect("new");
        file.push(pair("b, \"quoted\"", 1.5)).expect("written");
        file.push(Pair("a\nbroken".to_owned(), None)).expect("written");
        let mut other = open(&two, &[]).expect("new");
        other.push(pair("unwanted", 0.0)).expect("written");
        other.push(pair("b, \"quoted\"", 9.0)).expect("written");
        other.push(pair("c", 2.0)).expect("written");
        let merged = open(&one, &[two]).expect("both are readable");
        assert!(merged.contains(&"c".to_owned()) && !merged.contains(&"unwanted".to_owned()));
        let rows = [Pair("a broken".to_owned(), None), pair("b, \"quoted\"", 1.5), pair("c", 2.0)];
        assert_eq!(merged.finish().expect("written"), rows);
        assert_eq!(open(&one, &[]).expect("readable").rows, rows);
    }

    #[test]
    fn other_conditions_are_refused_and_shown() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("one.csv");
        open(&path, &[]).expect("new");
        let error = RowFile::<Pair>::open(&path, &[], "others", |_| true).err().expect("refused").to_string();
        assert!(error.contains("# two lines") && error.contains("# others") && error.contains("--output"), "{error}");
    }
}
