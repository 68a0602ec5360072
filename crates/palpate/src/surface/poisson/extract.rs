//! The isosurface of the solution on the finest lattice, near the samples.

use super::basis::hats;
use super::crossings::entered_cells;
use super::octree::{Cell, Samples, corner, locate};
use super::system::{Level, Weighted};
use crate::geometry::{Point, TriangleMesh, Vector};
use crate::surface::isosurface::mesh_of;
use rayon::prelude::*;
use std::ops::Range;

/// The value of the function on the surface, and the samples where the function is lowest and highest.
pub(super) struct Isovalue {
    pub(super) value: f64,
    lowest: usize,
    highest: usize,
}

/// The solved function: piecewise trilinear, given at the nodes of every depth.
pub(super) struct Field {
    /// From coarse to fine.
    levels: Vec<Level>,
}

impl Field {
    pub(super) fn new(levels: Vec<Level>) -> Self {
        Self { levels }
    }

    fn depth(&self) -> u32 {
        self.levels.last().map_or(0, |l| l.depth)
    }

    /// The function at a place of the unit cube.
    ///
    /// On a cell whose eight corners are nodes of its depth, all finer contributions vanish or are included in deeper cells, and the function is their
    /// trilinear interpolation; so the deepest such cell answers.
    pub(super) fn at(&self, place: [f64; 3]) -> f64 {
        for level in self.levels.iter().rev() {
            let (cell, inside) = locate(place, level.depth);
            if let Some(rows) = level.lattice.corner_rows(cell) {
                let value = |c: usize| f64::from(level.values[corner(&rows, c)]);
                return hats(inside).iter().enumerate().map(|(c, b)| b * value(c)).sum();
            }
        }
        0.0
    }

    /// What `read` makes of the function round each sample: its values at the corners of the deepest cell that has them, the place in that cell, and the
    /// cell's depth. Samples of one cell share the look-up.
    fn at_samples<T: Send>(
        &self,
        samples: &Samples,
        read: impl Fn(&[f64; 8], [f64; 3], u32) -> T + Sync,
        nowhere: impl Fn() -> T + Sync,
    ) -> Vec<T> {
        let depth = self.depth();
        let read_cell = |(cell, range): &(Cell, Range<usize>)| -> Vec<T> {
            let found = self.levels.iter().rev().find_map(|level| {
                let rows = level.lattice.corner_rows(cell.map(|c| c >> (depth - level.depth)))?;
                Some((std::array::from_fn(|c| f64::from(level.values[corner(&rows, c)])), level.depth))
            });
            let place = |i: usize, depth: u32| locate(samples.position[i], depth).1;
            match &found {
                Some((values, depth)) => range.clone().map(|i| read(values, place(i, *depth), *depth)).collect(),
                None => range.clone().map(|_| nowhere()).collect(),
            }
        };
        samples.cells(depth).par_iter().with_min_len(1024).flat_map_iter(read_cell).collect()
    }

    /// Mean distance of the samples from the surface along the function's slope, each weighing its area, unit cube; at most two cells count.
    pub(super) fn misfit(&self, input: &Weighted, isovalue: f64) -> f64 {
        let limit = 2.0 / f64::from(1_u32 << self.depth());
        let place =
            |values: &[f64; 8], inside: [f64; 3], depth: u32| distance(values, inside, depth, isovalue).min(limit);
        let distances = self.at_samples(input.samples, place, || limit);
        let weighted: f64 = distances.iter().zip(&input.area).map(|(d, a)| d * a).sum();
        weighted / input.area.iter().sum::<f64>()
    }

    /// The function at a node of the finest lattice.
    fn at_node(&self, node: Cell) -> f64 {
        let Some(finest) = self.levels.last() else { return 0.0 };
        if let Some(i) = finest.lattice.find(node) {
            f64::from(finest.values[i])
        } else {
            let n = f64::from(1_u32 << finest.depth);
            self.at(node.map(|c| f64::from(c) / n))
        }
    }

