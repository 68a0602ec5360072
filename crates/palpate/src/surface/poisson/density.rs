//! How densely the surface is sampled: samples per unit area, read from splatted counts.

use super::basis::{QUADRATIC_SELF, quadratic};
use super::octree::{Lattice, Samples, cell_keys, grown, locate};
use rayon::prelude::*;

/// Samples (or weight) that the kernel must see before a density is trusted; otherwise a coarser depth is asked.
const ENOUGH: f64 = 6.0;

/// Coarsest depth that is read.
const COARSEST: u32 = 2;

/// Counts and weights splatted at several depths with quadratic B-splines, which see a plane nearly alike at every tilt and offset.
pub(super) struct Density {
    /// From fine to coarse.
    depths: Vec<Splat>,
}

struct Splat {
    depth: u32,
    cells: Lattice,
    count: Vec<f64>,
    weight: Vec<f64>,
}

/// Density at a place, per area in units of the unit cube.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Reading {
    /// Samples per unit area.
    pub(super) count: f64,
    /// Weight per unit area.
    pub(super) weight: f64,
}

impl Density {
    /// Splats at the deepest depth, at most `deepest`, whose occupied cells hold eight distinct samples on average, and at the coarser ones.
    pub(super) fn new(samples: &Samples, deepest: u32) -> Self {
        let distinct = samples.distinct();
        let finest = (COARSEST..=deepest).rev().find(|&d| distinct >= 8 * samples.occupied(d)).unwrap_or(COARSEST);
        Self { depths: (COARSEST..=finest).rev().map(|depth| Splat::new(samples, depth)).collect() }
    }

    /// The density at a place of the unit cube; near zero far from all samples.
    pub(super) fn at(&self, place: [f64; 3]) -> Reading {
        let mut reading = Reading::default();
        for splat in &self.depths {
            let (count, weight) = splat.read(place);
            // Σ of the kernel over a plane of density ρ per cell is QUADRATIC_SELF · ρ.
            let cells_per_area = f64::from(1_u32 << splat.depth).powi(2) / QUADRATIC_SELF;
            reading = Reading { count: count * cells_per_area, weight: weight * cells_per_area };
            if count >= ENOUGH * QUADRATIC_SELF {
                break;
            }
        }
        reading
    }

    /// The density at every sample.
    pub(super) fn at_samples(&self, samples: &Samples) -> Vec<Reading> {
        samples.position.par_iter().map(|&p| self.at(p)).collect()
    }
}

impl Splat {
    fn new(samples: &Samples, depth: u32) -> Self {
        let last = (1_i16 << depth) - 1;
        let occupied = cell_keys(samples.cells(depth).into_iter().map(|(cell, _)| cell));
        let cells = Lattice::new(depth, &grown(occupied, 0..=last));
        let (mut count, mut weight) = (vec![0.0; cells.len()], vec![0.0; cells.len()]);
        for (&place, &w) in samples.position.iter().zip(&samples.weight) {
            for_kernel(&cells, depth, place, |i, b| {
                count[i] += b;
                weight[i] += w * b;
            });
        }
        Self { depth, cells, count, weight }
    }

    fn read(&self, place: [f64; 3]) -> (f64, f64) {
        let (mut count, mut weight) = (0.0, 0.0);
        for_kernel(&self.cells, self.depth, place, |i, b| {
            count += b * self.count[i];
            weight += b * self.weight[i];
        });
        (count, weight)
    }
}

/// Calls `f` with each stored cell under the kernel centred at a place, and the kernel's value there.
fn for_kernel(cells: &Lattice, depth: u32, place: [f64; 3], mut f: impl FnMut(usize, f64)) {
    let (cell, inside) = locate(place, depth);
    let [bx, by, bz] = inside.map(quadratic);
    for (dz, wz) in (-1..=1).zip(bz) {
        for (dy, wy) in (-1..=1).zip(by) {
            // There are rows just outside the domain, and they are empty.
            let row = cells.row(cell[1] + dy, cell[2] + dz);
            let first = row.start + cells.nodes[row.clone()].partition_point(|n| n[0] < cell[0] - 1);
            for (i, node) in cells.nodes[first..row.end].iter().enumerate().take_while(|(_, n)| n[0] <= cell[0] + 1) {
                f(first + i, bx[(node[0] - cell[0] + 1) as usize] * wy * wz);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, PointCloud, Vector};

    #[test]
    fn a_plane_reads_its_density_at_any_offset() {
        // 100 × 100 points on a square of side 0.6: 27,778 a unit area.
        let per_area = 10_000.0 / 0.36;
        for offset in [0.5, 0.507, 0.53] {
            let points: Vec<Point> = (0..10_000)
                .map(|i| Point::new(0.2 + 0.006 * (i % 100) as f64, 0.2 + 0.006 * (i / 100) as f64, offset))
                .collect();
            let cloud = PointCloud { points, ..PointCloud::default() };
            let chosen: Vec<u32> = (0..10_000).collect();
            let samples = Samples::new(&cloud, &vec![Vector::z(); 10_000], None, &chosen, Point::origin(), 1.0);
            let density = Density::new(&samples, 8);
            let middle = density.at([0.5, 0.51, offset]);
            assert!((middle.count / per_area - 1.0).abs() < 0.1, "{} against {per_area}", middle.count);
            assert!((middle.weight / per_area - 1.0).abs() < 0.1);
            assert!(density.at([0.5, 0.51, 0.01]).count < 0.01 * per_area);
        }
    }
}
