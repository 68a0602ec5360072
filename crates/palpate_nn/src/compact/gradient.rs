use super::networks::LocalNetwork;
use super::{CompactTask, Stage};
use crate::data::DataError;
use crate::train::{Better, Metric, Task};
use crate::weights::{Architecture, Provenance, host_values};
use burn::prelude::*;
use burn::tensor::backend::AutodiffBackend;
use palpate::geometry::Raster;
use palpate::tactile::compact::{GRADIENT_LAYERS, Planes, STEP_SCALE, gradient_input};
use rand::RngExt as _;
use rand_pcg::Pcg64;

/// Training of the gradient map, on crops: it is local.
pub struct GradientTask<'a>(pub(super) CompactTask<'a>);

/// Side of a crop in blocks of 2 × 2 pixels; the outermost ring sees the padding and does not count.
const CROP: usize = 42;
/// Channels: 14 of the input, 8 of the truth, 1 of the weights.
const INPUTS: usize = 14;
const OUTPUTS: usize = 8;

/// Crops on the host.
pub struct Crops {
    count: usize,
    side: [usize; 2],
    input: Vec<f32>,
    truth: Vec<f32>,
    weight: Vec<f32>,
}

impl GradientTask<'_> {
    /// Input, truth and weight planes of a press.
    /// The light is not varied: a local map cannot tell a changed lamp from a slope and would learn to doubt every slope. What a
    /// changed lamp does to the integral is for the level network to undo.
    fn planes(&self, index: usize) -> Result<[Planes; 3], DataError> {
        let press = self.0.load(index, None)?;
        let truth = press.steps().map(|s| s.map(|v| v * STEP_SCALE));
        // Contact counts twice: it is what is fused.
        let weight = press.mask.map(|&m| [if m { 2.0 } else { 1.0 }]);
        Ok([gradient_input(&press.difference), blocks(&truth), blocks(&weight)])
    }
}

fn blocks<const N: usize>(raster: &Raster<[f32; N]>) -> Planes {
    Planes::from_blocks(raster, 2)
}

impl<B: AutodiffBackend> Task<B> for GradientTask<'_> {
    type Model = LocalNetwork<B>;
    type Batch = Crops;

    fn architecture(&self) -> Architecture {
        Architecture::new("palpate-compact-gradient", 1, &GRADIENT_LAYERS)
    }

    fn provenance(&self) -> Provenance {
        self.0.provenance.clone()
    }

    fn model(&self, seed: u64, device: &B::Device) -> Self::Model {
        LocalNetwork::new(&GRADIENT_LAYERS, seed, device)
    }

    fn training_samples(&self) -> usize {
        self.0.parts.train.len()
    }

    fn batch(&self, indices: &[usize], rng: &mut Pcg64) -> Result<Crops, DataError> {
        let loaded = self.0.for_each(indices, rng, |index, mut rng| {
            let [input, truth, weight] = self.planes(index)?;
            let [_, rows, cols] = input.shape();
            let (r, c) = (rng.random_range(0..=rows - CROP), rng.random_range(0..=cols - CROP));
            let cut = |p: &Planes, ring: usize| p.crop(r + ring, c + ring, CROP - 2 * ring, CROP - 2 * ring);
            Ok([cut(&input, 0), cut(&truth, 1), cut(&weight, 1)])
        })?;
        let mut batch =
            Crops { count: loaded.len(), side: [CROP, CROP], input: Vec::new(), truth: Vec::new(), weight: Vec::new() };
        for [input, truth, weight] in loaded {
            batch.input.extend(input);
            batch.truth.extend(truth);
            // One weight for the steps to both neighbours.
            batch.weight.extend_from_slice(&weight);
            batch.weight.extend(weight);
        }
        Ok(batch)
    }

    fn loss(&self, model: &Self::Model, batch: Crops, _rng: &mut Pcg64, device: &B::Device) -> Tensor<B, 1> {
        let Crops { count, side: [rows, cols], .. } = batch;
        let tensor = |values, channels, rows, cols| -> Tensor<B, 4> {
            Tensor::from_data(TensorData::new(values, [count, channels, rows, cols]), device)
        };
        let out = model.forward(tensor(batch.input, INPUTS, rows, cols));
        let out = out.narrow(2, 1, rows - 2).narrow(3, 1, cols - 2);
        let error = out.sub(tensor(batch.truth, OUTPUTS, rows - 2, cols - 2));
        let weight = tensor(batch.weight, OUTPUTS, rows - 2, cols - 2);
        // The absolute error keeps edges; the squared one keeps the mean, which integration sums up.
        error.clone().abs().add(error.square().mul_scalar(2.0)).mul(weight).mean()
    }

    fn metrics(&self) -> &[Metric] {
        &[
            Metric { name: "step_error_um", better: Better::Lower },
            Metric { name: "contact_step_error_um", better: Better::Lower },
        ]
    }

    fn validate(&self, model: &LocalNetwork<B::InnerBackend>, device: &B::Device) -> Result<Vec<f64>, DataError> {
        let mut sums = [0.0f64; 4];
        for &index in self.0.validation(Stage::Gradient) {
            let [input, truth, weight] = self.planes(index)?;
            let [_, rows, cols] = input.shape();
            let values = TensorData::new(input.as_slice().to_vec(), [1, INPUTS, rows, cols]);
            let out = host_values(model.forward(Tensor::from_data(values, device)));
            for (i, (o, t)) in out.iter().zip(truth.as_slice()).enumerate() {
                let error = f64::from((o - t).abs() / STEP_SCALE) * 1e3;
                sums[0] += error;
                sums[1] += 1.0;
                if weight.as_slice()[i % weight.as_slice().len()] > 1.5 {
                    sums[2] += error;
                    sums[3] += 1.0;
                }
            }
        }
        Ok(vec![sums[0] / sums[1].max(1.0), sums[2] / sums[3].max(1.0)])
    }
}
