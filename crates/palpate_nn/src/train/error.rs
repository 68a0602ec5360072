use crate::data::DataError;
use crate::weights::WeightsError;
use palpate::io::IoError;
use std::path::PathBuf;

/// A training parameter that makes no sense.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[error("{field} is {found}; {rule}")]
pub struct ConfigError {
    /// Name of the parameter.
    pub field: &'static str,
    /// Its value.
    pub found: f64,
    /// What it must be.
    pub rule: &'static str,
}

/// Why a training run could not go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A parameter is out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A sample cannot be read, or there are none.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A checkpoint or weight file cannot be written or read.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The metrics cannot be written or read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The folder holds another run already.
    #[error("{} holds the checkpoint of a run; resume it or name another folder", folder.display())]
    Occupied {
        /// The folder.
        folder: PathBuf,
    },
    /// There is nothing to resume.
    #[error("{} holds no checkpoint to resume from; start the run without resuming", folder.display())]
    NoCheckpoint {
        /// The folder.
        folder: PathBuf,
    },
    /// The checkpoint belongs to a run that cannot be continued with these parameters.
    #[error("{}: the run was started with {field} {found}, now it is {needed}; resume it with the same", path.display())]
    OtherRun {
        /// The checkpoint.
        path: PathBuf,
        /// Name of the parameter.
        field: &'static str,
        /// Value in the checkpoint.
        found: String,
        /// Value now.
        needed: String,
    },
    /// `metrics.csv` has other columns or a row that is no row.
    #[error("{}: line {line} is not a row of this run: {reason}", path.display())]
    Metrics {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// The loss or the gradient is NaN or infinite.
    #[error("training diverged: {what} is {found} at step {step}; lower the learning rate or the gradient clip")]
    Diverged {
        /// Which number.
        what: &'static str,
        /// Its value.
        found: f64,
        /// The step.
        step: usize,
    },
    /// Training samples are fewer than one batch can use.
    #[error("{found} training samples; at least {needed} are required")]
    TooFewSamples {
        /// Samples there are.
        found: usize,
        /// Samples needed.
        needed: usize,
    },
}
