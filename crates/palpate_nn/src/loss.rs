//! Losses over `[batch, 1, row, col]` maps, each one value.

use burn::prelude::*;
use serde::{Deserialize, Serialize};

/// What training makes small.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Loss {
    /// √(mean squared error) over the batch: the thesis.
    RootMeanSquare,
    /// Mean absolute error, and that of the differences between neighbouring pixels: keeps edges and slopes.
    L1Gradient {
        /// Weight of the differences. Larger gives sharper edges and smoother faces.
        gradient: f64,
    },
    /// Binary cross-entropy, and one minus the Dice overlap: right about pixels and about areas, however small.
    BceDice {
        /// Weight of the overlap.
        dice: f64,
    },
}

impl Loss {
    /// The loss of a prediction.
    pub fn of<B: Backend>(&self, prediction: Tensor<B, 4>, truth: Tensor<B, 4>) -> Tensor<B, 1> {
        match *self {
            Self::RootMeanSquare => prediction.sub(truth).square().mean().sqrt(),
            Self::L1Gradient { gradient } => {
                let error = prediction.sub(truth);
                let slopes = differences(&error, 2).abs().mean().add(differences(&error, 3).abs().mean());
                error.abs().mean().add(slopes.mul_scalar(gradient))
            }
            Self::BceDice { dice } => binary_cross_entropy(prediction.clone(), truth.clone())
                .add(dice_loss(prediction, truth).mul_scalar(dice)),
        }
    }
}

fn differences<B: Backend>(map: &Tensor<B, 4>, axis: usize) -> Tensor<B, 4> {
    let n = map.dims()[axis] - 1;
    map.clone().narrow(axis, 1, n).sub(map.clone().narrow(axis, 0, n))
}

/// Mean −log of the probability given to the truth; probabilities are kept away from 0 and 1 by 1e-6.
fn binary_cross_entropy<B: Backend>(probability: Tensor<B, 4>, truth: Tensor<B, 4>) -> Tensor<B, 1> {
    let p = probability.clamp(1e-6, 1.0 - 1e-6);
    let of_ones = truth.clone().mul(p.clone().log());
    let of_zeros = truth.neg().add_scalar(1.0).mul(p.neg().add_scalar(1.0).log());
    of_ones.add(of_zeros).mean().neg()
}

/// 1 − 2 Σ p·t / (Σ p + Σ t), per image, then the mean. An image without contact counts its false area.
fn dice_loss<B: Backend>(probability: Tensor<B, 4>, truth: Tensor<B, 4>) -> Tensor<B, 1> {
    let n = probability.dims()[0];
    let sum = |map: Tensor<B, 4>| -> Tensor<B, 1> {
        let pixels = map.shape().num_elements() / n;
        map.reshape([n, pixels]).sum_dim(1).reshape([n])
    };
    let both = sum(probability.clone().mul(truth.clone()));
    let all = sum(probability).add(sum(truth));
    let overlap = both.mul_scalar(2.0).add_scalar(1.0).div(all.add_scalar(1.0));
    overlap.mean().neg().add_scalar(1.0)
}
