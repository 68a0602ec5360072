use super::checkpoint::{self, Progress};
use super::optimizer::{Optimizer, gradient_norm};
use super::{Better, LoopConfig, MetricLog, MetricRow, Task, TrainError};
use crate::data::DataError;
use crate::random::{Purpose, generator, order};
use crate::weights::{Precision, WeightFile, host_values};
use burn::module::AutodiffModule as _;
use burn::optim::GradientsParams;
use burn::tensor::backend::AutodiffBackend;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Instant;

/// Names of a run's files.
#[derive(Debug, Clone)]
pub struct RunFolder(PathBuf);

impl RunFolder {
    /// * `path` – an existing folder
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// Everything needed to resume.
    pub fn checkpoint(&self) -> PathBuf {
        self.0.join("checkpoint.safetensors")
    }

    /// Weights of the best validation.
    pub fn best(&self) -> PathBuf {
        self.0.join("best.safetensors")
    }

    /// One row per validation.
    pub fn metrics(&self) -> PathBuf {
        self.0.join("metrics.csv")
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

/// What happened in a run just now.
#[derive(Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// A step was made.
    Step {
        /// Steps done.
        step: usize,
        /// Steps of the whole run.
        steps: usize,
        /// Loss of its batch.
        loss: f64,
    },
    /// The network was validated and a row added; the checkpoint is written.
    Validated {
        /// All rows so far.
        log: &'a MetricLog,
        /// Whether these are the best weights so far.
        best: bool,
    },
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// All epochs are done.
    Finished,
    /// No improvement for as many validations as the patience allows.
    Patience,
    /// The caller asked for it; the run can be resumed.
    Stopped,
}

/// What a run leaves besides its files.
#[derive(Debug)]
pub struct Outcome<M> {
    /// The network after the last step.
    pub model: M,
    /// Step and value of the best validation.
    pub best: Option<(usize, f64)>,
    /// Steps done.
    pub step: usize,
    /// Why it ended.
    pub ended: Ended,
}

/// Trains a network, or goes on where a run stopped.
///
/// Per step: batch (prepared ahead on another thread), loss, gradient, clip, optimizer. Every validation appends to the
/// metrics, keeps the weights if the first metric is the best so far, and replaces the checkpoint.
///
/// * `folder` – exists; without `resume` it holds no checkpoint
/// * `watch` – called after every step and validation; `Break` writes a checkpoint and ends the run
///
/// # Errors
/// [`TrainError`]. What earlier checkpoints hold stays readable.
pub fn train<B: AutodiffBackend, T: Task<B>>(
    task: &T,
    config: &LoopConfig,
    folder: &RunFolder,
    resume: bool,
    device: &B::Device,
    watch: &mut dyn FnMut(Event<'_>) -> ControlFlow<()>,
) -> Result<Outcome<T::Model>, TrainError> {
    config.validate()?;
    let samples = task.training_samples();
    if samples == 0 {
        return Err(TrainError::TooFewSamples { found: 0, needed: 1 });
    }
    let plan = Plan { config, samples, per_epoch: (samples / config.batch_size).max(1) };
    let mut run = Run::start(task, plan, folder, resume, device)?;
    // The loader may be two batches ahead.
    let ended = std::thread::scope(|scope| {
        let (sender, batches) = sync_channel(1);
        let first = run.progress.step;
        scope.spawn(move || load_batches(task, plan, first, &sender));
        run.steps(&batches, watch)
    })?;
    let Run { model, progress, .. } = run;
    Ok(Outcome { model, best: progress.best, step: progress.step, ended })
}

/// Which samples make which step.
#[derive(Clone, Copy)]
struct Plan<'a> {
    config: &'a LoopConfig,
    samples: usize,
    per_epoch: usize,
}

impl Plan<'_> {
    fn steps(&self) -> usize {
        self.per_epoch * self.config.epochs
    }

    fn validates_after(&self, steps: usize) -> bool {
        let every = if self.config.validate_every == 0 { self.per_epoch } else { self.config.validate_every };
        steps.is_multiple_of(every) || steps == self.steps()
    }
}

fn load_batches<B: AutodiffBackend, T: Task<B>>(
    task: &T,
    plan: Plan<'_>,
    first: usize,
    sender: &SyncSender<Result<T::Batch, DataError>>,
) {
    let seed = plan.config.seed;
    let mut epoch = (usize::MAX, Vec::new());
    for step in first..plan.steps() {
        if epoch.0 != step / plan.per_epoch {
            epoch = (step / plan.per_epoch, order(seed, step / plan.per_epoch, plan.samples));
        }
        let start = step % plan.per_epoch * plan.config.batch_size;
        let indices = &epoch.1[start..(start + plan.config.batch_size).min(plan.samples)];
        let batch = task.batch(indices, &mut generator(seed, Purpose::Batch, step));
        let failed = batch.is_err();
        // The receiver is gone once the run has ended.
        if sender.send(batch).is_err() || failed {
            return;
        }
    }
}

struct Run<'a, B: AutodiffBackend, T: Task<B>> {
    task: &'a T,
    plan: Plan<'a>,
    folder: &'a RunFolder,
    device: &'a B::Device,
    model: T::Model,
    optimizer: Optimizer<B::InnerBackend>,
    progress: Progress,
    log: MetricLog,
    clock: Instant,
}

