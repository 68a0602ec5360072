//! One row a decoded image, kept as they come; shards in files of their own.

use super::super::results::{csv_line, fields_of};
use anyhow::{Context as _, bail};
use palpate::metrics::TactileErrors;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

const COLUMNS: [&str; 15] = [
    "object",
    "press",
    "decoder",
    "rmse_mm",
    "rmse_px",
    "contact_rmse_mm",
    "contact_rmse_px",
    "contact_bias_mm",
    "normal_error_deg",
    "mask_iou",
    "mask_f1",
    "truth_share",
    "decoded_share",
    "seconds",
    "error",
];
/// Numeric columns: all between the key and the error.
const NUMBERS: std::ops::Range<usize> = 3..14;
/// The pixel of the YCB-Sight maps, mm: the unit of the published numbers.
const PIXEL_MM: f64 = 0.0295;

/// Which image by which decoder.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key {
    pub(super) object: String,
    pub(super) press: String,
    pub(super) decoder: String,
}

/// What came out, or why nothing did.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    pub(super) key: Key,
    values: Vec<Option<f64>>,
    /// Empty if the image was decoded.
    pub(super) error: String,
}

impl Row {
    /// * `heights` – whether the decoder gives heights; if not, only masks are judged
    pub(super) fn new(key: Key, errors: &TactileErrors, heights: bool, seconds: f64) -> Self {
        let e = errors;
        let height = |v: Option<f64>| v.filter(|_| heights);
        let px = |v: Option<f64>| height(v).map(|v| v / PIXEL_MM);
        let values = vec![
            height(Some(e.rmse_mm)),
            px(Some(e.rmse_mm)),
            height(e.contact_rmse_mm),
            px(e.contact_rmse_mm),
            height(e.contact_bias_mm),
            height(e.normal_error_deg),
            Some(e.mask_iou),
            Some(e.mask_f1),
            Some(e.truth_share),
            Some(e.decoded_share),
            Some(seconds),
        ];
        Self { key, values, error: String::new() }
    }

    pub(super) fn failed(key: Key, error: String) -> Self {
        Self { key, values: vec![None; NUMBERS.len()], error }
    }

    /// A number by the name of its column.
    pub(super) fn value(&self, column: &str) -> Option<f64> {
        COLUMNS[NUMBERS].iter().position(|c| *c == column).and_then(|i| self.values[i])
    }

    fn line(&self) -> String {
        let key = [self.key.object.clone(), self.key.press.clone(), self.key.decoder.clone()];
        let numbers = self.values.iter().map(|v| v.map_or(String::new(), |v| format!("{v:.6}")));
        csv_line(&key.into_iter().chain(numbers).chain([self.error.clone()]).collect::<Vec<_>>())
    }

    fn parse(line: &str) -> Option<Self> {
        let fields = fields_of(line);
        let [object, press, decoder, numbers @ .., error] = fields.as_slice() else { return None };
        let number = |f: &String| if f.is_empty() { Some(None) } else { f.parse().ok().map(Some) };
        let values: Vec<Option<f64>> = numbers.iter().map(number).collect::<Option<_>>()?;
        let key = Key { object: object.clone(), press: press.clone(), decoder: decoder.clone() };
        (values.len() == NUMBERS.len()).then(|| Self { key, values, error: error.clone() })
    }
}

/// The rows so far, open for more.
pub(super) struct ResultsFile {
    path: PathBuf,
    preamble: String,
    pub(super) rows: Vec<Row>,
    file: File,
}

impl ResultsFile {
    /// Opens or starts `results.csv`, with the rows of all shards there; or the file of one shard (number, of how many).
    ///
    /// `conditions` is a line on what the rows depend on: others are never mixed in.
    pub(super) fn open(folder: &Path, conditions: &str, shard: Option<(usize, usize)>) -> anyhow::Result<Self> {
        let preamble = format!("# {}\n{}\n", conditions.replace('\n', " "), COLUMNS.join(","));
        let path = match shard {
            None => folder.join("results.csv"),
            Some((i, n)) => folder.join(format!("results-{}-of-{n}.csv", i + 1)),
        };
        let mut files = vec![path.clone()];
        if shard.is_none() {
            let entries = std::fs::read_dir(folder).with_context(|| format!("reading {}", folder.display()))?;
            let entries = entries.map(|e| Ok(e?.path())).collect::<anyhow::Result<Vec<_>>>()?;
            let is_shard = |p: &PathBuf| {
                let name = p.file_name().unwrap_or_default().to_string_lossy().into_owned();
                name.starts_with("results-") && p.extension().is_some_and(|e| e == "csv")
            };
            files.extend(entries.into_iter().filter(is_shard));
        }
        let mut rows = Vec::new();
        for file in files.iter().filter(|f| f.exists()) {
            rows.extend(read_rows(file, &preamble)?);
        }
        sort(&mut rows);
        let file = rewrite(&path, &preamble, &rows)?;
        Ok(Self { path, preamble, rows, file })
    }

