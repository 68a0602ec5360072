//! `results.csv`: one row a run.

use super::row_file::{Record, RowFile, number_text, numbers};
use palpate::metrics::Comparison;
use std::path::Path;

/// Numeric columns, by their keys in `palpate compare --json`; `hidden_…` are those of the hidden side.
pub(super) const METRICS: [&str; 22] = [
    "volumetric_iou",
    "chamfer_mean_mm",
    "chamfer_squared_mm2",
    "accuracy_mm",
    "completeness_mm",
    "hausdorff95_mm",
    "normal_consistency",
    "f_score_1mm",
    "f_score_2mm",
    "f_score_5mm",
    "hidden_share",
    "hidden_chamfer_mean_mm",
    "hidden_chamfer_squared_mm2",
    "hidden_accuracy_mm",
    "hidden_completeness_mm",
    "hidden_hausdorff95_mm",
    "hidden_normal_consistency",
    "hidden_f_score_1mm",
    "hidden_f_score_2mm",
    "hidden_f_score_5mm",
    "components",
    "faces",
];
const FIRST: [&str; 7] = ["object", "view", "touches", "method", "symmetry", "touches_used", "watertight"];
const LAST: [&str; 6] = ["seconds", "slowest_stage", "slowest_stage_seconds", "stages", "note", "error"];

/// Which run a row is of.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key {
    pub(super) object: String,
    pub(super) view: usize,
    pub(super) touches: usize,
    pub(super) method: String,
    pub(super) symmetry: String,
}

/// One run: what came out, or why nothing did.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    pub(super) key: Key,
    /// Touches that the scene really had: fewer than asked for if the object offers no more.
    pub(super) touches_used: usize,
    pub(super) watertight: bool,
    /// In the order of [`METRICS`].
    pub(super) metrics: Vec<Option<f64>>,
    pub(super) seconds: f64,
    pub(super) stages: Vec<(String, f64)>,
    pub(super) note: String,
    /// Empty if the run gave a mesh.
    pub(super) error: String,
}

impl Row {
    /// A run that failed.
    pub(super) fn failed(key: Key, touches_used: usize, error: String) -> Self {
        let metrics = vec![None; METRICS.len()];
        Self { key, touches_used, watertight: false, metrics, seconds: 0.0, stages: vec![], note: String::new(), error }
    }

    /// Fills in what a comparison found.
    pub(super) fn with_comparison(mut self, comparison: &Comparison) -> anyhow::Result<Self> {
        let json = serde_json::to_value(comparison)?;
        self.metrics = METRICS
            .iter()
            .map(|name| match name.strip_prefix("hidden_") {
                Some(name) => json["hidden"][name].as_f64(),
                None => json[*name].as_f64(),
            })
            .collect();
        self.watertight = comparison.watertight;
        self.note = comparison.note.clone().unwrap_or_default();
        self.error = String::new();
        Ok(self)
    }

    /// A metric by name; `None` if it is not defined for this run.
    pub(super) fn metric(&self, name: &str) -> Option<f64> {
        METRICS.iter().position(|m| *m == name).and_then(|i| self.metrics[i])
    }

    fn slowest(&self) -> (&str, f64) {
        self.stages.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(("", 0.0), |(name, s)| (name, *s))
    }
}

impl Record for Row {
    type Key = Key;

