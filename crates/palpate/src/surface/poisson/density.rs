//! How densely the surface is sampled: samples per unit area, read from splatted counts.

use super::basis::{QUADRATIC_SELF, quadratic};
use super::octree::{Cell, Lattice, Samples, add_by_slabs, locate};
use super::spans::Spans;
use rayon::prelude::*;
use std::ops::Range;

/// Samples (or weight) that the kernel must see before a density is trusted; otherwise a coarser depth is asked.
const ENOUGH: f64 = 6.0;

/// Coarsest depth that is read.
const COARSEST: u32 = 2;

/// Cells that are splatted before their sums are added up, and places that are read in one go.
const BATCH: usize = 8192;

/// Counts and weights splatted at several depths with quadratic B-splines, which see a plane nearly alike at every tilt and offset. A depth is splatted
/// when a reading first asks for it.
pub(super) struct Density<'a> {
    samples: &'a Samples,
    /// From fine to coarse, as many as were asked for.
    depths: Vec<Splat>,
    finest: u32,
}

struct Splat {
    depth: u32,
    cells: Lattice,
    /// Count and weight in each cell.
    sums: Vec<(f64, f64)>,
}

/// Density at a place, per area in units of the unit cube.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Reading {
    /// Samples per unit area.
    pub(super) count: f64,
    /// Weight per unit area.
    pub(super) weight: f64,
}

impl<'a> Density<'a> {
    /// The finest is the deepest depth, at most `deepest`, whose occupied cells hold eight distinct samples on average.
    pub(super) fn new(samples: &'a Samples, deepest: u32) -> Self {
        let distinct = samples.distinct();
        let finest = (COARSEST..=deepest).rev().find(|&d| distinct >= 8 * samples.occupied(d)).unwrap_or(COARSEST);
        Self { samples, depths: Vec::new(), finest }
    }

    /// The densities at places of the unit cube, each at the finest depth that sees enough there; near zero far from all samples.
    pub(super) fn at(&mut self, places: &[[f64; 3]]) -> Vec<Reading> {
        let mut readings = vec![Reading::default(); places.len()];
        let mut open: Vec<u32> = (0..places.len() as u32).collect();
        for depth in (COARSEST..=self.finest).rev() {
            if open.is_empty() {
                break;
            }
            let k = (self.finest - depth) as usize;
            if self.depths.len() == k {
                self.depths.push(Splat::new(self.samples, depth));
            }
            let splat = &self.depths[k];
            let read: Vec<(f64, f64)> = open.par_chunks(BATCH).flat_map_iter(|part| splat.read(places, part)).collect();
            for (&i, &(count, weight)) in open.iter().zip(&read) {
                readings[i as usize] = splat.reading(count, weight);
            }
            let mut enough = read.iter().map(|r| r.0 >= ENOUGH * QUADRATIC_SELF);
            open.retain(|_| !enough.next().unwrap_or(true));
        }
        readings
    }

    /// The densities at the samples.
    pub(super) fn at_samples(&mut self) -> Vec<Reading> {
        self.at(&self.samples.position)
    }
}

impl Splat {
    fn new(samples: &Samples, depth: u32) -> Self {
        let last = (1_i16 << depth) - 1;
        let used = samples.cells(depth);
        let cells = Lattice::new(depth, &Spans::of(last + 1, used.iter().map(|c| c.0)).grown(&(-1..=1), &(0..=last)));
        let mut sums = vec![(0.0, 0.0); cells.len()];
        // In batches, so that memory stays small.
        for batch in used.chunks(BATCH) {
            let left: Vec<Around> = batch.par_iter().with_min_len(64).map(|(_, r)| summed(samples, depth, r)).collect();
            add_by_slabs(&cells, batch, &(-1..=1), &mut sums, |slab, start, step, cell| {
                for_plane(&cells, batch[cell].0, step, |i, k| {
                    let (sum, add) = (&mut slab[i - start], left[cell][k]);
                    *sum = (sum.0 + add.0, sum.1 + add.1);
                });
            });
        }
        Self { depth, cells, sums }
    }

