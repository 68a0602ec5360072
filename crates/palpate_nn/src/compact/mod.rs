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
use crate::train::{Event, Outcome, RunFolder, TrainError, train};
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
    pub fn new(
        samples: &'a dyn Samples,
        parts: &'a Parts,
        config: &CompactConfig,
        split: &str,
        command: &str,
    ) -> Self {
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
/// Parts that are complete are not trained again, so that calling it with `resume` goes on after any interruption.
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
) -> Result<(), TrainError> {
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
        Ok(export::folded(stage.name(), &WeightFile::open(&run.best())?.tensors))
    };

    let (run, again) = part(Stage::Gradient)?;
    let gradient = GradientTask(task.clone());
    let _: Outcome<_> =
        train::<B, _>(&gradient, &config.gradient, &run, again, device, &mut |event| watch(Stage::Gradient, event))?;
    tensors.extend(best(&run, Stage::Gradient)?);
    let loaded = "trained in the shape that is run";
    let gradient = GradientMap::from_weights(&export::weights(tensors.clone())).expect(loaded);

    let (run, again) = part(Stage::Level)?;
    let level = LevelTask { shared: task.clone(), gradient: gradient.clone() };
    let _: Outcome<_> =
        train::<B, _>(&level, &config.level, &run, again, device, &mut |event| watch(Stage::Level, event))?;
    tensors.extend(best(&run, Stage::Level)?);
    let level = LevelNetwork::from_weights(&export::weights(tensors.clone())).expect(loaded);

    let (run, again) = part(Stage::Mask)?;
    let mask = MaskTask { shared: task.clone(), gradient, level };
    let _: Outcome<_> =
        train::<B, _>(&mask, &config.mask, &run, again, device, &mut |event| watch(Stage::Mask, event))?;
    tensors.extend(best(&run, Stage::Mask)?);
    export::save(tensors, &task.provenance, &folder.join("compact.safetensors"))?;
    Ok(())
}
