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
use rand_pcg::Pcg64;

/// Training of the mask map, on what the parts before it make of the images.
pub struct MaskTask<'a> {
    pub(super) shared: CompactTask<'a>,
    pub(super) gradient: GradientMap,
    pub(super) level: LevelNetwork,
}

const INPUTS: usize = 13;
const ROWS: usize = WORKING_SIZE.0 / 2;
const COLS: usize = WORKING_SIZE.1 / 2;

/// Images on the host.
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
        let loaded = self.shared.for_each(indices, rng, |index, mut rng| self.planes(index, Some(&mut rng)))?;
        let mut batch = Masks { count: loaded.len(), input: Vec::new(), truth: Vec::new() };
        for [input, truth] in loaded {
            batch.input.extend_from_slice(input.as_slice());
            batch.truth.extend_from_slice(truth.as_slice());
        }
        Ok(batch)
    }

    /// Cross-entropy, and one minus the Dice overlap per image.
    fn loss(&self, model: &Self::Model, batch: Masks, _rng: &mut Pcg64, device: &B::Device) -> Tensor<B, 1> {
        let n = batch.count;
        let tensor = |values, channels| -> Tensor<B, 4> {
            Tensor::from_data(TensorData::new(values, [n, channels, ROWS, COLS]), device)
        };
        let logit = model.forward(tensor(batch.input, INPUTS));
        let truth = tensor(batch.truth, 4);
        let entropy = log_sigmoid(logit.clone())
            .mul(truth.clone())
            .add(log_sigmoid(logit.clone().neg()).mul(truth.clone().neg().add_scalar(1.0)))
            .mean()
            .neg();
        let share = sigmoid(logit);
        let sum = |x: Tensor<B, 4>| -> Tensor<B, 2> { x.reshape([n, 4 * ROWS * COLS]).sum_dim(1) };
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