    /// Counts and weights at the chosen places. Neighbours in the list often share a cell, which is then looked up once.
    fn read(&self, places: &[[f64; 3]], chosen: &[u32]) -> Vec<(f64, f64)> {
        let mut last: Option<(Cell, Around)> = None;
        let read = |&i: &u32| {
            let (cell, inside) = locate(places[i as usize], self.depth);
            let around = match &last {
                Some((same, around)) if *same == cell => around,
                _ => &last.insert((cell, self.around(cell))).1,
            };
            let weighted = around.iter().zip(kernel(inside));
            weighted.fold((0.0, 0.0), |s, (a, b)| (s.0 + b * a.0, s.1 + b * a.1))
        };
        chosen.iter().map(read).collect()
    }

    /// Counts and weights of the 27 cells round one.
    fn around(&self, cell: Cell) -> Around {
        let mut around = [(0.0, 0.0); 27];
        (-1..=1).for_each(|dz| for_plane(&self.cells, cell, dz, |i, k| around[k] = self.sums[i]));
        around
    }

    /// Per unit area: Σ of the kernel over a plane of density ρ per cell is `QUADRATIC_SELF` · ρ.
    fn reading(&self, count: f64, weight: f64) -> Reading {
        let cells_per_area = f64::from(1_u32 << self.depth).powi(2) / QUADRATIC_SELF;
        Reading { count: count * cells_per_area, weight: weight * cells_per_area }
    }
}

/// Count and weight in each of the 27 cells round one, x fastest.
type Around = [(f64, f64); 27];

/// What the samples of a cell leave in the cells around it.
fn summed(samples: &Samples, depth: u32, range: &Range<usize>) -> Around {
    let mut sum = [(0.0, 0.0); 27];
    for i in range.clone() {
        let w = samples.weight[i];
        for (s, b) in sum.iter_mut().zip(kernel(locate(samples.position[i], depth).1)) {
            *s = (s.0 + b, s.1 + w * b);
        }
    }
    sum
}

/// The kernel's value in the 27 cells, centred at a place in the middle one.
fn kernel(inside: [f64; 3]) -> [f64; 27] {
    let [x, y, z] = inside.map(quadratic);
    std::array::from_fn(|k| x[k % 3] * y[k / 3 % 3] * z[k / 9])
}

/// Calls `f` with the index and the number, x fastest, of those of the 27 cells round one that are stored and `dz` away in z.
fn for_plane(cells: &Lattice, cell: Cell, dz: i16, mut f: impl FnMut(usize, usize)) {
    for step in 3 * dz + 3..3 * dz + 6 {
        // There are rows just outside the domain, and they are empty.
        let row = cells.row(cell[1] + step % 3 - 1, cell[2] + dz);
        let first = row.start + cells.nodes[row.clone()].partition_point(|n| n[0] < cell[0] - 1);
        for (i, node) in cells.nodes[first..row.end].iter().enumerate().take_while(|(_, n)| n[0] <= cell[0] + 1) {
            f(first + i, (3 * step + node[0] - cell[0] + 1) as usize);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Vector};

    #[test]
    fn a_plane_reads_its_density_at_any_offset() {
        // 100 × 100 points on a square of side 0.6: 27,778 a unit area.
        let per_area = 10_000.0 / 0.36;
        for offset in [0.5, 0.507, 0.53] {
            let points: Vec<Point> = (0..10_000)
                .map(|i| Point::new(0.2 + 0.006 * (i % 100) as f64, 0.2 + 0.006 * (i / 100) as f64, offset))
                .collect();
            let chosen: Vec<u32> = (0..10_000).collect();
            let samples = Samples::new(&points, &vec![Vector::z(); 10_000], None, &chosen, Point::origin(), 1.0);
            let readings = Density::new(&samples, 8).at(&[[0.5, 0.51, offset], [0.5, 0.51, 0.01]]);
            let (middle, far) = (readings[0], readings[1]);
            assert!((middle.count / per_area - 1.0).abs() < 0.1, "{} against {per_area}", middle.count);
            assert!((middle.weight / per_area - 1.0).abs() < 0.1);
            assert!(far.count < 0.01 * per_area);
        }
    }
}
