use super::tensors::{TensorPath, follow_path};
use crate::random::mix;
use burn::module::{ModuleMapper, Param};
use burn::prelude::*;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64;

/// Draws every convolution kernel from N(0, √(2 / (kh·kw·`C_out`))); all else stays.
///
/// Each tensor has a random stream of its own, chosen by its name: adding a layer does not change the others, and every back
/// end starts from the same weights.
///
/// # References
/// He et al., *Delving Deep into Rectifiers*, ICCV 2015, §2.2 (the backward form).
pub fn initialize<B: Backend, M: Module<B>>(model: M, seed: u64) -> M {
    model.map(&mut Draw { path: TensorPath::default(), seed })
}

struct Draw {
    path: TensorPath,
    seed: u64,
}

impl<B: Backend> ModuleMapper<B> for Draw {
    follow_path!();
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<B, D>>) -> Param<Tensor<B, D>> {
        let (id, old, mapper) = param.consume();
        let new = match old.dims()[..] {
            [outputs, inputs, rows, cols] => {
                let deviation = (2.0 / (rows * cols * outputs) as f32).sqrt();
                let mut rng = Pcg64::seed_from_u64(mix(self.seed) ^ fnv1a(&self.path.name()));
                let values: Vec<f32> = (0..outputs * inputs * rows * cols)
                    .map(|_| {
                        let z: f32 = StandardNormal.sample(&mut rng);
                        z * deviation
                    })
                    .collect();
                let data = TensorData::new(values, old.shape());
                Tensor::from_data(data, &old.device()).set_require_grad(old.is_require_grad())
            }
            _ => old,
        };
        Param::from_mapped_value(id, new, mapper)
    }
}

/// A hash that stays the same between releases of Rust.
fn fnv1a(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}