    pub(super) fn push(&mut self, row: Row) -> anyhow::Result<()> {
        let written = self.file.write_all(row.line().as_bytes()).and_then(|()| self.file.flush());
        written.with_context(|| format!("writing {}", self.path.display()))?;
        self.rows.push(row);
        Ok(())
    }

    /// Puts the rows in order.
    pub(super) fn finish(mut self) -> anyhow::Result<Vec<Row>> {
        sort(&mut self.rows);
        rewrite(&self.path, &self.preamble, &self.rows)?;
        Ok(self.rows)
    }
}

fn sort(rows: &mut Vec<Row>) {
    rows.sort_by(|a, b| a.key.cmp(&b.key));
    rows.dedup_by(|a, b| a.key == b.key);
}

/// Complete rows of a file; the last of an interrupted run may be cut short.
fn read_rows(path: &Path, preamble: &str) -> anyhow::Result<Vec<Row>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    let Some(body) = text.strip_prefix(preamble) else {
        let found = text.lines().next().unwrap_or_default();
        let needed = preamble.lines().next().unwrap_or_default();
        bail!(
            "{} holds results of another kind:\n  found  {found}\n  needed {needed}\nuse another --output",
            path.display()
        );
    };
    Ok(body.split_inclusive('\n').filter(|l| l.ends_with('\n')).filter_map(Row::parse).collect())
}

fn rewrite(path: &Path, preamble: &str, rows: &[Row]) -> anyhow::Result<File> {
    let lines: String = rows.iter().map(Row::line).collect();
    palpate::io::write_text(path, &(preamble.to_owned() + &lines))?;
    File::options().append(true).open(path).with_context(|| format!("opening {}", path.display()))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn row(object: &str, press: &str, decoder: &str, rmse_mm: f64, truth_share: f64) -> Row {
        let errors = TactileErrors {
            rmse_mm,
            contact_rmse_mm: Some(2.0 * rmse_mm),
            contact_bias_mm: Some(-rmse_mm),
            normal_error_deg: Some(3.0),
            mask_iou: 0.75,
            mask_f1: 0.857,
            truth_share,
            decoded_share: 0.2,
        };
        let key = Key { object: object.to_owned(), press: press.to_owned(), decoder: decoder.to_owned() };
        Row::new(key, &errors, decoder != "threshold", 0.015)
    }

    #[test]
    fn shards_are_merged_and_cut_rows_dropped() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (i, object) in ["can", "mug, red"].into_iter().enumerate() {
            let mut file = ResultsFile::open(folder.path(), "c", Some((i, 2))).expect("new");
            file.push(row(object, "0", "lookup", 0.125, 0.1)).expect("written");
            file.push(row(object, "1", "threshold", 0.5, 0.1)).expect("written");
        }
        let second = folder.path().join("results-2-of-2.csv");
        let text = std::fs::read_to_string(&second).expect("there");
        std::fs::write(&second, &text[..text.len() - 3]).expect("written");
        let all = ResultsFile::open(folder.path(), "c", None).expect("merged").finish().expect("written");
        assert_eq!(
            all.iter().map(Row::line).collect::<Vec<_>>(),
            [
                row("can", "0", "lookup", 0.125, 0.1),
                row("can", "1", "threshold", 0.5, 0.1),
                row("mug, red", "0", "lookup", 0.125, 0.1)
            ]
            .map(|row| row.line())
        );
        assert_eq!(all[1].value("rmse_mm"), None);
        assert!((all[0].value("rmse_px").expect("there") - 0.125 / 0.0295).abs() < 1e-5);
        assert!(ResultsFile::open(folder.path(), "other", None).is_err());
    }
}
