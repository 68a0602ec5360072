use super::{Metric, TrainError};
use palpate::io::{IoError, read_text, write_text};
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// One validation of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct MetricRow {
    /// Steps done.
    pub step: usize,
    /// Epochs done, with the part of the current one.
    pub epoch: f64,
    /// Learning rate of the last step.
    pub learning_rate: f64,
    /// Mean training loss since the row before.
    pub train_loss: f64,
    /// Validation metrics, in the order of the log's names.
    pub values: Vec<f64>,
    /// Seconds of training so far, all parts of a resumed run together.
    pub seconds: f64,
}

/// `metrics.csv` of a run: a header, then one row per validation.
#[derive(Debug, Clone, PartialEq)]
pub struct MetricLog {
    path: PathBuf,
    /// Names of the validation metrics.
    pub names: Vec<String>,
    /// Rows so far.
    pub rows: Vec<MetricRow>,
}

const FIRST: [&str; 4] = ["step", "epoch", "learning_rate", "train_loss"];

impl MetricLog {
    /// Starts a file with its header.
    ///
    /// # Errors
    /// [`IoError`] if it cannot be written.
    pub fn create(path: &Path, metrics: &[Metric]) -> Result<Self, IoError> {
        let names = metrics.iter().map(|m| m.name.to_owned()).collect();
        let log = Self { path: path.to_owned(), names, rows: Vec::new() };
        write_text(path, &log.header())?;
        Ok(log)
    }

    /// Reads the file of a run.
    ///
    /// # Errors
    /// [`IoError`] or [`TrainError::Metrics`] with the line.
    pub fn open(path: &Path) -> Result<Self, TrainError> {
        let text = read_text(path)?;
        let wrong = |line, reason: String| TrainError::Metrics { path: path.to_owned(), line, reason };
        let mut lines = text.lines();
        let columns: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let names = match columns.as_slice() {
            [a, b, c, d, names @ .., "seconds"] if [*a, *b, *c, *d] == FIRST => names,
            _ => return Err(wrong(1, format!("the columns must be {}, …, seconds", FIRST.join(", ")))),
        };
        let mut log =
            Self { path: path.to_owned(), names: names.iter().map(|&n| n.to_owned()).collect(), rows: vec![] };
        for (i, line) in lines.enumerate() {
            let numbers: Option<Vec<f64>> = line.split(',').map(|v| v.parse().ok()).collect();
            let row = match numbers.as_deref() {
                Some(&[step, epoch, learning_rate, train_loss, ref values @ .., seconds])
                    if values.len() == names.len() =>
                {
                    let values = values.to_vec();
                    MetricRow { step: step as usize, epoch, learning_rate, train_loss, values, seconds }
                }
                // A run killed while it appended leaves part of a line at the end.
                _ if i + 2 == text.lines().count() && !text.ends_with('\n') => break,
                _ => return Err(wrong(i + 2, format!("{} numbers are needed", columns.len()))),
            };
            log.rows.push(row);
        }
        Ok(log)
    }

    /// Drops the rows after `step`, in the file too.
    ///
    /// # Errors
    /// [`IoError`] if the file cannot be written.
    pub fn cut(&mut self, step: usize) -> Result<(), IoError> {
        self.rows.retain(|row| row.step <= step);
        let text = self.rows.iter().fold(self.header(), |text, row| text + &line(row));
        write_text(&self.path, &text)
    }

    /// Adds a row, in the file too.
    ///
    /// # Errors
    /// [`IoError`] if the file cannot be written.
    pub fn push(&mut self, row: MetricRow) -> Result<(), IoError> {
        let append = || File::options().append(true).open(&self.path)?.write_all(line(&row).as_bytes());
        append().map_err(|source| IoError::Write { path: self.path.clone(), source })?;
        self.rows.push(row);
        Ok(())
    }

    fn header(&self) -> String {
        let names: String = self.names.iter().map(|n| format!("{n},")).collect();
        format!("{},{names}seconds\n", FIRST.join(","))
    }
}

fn line(row: &MetricRow) -> String {
    let mut line = format!("{},{},{},{},", row.step, row.epoch, row.learning_rate, row.train_loss);
    for value in &row.values {
        let _ = write!(line, "{value},");
    }
    let _ = writeln!(line, "{:.1}", row.seconds);
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::Better;

    fn row(step: usize) -> MetricRow {
        let values = vec![0.1 * step as f64];
        MetricRow { step, epoch: 0.5, learning_rate: 1e-5, train_loss: 0.3, values, seconds: 2.0 }
    }

    #[test]
    fn rows_come_back_and_are_cut_after_a_step() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("metrics.csv");
        let mut log = MetricLog::create(&path, &[Metric { name: "rmse_mm", better: Better::Lower }]).expect("new");
        for step in [1, 2, 3] {
            log.push(row(step)).expect("appended");
        }
        assert_eq!(MetricLog::open(&path).expect("readable"), log);
        log.cut(2).expect("rewritten");
        assert_eq!(MetricLog::open(&path).expect("readable").rows, [row(1), row(2)]);
    }

    #[test]
    fn half_a_line_at_the_end_is_forgiven_and_elsewhere_named() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("metrics.csv");
        let header = "step,epoch,learning_rate,train_loss,iou,seconds\n";
        std::fs::write(&path, format!("{header}1,1,0.1,0.5,0.9,3\n2,1,0.")).expect("written");
        assert_eq!(MetricLog::open(&path).expect("readable").rows.len(), 1);
        std::fs::write(&path, format!("{header}2,1,0.\n1,1,0.1,0.5,0.9,3\n")).expect("written");
        let error = MetricLog::open(&path).expect_err("broken").to_string();
        assert!(error.contains("line 2"), "{error}");
    }
}
