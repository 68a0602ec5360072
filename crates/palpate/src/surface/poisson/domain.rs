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

/// (Noise over spacing, cell over spacing) from which larger cells are tried, with straight lines between; noise beyond the last raises the cells in
/// proportion. From the errors of three objects at 10,000 to 200,000 points with noise of 0 to 1 mm.
const NOISY: [(f64, f64); 3] = [(0.22, 1.2), (0.35, 1.2), (0.5, 1.9)];

/// Noise over spacing from which the larger cells stay whatever the misfit, which says nothing where the noise is as large as the cells.
const VERY_NOISY: f64 = 0.5;
const CELL_PER_NOISE: f64 = 2.4;

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
            return Ok((samples, Self { origin, edge: smallest, depth, coarse: false, finer_depth: None, noise }));
        }
        let (chosen_cells, may_refine) = automatic(noise / (smallest * spacing));
        let coarse = params.cell_per_spacing.is_none() && chosen_cells > CELL_PER_SPACING;
        let may_refine = may_refine && coarse;
        let cells = params.cell_per_spacing.unwrap_or(chosen_cells);
        let cell = cells * spacing * smallest;
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

/// Cell over spacing for samples with this noise over spacing, and whether cells half as large follow if those do not explain the samples.
fn automatic(noise_per_spacing: f64) -> (f64, bool) {
    if noise_per_spacing < NOISY[0].0 {
        return (CELL_PER_SPACING, false);
    }
    let between = NOISY.windows(2).find(|w| noise_per_spacing < w[1].0);
    let cells = match between {
        Some(&[(from, low), (to, high), ..]) => low + (high - low) * (noise_per_spacing - from) / (to - from),
        _ => NOISY[2].1.max(CELL_PER_NOISE * noise_per_spacing),
    };
    (cells, noise_per_spacing < VERY_NOISY)
}

/// Median over the samples of 1/√density, repeated positions counted once on average.
fn median_spacing(samples: &Samples) -> f64 {
    let density = Density::new(samples, AUTOMATIC_DEPTHS.1);
    let repeats = samples.len() as f64 / samples.distinct() as f64;
    (repeats / super::finish::median_density(&density, samples)).sqrt()
}
