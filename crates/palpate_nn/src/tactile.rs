//! [`Task`] of the tactile networks: image of the gel to height map or contact mask.

use crate::config::{Input, NetworkConfig, Target, TrainConfig};
use crate::data::{DataError, Parts, Prepared, Samples, small_image};
use crate::fcrn::{Fcrn, Head};
use crate::loss::Loss;
use crate::train::{Better, Metric, Task};
use crate::weights::{Architecture, Provenance, host_values};
use burn::prelude::*;
use burn::tensor::backend::AutodiffBackend;
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// Training of an [`Fcrn`] on a set of presses.
pub struct FcrnTask<'a> {
    samples: &'a dyn Samples,
    parts: Parts,
    config: TrainConfig,
    provenance: Provenance,
    /// What is taken off the images, if anything.
    background: Option<Vec<f32>>,
}

/// Images and truth of some presses on the host.
pub struct TactileBatch {
    count: usize,
    images: Vec<f32>,
    truth: Vec<f32>,
}

const HEIGHT_METRICS: [Metric; 3] = [
    Metric { name: "rmse_mm", better: Better::Lower },
    Metric { name: "mae_mm", better: Better::Lower },
    Metric { name: "contact_rmse_mm", better: Better::Lower },
];

const MASK_METRICS: [Metric; 3] = [
    Metric { name: "iou", better: Better::Higher },
    Metric { name: "accuracy", better: Better::Higher },
    Metric { name: "rmse", better: Better::Lower },
];

impl<'a> FcrnTask<'a> {
    /// * `config` – validated
    /// * `parts` – of `samples`, by a split
    /// * `split`, `command` – for the weight file
    pub fn new(samples: &'a dyn Samples, parts: Parts, config: TrainConfig, split: &str, command: &str) -> Self {
        let provenance = Provenance {
            sensor: samples.sensor().model.clone(),
            input: (config.data.rows, config.data.cols),
            split: split.to_owned(),
            seed: config.run.seed,
            command: command.to_owned(),
            run: serde_json::to_string(&config).expect("a plain struct"),
        };
        let size = (config.data.rows, config.data.cols);
        let background = (config.data.input == Input::Difference).then(|| small_image(samples.background(), size));
        Self { samples, parts, config, provenance, background }
    }

    fn size(&self) -> (usize, usize) {
        (self.config.data.rows, self.config.data.cols)
    }

    fn network(&self) -> &NetworkConfig {
        &self.config.network
    }

    fn load(&self, index: usize, rng: Option<&mut Pcg64>) -> Result<Prepared, DataError> {
        let augment = rng.map(|rng| (&self.config.augment, rng));
        Prepared::load(self.samples, index, self.size(), self.background.as_deref(), augment)
    }

    fn collect(&self, samples: Vec<Prepared>) -> TactileBatch {
        let mut batch = TactileBatch { count: samples.len(), images: Vec::new(), truth: Vec::new() };
        let relaxed = self.samples.sensor().relaxed(self.config.data.rows, self.config.data.cols);
        for sample in samples {
            self.config.data.input.encode(&sample.image, &mut batch.images);
            let target = self.config.data.target;
            match self.network().head {
                Head::ContactMask => batch.truth.extend(sample.mask),
                Head::HeightMap | Head::SignedHeightMap => {
                    let truth = sample.height.iter().zip(relaxed.as_slice());
                    batch.truth.extend(truth.map(|(&z, &relaxed)| target.encode(z, relaxed, self.samples.sensor())));
                }
            }
        }
        batch
    }

    fn images<B: Backend>(&self, batch: &mut TactileBatch, device: &B::Device) -> Tensor<B, 4> {
        let (rows, cols) = self.size();
        let values = std::mem::take(&mut batch.images);
        Tensor::from_data(TensorData::new(values, [batch.count, 3, rows, cols]), device)
    }
}

