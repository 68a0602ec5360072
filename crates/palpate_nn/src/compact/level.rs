use super::networks::LevelModule;
use super::{CompactTask, Stage};
use crate::data::DataError;
use crate::train::{Better, Metric, Task};
use crate::weights::{Architecture, Provenance, host_values};
use burn::prelude::*;
use burn::tensor::backend::AutodiffBackend;
use palpate::geometry::Raster;
use palpate::tactile::compact::{
    GradientMap, LEVEL_BLOCKS, LEVEL_INPUTS, LEVEL_SCALE, LEVEL_WIDTHS, Planes, WORKING_SIZE, level_input,
};
use rand_pcg::Pcg64;

/// Training of the level network on what integration leaves open, at a quarter of the working size.
pub struct LevelTask<'a> {
    pub(super) shared: CompactTask<'a>,
    pub(super) gradient: GradientMap,
}

const ROWS: usize = WORKING_SIZE.0 / 4;
const COLS: usize = WORKING_SIZE.1 / 4;

/// Images on the host.
pub struct Levels {
    count: usize,
    input: Vec<f32>,
    /// Level that is to be added, mm, as 2 × 2 blocks.
    truth: Vec<f32>,
    /// Share of contact, the same.
    contact: Vec<f32>,
}

impl LevelTask<'_> {
    /// Input, level and contact of a press.
    fn planes(&self, index: usize, rng: Option<&mut Pcg64>) -> Result<[Planes; 3], DataError> {
        let press = self.shared.load(index, rng)?;
        let steps = self.gradient.run(&press.difference);
        let shape = self.shared.integrator.integrate_steps(&steps);
        let pairs = press.depth.as_slice().iter().zip(shape.as_slice());
        let missing: Vec<[f32; 1]> = pairs.map(|(d, s)| [d - s]).collect();
        let missing = Raster::from_vec(WORKING_SIZE.0, WORKING_SIZE.1, missing).expect("same size");
        let mask = press.mask.map(|&m| [f32::from(u8::from(m))]);
        let small = |planes: Planes| {
            let values = planes.as_slice().iter().map(|&v| [v]).collect();
            Planes::from_blocks(&Raster::from_vec(ROWS, COLS, values).expect("a quarter"), 2)
        };
        Ok([
            level_input(&press.difference, &shape, &steps, &self.shared.relaxed),
            small(Planes::means(&missing, 4)),
            small(Planes::means(&mask, 4)),
        ])
    }
}

impl<B: AutodiffBackend> Task<B> for LevelTask<'_> {
    type Model = LevelModule<B>;
    type Batch = Levels;

    fn architecture(&self) -> Architecture {
        Architecture::new("palpate-compact-level", 1, &(LEVEL_WIDTHS, LEVEL_BLOCKS))
    }

    fn provenance(&self) -> Provenance {
        self.shared.provenance.clone()
    }

    fn model(&self, seed: u64, device: &B::Device) -> Self::Model {
        LevelModule::new(seed, device)
    }

    fn training_samples(&self) -> usize {
        self.shared.parts.train.len()
    }

    fn batch(&self, indices: &[usize], rng: &mut Pcg64) -> Result<Levels, DataError> {
        let loaded = self.shared.for_each(indices, rng, |index, mut rng| self.planes(index, Some(&mut rng)))?;
        let mut batch = Levels { count: loaded.len(), input: Vec::new(), truth: Vec::new(), contact: Vec::new() };
        for [input, truth, contact] in loaded {
            batch.input.extend_from_slice(input.as_slice());
            batch.truth.extend_from_slice(truth.as_slice());
            batch.contact.extend_from_slice(contact.as_slice());
        }
        Ok(batch)
    }

    /// Per image, as it is judged: root mean square and absolute error, contact counting three times, and the error's steps,
    /// which keep the normals.
    fn loss(&self, model: &Self::Model, batch: Levels, _rng: &mut Pcg64, device: &B::Device) -> Tensor<B, 1> {
        let n = batch.count;
        let tensor = |values, channels, rows, cols| -> Tensor<B, 4> {
            Tensor::from_data(TensorData::new(values, [n, channels, rows, cols]), device)
        };
        let out = model.forward(tensor(batch.input, LEVEL_INPUTS, ROWS, COLS)).mul_scalar(LEVEL_SCALE);
        let truth = tensor(batch.truth, 4, ROWS / 2, COLS / 2);
        let weight = tensor(batch.contact, 4, ROWS / 2, COLS / 2).mul_scalar(2.0).add_scalar(1.0);
        let error = out.sub(truth);
        let total: Tensor<B, 2> = weight.clone().reshape([n, ROWS * COLS]).sum_dim(1);
        let squares: Tensor<B, 2> = error.clone().square().mul(weight.clone()).reshape([n, ROWS * COLS]).sum_dim(1);
        let root = squares.div(total.clone()).add_scalar(1e-6).sqrt().mean();
        let absolute = error.clone().abs().mul(weight).reshape([n, ROWS * COLS]).sum_dim(1).div(total).mean();
        // Between the same place of neighbouring blocks, and between the places of a block.
        let apart = |axis: usize, length: usize| {
            error.clone().narrow(axis, 1, length - 1).sub(error.clone().narrow(axis, 0, length - 1)).abs().mean()
        };
        let slopes = apart(2, ROWS / 2).add(apart(3, COLS / 2)).add(apart(1, 4));
        root.mul_scalar(4.0).add(absolute.mul_scalar(2.0)).add(slopes.mul_scalar(2.0))
    }

    fn metrics(&self) -> &[Metric] {
        &[
            Metric { name: "rmse_mm", better: Better::Lower },
            Metric { name: "contact_rmse_mm", better: Better::Lower },
            Metric { name: "bias_mm", better: Better::Lower },
        ]
    }

    fn validate(&self, model: &LevelModule<B::InnerBackend>, device: &B::Device) -> Result<Vec<f64>, DataError> {
        let (mut whole, mut inside, mut bias, mut images, mut touched) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for &index in self.shared.validation(Stage::Level) {
            let [input, truth, contact] = self.planes(index, None)?;
            let values = TensorData::new(input.as_slice().to_vec(), [1, LEVEL_INPUTS, ROWS, COLS]);
            let out = host_values(model.forward(Tensor::from_data(values, device)));
            let (mut squares, mut sum, mut in_squares, mut area) = (0.0, 0.0, 0.0, 0.0);
            for ((o, t), m) in out.iter().zip(truth.as_slice()).zip(contact.as_slice()) {
                let error = f64::from(o * LEVEL_SCALE - t);
                squares += error * error;
                sum += error;
                in_squares += error * error * f64::from(*m);
                area += f64::from(*m);
            }
            let pixels = out.len() as f64;
            whole += (squares / pixels).sqrt();
            bias += (sum / pixels).abs();
            images += 1.0;
            if area > 0.0 {
                inside += (in_squares / area).sqrt();
                touched += 1.0;
            }
        }
        let images = f64::max(images, 1.0);
        Ok(vec![whole / images, inside / f64::max(touched, 1.0), bias / images])
    }
}
