//! One depth's share of the problem: its nodes, the splatted normals, the constraints and the screening.
//!
//! Everything is in units of the depth's cell h: with v̂ = h·v for the vector field and the energy divided by h, a sample of area a counts a/h².
//! Stored in single precision: the solution is wanted to a thousandth.

use super::basis::hats;
use super::octree::{Cell, Lattice, Samples, add_by_slabs, corner, locate};
use super::params::Boundary;
use super::runs::Runs;
use super::screening::{CellSample, Screening};
use super::spans::Spans;
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// Depths up to this one use every node of the domain.
pub(super) const FULL_DEPTH: u32 = 5;

/// Cells whose normals are splatted before their sums are added up.
const BATCH: usize = 1 << 15;

/// Rings of nodes beyond the corners of occupied cells that carry an unknown.
const RINGS: i16 = 1;

/// Samples with what the solver needs to know of them.
pub(super) struct Weighted<'a> {
    pub(super) samples: &'a Samples,
    /// Area that each stands for, in the unit cube.
    pub(super) area: Vec<f64>,
    /// Depth at which each is splatted, fractional: shared between the two depths around it.
    pub(super) depth: Vec<f64>,
}

impl Weighted<'_> {
    /// Share of a sample that is splatted at `depth` or deeper.
    fn share(&self, sample: usize, depth: u32, base: u32) -> f64 {
        if depth <= base { 1.0 } else { (self.depth[sample] - f64::from(depth) + 1.0).clamp(0.0, 1.0) }
    }
}

/// Depths that are solved, and what holds at the domain's border.
#[derive(Clone, Copy)]
pub(super) struct Extent {
    pub(super) base: u32,
    pub(super) last: u32,
    pub(super) boundary: Boundary,
}

/// One depth: nodes with the cumulative solution, and while solving, its right-hand side and operator.
pub(super) struct Level {
    pub(super) depth: u32,
    pub(super) lattice: Lattice,
    /// Nodes that carry an unknown; all their neighbours are in the lattice.
    pub(super) unknowns: Runs,
    /// Nodes just outside the domain and their images inside; empty unless the border is Neumann's.
    mirrored: Vec<(u32, u32)>,
    /// The function at each node (sum over this and all coarser depths).
    pub(super) values: Vec<f32>,
    cells: Vec<CellSample>,
    /// Splatted normals, first this depth's own and later with all coarser ones.
    field: Vec<[f32; 3]>,
    /// ⟨∇B, V⟩ of the field of this depth and all finer ones.
    constraint: Vec<f32>,
}

impl Level {
    /// Lays out the nodes of a depth and splats the samples' normals that belong to it.
    pub(super) fn new(input: &Weighted, depth: u32, extent: Extent) -> Self {
        let occupied = input.samples.cells(depth);
        let used: Vec<(Cell, Range<usize>)> = if depth <= extent.base {
            occupied
        } else {
            let reaches = |r: &Range<usize>| r.clone().any(|i| input.share(i, depth, extent.base) > 0.0);
            occupied.into_iter().filter(|(_, r)| reaches(r)).collect()
        };
        let (lattice, unknowns) = lay_out(&used, depth, extent);
        let mirrored = if matches!(extent.boundary, Boundary::Dirichlet) { Vec::new() } else { mirrored(&lattice) };
        let corners: Vec<[u32; 4]> = used
            .par_iter()
            .map(|(cell, _)| lattice.corner_rows(*cell).expect("occupied cells have their corners"))
            .collect();
        let mut field = vec![[0.0; 3]; lattice.len()];
        splat_normals(input, &lattice, depth, extent, &used, &corners, &mut field);
        let cells = cell_samples(input, depth, extent.base, &used, &corners);
        Self { depth, values: Vec::new(), constraint: Vec::new(), lattice, unknowns, mirrored, cells, field }
    }

    /// Adds ⟨∇B, V⟩ of this depth's own field and, restricted, of the finer ones.
    pub(super) fn gather_constraints(&mut self, finer: Option<&Level>) {
        self.mirror_field();
        let mut constraint = finer.map_or_else(|| vec![0.0; self.lattice.len()], |f| self.restricted(f));
        self.unknowns.add_divergence(&self.field, &mut constraint);
        self.constraint = constraint;
    }