    /// Where the surface is: at the mean of the function over the samples, each weighing its area.
    pub(super) fn isovalue(&self, input: &Weighted) -> Isovalue {
        let read = |values: &[f64; 8], inside: [f64; 3], _| interpolated(values, inside);
        let at = self.at_samples(input.samples, read, || 0.0);
        let (mut sum, mut total) = (0.0, 0.0);
        for (value, area) in at.iter().zip(&input.area) {
            sum += value * area;
            total += area;
        }
        let by_value = |&a: &usize, &b: &usize| at[a].total_cmp(&at[b]);
        let lowest = (0..at.len()).min_by(by_value).unwrap_or(0);
        let highest = (0..at.len()).max_by(by_value).unwrap_or(0);
        Isovalue { value: sum / total, lowest, highest }
    }

    /// The closed surface at the isovalue, of the components that pass near a sample. The domain's border counts as outside.
    pub(super) fn extract(&self, samples: &Samples, at: &Isovalue, origin: Point, edge: f64) -> TriangleMesh {
        let size = 1_i32 << self.depth();
        let Some(finest) = self.levels.last() else { return TriangleMesh::default() };
        let outside = |c: [i32; 3]| c.iter().any(|&i| i <= 0 || i >= size);
        let value = |c: [i32; 3]| if outside(c) { 1.0 } else { at.value - self.at_node(c.map(|i| i as i16)) };
        let step = edge / f64::from(size);
        let position = |c: [i32; 3]| origin + Vector::new(c[0].into(), c[1].into(), c[2].into()) * step;
        let inside: Vec<bool> = (finest.lattice.nodes.par_iter().zip(&finest.values))
            .map(|(n, v)| !outside(n.map(i32::from)) && at.value - f64::from(*v) < 0.0)
            .collect();
        let cells = entered_cells(&finest.lattice, &inside, &self.seeds(samples, at), value);
        mesh_of(&cells, value, position)
    }

    /// Cells of the finest lattice that the surface enters: from each sample along its normal, out if it is inside and in if it is outside.
    fn seeds(&self, samples: &Samples, at: &Isovalue) -> Vec<[i32; 3]> {
        let depth = self.depth();
        let inside = |p: [f64; 3]| self.at(p) > at.value;
        let n = f64::from(1_u32 << depth);
        let walk = |(_, range): &(Cell, Range<usize>)| {
            let (start, normal) = (samples.position[range.start], samples.normal(range.start));
            let start_inside = inside(start);
            let step = normal.map(|c| f64::from(c) * (if start_inside { 0.5 } else { -0.5 } / n));
            let place = |k: i32| -> [f64; 3] { std::array::from_fn(|a| start[a] + f64::from(k) * step[a]) };
            let reached = (1..=16).find(|&k| inside(place(k)) != start_inside)?;
            Some([place(reached - 1), place(reached)].map(|p| locate(p, depth).0.map(i32::from)))
        };
        let mut seeds: Vec<[i32; 3]> = samples.cells(depth).par_iter().filter_map(walk).collect::<Vec<_>>().concat();
        seeds.extend(self.between_extremes(samples, at));
        seeds
    }

    /// Cells along the line from the sample with the lowest value to the one with the highest: the isovalue lies between, so the surface is met.
    fn between_extremes(&self, samples: &Samples, at: &Isovalue) -> Vec<[i32; 3]> {
        let (low, high) = (samples.position[at.lowest], samples.position[at.highest]);
        let steps = 4 << self.depth();
        let place = |k: u32, axis: usize| {
            let t = f64::from(k) / f64::from(steps);
            low[axis] * (1.0 - t) + high[axis] * t
        };
        (0..=steps).map(|k| locate([place(k, 0), place(k, 1), place(k, 2)], self.depth()).0.map(i32::from)).collect()
    }
}

/// Trilinear interpolation of a cell's corners.
fn interpolated(values: &[f64; 8], inside: [f64; 3]) -> f64 {
    hats(inside).iter().zip(values).map(|(b, v)| b * v).sum()
}

/// Distance of a place in a cell from the surface to first order, unit cube.
fn distance(values: &[f64; 8], inside: [f64; 3], depth: u32, isovalue: f64) -> f64 {
    let cells = f64::from(1_u32 << depth);
    // Linear along each axis: the slope is the difference of the two sides.
    let slope: f64 = (0..3)
        .map(|axis| {
            let side = |t: f64| interpolated(values, std::array::from_fn(|k| if k == axis { t } else { inside[k] }));
            ((side(1.0) - side(0.0)) * cells).powi(2)
        })
        .sum();
    (interpolated(values, inside) - isovalue).abs() / slope.sqrt()
}
