//! A press as the compact network's parts see it.

use crate::data::{DataError, PressSample, Samples};
use palpate::geometry::Raster;
use palpate::tactile::compact::WORKING_SIZE;
use rand::RngExt as _;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// Random changes of the light on top of those that the data set was made with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightAugment {
    /// 1σ of the relative change of a channel's gain; a fifth of the images get four times as much.
    pub gain: f64,
    /// 1σ of a channel's offset, grey levels.
    pub offset: f64,
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
        let (mut gain, mut offset) = ([1.0f32; 3], [0.0f32; 3]);
        if let Some((augment, rng)) = augment {
            let wide = if rng.random::<f64>() < 0.2 { 4.0 } else { 1.0 };
            for k in 0..3 {
                let mut normal = |sigma: f64| (sigma * wide * rng.sample::<f64, _>(StandardNormal)) as f32;
                gain[k] += normal(augment.gain).clamp(-0.4, 0.4);
                offset[k] = normal(augment.offset);
            }
        }
        let pixels = image.as_slice().iter().zip(samples.background().as_slice());
        let difference = pixels
            .map(|(i, b)| std::array::from_fn(|k| f32::from(i[k]) * gain[k] + offset[k] - f32::from(b[k])))
            .collect();
        let depth = height_map.as_slice().iter().zip(relaxed.as_slice()).map(|(z, g)| (g - z) * 1e3).collect();
        let raster = "same size";
        Ok(Self {
            difference: Raster::from_vec(WORKING_SIZE.0, WORKING_SIZE.1, difference).expect(raster),
            depth: Raster::from_vec(WORKING_SIZE.0, WORKING_SIZE.1, depth).expect(raster),
            mask,
        })
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