impl<B: AutodiffBackend> Task<B> for FcrnTask<'_> {
    type Model = Fcrn<B>;
    type Batch = TactileBatch;

    fn architecture(&self) -> Architecture {
        self.network().fcrn().architecture()
    }

    fn provenance(&self) -> Provenance {
        self.provenance.clone()
    }

    fn model(&self, seed: u64, device: &B::Device) -> Fcrn<B> {
        Fcrn::new(self.network().fcrn(), seed, device).expect("the config was validated")
    }

    fn training_samples(&self) -> usize {
        self.parts.train.len()
    }

    fn batch(&self, indices: &[usize], rng: &mut Pcg64) -> Result<TactileBatch, DataError> {
        use rand::{RngExt as _, SeedableRng as _};
        // Every sample has a generator of its own, so that the samples can be loaded in parallel.
        let seeds: Vec<(usize, u64)> = indices.iter().map(|&i| (self.parts.train[i], rng.random())).collect();
        let samples: Result<Vec<_>, _> =
            seeds.into_par_iter().map(|(i, seed)| self.load(i, Some(&mut Pcg64::seed_from_u64(seed)))).collect();
        Ok(self.collect(samples?))
    }

    fn loss(&self, model: &Fcrn<B>, mut batch: TactileBatch, rng: &mut Pcg64, device: &B::Device) -> Tensor<B, 1> {
        let (rows, cols) = self.size();
        let prediction = model.forward_train(self.images(&mut batch, device), rng);
        let truth = Tensor::from_data(TensorData::new(batch.truth, [batch.count, 1, rows, cols]), device);
        self.config.loss.of(prediction, truth)
    }

    fn metrics(&self) -> &[Metric] {
        match self.network().head {
            Head::HeightMap | Head::SignedHeightMap => &HEIGHT_METRICS,
            Head::ContactMask => &MASK_METRICS,
        }
    }

    fn validate(&self, model: &Fcrn<B::InnerBackend>, device: &B::Device) -> Result<Vec<f64>, DataError> {
        let mut sums = Sums::default();
        for indices in self.parts.validation.chunks(self.config.run.batch_size) {
            let samples: Result<Vec<_>, _> = indices.par_iter().map(|&i| self.load(i, None)).collect();
            let samples = samples?;
            let masks: Vec<f32> = samples.iter().flat_map(|s| &s.mask).copied().collect();
            let mut batch = self.collect(samples);
            let prediction = host_values(model.forward(self.images::<B::InnerBackend>(&mut batch, device)));
            match self.network().head {
                Head::HeightMap | Head::SignedHeightMap => {
                    let mm = self.config.data.target.millimetres(self.samples.sensor());
                    sums.add_heights(&prediction, &batch.truth, &masks, mm);
                }
                Head::ContactMask => sums.add_masks(&prediction, &masks),
            }
        }
        Ok(match self.network().head {
            Head::HeightMap | Head::SignedHeightMap => sums.heights(),
            Head::ContactMask => sums.masks(),
        })
    }
}

/// What the metrics are means of.
#[derive(Default)]
struct Sums {
    pixels: f64,
    squares: f64,
    absolutes: f64,
    contact_pixels: f64,
    contact_squares: f64,
    right: f64,
    both: f64,
    either: f64,
}

impl Sums {
    /// * `unit_mm` – millimetres of one unit of the maps
    fn add_heights(&mut self, prediction: &[f32], truth: &[f32], mask: &[f32], unit_mm: f64) {
        for ((&p, &t), &m) in prediction.iter().zip(truth).zip(mask) {
            let error = f64::from(p - t) * unit_mm;
            self.pixels += 1.0;
            self.squares += error * error;
            self.absolutes += error.abs();
            if m > 0.5 {
                self.contact_pixels += 1.0;
                self.contact_squares += error * error;
            }
        }
    }

    fn add_masks(&mut self, prediction: &[f32], truth: &[f32]) {
        for (&p, &t) in prediction.iter().zip(truth) {
            let (is, should) = (p > 0.5, t > 0.5);
            self.pixels += 1.0;
            self.squares += f64::from(p - t).powi(2);
            self.right += f64::from(u8::from(is == should));
            self.both += f64::from(u8::from(is && should));
            self.either += f64::from(u8::from(is || should));
        }
    }

    fn heights(&self) -> Vec<f64> {
        let contact = (self.contact_squares / self.contact_pixels.max(1.0)).sqrt();
        vec![(self.squares / self.pixels).sqrt(), self.absolutes / self.pixels, contact]
    }

    /// Overlap over all pixels of the set together; 1 if neither holds any contact.
    fn masks(&self) -> Vec<f64> {
        let iou = if self.either > 0.0 { self.both / self.either } else { 1.0 };
        vec![iou, self.right / self.pixels, (self.squares / self.pixels).sqrt()]
    }
}

impl Input {
    /// Appends an image of [`Prepared`] as the network reads it.
    pub(crate) fn encode(self, rgb: &[f32], out: &mut Vec<f32>) {
        match self {
            Self::Bgr255 => rgb.chunks(rgb.len() / 3).rev().for_each(|channel| out.extend_from_slice(channel)),
            // A difference of 64 grey levels is a strong one: 1.
            Self::Difference => out.extend(rgb.iter().map(|v| v / 64.0)),
        }
    }
}

impl Loss {
    /// Whether the loss is one of probabilities.
    pub(crate) fn needs_probabilities(&self) -> bool {
        matches!(self, Self::BceDice { .. })
    }
}

impl Target {
    fn encode(self, z: f32, relaxed: f32, sensor: &palpate::tactile::TactileSensor) -> f32 {
        match self {
            Self::DepthPx => -z / sensor.pixel_pitch as f32,
            Self::IndentationMm => 1e3 * (relaxed - z),
        }
    }

    /// Millimetres of one unit of the target.
    pub(crate) fn millimetres(self, sensor: &palpate::tactile::TactileSensor) -> f64 {
        match self {
            Self::DepthPx => 1e3 * sensor.pixel_pitch,
            Self::IndentationMm => 1.0,
        }
    }
}
