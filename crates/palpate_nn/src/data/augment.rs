use rand::RngExt as _;
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// Random changes of the light of a training image; the truth stays. 0 everywhere = none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Augment {
    /// Largest relative change of a channel's gain. Larger stands for more different lamps.
    pub gain: f64,
    /// Largest offset of a channel, grey levels of 255.
    pub offset: f64,
    /// Standard deviation of the noise of each pixel, grey levels of 255.
    pub noise: f64,
}

impl Augment {
    /// Changes an image in place: `[3, rows·cols]`, grey levels of 255 (or differences of them).
    ///
    /// Every channel has a gain and an offset of its own, every value its noise.
    pub fn apply(&self, channels: &mut [f32], rng: &mut Pcg64) {
        let pixels = channels.len() / 3;
        for channel in channels.chunks_mut(pixels.max(1)) {
            let gain = (1.0 + spread(self.gain, rng)) as f32;
            let offset = spread(self.offset, rng) as f32;
            for value in channel {
                *value = *value * gain + offset;
            }
        }
        if let (true, Ok(noise)) = (self.noise > 0.0, Normal::new(0.0, self.noise as f32)) {
            for value in channels {
                *value += noise.sample(rng);
            }
        }
    }
}

fn spread(limit: f64, rng: &mut Pcg64) -> f64 {
    if limit > 0.0 { rng.random_range(-limit..=limit) } else { 0.0 }
}
