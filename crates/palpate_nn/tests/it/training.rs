use crate::presses::{presses, split, task, tiny};
use burn::module::AutodiffModule as _;
use burn::tensor::Tensor;
use palpate_nn::config::TrainConfig;
use palpate_nn::data::{Augment, DataError, Parts};
use palpate_nn::fcrn::Fcrn;
use palpate_nn::tactile::{FcrnTask, TactileBatch};
use palpate_nn::train::{Ended, Event, Metric, MetricLog, Outcome, RunFolder, Schedule, Task, TrainError, train};
use palpate_nn::weights::{Architecture, Precision, Provenance, TensorFile, WeightFile, named_tensors};
use palpate_nn::{Cpu, CpuAutodiff, CpuDevice};
use rand_pcg::Pcg64;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Mutex;
use tempfile::TempDir;

fn folder() -> (TempDir, RunFolder) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = RunFolder::new(folder.path());
    (folder, run)
}

/// Trains until `stop` steps are done.
fn run(
    config: &TrainConfig,
    folder: &RunFolder,
    resume: bool,
    stop: usize,
) -> Result<Outcome<Fcrn<CpuAutodiff>>, TrainError> {
    let samples = presses(18, 64, 64);
    let mut watch = |event: Event<'_>| match event {
        Event::Step { step, .. } if step == stop => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let task = task(&samples, config.clone());
    train::<CpuAutodiff, _>(&task, &config.run, folder, resume, &CpuDevice, &mut watch)
}

#[test]
fn a_small_network_learns_a_small_batch_by_heart() {
    for preset in ["reduced-height-map", "reduced-contact-mask"] {
        let mut config = tiny(preset);
        config.network.dropout = 0.0;
        config.augment = Augment::default();
        config.run.learning_rate = 0.01;
        config.run.schedule = Schedule::Constant;
        config.run.epochs = 1;
        let samples = presses(4, 64, 64);
        let parts = Parts { train: (0..4).cycle().take(4 * 30).collect(), validation: vec![0], test: vec![] };
        let task = palpate_nn::tactile::FcrnTask::new(&samples, parts, config.clone(), "tiny", "test");
        let mut losses = Vec::new();
        let mut watch = |event: Event<'_>| {
            if let Event::Step { loss, .. } = event {
                losses.push(loss);
            }
            ControlFlow::Continue(())
        };
        let (_guard, folder) = folder();
        train::<CpuAutodiff, _>(&task, &config.run, &folder, false, &CpuDevice, &mut watch).expect("trained");
        let (first, last) = (losses[0], losses[25..].iter().sum::<f64>() / 5.0);
        assert!(last < 0.5 * first, "{preset}: {first} → {last}: {losses:?}");
    }
}

#[test]
fn a_resumed_run_gives_the_same_bytes() {
    // 12 training presses in batches of 4: three steps an epoch, so that step 4 stops inside one.
    let mut config = tiny("reduced-height-map");
    config.run.epochs = 2;
    let (_a, straight) = folder();
    let (_b, parted) = folder();
    let whole = run(&config, &straight, false, usize::MAX).expect("trained");
    assert_eq!((whole.ended, whole.step), (Ended::Finished, 6));
    assert_eq!(run(&config, &parted, false, 4).expect("trained").ended, Ended::Stopped);
    let rest = run(&config, &parted, true, usize::MAX).expect("resumed");
    assert_eq!(rest.step, 6);
    assert_eq!(named_tensors(&whole.model.valid()), named_tensors(&rest.model.valid()));
    let checkpoint = |f: &RunFolder| TensorFile::open(&f.checkpoint()).expect("readable").tensors;
    assert_eq!(checkpoint(&straight), checkpoint(&parted), "moments too");
    let bytes = |f: &RunFolder| std::fs::read(f.best()).expect("readable");
    assert!(bytes(&straight) == bytes(&parted), "best weights differ");
    let rows = |f: &RunFolder| MetricLog::open(&f.metrics()).expect("readable").rows;
    let (a, b) = (rows(&straight), rows(&parted));
    assert_eq!(a.len(), 2);
    for (a, b) in a.iter().zip(&b) {
        assert_eq!((a.step, a.train_loss, &a.values), (b.step, b.train_loss, &b.values));
    }
}