    fn columns() -> Vec<&'static str> {
        FIRST.iter().chain(&METRICS).chain(&LAST).copied().collect()
    }

    fn key(&self) -> &Key {
        &self.key
    }

    fn fields(&self) -> Vec<String> {
        let key = &self.key;
        let (slowest, slowest_seconds) = self.slowest();
        let stages: Vec<String> = self.stages.iter().map(|(name, s)| format!("{name}={s:.4}")).collect();
        [key.object.clone(), key.view.to_string(), key.touches.to_string(), key.method.clone(), key.symmetry.clone()]
            .into_iter()
            .chain([self.touches_used.to_string(), self.watertight.to_string()])
            .chain(self.metrics.iter().map(|v| number_text(*v)))
            .chain([format!("{:.4}", self.seconds), slowest.to_owned(), format!("{slowest_seconds:.4}")])
            .chain([stages.join(";"), self.note.clone(), self.error.clone()])
            .collect()
    }

    fn from_fields(fields: &[String]) -> Option<Self> {
        let [object, view, touches, method, symmetry, touches_used, watertight, rest @ ..] = fields else {
            return None;
        };
        let (metrics, last) = rest.split_at_checked(METRICS.len())?;
        let [seconds, _, _, stages, note, error] = last else { return None };
        let stages = stages.split(';').filter(|s| !s.is_empty()).map(|stage| {
            let (name, seconds) = stage.split_once('=')?;
            Some((name.to_owned(), seconds.parse().ok()?))
        });
        Some(Self {
            key: Key {
                object: object.clone(),
                view: view.parse().ok()?,
                touches: touches.parse().ok()?,
                method: method.clone(),
                symmetry: symmetry.clone(),
            },
            touches_used: touches_used.parse().ok()?,
            watertight: watertight.parse().ok()?,
            metrics: numbers(metrics)?,
            seconds: seconds.parse().ok()?,
            stages: stages.collect::<Option<_>>()?,
            note: note.clone(),
            error: error.clone(),
        })
    }
}

/// Opens or starts the file; the rows of failed runs are dropped if they shall be tried again.
pub(super) fn open(path: &Path, conditions: &str, retry_failed: bool) -> anyhow::Result<RowFile<Row>> {
    RowFile::open(path, &[], conditions, |row: &Row| row.error.is_empty() || !retry_failed)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A run with the given IoU and Chamfer distance.
    pub(in super::super) fn row(object: &str, touches: usize, method: &str, iou: f64) -> Row {
        let symmetry = "estimated".to_owned();
        let key = Key { object: object.to_owned(), view: 0, touches, method: method.to_owned(), symmetry };
        let mut row = Row::failed(key, touches, String::new());
        row.metrics = METRICS.iter().map(|m| m.ends_with("_iou").then_some(iou).or(Some(2.0 - iou))).collect();
        row.seconds = 1.25;
        row.stages = vec![("see".to_owned(), 0.5), ("mesh".to_owned(), 0.75)];
        row
    }

    #[test]
    fn rows_survive_the_file() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("results.csv");
        let mut bad = Row::failed(row("a", 0, "fused", 0.5).key, 0, "no \"plane\", none\nat all".to_owned());
        let mut file = open(&path, "conditions", false).expect("a new file");
        file.push(row("b, c", 5, "fused", 0.75)).expect("written");
        file.push(bad.clone()).expect("written");
        bad.error = "no \"plane\", none at all".to_owned();

        let again = open(&path, "conditions", false).expect("the same file");
        assert_eq!(again.rows, [bad.clone(), row("b, c", 5, "fused", 0.75)]);
        assert!(again.contains(&bad.key) && !again.contains(&row("b", 5, "fused", 0.0).key));
        let retried = open(&path, "conditions", true).expect("the same file");
        assert_eq!(retried.rows.len(), 1);
        assert!(open(&path, "others", false).is_err());
    }

    #[test]
    fn a_row_cut_short_is_dropped() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("results.csv");
        let mut file = open(&path, "conditions", false).expect("a new file");
        file.push(row("a", 0, "fused", 0.5)).expect("written");
        file.push(row("b", 0, "fused", 0.5)).expect("written");
        let text = std::fs::read_to_string(&path).expect("there");
        for cut in [1, 10, 100] {
            std::fs::write(&path, &text[..text.len() - cut]).expect("written");
            let file = open(&path, "conditions", false).expect("readable");
            assert_eq!(file.rows, [row("a", 0, "fused", 0.5)], "{cut} bytes missing");
        }
    }
}
