//! How far the samples lie off their surface, read from the samples themselves.

use super::octree::Samples;
use rayon::prelude::*;

/// Samples after each in octree order that are compared with it.
const PAIRS: usize = 4;

/// Pairs that are looked at; more tell the noise no better.
const MOST_PAIRS: usize = 200_000;

/// Pairs are compared up to this many spacings apart along the surface, and once the noise is known, that many of its deviations further …
const REACH: (f64, f64) = (2.5, 5.0);

/// … and if their normals agree to this cosine: not across edges and thin walls.
const AGREEMENT: f64 = 0.7;

/// Neighbours in octree order are near in space, hence alike in their noise where that is as large as the spacing: the samples that lie between those
/// compared cover a square with a side of this many deviations.
const APART: f64 = 4.0;

/// Most estimates, each with the pairs that the one before asks for …
const ROUNDS: usize = 5;

/// … until they agree to this share.
const SETTLED: f64 = 0.02;

/// Median of |x| for the standard normal distribution.
const MEDIAN_OF_NORMAL: f64 = 0.674_489_75;

/// Standard deviation of the samples along their normals, in units of the unit cube.
///
/// For two points of a sphere the chord is perpendicular to the sum of the normals, and for any smooth surface it is so up to the third order of the
/// distance: what is left of (q − p)·(n + m)/|n + m| is the noise of two samples. The median does not see edges and outliers. Noise of the normals
/// counts as noise of the position at the distance of a neighbour, which is what it does to the surface.
///
/// * `spacing` – of each sample, unit cube; 0 if no pair is near enough
pub(super) fn deviation(samples: &Samples, spacing: f64) -> f64 {
    let mut deviation = deviation_within(samples, REACH.0 * spacing, 1);
    for _ in 1..ROUNDS {
        let stride = ((APART * deviation / spacing).powi(2).ceil() as usize).clamp(1, samples.len().div_ceil(PAIRS));
        let next = deviation_within(samples, REACH.0 * spacing + REACH.1 * deviation, stride);
        let settled = (next - deviation).abs() <= SETTLED * next;
        deviation = next;
        if settled {
            break;
        }
    }
    deviation
}

fn deviation_within(samples: &Samples, reach: f64, stride: usize) -> f64 {
    let step = (PAIRS * samples.len()).div_ceil(MOST_PAIRS);
    let compared = |i: usize| {
        let (p, n) = (samples.position[i], samples.normal(i).map(f64::from));
        (1..=PAIRS).map(move |k| i + k * stride).take_while(|&j| j < samples.len()).filter_map(move |j| {
            let (q, m) = (samples.position[j], samples.normal(j).map(f64::from));
            let chord: [f64; 3] = std::array::from_fn(|k| q[k] - p[k]);
            let sum: [f64; 3] = std::array::from_fn(|k| n[k] + m[k]);
            let residual = dot(chord, sum) / dot(sum, sum).sqrt();
            let along = dot(chord, chord) - residual * residual;
            (along > 0.0 && along < reach * reach && dot(n, m) > AGREEMENT).then(|| residual.abs())
        })
    };
    let looked_at = samples.len().div_ceil(step);
    let mut residuals: Vec<f64> =
        (0..looked_at).into_par_iter().with_min_len(1024).flat_map_iter(|i| compared(i * step)).collect();
    if residuals.is_empty() {
        return 0.0;
    }
    let middle = residuals.len() / 2;
    let (_, median, _) = residuals.select_nth_unstable_by(middle, f64::total_cmp);
    *median / (MEDIAN_OF_NORMAL * std::f64::consts::SQRT_2)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Vector};
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn the_noise_of_a_sphere_is_read_whatever_its_curvature() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        // The spacing is 0.017.
        for sigma in [0.0, 1e-4, 1e-3, 5e-3, 1.5e-2, 2.5e-2] {
            let noise = Normal::new(0.0, sigma).expect("finite");
            let (mut points, mut normals) = (Vec::new(), Vec::new());
            while points.len() < 4000 {
                let v = Vector::from_fn(|_, _| rng.random_range(-1.0..1.0));
                if let Some(n) = v.try_normalize(0.05).filter(|_| v.norm() < 1.0) {
                    points.push(Point::from(n * (0.3 + noise.sample(&mut rng))));
                    normals.push(n);
                }
            }
            let chosen: Vec<u32> = (0..4000).collect();
            let samples = Samples::new(&points, &normals, None, &chosen, Point::new(-0.5, -0.5, -0.5), 1.0);
            let found = deviation(&samples, 0.3 * (4.0 * std::f64::consts::PI / 4000.0_f64).sqrt());
            assert!((found - sigma).abs() < 0.08 * sigma + 1e-6, "{found} for {sigma}");
        }
    }
}
