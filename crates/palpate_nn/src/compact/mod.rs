//! Training of the compact network that `palpate::tactile::compact` runs: gradient map, then level network, then mask map.
//!
//! Each part is trained on what the parts before it make of the training images, so that it learns their faults too.

mod config;
mod data;
mod export;
mod gradient;
mod level;
mod mask;
mod networks;

pub use config::CompactConfig;
pub use data::LightAugment;
pub use gradient::GradientTask;
pub use level::LevelTask;
pub use mask::MaskTask;
pub use networks::{LevelModule, LocalNetwork};

use crate::data::{DataError, Parts, Samples};
use crate::train::{Ended, Event, RunFolder, TrainError, train};
use crate::weights::{NamedTensors, Provenance, WeightFile};
use burn::tensor::backend::AutodiffBackend;
use data::Press;
use palpate::geometry::Raster;
use palpate::tactile::Integrator;
use palpate::tactile::compact::{GradientMap, LevelNetwork, WORKING_SIZE};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::path::Path;

/// A part of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Colour to steps of the height.
    Gradient,
    /// What integration cannot know.
    Level,
    /// Contact.
    Mask,
}

impl Stage {
    /// All, in the order of training.
    pub const ALL: [Self; 3] = [Self::Gradient, Self::Level, Self::Mask];

    /// Name of its folder in a run.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gradient => "gradient",
            Self::Level => "level",
            Self::Mask => "mask",
        }
    }
}

/// What the training of all parts shares.
#[derive(Clone)]
pub struct CompactTask<'a> {
    samples: &'a dyn Samples,
    parts: &'a Parts,
    augment: LightAugment,
    provenance: Provenance,
    relaxed: Raster<f32>,
    integrator: std::sync::Arc<Integrator>,
}

/// Validation presses of the part that needs most of them; each takes about a hundredth of a second.
const VALIDATION: usize = 400;

impl<'a> CompactTask<'a> {
    /// * `samples` – 320 × 240
    /// * `split`, `command` – for the weight file
    pub fn new(samples: &'a dyn Samples, parts: &'a Parts, config: &CompactConfig, split: &str, command: &str) -> Self {
        let provenance = Provenance {
            sensor: samples.sensor().model.clone(),
            input: WORKING_SIZE,
            split: split.to_owned(),
            seed: config.level.seed,
            command: command.to_owned(),
            run: serde_json::to_string(config).expect("a plain struct"),
        };
        Self {
            samples,
            parts,
            augment: config.augment,
            provenance,
            relaxed: samples.sensor().relaxed(WORKING_SIZE.0, WORKING_SIZE.1),
            integrator: Integrator::new(WORKING_SIZE.0, WORKING_SIZE.1).into(),
        }
    }

    fn load(&self, index: usize, rng: Option<&mut Pcg64>) -> Result<Press, DataError> {
        Press::load(self.samples, index, &self.relaxed, rng.map(|rng| (&self.augment, rng)))
    }

    /// Does something with training presses in parallel; each has a generator of its own.
    fn for_each<T: Send>(
        &self,
        indices: &[usize],
        rng: &mut Pcg64,
        work: impl Fn(usize, Pcg64) -> Result<T, DataError> + Sync,
    ) -> Result<Vec<T>, DataError> {
        let seeds: Vec<(usize, u64)> = indices.iter().map(|&i| (self.parts.train[i], rng.random())).collect();
        seeds.into_par_iter().map(|(index, seed)| work(index, Pcg64::seed_from_u64(seed))).collect()
    }

    /// Validation presses of a part, evenly out of all.
    fn validation(&self, stage: Stage) -> &[usize] {
        let most = if stage == Stage::Level { VALIDATION } else { VALIDATION / 4 };
        let all = &self.parts.validation;
        &all[..all.len().min(most)]
    }
}

