use super::networks::LocalNetwork;
use super::{CompactTask, Stage};
use crate::data::DataError;
use crate::train::{Better, Metric, Task};
use crate::weights::{Architecture, Provenance, host_values};
use burn::prelude::*;
use burn::tensor::activation::{log_sigmoid, sigmoid};
use burn::tensor::backend::AutodiffBackend;
use palpate::tactile::compact::{
    GradientMap, LevelNetwork, MASK_LAYERS, Planes, WORKING_SIZE, indentation, mask_input,
};
use rand::RngExt as _;
use rand_pcg::Pcg64;

/// Training of the mask map, on what the parts before it make of the images.
pub struct MaskTask<'a> {
    pub(super) shared: CompactTask<'a>,
    pub(super) gradient: GradientMap,
    pub(super) level: LevelNetwork,
}

const INPUTS: usize = 13;
/// Size of an image in blocks of 2 × 2 pixels.
const ROWS: usize = WORKING_SIZE.0 / 2;
const COLS: usize = WORKING_SIZE.1 / 2;
/// Size of a training crop in blocks: the map is local.
const CROP: [usize; 2] = [60, 80];
/// Share of the crops that are centred on a pixel of the contact.
const ON_CONTACT: f64 = 0.7;

/// Crops on the host.
pub struct Masks {
    count: usize,
    input: Vec<f32>,
    truth: Vec<f32>,
}

impl MaskTask<'_> {
    /// Input and truth of a press.
    fn planes(&self, index: usize, rng: Option<&mut Pcg64>) -> Result<[Planes; 2], DataError> {
        let press = self.shared.load(index, rng)?;
        let shared = &self.shared;
        let felt = indentation(&self.gradient, &self.level, &press.difference, &shared.relaxed, &shared.integrator);
        let truth = press.mask.map(|&m| [f32::from(u8::from(m))]);
        Ok([mask_input(&felt.depth, &felt.steps, felt.peak), Planes::from_blocks(&truth, 2)])
    }
}

/// First row and column of a crop.
fn corner(truth: &Planes, rng: &mut Pcg64) -> [usize; 2] {
    let touched: Vec<usize> = truth.plane(0).iter().enumerate().filter(|(_, t)| **t > 0.5).map(|(i, _)| i).collect();
    if !touched.is_empty() && rng.random::<f64>() < ON_CONTACT {
        let at = touched[rng.random_range(0..touched.len())];
        let within = |center: usize, crop: usize, all: usize| center.saturating_sub(crop / 2).min(all - crop);
        return [within(at / COLS, CROP[0], ROWS), within(at % COLS, CROP[1], COLS)];
    }
    [rng.random_range(0..=ROWS - CROP[0]), rng.random_range(0..=COLS - CROP[1])]
}

impl<B: AutodiffBackend> Task<B> for MaskTask<'_> {
    type Model = LocalNetwork<B>;
    type Batch = Masks;

    fn architecture(&self) -> Architecture {
        Architecture::new("palpate-compact-mask", 1, &MASK_LAYERS)
    }

    fn provenance(&self) -> Provenance {
        self.shared.provenance.clone()
    }

    fn model(&self, seed: u64, device: &B::Device) -> Self::Model {
        LocalNetwork::new(&MASK_LAYERS, seed, device)
    }

    fn training_samples(&self) -> usize {
        self.shared.parts.train.len()
    }

    fn batch(&self, indices: &[usize], rng: &mut Pcg64) -> Result<Masks, DataError> {
        let loaded = self.shared.for_each(indices, rng, |index, mut rng| {
            let [input, truth] = self.planes(index, Some(&mut rng))?;
            let [row, col] = corner(&truth, &mut rng);
            Ok([&input, &truth].map(|planes| planes.crop(row, col, CROP[0], CROP[1])))
        })?;
        let mut batch = Masks { count: loaded.len(), input: Vec::new(), truth: Vec::new() };
        for [input, truth] in loaded {
            batch.input.extend(input);
            batch.truth.extend(truth);
        }
        Ok(batch)
    }

    /// Cross-entropy, and one minus the Dice overlap per image.
    fn loss(&self, model: &Self::Model, batch: Masks, _rng: &mut Pcg64, device: &B::Device) -> Tensor<B, 1> {
        let n = batch.count;
        let tensor = |values, channels| -> Tensor<B, 4> {
            Tensor::from_data(TensorData::new(values, [n, channels, CROP[0], CROP[1]]), device)
        };
        let logit = model.forward(tensor(batch.input, INPUTS));
        let truth = tensor(batch.truth, 4);
        let entropy = log_sigmoid(logit.clone())
            .mul(truth.clone())
            .add(log_sigmoid(logit.clone().neg()).mul(truth.clone().neg().add_scalar(1.0)))
            .mean()
            .neg();
        let share = sigmoid(logit);
        let sum = |x: Tensor<B, 4>| -> Tensor<B, 2> { x.reshape([n, 4 * CROP[0] * CROP[1]]).sum_dim(1) };
        let both = sum(share.clone().mul(truth.clone())).mul_scalar(2.0).add_scalar(1.0);
        let dice = both.div(sum(share).add(sum(truth)).add_scalar(1.0)).mean();
        entropy.mul_scalar(4.0).add(dice.neg().add_scalar(1.0))
    }

    fn metrics(&self) -> &[Metric] {
        &[Metric { name: "iou", better: Better::Higher }]
    }

    fn validate(&self, model: &LocalNetwork<B::InnerBackend>, device: &B::Device) -> Result<Vec<f64>, DataError> {
        let indices = self.shared.validation(Stage::Mask);
        let mut sum = 0.0;
        for &index in indices {
            let [input, truth] = self.planes(index, None)?;
            let values = TensorData::new(input.as_slice().to_vec(), [1, INPUTS, ROWS, COLS]);
            let out = host_values(model.forward(Tensor::from_data(values, device)));
            let (mut both, mut either) = (0.0, 0.0);
            for (o, t) in out.iter().zip(truth.as_slice()) {
                both += f64::from(u8::from(*o > 0.0 && *t > 0.5));
                either += f64::from(u8::from(*o > 0.0 || *t > 0.5));
            }
            sum += if either > 0.0 { both / either } else { 1.0 };
        }
        Ok(vec![sum / indices.len().max(1) as f64])
    }
}
