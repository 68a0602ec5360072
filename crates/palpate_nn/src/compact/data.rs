//! A press as the compact network's parts see it.

use crate::data::{DataError, PressSample, Samples};
use palpate::geometry::Raster;
use palpate::tactile::compact::WORKING_SIZE;
use rand::RngExt as _;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// Random changes of the light since the no-contact image was taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightAugment {
    /// Share of the images that are changed at all. Larger: withstands more, and knows less of images that did not change.
    pub share: f64,
    /// 1σ of the relative change of the gain, common to the channels and of each alone; every fourth image gets three times as much.
    pub gain: f64,
    /// 1σ of a channel's offset, grey levels.
    pub offset: f64,
    /// 1σ of a smooth field (3 × 4 knots) on each channel, grey levels.
    pub drift: f64,
}

impl LightAugment {
    /// Draws gain and offset of each channel at every pixel, and applies them.
    fn apply(&self, difference: &mut Raster<[f32; 3]>, background: &Raster<[u8; 3]>, rng: &mut Pcg64) {
        if rng.random::<f64>() >= self.share {
            return;
        }
        let much = if rng.random::<f64>() < 0.25 { 3.0 } else { 1.0 };
        let mut normal = |sigma: f64| (sigma * rng.sample::<f64, _>(StandardNormal)) as f32;
        let common = normal(self.gain * much);
        let gain: [f32; 3] = std::array::from_fn(|_| (common + normal(self.gain * much)).clamp(-0.4, 0.4));
        let offset: [f32; 3] = std::array::from_fn(|_| normal(self.offset));
        let knots: [[[f32; 4]; 3]; 3] =
            std::array::from_fn(|_| std::array::from_fn(|_| std::array::from_fn(|_| normal(self.drift))));
        let (rows, cols) = difference.shape();
        for row in 0..rows {
            let v = 2.0 * row as f32 / rows as f32;
            let (r, fv) = (v as usize, v.fract());
            // Knots of this row, so that only columns are left to interpolate.
            let line: [[f32; 4]; 3] = knots.map(|k| std::array::from_fn(|c| k[r][c] * (1.0 - fv) + k[r + 1][c] * fv));
            for col in 0..cols {
                let u = 3.0 * col as f32 / cols as f32;
                let (c, fu) = (u as usize, u.fract());
                let still = background[(row, col)];
                for (k, d) in difference[(row, col)].iter_mut().enumerate() {
                    let drift = line[k][c] * (1.0 - fu) + line[k][c + 1] * fu;
                    *d += gain[k] * (*d + f32::from(still[k])) + offset[k] + drift;
                }
            }
        }
    }
}

/// An image's colour difference and the truth, at the working size.
pub(super) struct Press {
    /// Image minus no-contact image, R, G, B.
    pub(super) difference: Raster<[f32; 3]>,
    /// Indentation, mm.
    pub(super) depth: Raster<f32>,
    /// Contact.
    pub(super) mask: Raster<bool>,
}

impl Press {
    pub(super) fn load(
        samples: &dyn Samples,
        index: usize,
        relaxed: &Raster<f32>,
        augment: Option<(&LightAugment, &mut Pcg64)>,
    ) -> Result<Self, DataError> {
        let PressSample { image, height_map, mask } = samples.load(index)?;
        let sizes = [image.shape(), height_map.shape(), mask.shape()];
        if sizes != [WORKING_SIZE; 3] {
            return Err(DataError::Sizes { index, object: samples.object(index).to_owned(), sizes });
        }
        let raster = "same size";
        let background = samples.background();
        let pixels = image.as_slice().iter().zip(background.as_slice());
        let difference = pixels.map(|(i, b)| std::array::from_fn(|k| f32::from(i[k]) - f32::from(b[k]))).collect();
        let mut difference = Raster::from_vec(WORKING_SIZE.0, WORKING_SIZE.1, difference).expect(raster);
        if let Some((augment, rng)) = augment {
            augment.apply(&mut difference, background, rng);
        }
        let depth = height_map.as_slice().iter().zip(relaxed.as_slice()).map(|(z, g)| (g - z) * 1e3).collect();
        Ok(Self { difference, depth: Raster::from_vec(WORKING_SIZE.0, WORKING_SIZE.1, depth).expect(raster), mask })
    }

    /// Steps of the depth to the next column and the next row, mm; 0 over the border.
    pub(super) fn steps(&self) -> Raster<[f32; 2]> {
        let (rows, cols) = self.depth.shape();
        Raster::from_fn(rows, cols, |r, c| {
            let here = self.depth[(r, c)];
            let step = |r: usize, c: usize| self.depth.get(r, c).map_or(0.0, |d| d - here);
            [step(r, c + 1), step(r + 1, c)]
        })
    }
}
