use super::{Augment, DataError, PressSample, Samples};
use palpate::geometry::Raster;
use rand_pcg::Pcg64;

/// A sample of a network's input size, planar.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// `[3, rows, cols]`: grey levels of 255, red green blue; or their differences to the background.
    pub image: Vec<f32>,
    /// z of the gel, metres.
    pub height: Vec<f32>,
    /// 1 where the object touches, else 0.
    pub mask: Vec<f32>,
}

impl Prepared {
    /// Loads a press and brings it to `(rows, cols)`.
    ///
    /// Images are resampled bilinearly, so is the mask, which is then cut at one half.
    ///
    /// * `subtract` – whether the background is taken off
    /// * `augment` – with its random numbers; none in validation
    ///
    /// # Errors
    /// [`DataError::Io`], [`DataError::Sizes`].
    pub fn load(
        samples: &dyn Samples,
        index: usize,
        (rows, cols): (usize, usize),
        subtract: bool,
        augment: Option<(&Augment, &mut Pcg64)>,
    ) -> Result<Self, DataError> {
        let PressSample { image, height_map, mask } = samples.load(index)?;
        let sizes = [image.shape(), height_map.shape(), mask.shape()];
        if sizes[1] != sizes[0] || sizes[2] != sizes[0] {
            return Err(DataError::Sizes { index, object: samples.object(index).to_owned(), sizes });
        }
        let background = samples.background();
        let plane =
            |raster: &Raster<[u8; 3]>, channel: usize| resize(&raster.map(|rgb| f32::from(rgb[channel])), rows, cols);
        let mut channels = Vec::with_capacity(3 * rows * cols);
        for channel in 0..3 {
            channels.extend_from_slice(plane(&image, channel).as_slice());
        }
        // The lamp changes, then the background is subtracted that was recorded before.
        if let Some((augment, rng)) = augment {
            augment.apply(&mut channels, rng);
        }
        if subtract {
            for (channel, values) in channels.chunks_mut(rows * cols).enumerate() {
                let background = plane(background, channel);
                values.iter_mut().zip(background.as_slice()).for_each(|(v, b)| *v -= b);
            }
        }
        let mask = resize(&mask.map(|&m| f32::from(u8::from(m))), rows, cols);
        Ok(Self {
            image: channels,
            height: resize(&height_map, rows, cols).as_slice().to_vec(),
            mask: mask.as_slice().iter().map(|&m| f32::from(u8::from(m >= 0.5))).collect(),
        })
    }
}

/// Bilinear resampling with pixel areas aligned and edges repeated; halving averages 2 × 2 pixels.
pub fn resize(raster: &Raster<f32>, rows: usize, cols: usize) -> Raster<f32> {
    if raster.shape() == (rows, cols) {
        return raster.clone();
    }
    let axis = |to: usize, from: usize| -> Vec<(usize, usize, f32)> {
        (0..to)
            .map(|i| {
                let x = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, from as f64 - 1.0);
                let low = x.floor() as usize;
                (low, (low + 1).min(from - 1), (x - low as f64) as f32)
            })
            .collect()
    };
    let (vs, us) = (axis(rows, raster.rows()), axis(cols, raster.cols()));
    Raster::from_fn(rows, cols, |row, col| {
        let ((r0, r1, fv), (c0, c1, fu)) = (vs[row], us[col]);
        let along = |r| raster[(r, c0)] * (1.0 - fu) + raster[(r, c1)] * fu;
        along(r0) * (1.0 - fv) + along(r1) * fv
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_averages_and_doubling_keeps_the_mean() {
        let raster = Raster::from_fn(4, 6, |r, c| (r * 6 + c) as f32);
        let half = resize(&raster, 2, 3);
        assert_eq!(half[(0, 0)], (0.0 + 1.0 + 6.0 + 7.0) / 4.0);
        let double = resize(&raster, 8, 12);
        let mean = |r: &Raster<f32>| r.as_slice().iter().sum::<f32>() / r.as_slice().len() as f32;
        assert!((mean(&double) - mean(&raster)).abs() < 1e-4);
    }
}
