//! Rasters that span the same pad at another resolution: areas are averaged going down, interpolated going up.

use crate::geometry::Raster;

/// A pixel that can be averaged.
pub trait Blend: Copy {
    /// Nothing.
    const ZERO: Self;
    /// Adds `weight` of `other`.
    fn add(&mut self, other: Self, weight: f32);
}

impl Blend for f32 {
    const ZERO: Self = 0.0;
    fn add(&mut self, other: Self, weight: f32) {
        *self += other * weight;
    }
}

impl<const N: usize> Blend for [f32; N] {
    const ZERO: Self = [0.0; N];
    fn add(&mut self, other: Self, weight: f32) {
        for (a, b) in self.iter_mut().zip(other) {
            *a += b * weight;
        }
    }
}

/// The raster at another size. Both span the same area; pixel centres are at half-integers of it.
///
/// Along an axis that shrinks, a pixel is the mean of the area it covers; along one that grows, it is interpolated linearly.
pub fn resize<T: Blend>(source: &Raster<T>, rows: usize, cols: usize) -> Raster<T> {
    if source.shape() == (rows, cols) {
        return source.clone();
    }
    let across = taps(source.cols(), cols);
    let down = taps(source.rows(), rows);
    let weigh = |taps: &[(usize, f32)], value: &dyn Fn(usize) -> T| {
        let mut sum = T::ZERO;
        for &(i, weight) in taps {
            sum.add(value(i), weight);
        }
        sum
    };
    let narrow = Raster::from_fn(source.rows(), cols, |r, c| weigh(&across[c], &|i| source[(r, i)]));
    Raster::from_fn(rows, cols, |r, c| weigh(&down[r], &|i| narrow[(i, c)]))
}

/// Source pixels and weights of each target pixel along one axis.
fn taps(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let ratio = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            if ratio > 1.0 {
                let (low, high) = (i as f64 * ratio, (i + 1) as f64 * ratio);
                let last = (high.ceil() as usize).min(from);
                (low as usize..last)
                    .map(|k| (k, ((high.min((k + 1) as f64) - low.max(k as f64)) / ratio) as f32))
                    .filter(|(_, weight)| *weight > 1e-6)
                    .collect()
            } else {
                let center = ((i as f64 + 0.5) * ratio - 0.5).clamp(0.0, from as f64 - 1.0);
                let low = center.floor() as usize;
                let share = (center - low as f64) as f32;
                if share > 0.0 { vec![(low, 1.0 - share), (low + 1, share)] } else { vec![(low, 1.0)] }
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_averages_four_pixels_and_doubling_keeps_a_ramp() {
        let ramp = Raster::from_fn(8, 12, |r, c| 10.0 * r as f32 + c as f32);
        let half = resize(&ramp, 4, 6);
        assert_eq!(half[(1, 2)], 0.25 * (24.0 + 25.0 + 34.0 + 35.0));
        let double = resize(&ramp, 16, 24);
        // Pixel 9 of 24 is centred at 9.5 / 24 of the width: column 4.25 of 12.
        assert!((double[(4, 9)] - (10.0 * 1.75 + 4.25)).abs() < 1e-5);
    }

    #[test]
    fn any_ratio_keeps_the_mean() {
        let noise = Raster::from_fn(37, 53, |r, c| ((r * 7919 + c * 104_729) % 97) as f32);
        let mean = |m: &Raster<f32>| m.as_slice().iter().sum::<f32>() / m.as_slice().len() as f32;
        assert!((mean(&resize(&noise, 11, 20)) - mean(&noise)).abs() < 1e-2);
    }
}