    /// The finer constraints at this depth's nodes: B at depth d is Σ ½^steps B at depth d + 1; lengths double, hence another ½.
    fn restricted(&self, finer: &Level) -> Vec<f32> {
        let mut out = vec![0.0_f32; self.lattice.len()];
        let cells = finer.lattice.cells;
        let slabs = self.lattice.slabs_mut(&mut out);
        slabs.into_par_iter().filter(|(z, _)| (0..=self.lattice.cells).contains(z)).for_each(|(z, slab)| {
            let start = self.lattice.slab(z).start;
            for y in 0..=self.lattice.cells {
                let row = self.lattice.row(y, z);
                for step in 0..9 {
                    let (dy, dz) = (step % 3 - 1, step / 3 - 1);
                    let (fy, fz) = (2 * y + dy, 2 * z + dz);
                    if row.is_empty() || !(0..=cells).contains(&fy) || !(0..=cells).contains(&fz) {
                        continue;
                    }
                    let share = 0.5 * 0.5_f32.powi(i32::from(dy.abs() + dz.abs()));
                    let fine = finer.lattice.row(fy, fz);
                    let mut at = fine.start;
                    for node in row.clone() {
                        let x = 2 * self.lattice.nodes[node][0];
                        while at < fine.end && finer.lattice.nodes[at][0] < x - 1 {
                            at += 1;
                        }
                        let near = finer.lattice.nodes[at..fine.end].iter().zip(&finer.constraint[at..fine.end]);
                        for (n, c) in near.take_while(|(n, _)| n[0] <= x + 1) {
                            slab[node - start] += share * if n[0] == x { *c } else { 0.5 * c };
                        }
                    }
                }
            }
        });
        out
    }

    /// Starts from the coarser depth: its function becomes the first guess, its field joins this one's and adds to the constraints.
    pub(super) fn start_from(&mut self, coarser: Option<&Level>) {
        let Some(coarser) = coarser else {
            self.values = vec![0.0; self.lattice.len()];
            return;
        };
        self.values = prolonged(&self.lattice, &coarser.lattice, &coarser.values, |v, share, c| *v += share * c);
        let mut field = prolonged(&self.lattice, &coarser.lattice, &coarser.field, |v: &mut [f32; 3], share, c| {
            *v = std::array::from_fn(|k| v[k] + 0.5 * share * c[k]);
        });
        std::mem::swap(&mut self.field, &mut field);
        self.mirror_field();
        self.unknowns.add_divergence(&self.field, &mut self.constraint);
        self.field.par_iter_mut().zip(&field).for_each(|(all, own)| {
            *all = std::array::from_fn(|k| all[k] + own[k]);
        });
    }

    /// The screening of this depth, and the residual at the unknowns of the present `values`, for samples meant to be at ½.
    pub(super) fn assemble(&mut self, alpha: f64) -> (Screening, Vec<f32>) {
        let per_area = alpha * f64::from(1_u32 << self.depth).powi(2);
        let cells = std::mem::take(&mut self.cells);
        let screening = Screening::new(&cells, per_area, &self.unknowns, self.lattice.len());
        self.mirror_values();
        let pull = screening.pull(&self.values, 0.5);
        let mut residual = vec![0.0; self.unknowns.len()];
        self.unknowns.stiffness(&self.values, &mut residual, |part, block| {
            negate(part);
            screening.add(part, block, &pull);
        });
        self.unknowns.gather(&mut residual, &self.constraint, |r, c| *r += c);
        (screening, residual)
    }

    /// Adds the correction at the unknowns.
    pub(super) fn correct(&mut self, correction: &[f32]) {
        self.unknowns.scatter(&mut self.values, |own, first| {
            own.iter_mut().zip(&correction[first..]).for_each(|(v, x)| *v += x);
        });
        self.mirror_values();
    }

    /// Fills the nodes just outside the domain.
    pub(super) fn mirror(&self, values: &mut [f32]) {
        for &(outside, inside) in &self.mirrored {
            values[outside as usize] = values[inside as usize];
        }
    }

    fn mirror_values(&mut self) {
        for &(outside, inside) in &self.mirrored {
            self.values[outside as usize] = self.values[inside as usize];
        }
    }

    /// A mirrored field points the other way along the mirrored axes.
    fn mirror_field(&mut self) {
        for &(outside, inside) in &self.mirrored {
            let (from, to) = (self.lattice.nodes[inside as usize], self.lattice.nodes[outside as usize]);
            let v = self.field[inside as usize];
            self.field[outside as usize] = std::array::from_fn(|k| if from[k] == to[k] { v[k] } else { -v[k] });
        }
    }

    /// Frees what only the solver needs, the field included.
    pub(super) fn finish(&mut self) {
        self.field = Vec::new();
        self.constraint = Vec::new();
    }
}

/// The lattice of a depth and its unknowns.
fn lay_out(used: &[(Cell, Range<usize>)], depth: u32, extent: Extent) -> (Lattice, Runs) {
    let last = 1_i16 << depth;
    let (unknown, node): (RangeInclusive<i16>, RangeInclusive<i16>) = match extent.boundary {
        Boundary::Dirichlet => (1..=last - 1, 0..=last),
        Boundary::Neumann => (0..=last, -1..=last + 1),
    };
    let unknowns = if depth <= FULL_DEPTH.max(extent.base) {
        Spans::full(last, &unknown)
    } else {
        // From cells to their corners and some rings of nodes beyond.
        let band = Spans::of(last, used.iter().map(|c| c.0)).grown(&(-RINGS..=1 + RINGS), &(0..=last));
        band.within(&unknown)
    };
    let lattice = Lattice::new(depth, &unknowns.grown(&(-1..=1), &node));
    let unknowns = Runs::new(&lattice, &unknowns);
    (lattice, unknowns)
}