#[test]
fn rows_after_the_checkpoint_are_dropped_on_resume_and_other_runs_are_refused() {
    let mut config = tiny("reduced-contact-mask");
    config.run.epochs = 2;
    let (_guard, folder) = folder();
    run(&config, &folder, false, 3).expect("trained");
    assert!(matches!(run(&config, &folder, false, 3), Err(TrainError::Occupied { .. })));

    let mut other = config.clone();
    other.run.seed = 9;
    let error = run(&other, &folder, true, 3).expect_err("another seed").to_string();
    assert!(error.contains("seed 0, now it is 9"), "{error}");
    other = config.clone();
    other.network.width = 3;
    let error = run(&other, &folder, true, 3).expect_err("another network").to_string();
    assert!(error.contains("\"width\":2") && error.contains("\"width\":3"), "{error}");

    // As if the run had been killed after it appended a row and before it replaced the checkpoint.
    let text = std::fs::read_to_string(folder.metrics()).expect("readable");
    std::fs::write(folder.metrics(), format!("{text}5,1.6,0.1,0.2,0.3,0.4,0.5,9\n")).expect("written");
    run(&config, &folder, true, usize::MAX).expect("resumed");
    let steps: Vec<_> = MetricLog::open(&folder.metrics()).expect("readable").rows.iter().map(|r| r.step).collect();
    assert_eq!(steps, [3, 6]);
}

/// An [`FcrnTask`] whose validations and losses go as a test needs them.
struct Scripted<'a> {
    task: FcrnTask<'a>,
    /// First metric of each validation.
    validations: Mutex<VecDeque<f64>>,
    /// What the loss of each step is multiplied by; 1 once they are used up.
    losses: Mutex<VecDeque<f32>>,
}

impl<'a> Scripted<'a> {
    fn new(task: FcrnTask<'a>, validations: &[f64], losses: &[f32]) -> Self {
        let validations = Mutex::new(validations.iter().copied().collect());
        let losses = Mutex::new(losses.iter().copied().collect());
        Self { task, validations, losses }
    }
}

impl Task<CpuAutodiff> for Scripted<'_> {
    type Model = Fcrn<CpuAutodiff>;
    type Batch = TactileBatch;

    fn architecture(&self) -> Architecture {
        Task::<CpuAutodiff>::architecture(&self.task)
    }
    fn provenance(&self) -> Provenance {
        Task::<CpuAutodiff>::provenance(&self.task)
    }
    fn model(&self, seed: u64, device: &CpuDevice) -> Fcrn<CpuAutodiff> {
        self.task.model(seed, device)
    }
    fn training_samples(&self) -> usize {
        Task::<CpuAutodiff>::training_samples(&self.task)
    }
    fn batch(&self, indices: &[usize], rng: &mut Pcg64) -> Result<TactileBatch, DataError> {
        Task::<CpuAutodiff>::batch(&self.task, indices, rng)
    }
    fn loss(
        &self,
        model: &Fcrn<CpuAutodiff>,
        batch: TactileBatch,
        rng: &mut Pcg64,
        device: &CpuDevice,
    ) -> Tensor<CpuAutodiff, 1> {
        let factor = self.losses.lock().expect("one thread").pop_front().unwrap_or(1.0);
        self.task.loss(model, batch, rng, device).mul_scalar(factor)
    }
    fn metrics(&self) -> &[Metric] {
        Task::<CpuAutodiff>::metrics(&self.task)
    }
    fn validate(&self, model: &Fcrn<Cpu>, device: &CpuDevice) -> Result<Vec<f64>, DataError> {
        let mut values = Task::<CpuAutodiff>::validate(&self.task, model, device)?;
        values[0] = self.validations.lock().expect("one thread").pop_front().unwrap_or(values[0]);
        Ok(values)
    }
}

/// A run of six epochs of one step, each with a validation.
fn short(preset: &str) -> TrainConfig {
    let mut config = tiny(preset);
    (config.run.epochs, config.run.batch_size, config.run.validate_every) = (6, 12, 1);
    config
}

fn run_scripted(
    config: &TrainConfig,
    folder: &RunFolder,
    validations: &[f64],
    losses: &[f32],
) -> Result<Outcome<Fcrn<CpuAutodiff>>, TrainError> {
    let samples = presses(18, 64, 64);
    let task = Scripted::new(task(&samples, config.clone()), validations, losses);
    train::<CpuAutodiff, _>(&task, &config.run, folder, false, &CpuDevice, &mut |_| ControlFlow::Continue(()))
}

#[test]
fn patience_ends_a_run_that_does_not_improve_and_the_best_weights_can_be_used() {
    let mut config = short("reduced-contact-mask");
    config.run.patience = 2;
    let (_guard, folder) = folder();
    // Higher is better; an equal value is no improvement.
    let outcome = run_scripted(&config, &folder, &[0.5, 0.4, 0.6, 0.6, 0.3], &[]).expect("trained");
    assert_eq!((outcome.ended, outcome.step, outcome.best), (Ended::Patience, 5, Some((3, 0.6))));
    let file = WeightFile::open(&folder.best()).expect("kept");
    assert_eq!((file.provenance.sensor.as_str(), file.provenance.input), ("ycb-sight", (64, 64)));
    let shape = file.config("fcrn", 1).expect("an FCRN");
    let model = Fcrn::<Cpu>::zeros(shape, &CpuDevice).expect("valid");
    file.load_into(model, &shape.architecture()).expect("fits");
}