impl<'a, B: AutodiffBackend, T: Task<B>> Run<'a, B, T> {
    fn start(
        task: &'a T,
        plan: Plan<'a>,
        folder: &'a RunFolder,
        resume: bool,
        device: &'a B::Device,
    ) -> Result<Self, TrainError> {
        let LoopConfig { seed, batch_size, optimizer, .. } = *plan.config;
        let mut optimizer = Optimizer::new(optimizer);
        let new = Progress { seed, batch_size, samples: plan.samples, ..Progress::default() };
        let path = folder.checkpoint();
        let (model, progress, log) = match (resume, path.exists()) {
            (false, true) => return Err(TrainError::Occupied { folder: folder.path().to_owned() }),
            (true, false) => return Err(TrainError::NoCheckpoint { folder: folder.path().to_owned() }),
            (false, false) => {
                let log = MetricLog::create(&folder.metrics(), task.metrics())?;
                (task.model(seed, device), new, log)
            }
            (true, true) => {
                let (model, progress) = checkpoint::load(&path, task, &mut optimizer, &new, device)?;
                let mut log = MetricLog::open(&folder.metrics())?;
                log.cut(progress.step)?;
                (model, progress, log)
            }
        };
        Ok(Self { task, plan, folder, device, model, optimizer, progress, log, clock: Instant::now() })
    }

    fn steps(
        &mut self,
        batches: &Receiver<Result<T::Batch, DataError>>,
        watch: &mut dyn FnMut(Event<'_>) -> ControlFlow<()>,
    ) -> Result<Ended, TrainError> {
        let patience = self.plan.config.patience;
        while self.progress.step < self.plan.steps() {
            let Ok(batch) = batches.recv() else { break };
            let loss = self.step(batch?)?;
            let (step, steps) = (self.progress.step, self.plan.steps());
            let mut flow = watch(Event::Step { step, steps, loss });
            if self.plan.validates_after(step) {
                let best = self.validate()?;
                self.checkpoint()?;
                let after = watch(Event::Validated { log: &self.log, best });
                if patience > 0 && self.progress.since_best >= patience {
                    return Ok(Ended::Patience);
                }
                flow = if after.is_break() { after } else { flow };
            }
            if flow.is_break() {
                self.checkpoint()?;
                return Ok(Ended::Stopped);
            }
        }
        Ok(Ended::Finished)
    }

    fn rate(&self, step: usize) -> f64 {
        let LoopConfig { schedule, learning_rate, .. } = *self.plan.config;
        schedule.rate(learning_rate, step, self.plan.per_epoch, self.plan.steps())
    }

    fn step(&mut self, batch: T::Batch) -> Result<f64, TrainError> {
        let step = self.progress.step;
        let finite = |what, found: f64| {
            if found.is_finite() { Ok(found) } else { Err(TrainError::Diverged { what, found, step }) }
        };
        let mut rng = generator(self.plan.config.seed, Purpose::Dropout, step);
        let loss = self.task.loss(&self.model, batch, &mut rng, self.device);
        let value = finite("the loss", f64::from(host_values(loss.clone().inner())[0]))?;
        let grads = GradientsParams::from_grads(loss.backward(), &self.model);
        let clip = self.plan.config.clip_norm;
        let scale =
            if clip > 0.0 { clip / finite("the gradient's norm", gradient_norm(&self.model, &grads))? } else { 1.0 };
        let rate = self.rate(step);
        self.model = self.optimizer.step::<B, _>(self.model.clone(), grads, rate, scale);
        self.progress.step += 1;
        self.progress.losses.0 += value;
        self.progress.losses.1 += 1;
        Ok(value)
    }

    /// Whether the weights are the best so far.
    fn validate(&mut self) -> Result<bool, TrainError> {
        let model = self.model.valid();
        let values = self.task.validate(&model, self.device)?;
        debug_assert_eq!(values.len(), self.task.metrics().len());
        let (metric, value, step) = (self.task.metrics()[0], values[0], self.progress.step);
        let best = match (self.progress.best, metric.better) {
            (None, _) => value.is_finite(),
            (Some((_, best)), Better::Lower) => value < best,
            (Some((_, best)), Better::Higher) => value > best,
        };
        if best {
            let (architecture, provenance) = (self.task.architecture(), self.task.provenance());
            WeightFile::of(&model, architecture, provenance).save(&self.folder.best(), Precision::F32)?;
            self.progress.best = Some((step, value));
            self.progress.since_best = 0;
        } else {
            self.progress.since_best += 1;
        }
        let (sum, count) = std::mem::take(&mut self.progress.losses);
        self.log.push(MetricRow {
            step,
            epoch: step as f64 / self.plan.per_epoch as f64,
            learning_rate: self.rate(step - 1),
            train_loss: sum / count.max(1) as f64,
            values,
            seconds: self.progress.seconds + self.clock.elapsed().as_secs_f64(),
        })?;
        Ok(best)
    }

    fn checkpoint(&mut self) -> Result<(), TrainError> {
        self.progress.seconds += std::mem::replace(&mut self.clock, Instant::now()).elapsed().as_secs_f64();
        let origin = (self.task.architecture(), self.task.provenance());
        Ok(checkpoint::save(&self.folder.checkpoint(), &self.model, &self.optimizer, &self.progress, origin)?)
    }
}
