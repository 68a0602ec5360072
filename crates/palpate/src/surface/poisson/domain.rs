//! The cube that the octree divides, and how deep.

use super::density::Density;
use super::octree::Samples;
use super::{FEWEST_SAMPLES, PoissonParams, noise};
use crate::geometry::{Aabb, Point, PointCloud, Vector};
use crate::surface::SurfaceError;

/// Depths that an automatic choice stays within.
const AUTOMATIC_DEPTHS: (u32, u32) = (4, 10);

/// Finest cell over spacing without noise, and how fast it grows with noise over spacing.
const CELL_PER_SPACING: (f64, f64) = (1.0, 2.0);

/// The largest cell over spacing that an automatic choice makes.
const LARGEST_CELL: f64 = 3.0;

pub(super) struct Domain {
    pub(super) origin: Point,
    pub(super) edge: f64,
    pub(super) depth: u32,
    /// Standard deviation of the samples along their normals, metres.
    pub(super) noise: f64,
}

impl Domain {
    /// With a stated depth, the cloud's box times the scale; otherwise the smallest such cube that is a power of two of the wanted cells.
    pub(super) fn choose(
        cloud: &PointCloud,
        normals: &[Vector],
        weights: Option<&[f64]>,
        chosen: &[u32],
        params: &PoissonParams,
    ) -> Result<(Samples, Self), SurfaceError> {
        let bounds = Aabb::of(chosen.iter().map(|&i| &cloud.points[i as usize]));
        let few = |found| SurfaceError::TooFewPoints { found, needed: FEWEST_SAMPLES };
        let bounds = bounds.ok_or(few(0))?;
        let longest = bounds.size().max();
        if !(longest > 0.0 && longest.is_finite()) {
            return Err(few(1));
        }
        let smallest = params.scale * longest;
        let sorted = |edge: f64| {
            let origin = bounds.center() - Vector::repeat(0.5 * edge);
            (Samples::new(cloud, normals, weights, chosen, origin, edge), origin)
        };
        let (samples, origin) = sorted(smallest);
        let distinct = samples.distinct();
        if distinct < FEWEST_SAMPLES {
            return Err(few(distinct));
        }
        let spacing = median_spacing(&samples);
        let noise = params.noise.unwrap_or_else(|| smallest * noise::deviation(&samples, spacing));
        if let Some(depth) = params.depth {
            return Ok((samples, Self { origin, edge: smallest, depth, noise }));
        }
        let cell_per_spacing = params.cell_per_spacing.unwrap_or_else(|| automatic(noise / (smallest * spacing)));
        let cell = cell_per_spacing * spacing * smallest;
        let depth = (smallest / cell).log2().ceil() as u32;
        let (low, high) = AUTOMATIC_DEPTHS;
        if depth < low || depth > high {
            return Ok((samples, Self { origin, edge: smallest, depth: depth.clamp(low, high), noise }));
        }
        drop(samples);
        let edge = cell * f64::from(1_u32 << depth);
        let (samples, origin) = sorted(edge);
        Ok((samples, Self { origin, edge, depth, noise }))
    }
}

/// Finest cell over spacing for samples with this noise over spacing.
fn automatic(noise_per_spacing: f64) -> f64 {
    let (clean, growth) = CELL_PER_SPACING;
    (clean + growth * noise_per_spacing).min(LARGEST_CELL)
}

/// Median over the samples of 1/√density, repeated positions counted once on average.
fn median_spacing(samples: &Samples) -> f64 {
    let density = Density::new(samples, AUTOMATIC_DEPTHS.1);
    let repeats = samples.len() as f64 / samples.distinct() as f64;
    (repeats / super::finish::median_density(&density, samples)).sqrt()
}
