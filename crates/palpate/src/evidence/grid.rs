use super::{EvidenceParams, Sample};
use crate::geometry::{Aabb, Point, VoxelGrid, distance_to_true_3d};
use rayon::prelude::*;

/// Cells along the longest side while the box is being cropped.
const CROP_CELLS: usize = 48;
/// Pads are only millimetres thick: on coarser cells than this, metres, they would bleed through thin walls.
const PAD_CELL: f64 = 0.0022;

/// The hull that free space leaves, as a signed distance on a regular grid.
pub(super) struct CarvedGrid {
    values: VoxelGrid<f32>,
    hull: Aabb,
}

impl CarvedGrid {
    /// * `proven` – clearance by camera and support plane · `pad` – clearance by the pads, used if `has_pads`
    pub(super) fn new(
        samples: &[Sample],
        params: &EvidenceParams,
        proven: impl Fn(&Point) -> f64 + Sync,
        pad: impl Fn(&Point) -> f64 + Sync,
        has_pads: bool,
    ) -> Self {
        let measured = Aabb::of(samples.iter().map(|s| &s.position))
            .unwrap_or(Aabb { min: Point::origin(), max: Point::origin() });
        // No hidden part is farther away than the visible part is long; two coarse passes crop the box to the hull.
        let mut bounds = measured.inflated(measured.diagonal() + params.grid_margin);
        for _ in 0..2 {
            let spacing = bounds.size().max() / CROP_CELLS as f64;
            let unknown = carve(&bounds, spacing, samples, |p| proven(p) <= 0.0);
            let hull = box_of_true(&unknown).map_or(measured, |b| b.inflated(spacing).union(&measured));
            bounds = Aabb {
                min: hull.inflated(params.grid_margin).min.sup(&bounds.min),
                max: hull.inflated(params.grid_margin).max.inf(&bounds.max),
            };
        }
        let spacing = (bounds.size().max() / params.grid_cells as f64).max(1e-5);
        let with_pads = has_pads && spacing < PAD_CELL;
        let unknown = carve(&bounds, spacing, samples, |p| proven(p) <= 0.0 && !(with_pads && pad(p) > 0.0));
        let hull = box_of_true(&unknown).map_or(measured, |b| b.union(&measured));
        Self { values: signed_distance(&unknown), hull }
    }

    pub(super) fn values(&self) -> &VoxelGrid<f32> {
        &self.values
    }

    pub(super) fn hull_bounds(&self) -> Aabb {
        self.hull
    }

    /// Trilinear inside the grid; outside, the bound that convexity of the box gives: both legs of a right (or obtuse) angle.
    #[inline]
    pub(super) fn signed_distance(&self, p: &Point) -> f64 {
        let dims = self.values.dims();
        let c = self.values.coordinates(p);
        let (mut base, mut t, mut outside) = ([0; 3], [0.0; 3], 0.0);
        for a in 0..3 {
            let last = (dims[a] - 1) as f64;
            let inside = c[a].clamp(0.0, last);
            outside += (c[a] - inside).powi(2);
            base[a] = (inside as usize).min(dims[a].saturating_sub(2));
            t[a] = inside - base[a] as f64;
        }
        let mut value = 0.0;
        for corner in 0..8_usize {
            let (mut index, mut weight) = ([0; 3], 1.0);
            for a in 0..3 {
                let upper = corner >> a & 1;
                index[a] = (base[a] + upper).min(dims[a] - 1);
                weight *= if upper == 1 { t[a] } else { 1.0 - t[a] };
            }
            value += weight * f64::from(self.values.as_slice()[self.values.index(index[0], index[1], index[2])]);
        }
        if outside == 0.0 { value } else { (value.max(0.0).powi(2) + outside * self.values.spacing().powi(2)).sqrt() }
    }
}

/// A grid over `bounds` that is true where `unknown` says so and a chain of such nodes leads to a sample: the object is connected.
fn carve(bounds: &Aabb, spacing: f64, samples: &[Sample], unknown: impl Fn(&Point) -> bool + Sync) -> VoxelGrid<bool> {
    let mut grid = VoxelGrid::covering(bounds, spacing, false);
    let [nx, ny, _] = grid.dims();
    let origin = grid.origin();
    grid.as_mut_slice().par_chunks_mut(nx).enumerate().for_each(|(line, values)| {
        let (j, k) = ((line % ny) as f64, (line / ny) as f64);
        for (i, value) in values.iter_mut().enumerate() {
            *value = unknown(&(origin + nalgebra::Vector3::new(i as f64, j, k) * spacing));
        }
    });
    joined_to_samples(&grid, samples)
}