/// Trains all parts and writes `compact.safetensors` (float16) into the folder.
///
/// Parts that are complete are not trained again, so that calling it with `resume` goes on after any interruption. Nothing is
/// written if the run was stopped.
///
/// * `folder` – exists; each part gets a folder in it
/// * `watch` – called after every step and validation of every part; `Break` ends the run, which can be resumed
///
/// # Errors
/// [`TrainError`].
pub fn train_compact<B: AutodiffBackend>(
    task: &CompactTask<'_>,
    config: &CompactConfig,
    folder: &Path,
    resume: bool,
    device: &B::Device,
    watch: &mut dyn FnMut(Stage, Event<'_>) -> ControlFlow<()>,
) -> Result<Ended, TrainError> {
    config.validate()?;
    let mut tensors = NamedTensors::new();
    let part = |stage: Stage| -> Result<(RunFolder, bool), TrainError> {
        let path = folder.join(stage.name());
        palpate::io::create_folder(&path)?;
        let run = RunFolder::new(path);
        let again = resume && run.checkpoint().exists();
        Ok((run, again))
    };
    let best = |run: &RunFolder, stage: Stage| -> Result<NamedTensors, TrainError> {
        Ok(export::named(stage.name(), &WeightFile::open(&run.best())?.tensors))
    };

    let (run, again) = part(Stage::Gradient)?;
    let gradient = GradientTask(task.clone());
    let done =
        train::<B, _>(&gradient, &config.gradient, &run, again, device, &mut |event| watch(Stage::Gradient, event))?;
    if done.ended == Ended::Stopped {
        return Ok(Ended::Stopped);
    }
    tensors.extend(best(&run, Stage::Gradient)?);
    let loaded = "trained in the shape that is run";
    let gradient = GradientMap::from_weights(&export::weights(tensors.clone())).expect(loaded);

    let (run, again) = part(Stage::Level)?;
    let level = LevelTask { shared: task.clone(), gradient: gradient.clone() };
    let done = train::<B, _>(&level, &config.level, &run, again, device, &mut |event| watch(Stage::Level, event))?;
    if done.ended == Ended::Stopped {
        return Ok(Ended::Stopped);
    }
    tensors.extend(best(&run, Stage::Level)?);
    let level = LevelNetwork::from_weights(&export::weights(tensors.clone())).expect(loaded);

    let (run, again) = part(Stage::Mask)?;
    let mask = MaskTask { shared: task.clone(), gradient, level };
    let done = train::<B, _>(&mask, &config.mask, &run, again, device, &mut |event| watch(Stage::Mask, event))?;
    if done.ended == Ended::Stopped {
        return Ok(Ended::Stopped);
    }
    tensors.extend(best(&run, Stage::Mask)?);
    export::save(tensors, &task.provenance, &folder.join("compact.safetensors"))?;
    Ok(Ended::Finished)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{MemorySamples, PressSample};
    use crate::weights::{host_values, named_tensors};
    use crate::{Cpu, CpuAutodiff, CpuDevice};
    use burn::prelude::*;
    use palpate::io::read_compact_weights;
    use palpate::simulate::{PressSampler, PressSetParams};
    use palpate::tactile::compact::{
        CompactDecoder, GRADIENT_LAYERS, LEVEL_INPUTS, MASK_LAYERS, MaskMap, Planes, gradient_input,
    };
    use palpate::tactile::{NoContact, TactileDecoder as _};

    fn noise(count: usize, seed: u64) -> Vec<f32> {
        let mut rng = Pcg64::seed_from_u64(seed);
        (0..count).map(|_| rng.random::<f32>() - 0.5).collect()
    }

    fn tensor<B: Backend>(values: Vec<f32>, shape: [usize; 4]) -> Tensor<B, 4> {
        Tensor::from_data(TensorData::new(values, shape), &Default::default())
    }

    fn worst(a: &[f32], b: &[f32]) -> f32 {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
    }

    #[test]
    fn the_level_network_is_the_same_here_and_there() {
        let module = LevelModule::<Cpu>::new(3, &CpuDevice);
        let tensors = export::named("level", &named_tensors::<Cpu, _>(&module));
        let network = LevelNetwork::from_weights(&export::weights(tensors)).expect("all tensors");
        let difference = Raster::from_vec(240, 320, noise(240 * 320 * 3, 9).as_chunks::<3>().0.to_vec()).expect("size");
        let steps = Raster::from_vec(240, 320, noise(240 * 320 * 2, 8).as_chunks::<2>().0.to_vec()).expect("size");
        let height = Raster::from_vec(240, 320, noise(240 * 320, 7)).expect("size");
        let input = palpate::tactile::compact::level_input(&difference, &height, &steps, &height);
        let here = host_values(module.forward(tensor(input.as_slice().to_vec(), [1, LEVEL_INPUTS, 60, 80])));
        let there: Vec<[f32; 1]> = network.run(&input).as_slice().iter().map(|&v| [v]).collect();
        let there = Planes::from_blocks(&Raster::from_vec(60, 80, there).expect("size"), 2);
        assert!(worst(&here, there.as_slice()) < 1e-4, "{}", worst(&here, there.as_slice()));
        assert!(here.iter().any(|v| v.abs() > 1e-3));
    }

    #[test]
    fn the_gradient_map_is_the_same_here_and_there() {
        let module = LocalNetwork::<Cpu>::new(&GRADIENT_LAYERS, 5, &CpuDevice);
        let tensors = export::named("gradient", &named_tensors::<Cpu, _>(&module));
        let map = GradientMap::from_weights(&export::weights(tensors)).expect("all tensors");
        let difference = Raster::from_vec(240, 320, noise(240 * 320 * 3, 1).as_chunks::<3>().0.to_vec()).expect("size");
        let input = gradient_input(&difference);
        let [channels, rows, cols] = input.shape();
        let here = host_values(module.forward(tensor(input.as_slice().to_vec(), [1, channels, rows, cols])));
        let scale = palpate::tactile::compact::STEP_SCALE;
        let there = Planes::from_blocks(&map.run(&difference).map(|s| s.map(|v| v * scale)), 2);
        assert!(worst(&here, there.as_slice()) < 1e-4, "{}", worst(&here, there.as_slice()));
        let mask = LocalNetwork::<Cpu>::new(&MASK_LAYERS, 5, &CpuDevice);
        let tensors = export::named("mask", &named_tensors::<Cpu, _>(&mask));
        assert!(MaskMap::from_weights(&export::weights(tensors)).is_ok());
    }

    /// A few presses of analytic indenters; the last two are for validation.
    fn samples(count: usize) -> (MemorySamples, Parts) {
        let params = PressSetParams { primitives: 1.0, ..PressSetParams::default() };
        let sampler = PressSampler::new(Vec::new(), params).expect("valid");
        let press = |i| {
            let (record, sample) = sampler.sample(i).expect("pressed");
            let palpate::simulate::PressSample { image, contact } = sample;
            (record.object, PressSample { image, height_map: contact.height_map, mask: contact.mask })
        };
        let samples = MemorySamples {
            sensor: sampler.sensor().clone(),
            background: sampler.background(),
            presses: (0..count).map(press).collect(),
        };
        let parts = Parts { train: (0..count - 2).collect(), validation: vec![count - 2, count - 1], test: vec![] };
        (samples, parts)
    }

    #[test]
    fn training_writes_a_file_that_decodes_and_goes_on_after_an_interruption() {
        let (samples, parts) = samples(6);
        let mut config = CompactConfig::preset(1);
        for part in [&mut config.gradient, &mut config.level, &mut config.mask] {
            (part.epochs, part.batch_size, part.validate_every) = (1, 2, 1);
        }
        let task = CompactTask::new(&samples, &parts, &config, "none", "test");
        let whole = tempfile::tempdir().expect("temporary folder");
        let mut go = |_: Stage, _: Event<'_>| ControlFlow::Continue(());
        train_compact::<CpuAutodiff>(&task, &config, whole.path(), false, &CpuDevice, &mut go).expect("trained");
        let file = whole.path().join("compact.safetensors");
        let weights = read_compact_weights(&file).expect("readable");
        let no_contact = NoContact::new(samples.background.clone(), &samples.sensor).expect("sound");
        let decoder = CompactDecoder::new(&weights, no_contact).expect("this network");
        assert!(decoder.model().parameters() < 2_000_000);
        let contact = decoder.decode(&samples.presses[0].1.image, &samples.sensor).expect("decoded");
        assert_eq!(contact.mask.shape(), (240, 320));

        let parted = tempfile::tempdir().expect("temporary folder");
        let mut stop = |stage: Stage, event: Event<'_>| match event {
            Event::Step { step: 1, .. } if stage == Stage::Level => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        let stopped = train_compact::<CpuAutodiff>(&task, &config, parted.path(), false, &CpuDevice, &mut stop);
        assert_eq!(stopped.expect("stopped in order"), Ended::Stopped);
        assert!(!parted.path().join("compact.safetensors").exists());
        train_compact::<CpuAutodiff>(&task, &config, parted.path(), true, &CpuDevice, &mut go).expect("resumed");
        let bytes = |folder: &Path| std::fs::read(folder.join("compact.safetensors")).expect("there");
        assert!(bytes(whole.path()) == bytes(parted.path()), "a resumed run gives other weights");
    }
}