/// Nodes just outside the domain with their mirror images.
fn mirrored(lattice: &Lattice) -> Vec<(u32, u32)> {
    let last = lattice.cells;
    let image = |c: i16| match c {
        -1 => 1,
        c if c > last => last - 1,
        c => c,
    };
    let outside = |n: &Cell| n.iter().any(|c| !(0..=last).contains(c));
    lattice
        .nodes
        .iter()
        .enumerate()
        .filter(|(_, n)| outside(n))
        .map(|(i, n)| (i as u32, lattice.find(n.map(image)).expect("a mirrored node has its image") as u32))
        .collect()
}

/// Merges the samples of each occupied cell, weighted by area times their share at this depth.
fn cell_samples(
    input: &Weighted,
    depth: u32,
    base: u32,
    used: &[(Cell, Range<usize>)],
    corners: &[[u32; 4]],
) -> Vec<CellSample> {
    let merge = |((cell, range), corners): (&(Cell, Range<usize>), &[u32; 4])| {
        let mut area = 0.0;
        let mut mean = [0.0; 3];
        for i in range.clone() {
            let a = input.area[i] * input.share(i, depth, base);
            area += a;
            mean = std::array::from_fn(|k| mean[k] + a * input.samples.position[i][k]);
        }
        let n = f64::from(1_u32 << depth);
        let place = std::array::from_fn(|k| (mean[k] / area * n - f64::from(cell[k])).clamp(0.0, 1.0));
        (area > 0.0).then_some(CellSample { corners: *corners, place, area })
    };
    used.par_iter().zip(corners).filter_map(merge).collect()
}

/// V = −Σ area · normal · B, on the nodes of the cells that hold the samples (the field points inwards, where the function is 1).
fn splat_normals(
    input: &Weighted,
    lattice: &Lattice,
    depth: u32,
    extent: Extent,
    used: &[(Cell, Range<usize>)],
    corners: &[[u32; 4]],
    field: &mut [[f32; 3]],
) {
    let per_area = f64::from(1_u32 << depth).powi(2);
    let cell = |range: &Range<usize>| {
        let mut sum = [[0.0_f64; 3]; 8];
        for i in range.clone() {
            let deeper = if depth == extent.last { 0.0 } else { input.share(i, depth + 1, extent.base) };
            let share = input.share(i, depth, extent.base) - deeper;
            if share > 0.0 {
                let v = input.samples.normal(i).map(|n| f64::from(n) * (-share * input.area[i] * per_area));
                let b = hats(locate(input.samples.position[i], depth).1);
                sum = std::array::from_fn(|c| std::array::from_fn(|k| sum[c][k] + b[c] * v[k]));
            }
        }
        sum.map(|v| v.map(|x| x as f32))
    };
    // In batches, so that memory stays small.
    for (used, corners) in used.chunks(BATCH).zip(corners.chunks(BATCH)) {
        let sums: Vec<[[f32; 3]; 8]> = used.par_iter().map(|(_, range)| cell(range)).collect();
        add_by_slabs(lattice, used, &(0..=1), field, |slab, start, step, i| {
            for c in 4 * step as usize..4 * step as usize + 4 {
                let node = &mut slab[corner(&corners[i], c) - start];
                *node = std::array::from_fn(|k| node[k] + sums[i][c][k]);
            }
        });
    }
}

/// Values at the fine nodes within the domain, from those at the coarse nodes around each: `add(sum, share, coarse value)`.
fn prolonged<T: Copy + Default + Send + Sync>(
    fine: &Lattice,
    coarse: &Lattice,
    values: &[T],
    add: impl Fn(&mut T, f32, T) + Sync,
) -> Vec<T> {
    let mut out = vec![T::default(); fine.len()];
    let inside = 0..=fine.cells;
    fine.slabs_mut(&mut out).into_par_iter().filter(|(z, _)| inside.contains(z)).for_each(|(z, slab)| {
        let start = fine.slab(z).start;
        for y in inside.clone() {
            let row = fine.row(y, z);
            if row.is_empty() {
                continue;
            }
            for (cy, cz) in [(y / 2, z / 2), ((y + 1) / 2, z / 2), (y / 2, (z + 1) / 2), ((y + 1) / 2, (z + 1) / 2)] {
                // Even coordinates name the same row twice, with half the share each time.
                let parents = coarse.row(cy, cz);
                let mut at = parents.start;
                for node in row.clone() {
                    let x = fine.nodes[node][0];
                    if !inside.contains(&x) {
                        continue;
                    }
                    while at < parents.end && coarse.nodes[at][0] < x / 2 {
                        at += 1;
                    }
                    let sum = &mut slab[node - start];
                    if x % 2 == 0 {
                        add(sum, 0.25, values[at]);
                    } else {
                        add(sum, 0.125, values[at]);
                        add(sum, 0.125, values[at + 1]);
                    }
                }
            }
        }
    });
    out
}

pub(super) fn negate(values: &mut [f32]) {
    for v in values {
        *v = -*v;
    }
}
