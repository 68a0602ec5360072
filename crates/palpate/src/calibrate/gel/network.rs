use crate::tactile::SlopeSample;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

/// Colours and place.
const INPUTS: usize = 5;
const HIDDEN: usize = 24;
/// Weights and bias of a hidden unit, then its two outputs; two output biases at the end.
const PARAMETERS: usize = HIDDEN * (INPUTS + 1) + 2 * HIDDEN + 2;
/// Passes over the samples.
const EPOCHS: usize = 60;
const BATCH: usize = 64;

/// Colour and place to slope, by a network of one hidden layer (24 tanh): bends where a polynomial overshoots, and cannot run off
/// for colours that were never seen.
#[derive(Debug, Clone, PartialEq)]
pub struct SlopeNetwork {
    weights: Vec<f32>,
}

impl SlopeNetwork {
    /// Trains on samples by Adam; the same samples and seed give the same network.
    pub fn fit(samples: &[SlopeSample], seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut weights: Vec<f32> = (0..PARAMETERS)
            .map(|i| {
                let scale = if i < HIDDEN * (INPUTS + 1) { 1.0 } else { 0.3 };
                scale * rng.random_range(-1.0f32..1.0)
            })
            .collect();
        let (mut first, mut second) = (vec![0.0f32; PARAMETERS], vec![0.0f32; PARAMETERS]);
        let mut order: Vec<usize> = (0..samples.len()).collect();
        let (steps, mut step) = (EPOCHS * samples.len().div_ceil(BATCH), 0);
        let mut gradient = vec![0.0f32; PARAMETERS];
        for _ in 0..EPOCHS {
            for i in (1..order.len()).rev() {
                order.swap(i, rng.random_range(0..=i));
            }
            for batch in order.chunks(BATCH) {
                gradient.fill(0.0);
                for &i in batch {
                    back(&weights, &samples[i], &mut gradient);
                }
                step += 1;
                let rate = 0.01 * 0.5 * (1.0 + (std::f32::consts::PI * step as f32 / steps as f32).cos()) + 1e-5;
                let correction = (1.0 - 0.999f32.powi(step.min(10_000))).sqrt() / (1.0 - 0.9f32.powi(step.min(10_000)));
                for p in 0..PARAMETERS {
                    let g = gradient[p] / batch.len() as f32 + 1e-5 * weights[p];
                    first[p] = 0.9 * first[p] + 0.1 * g;
                    second[p] = 0.999 * second[p] + 0.001 * g * g;
                    weights[p] -= rate * correction * first[p] / (second[p].sqrt() + 1e-8);
                }
            }
        }
        Self { weights }
    }

    /// Its parameters.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// A network of stored parameters; `None` unless there are as many as needed and all are finite.
    pub fn from_weights(weights: Vec<f32>) -> Option<Self> {
        (weights.len() == PARAMETERS && weights.iter().all(|w| w.is_finite())).then_some(Self { weights })
    }

    /// The slope that goes with a relative difference at a place.
    pub fn slope(&self, relative: [f32; 3], place: [f32; 2]) -> [f32; 2] {
        forward(&self.weights, inputs(relative, place)).0
    }
}

fn inputs([r, g, b]: [f32; 3], [x, y]: [f32; 2]) -> [f32; INPUTS] {
    [r, g, b, x, y]
}

/// Slope and the hidden units' values.
fn forward(weights: &[f32], input: [f32; INPUTS]) -> ([f32; 2], [f32; HIDDEN]) {
    let (own, out) = weights.split_at(HIDDEN * (INPUTS + 1));
    let mut slope = [out[2 * HIDDEN], out[2 * HIDDEN + 1]];
    let mut hidden = [0.0; HIDDEN];
    for (unit, weights) in own.as_chunks::<{ INPUTS + 1 }>().0.iter().enumerate() {
        let sum: f32 = (0..INPUTS).map(|k| weights[k] * input[k]).sum::<f32>() + weights[INPUTS];
        hidden[unit] = sum.tanh();
        slope[0] += out[2 * unit] * hidden[unit];
        slope[1] += out[2 * unit + 1] * hidden[unit];
    }
    (slope, hidden)
}

/// Adds a sample's gradient of half the squared error.
fn back(weights: &[f32], sample: &SlopeSample, gradient: &mut [f32]) {
    let input = inputs(sample.relative, sample.place);
    let (slope, hidden) = forward(weights, input);
    let error = [slope[0] - sample.slope[0], slope[1] - sample.slope[1]];
    let start = HIDDEN * (INPUTS + 1);
    for unit in 0..HIDDEN {
        let out = [weights[start + 2 * unit], weights[start + 2 * unit + 1]];
        gradient[start + 2 * unit] += error[0] * hidden[unit];
        gradient[start + 2 * unit + 1] += error[1] * hidden[unit];
        let inner = (error[0] * out[0] + error[1] * out[1]) * (1.0 - hidden[unit] * hidden[unit]);
        let own = &mut gradient[unit * (INPUTS + 1)..(unit + 1) * (INPUTS + 1)];
        (0..INPUTS).for_each(|k| own[k] += inner * input[k]);
        own[INPUTS] += inner;
    }
    gradient[start + 2 * HIDDEN] += error[0];
    gradient[start + 2 * HIDDEN + 1] += error[1];
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> Vec<SlopeSample> {
        (0..1500)
            .map(|i| {
                let (a, b) = ((i % 40) as f32 / 20.0 - 1.0, (i / 40) as f32 / 20.0 - 1.0);
                SlopeSample {
                    relative: [0.6 * a + 0.1 * b, 0.5 * b, 0.3 * b - 0.4 * a],
                    place: [0.3 * b, -0.2 * a],
                    slope: [0.7 * a, 0.5 * b + 0.1 * a * a],
                }
            })
            .collect()
    }

    #[test]
    fn it_learns_and_is_the_same_each_time() {
        let samples = samples();
        let network = SlopeNetwork::fit(&samples, 7);
        let off = |s: &SlopeSample| {
            let found = network.slope(s.relative, s.place);
            (found[0] - s.slope[0]).powi(2) + (found[1] - s.slope[1]).powi(2)
        };
        let rms = (samples.iter().map(off).sum::<f32>() / samples.len() as f32).sqrt();
        assert!(rms < 0.03, "{rms}");
        assert_eq!(network, SlopeNetwork::fit(&samples, 7));
        assert_eq!(SlopeNetwork::from_weights(network.weights().to_vec()), Some(network));
        assert_eq!(SlopeNetwork::from_weights(vec![0.0; 3]), None);
    }
}
