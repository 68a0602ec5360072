//! One row a decoded image, kept as they come; shards in files of their own.

use super::super::row_file::{Record, RowFile, number_text, numbers};
use anyhow::Context as _;
use palpate::metrics::TactileErrors;
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
}

impl Record for Row {
    type Key = Key;

    fn columns() -> Vec<&'static str> {
        COLUMNS.to_vec()
    }

    fn key(&self) -> &Key {
        &self.key
    }

    fn fields(&self) -> Vec<String> {
        let key = [self.key.object.clone(), self.key.press.clone(), self.key.decoder.clone()];
        key.into_iter().chain(self.values.iter().map(|v| number_text(*v))).chain([self.error.clone()]).collect()
    }

    fn from_fields(fields: &[String]) -> Option<Self> {
        let [object, press, decoder, values @ .., error] = fields else { return None };
        let values = numbers(values)?;
        let key = Key { object: object.clone(), press: press.clone(), decoder: decoder.clone() };
        (values.len() == NUMBERS.len()).then(|| Self { key, values, error: error.clone() })
    }
}

/// Opens or starts `results.csv`, with the rows of all shards there; or the file of one shard (number, of how many).
pub(super) fn open(folder: &Path, conditions: &str, shard: Option<(usize, usize)>) -> anyhow::Result<RowFile<Row>> {
    let (path, others) = match shard {
        None => (folder.join("results.csv"), shards(folder)?),
        Some((i, n)) => (folder.join(format!("results-{}-of-{n}.csv", i + 1)), Vec::new()),
    };
    RowFile::open(&path, &others, conditions, |_| true)
}

fn shards(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("reading {}", folder.display()))?;
    let mut paths = entries.map(|e| Ok(e?.path())).collect::<anyhow::Result<Vec<_>>>()?;
    paths.retain(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("results-") && name.ends_with(".csv")
    });
    paths.sort();
    Ok(paths)
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
            let mut file = open(folder.path(), "c", Some((i, 2))).expect("new");
            file.push(row(object, "0", "lookup", 0.125, 0.1)).expect("written");
            file.push(row(object, "1", "threshold", 0.5, 0.1)).expect("written");
        }
        let second = folder.path().join("results-2-of-2.csv");
        let text = std::fs::read_to_string(&second).expect("there");
        std::fs::write(&second, &text[..text.len() - 3]).expect("written");
        let all = open(folder.path(), "c", None).expect("merged").finish().expect("written");
        assert_eq!(
            all.iter().map(Row::fields).collect::<Vec<_>>(),
            [
                row("can", "0", "lookup", 0.125, 0.1),
                row("can", "1", "threshold", 0.5, 0.1),
                row("mug, red", "0", "lookup", 0.125, 0.1)
            ]
            .map(|row| row.fields())
        );
        assert_eq!(all[1].value("rmse_mm"), None);
        assert!((all[0].value("rmse_px").expect("there") - 0.125 / 0.0295).abs() < 1e-5);
        assert!(open(folder.path(), "other", None).is_err());
    }
}