#[test]
fn patience_counts_from_the_last_improvement() {
    let mut config = short("reduced-height-map");
    config.run.patience = 2;
    let (_guard, folder) = folder();
    // Lower is better.
    let outcome = run_scripted(&config, &folder, &[0.5, 0.6, 0.4, 0.5, 0.3, 0.4], &[]).expect("trained");
    assert_eq!((outcome.ended, outcome.step, outcome.best), (Ended::Finished, 6, Some((5, 0.3))));
}

#[test]
fn a_diverged_run_says_so_and_keeps_no_broken_weights() {
    let mut config = short("reduced-height-map");
    let (_a, loss) = folder();
    let error = run_scripted(&config, &loss, &[], &[1.0, 1.0, f32::NAN]).expect_err("diverged");
    assert!(matches!(error, TrainError::Diverged { what: "the loss", found, step: 2 } if found.is_nan()), "{error}");
    config.run.clip_norm = 1.0;
    let (_b, gradient) = folder();
    // The loss is finite in f32, the square of the gradient is not.
    let error = run_scripted(&config, &gradient, &[], &[1.0, 1.0, 1e37]).expect_err("diverged");
    let named = matches!(error, TrainError::Diverged { what: "the gradient's norm", step: 2, .. });
    assert!(named && error.to_string().contains("lower the learning rate"), "{error}");
    for folder in [loss, gradient] {
        assert_eq!(MetricLog::open(&folder.metrics()).expect("readable").rows.len(), 2);
        for file in [folder.best(), folder.checkpoint()] {
            let tensors = TensorFile::open(&file).expect("of the step before").tensors;
            assert!(tensors.values().all(|t| t.values.iter().all(|v| v.is_finite())));
        }
    }
}

#[test]
fn an_empty_set_and_a_part_without_presses_are_named() {
    let error = Parts::of(&presses(0, 8, 8), &split()).expect_err("empty").to_string();
    assert!(error.contains("holds no presses"), "{error}");
    let error = Parts::of(&presses(2, 8, 8), &split()).expect_err("no 002").to_string();
    assert!(error.contains("validation") && error.contains("2 presses"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up_while_training_ends_the_run_with_its_reason() {
    let mut config = tiny("reduced-contact-mask");
    config.run.epochs = 2;
    for file in ["checkpoint.safetensors", "best.safetensors", "metrics.csv"] {
        let samples = presses(18, 64, 64);
        let (_guard, folder) = folder();
        let path = folder.path().join(file);
        // /dev/full refuses every byte as a full disk does; the loop finds it where its file would be.
        let mut watch = |event: Event<'_>| {
            if let Event::Step { step: 1, .. } = event {
                let _ = std::fs::remove_file(&path);
                std::os::unix::fs::symlink("/dev/full", &path).expect("linked");
            }
            ControlFlow::Continue(())
        };
        let task = task(&samples, config.clone());
        let error = train::<CpuAutodiff, _>(&task, &config.run, &folder, false, &CpuDevice, &mut watch)
            .expect_err("nothing fits on the disk");
        let mut reasons = vec![error.to_string()];
        let mut source = std::error::Error::source(&error);
        while let Some(reason) = source {
            reasons.push(reason.to_string());
            source = reason.source();
        }
        let reasons = reasons.join(": ");
        assert!(reasons.contains(file) && reasons.contains("No space left"), "{reasons}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_named_and_the_old_checkpoint_survives() {
    use std::io::Write as _;
    let (_guard, folder) = folder();
    let config = tiny("reduced-contact-mask");
    run(&config, &folder, false, 1).expect("trained");
    let old = std::fs::read(folder.checkpoint()).expect("there");

    // /dev/full refuses every byte as a full disk does.
    let file = TensorFile::open(&folder.checkpoint()).expect("readable");
    let error = file.save(std::path::Path::new("/dev/full"), Precision::F32).expect_err("full");
    let source = std::error::Error::source(&error).expect("the system's reason").to_string();
    assert!(error.to_string().contains("/dev/full") && source.contains("No space left"), "{error}: {source}");

    // A disk that fills up in the middle of the file.
    let result = palpate::io::atomic_write(folder.checkpoint(), |out| {
        file.write(&mut Budget { out, left: old.len() / 2 }, Precision::F32)?;
        out.flush()
    });
    assert!(result.is_err());
    assert!(std::fs::read(folder.checkpoint()).expect("there") == old);
    run(&config, &folder, true, 2).expect("resumed from the old one");
}

/// A disk with so many bytes left.
struct Budget<'a, W> {
    out: &'a mut W,
    left: usize,
}

impl<W: std::io::Write> std::io::Write for Budget<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if bytes.len() > self.left {
            return Err(std::io::ErrorKind::StorageFull.into());
        }
        self.left -= bytes.len();
        self.out.write(bytes)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}
