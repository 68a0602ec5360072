use super::optimizer::Optimizer;
use super::{Task, TrainError};
use crate::weights::{Architecture, NamedTensors, Precision, Provenance, TensorFile, WeightFile, WeightsError};
use crate::weights::{load_tensors, named_tensors};
use burn::module::AutodiffModule;
use burn::tensor::backend::AutodiffBackend;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Where a run stands, besides its tensors.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Progress {
    /// Steps done.
    pub(super) step: usize,
    /// Best value of the first metric and its step.
    pub(super) best: Option<(usize, f64)>,
    /// Validations since the best one.
    pub(super) since_best: usize,
    /// Sum and number of training losses since the last validation.
    pub(super) losses: (f64, usize),
    /// Seconds of training.
    pub(super) seconds: f64,
    /// What must not change when the run is resumed.
    pub(super) seed: u64,
    pub(super) batch_size: usize,
    pub(super) samples: usize,
}

const STATE: &str = "training_state";

#[derive(Serialize, Deserialize)]
struct State {
    progress: Progress,
    times: BTreeMap<String, usize>,
}

/// Everything that the next step depends on, in one file: a single rename replaces the checkpoint before.
pub(super) fn save<B: AutodiffBackend, M: AutodiffModule<B>>(
    path: &Path,
    model: &M,
    optimizer: &Optimizer<B::InnerBackend>,
    progress: &Progress,
    (architecture, provenance): (Architecture, Provenance),
) -> Result<(), WeightsError> {
    let mut tensors = NamedTensors::new();
    let times = optimizer.state(&mut tensors);
    tensors.extend(named_tensors(&model.valid()).into_iter().map(|(name, t)| (format!("model.{name}"), t)));
    let mut metadata = WeightFile::of_tensors(NamedTensors::new(), architecture, provenance).to_file().metadata;
    let state = State { progress: progress.clone(), times };
    metadata.insert(STATE.to_owned(), serde_json::to_string(&state).expect("a plain struct"));
    TensorFile { metadata, tensors }.save(path, Precision::F32)
}

/// Undoes [`save`].
pub(super) fn load<B: AutodiffBackend, T: Task<B>>(
    path: &Path,
    task: &T,
    optimizer: &mut Optimizer<B::InnerBackend>,
    now: &Progress,
    device: &B::Device,
) -> Result<(T::Model, Progress), TrainError> {
    let mut file = TensorFile::open(path)?;
    let no_state = || WeightsError::Metadata { path: path.to_owned(), key: STATE };
    let state = file.metadata.remove(STATE).ok_or_else(no_state)?;
    let State { progress, times } = serde_json::from_str(&state).map_err(|_| no_state())?;
    let weights = WeightFile::from_file(file, path)?;
    weights.check(&task.architecture())?;
    for (field, found, needed) in [
        ("seed", progress.seed, now.seed),
        ("batch_size", progress.batch_size as u64, now.batch_size as u64),
        ("number of training samples", progress.samples as u64, now.samples as u64),
    ] {
        if found != needed {
            let (path, found, needed) = (path.to_owned(), found.to_string(), needed.to_string());
            return Err(TrainError::OtherRun { path, field, found, needed });
        }
    }
    let mut tensors = weights.tensors;
    optimizer.restore(&mut tensors, times, device).map_err(|tensor| WeightsError::Missing {
        path: path.to_owned(),
        tensor,
        needed: Vec::new(),
    })?;
    let tensors =
        tensors.into_iter().map(|(name, t)| (name.strip_prefix("model.").unwrap_or(&name).to_owned(), t)).collect();
    Ok((load_tensors(task.model(now.seed, device), tensors, path)?, progress))
}