fn joined_to_samples(unknown: &VoxelGrid<bool>, samples: &[Sample]) -> VoxelGrid<bool> {
    let dims = unknown.dims();
    let mut joined = VoxelGrid::filled(unknown.origin(), unknown.spacing(), dims, false);
    // A sample's own node is never free: a wall thinner than a cell would vanish between the nodes.
    let mut stack: Vec<usize> = Vec::new();
    for s in samples {
        if let Some(node) = unknown.nearest(&s.position)
            && !joined.as_slice()[node]
        {
            joined.as_mut_slice()[node] = true;
            stack.push(node);
        }
    }
    while let Some(node) = stack.pop() {
        let at = [node % dims[0], node / dims[0] % dims[1], node / (dims[0] * dims[1])];
        let range = |a: usize| at[a].saturating_sub(1)..(at[a] + 2).min(dims[a]);
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let neighbour = unknown.index(i, j, k);
                    if unknown.as_slice()[neighbour] && !joined.as_slice()[neighbour] {
                        joined.as_mut_slice()[neighbour] = true;
                        stack.push(neighbour);
                    }
                }
            }
        }
    }
    joined
}

/// The box of the true nodes, each with its cell.
fn box_of_true(grid: &VoxelGrid<bool>) -> Option<Aabb> {
    let [nx, ny, nz] = grid.dims();
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for k in 0..nz {
        for j in 0..ny {
            let line = &grid.as_slice()[grid.index(0, j, k)..][..nx];
            let (Some(first), Some(last)) = (line.iter().position(|&v| v), line.iter().rposition(|&v| v)) else {
                continue;
            };
            low = [low[0].min(first), low[1].min(j), low[2].min(k)];
            high = [high[0].max(last), high[1].max(j), high[2].max(k)];
        }
    }
    let half = 0.5 * grid.spacing();
    (low[0] != usize::MAX).then(|| {
        Aabb { min: grid.position(low[0], low[1], low[2]), max: grid.position(high[0], high[1], high[2]) }
            .inflated(half)
    })
}

/// Distance to the boundary between true and false nodes, which runs halfway between them; > 0 at false ones.
fn signed_distance(unknown: &VoxelGrid<bool>) -> VoxelGrid<f32> {
    let mut distance = distance_to_true_3d(unknown);
    let mut free = unknown.clone();
    free.as_mut_slice().iter_mut().for_each(|v| *v = !*v);
    let depth = distance_to_true_3d(&free);
    let (h, far) = (unknown.spacing() as f32, unknown.dims().iter().sum::<usize>() as f32);
    distance.as_mut_slice().par_iter_mut().zip(depth.as_slice()).for_each(|(d, inside)| {
        *d = h * if *d > 0.0 { d.min(far) - 0.5 } else { 0.5 - inside.min(far) };
    });
    distance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Provenance;
    use crate::geometry::Vector;

    fn ball() -> CarvedGrid {
        let sample = |p: Vector| Sample {
            position: Point::from(p * 0.05),
            normal: p,
            sigma: 1e-4,
            provenance: Provenance::Seen,
        };
        let samples = [Vector::x(), -Vector::x(), Vector::y(), -Vector::y(), Vector::z(), -Vector::z()].map(sample);
        let params = EvidenceParams { grid_cells: 60, ..EvidenceParams::default() };
        CarvedGrid::new(&samples, &params, |p| p.coords.norm() - 0.05, |_| -1.0, false)
    }

    #[test]
    fn a_carved_ball_has_its_distance_inside_and_outside_the_grid() {
        let grid = ball();
        let h = grid.values().spacing();
        assert!(grid.hull_bounds().size().max() < 0.1 + 2.0 * h, "cropped to the ball: {:?}", grid.hull_bounds());
        for (p, truth) in [
            (Point::new(0.06, 0.0, 0.0), 0.01),
            (Point::new(0.0, 0.03, 0.0), -0.02),
            (Point::new(0.036, 0.036, 0.02), (0.036_f64.powi(2) * 2.0 + 0.0004).sqrt() - 0.05),
        ] {
            assert!((grid.signed_distance(&p) - truth).abs() < h, "{p}: {} is not {truth}", grid.signed_distance(&p));
        }
        let far = grid.signed_distance(&Point::new(0.3, 0.2, 0.1));
        let truth = (0.09_f64 + 0.04 + 0.01).sqrt() - 0.05;
        assert!(far < truth + h && far > 0.5 * truth, "a lower bound far away: {far} of {truth}");
    }
}
