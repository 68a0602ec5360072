//! One training loop for every network.
//!
//! A network becomes trainable by implementing [`Task`]: how to make it, how to make batches, its loss and its metrics.
//! [`train`] does the rest: shuffling, learning rate, gradient clipping, validation, the best weights, checkpoints, resuming.
//!
//! The order of the samples and every random choice follow from (seed, step) alone, so a run that is stopped and resumed gives
//! on the CPU the same bytes as one that was not.
//!
//! A run's folder holds `checkpoint.safetensors` (to resume), `best.safetensors` (weights of the best validation) and
//! `metrics.csv`.

mod checkpoint;
mod config;
mod error;
mod metrics;
mod optimizer;
mod run;
mod task;

pub use config::{LoopConfig, OptimizerConfig, Schedule};
pub use error::{ConfigError, TrainError};
pub use metrics::{MetricLog, MetricRow};
pub use run::{Ended, Event, Outcome, RunFolder, train};
pub use task::{Better, Metric, Task};
