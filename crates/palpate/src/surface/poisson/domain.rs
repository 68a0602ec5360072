//! The cube that the octree divides, and how deep.

use super::density::Density;
use super::octree::Samples;
use super::{FEWEST_SAMPLES, PoissonParams, noise};
use crate::geometry::{Aabb, Point, PointCloud, Vector};
use crate::surface::SurfaceError;

/// Depths that an automatic choice stays within.
const AUTOMATIC_DEPTHS: (u32, u32) = (4, 10);

/// Finest cell over spacing for samples with little noise.
const CELL_PER_SPACING: f64 = 0.85;

/// Finest cell over (longest edge of the cloud's box · noise · spacing)^⅓ for noisy samples. With cells of h the fit's bias goes with h² times the
/// curvature, its scatter with noise · spacing / h; both together are least at an h that is such a root, with curvatures in proportion to the box. The
/// factor: errors of the drill, the bunny and the armadillo, 10,000 to 200,000 points, noise of 0.3 and 1 mm.
const NOISY_CELL: f64 = 0.3;

/// Finest cell over noise, at least.
const CELL_PER_NOISE: f64 = 1.0;

/// Noise over spacing from which the larger cells stay whatever the misfit, which says nothing where the noise is as large as the cells.
const VERY_NOISY: f64 = 0.5;

pub(super) struct Domain {
    pub(super) origin: Point,
    pub(super) edge: f64,
    pub(super) depth: u32,
    /// Whether the cells are coarser than the spacing asks for, because of the noise.
    pub(super) coarse: bool,
    /// Depth to go on to if the samples are not explained at that one.
    pub(super) finer_depth: Option<u32>,
    /// Standard deviation of the samples along their normals, metres.
    pub(super) noise: f64,
}

impl Domain {
    /// Edge of the cells of a depth, metres.
    pub(super) fn cell(&self, depth: u32) -> f64 {
        self.edge / f64::from(1_u32 << depth)
    }

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
            (Samples::new(&cloud.points, normals, weights, chosen, origin, edge), origin)
        };
        let (samples, origin) = sorted(smallest);
        let distinct = samples.distinct();
        if distinct < FEWEST_SAMPLES {
            return Err(few(distinct));
        }
        let spacing = median_spacing(&samples);
        let noise = params.noise.unwrap_or_else(|| smallest * noise::deviation(&samples, spacing));
        if let Some(depth) = params.depth {
            return Ok((samples, Self { origin, edge: smallest, depth, coarse: false, finer_depth: None, noise }));
        }
        let spacing = smallest * spacing;
        let automatic = automatic_cell(longest, noise, spacing);
        let coarse = params.cell_per_spacing.is_none() && automatic > CELL_PER_SPACING * spacing;
        let may_refine = coarse && noise < VERY_NOISY * spacing;
        let cell = params.cell_per_spacing.map_or(automatic, |c| c * spacing);
        let depth = (smallest / cell).log2().ceil() as u32;
        let (low, high) = AUTOMATIC_DEPTHS;
        let finer = |depth: u32| (may_refine && depth < high).then_some(depth + 1);
        if depth < low || depth > high {
            let depth = depth.clamp(low, high);
            return Ok((samples, Self { origin, edge: smallest, depth, coarse, finer_depth: finer(depth), noise }));
        }
        drop(samples);
        let edge = cell * f64::from(1_u32 << depth);
        let (samples, origin) = sorted(edge);
        Ok((samples, Self { origin, edge, depth, coarse, finer_depth: finer(depth), noise }))
    }
}

/// The cell that noise and spacing ask for.
fn automatic_cell(longest: f64, noise: f64, spacing: f64) -> f64 {
    let noisy = (NOISY_CELL * (longest * noise * spacing).cbrt()).max(CELL_PER_NOISE * noise);
    noisy.max(CELL_PER_SPACING * spacing)
}

/// The cell that points with unit normals ask for, metres; zero for none or one place.
pub(in crate::surface) fn wanted_cell(points: &[Point], normals: &[Vector]) -> f64 {
    let (noise, spacing) = noise_and_spacing(points, normals);
    automatic_cell(Aabb::of(points).map_or(0.0, |b| b.size().max()), noise, spacing)
}

/// Standard deviation of points along their unit normals, and their median spacing, metres; zero for none or one place.
pub(in crate::surface) fn noise_and_spacing(points: &[Point], normals: &[Vector]) -> (f64, f64) {
    let Some(bounds) = Aabb::of(points) else { return (0.0, 0.0) };
    let edge = bounds.size().max();
    if !(edge > 0.0 && edge.is_finite()) {
        return (0.0, 0.0);
    }
    let chosen: Vec<u32> = (0..points.len() as u32).collect();
    let samples = Samples::new(points, normals, None, &chosen, bounds.min, edge);
    let spacing = median_spacing(&samples);
    (edge * noise::deviation(&samples, spacing), edge * spacing)
}

/// Median over the samples of 1/√density, repeated positions counted once on average.
fn median_spacing(samples: &Samples) -> f64 {
    let mut density = Density::new(samples, AUTOMATIC_DEPTHS.1);
    let repeats = samples.len() as f64 / samples.distinct() as f64;
    (repeats / super::finish::median_density(&mut density, samples)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cell_grows_with_the_cube_root_of_the_noise_and_never_below_it() {
        assert_eq!(automatic_cell(1.0, 0.0, 1e-3), CELL_PER_SPACING * 1e-3);
        let [low, high] = [5e-4, 4e-3].map(|noise| automatic_cell(1.0, noise, 1e-3));
        assert!((low - 2.381e-3).abs() < 1e-6 && (high / low - 2.0).abs() < 1e-12, "{low} {high}");
        assert_eq!(automatic_cell(1.0, 0.1, 1e-3), 0.1);
        // Whatever the unit.
        assert!((automatic_cell(1e3, 0.5, 1.0) / low - 1e3).abs() < 1e-9);
    }
}
