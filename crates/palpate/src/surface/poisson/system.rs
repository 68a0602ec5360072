//! One depth's share of the problem: its nodes, the splatted normals, the constraints and the screening.
//!
//! Everything is in units of the depth's cell h: with v̂ = h·v for the vector field and the energy divided by h, a sample of area a counts a/h².

use super::basis::{gradient_stencil, hats};
use super::octree::{Cell, Lattice, Samples, all_keys, cell_keys, corner_keys, grown, locate, within};
use rayon::prelude::*;

/// Depths up to this one use every node of the domain.
pub(super) const FULL_DEPTH: u32 = 5;

/// Rings of nodes beyond the corners of occupied cells that carry an unknown.
const RINGS: usize = 1;

/// Stands for "this node has no screening row".
const NO_ROW: u32 = u32::MAX;

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

/// A sample that stands for all of a cell, as the screening sees it.
struct CellSample {
    cell: Cell,
    place: [f64; 3],
    area: f64,
}

/// One depth: nodes with the cumulative solution, and while solving, its right-hand side and operator.
pub(super) struct Level {
    pub(super) depth: u32,
    pub(super) lattice: Lattice,
    /// Nodes that carry an unknown; all their neighbours are in the lattice.
    pub(super) active: Vec<u32>,
    /// The function at each node (sum over this and all coarser depths).
    pub(super) values: Vec<f64>,
    cells: Vec<CellSample>,
    /// Splatted normals, first this depth's own and later with all coarser ones.
    field: Vec<[f64; 3]>,
    /// ⟨∇B, V⟩ of the field of this depth and all finer ones.
    constraint: Vec<f64>,
}

/// The operator of one depth: stiffness stencil plus screening rows.
pub(super) struct Operator {
    pub(super) neighbours: Vec<[u32; 9]>,
    /// Row of each active node in `rows`, or [`NO_ROW`].
    row_of: Vec<u32>,
    rows: Vec<[f32; 27]>,
}

impl Operator {
    /// The screening row of an active node.
    #[inline]
    pub(super) fn row(&self, active: usize) -> Option<&[f32; 27]> {
        self.rows.get(self.row_of[active] as usize)
    }
}

impl Level {
    /// Lays out the nodes of a depth and splats the samples' normals that belong to it. `base` is the coarsest depth solved.
    pub(super) fn new(input: &Weighted, depth: u32, base: u32, last: u32) -> Self {
        let last_node = 1_u64 << depth;
        let cells = cell_samples(input, depth, base);
        let (active_keys, keys) = if depth <= FULL_DEPTH.max(base) {
            (all_keys(1, last_node - 1), all_keys(0, last_node))
        } else {
            let mut band = corner_keys(cell_keys(cells.iter().map(|c| c.cell)));
            for _ in 0..RINGS {
                band = grown(band, 0, last_node);
            }
            let active = within(&band, 1, last_node - 1);
            let nodes = grown(active.clone(), 0, last_node);
            (active, nodes)
        };
        let lattice = Lattice::new(last_node as usize + 1, &keys);
        let active = positions(&keys, &active_keys);
        let mut field = vec![[0.0; 3]; lattice.len()];
        splat_normals(input, depth, base, last, &lattice, &mut field);
        Self { depth, values: Vec::new(), constraint: Vec::new(), lattice, active, cells, field }
    }

    /// Adds ⟨∇B, V⟩ of this depth's own field and, restricted, of the finer ones.
    pub(super) fn gather_constraints(&mut self, finer: Option<&Level>, neighbours: &[[u32; 9]]) {
        let mut constraint = vec![0.0; self.lattice.len()];
        for (&i, b) in self.active.iter().zip(divergence(neighbours, &self.field)) {
            constraint[i as usize] = b;
        }
        if let Some(finer) = finer {
            for &i in &finer.active {
                let b = finer.constraint[i as usize];
                if b != 0.0 {
                    // B at depth d is Σ ½^steps B at depth d + 1; lengths double, hence the other ½.
                    for_parents(finer.lattice.nodes[i as usize], |parent, share| {
                        let at = self.lattice.find(parent).expect("parents of active nodes are in the coarser lattice");
                        constraint[at] += 0.5 * share * b;
                    });
                }
            }
        }
        self.constraint = constraint;
    }

    /// Starts from the coarser depth: its function becomes the first guess, its field joins this one's and adds to the constraints.
    pub(super) fn start_from(&mut self, coarser: Option<&Level>, neighbours: &[[u32; 9]]) {
        let Some(coarser) = coarser else {
            self.values = vec![0.0; self.lattice.len()];
            return;
        };
        let from_coarser: Vec<(f64, [f64; 3])> = self.lattice.nodes.par_iter().map(|&n| coarser.at_child(n)).collect();
        self.values = from_coarser.iter().map(|c| c.0).collect();
        let coarse_field: Vec<[f64; 3]> = from_coarser.iter().map(|c| c.1.map(|v| 0.5 * v)).collect();
        for (&i, b) in self.active.iter().zip(divergence(neighbours, &coarse_field)) {
            self.constraint[i as usize] += b;
        }
        for (own, coarse) in self.field.iter_mut().zip(&coarse_field) {
            *own = std::array::from_fn(|k| own[k] + coarse[k]);
        }
    }

    /// The operator, and the residual at the active nodes of the present `values`, for screening weight `alpha` and samples meant to be at ½.
    pub(super) fn assemble(&self, alpha: f64, neighbours: Vec<[u32; 9]>) -> (Operator, Vec<f64>) {
        let mut right: Vec<f64> = vec![0.0; self.lattice.len()];
        let mut row_of_node = vec![NO_ROW; self.lattice.len()];
        let mut rows: Vec<[f32; 27]> = Vec::new();
        let per_area = alpha * f64::from(1_u32 << self.depth).powi(2);
        for sample in self.cells.iter().filter(|_| alpha > 0.0) {
            let corners = self.lattice.corners(sample.cell).expect("occupied cells have their corners");
            let b = hats(sample.place);
            let weight = per_area * sample.area;
            let value: f64 = (0..8).map(|c| b[c] * self.values[corners[c]]).sum();
            for i in 0..8 {
                right[corners[i]] += weight * b[i] * (0.5 - value);
                let row = &mut row_of_node[corners[i]];
                if *row == NO_ROW {
                    *row = rows.len() as u32;
                    rows.push([0.0; 27]);
                }
                for j in 0..8 {
                    rows[*row as usize][step_between(i, j)] += (weight * b[i] * b[j]) as f32;
                }
            }
        }
        let row_of = self.active.iter().map(|&i| row_of_node[i as usize]).collect();
        let stiffness = Operator { neighbours, row_of: vec![NO_ROW; self.active.len()], rows: Vec::new() };
        let applied = super::solve::apply(&stiffness, &self.active, &self.values);
        let residual = self
            .active
            .iter()
            .zip(applied)
            .map(|(&i, a)| self.constraint[i as usize] + right[i as usize] - a)
            .collect();
        (Operator { row_of, rows, ..stiffness }, residual)
    }

    /// Adds the correction at the active nodes.
    pub(super) fn correct(&mut self, correction: &[f64]) {
        for (&i, x) in self.active.iter().zip(correction) {
            self.values[i as usize] += x;
        }
    }

    /// Frees what only the solver needs, the field included.
    pub(super) fn finish(&mut self) {
        self.field = Vec::new();
        self.constraint = Vec::new();
        self.cells = Vec::new();
    }

    /// Function and field at a node of the next finer depth.
    fn at_child(&self, node: Cell) -> (f64, [f64; 3]) {
        let (mut value, mut field) = (0.0, [0.0; 3]);
        for_parents(node, |parent, share| {
            let at = self.lattice.find(parent).expect("parents of nodes are in the coarser lattice");
            value += share * self.values[at];
            field = std::array::from_fn(|k| field[k] + share * self.field[at][k]);
        });
        (value, field)
    }
}

/// Merges the samples of each occupied cell, weighted by area times their share at this depth.
fn cell_samples(input: &Weighted, depth: u32, base: u32) -> Vec<CellSample> {
    let merge = |(cell, range): &(Cell, std::ops::Range<usize>)| {
        let mut area = 0.0;
        let mut mean = [0.0; 3];
        for i in range.clone() {
            let a = input.area[i] * input.share(i, depth, base);
            area += a;
            mean = std::array::from_fn(|k| mean[k] + a * input.samples.position[i][k]);
        }
        let n = f64::from(1_u32 << depth);
        let place = std::array::from_fn(|k| (mean[k] / area * n - f64::from(cell[k])).clamp(0.0, 1.0));
        (area > 0.0).then_some(CellSample { cell: *cell, place, area })
    };
    input.samples.cells(depth).par_iter().filter_map(merge).collect()
}

/// V = −Σ area · normal · B, on the nodes of the cells that hold the samples (the field points inwards, where the function is 1).
fn splat_normals(input: &Weighted, depth: u32, base: u32, last: u32, lattice: &Lattice, field: &mut [[f64; 3]]) {
    let per_area = f64::from(1_u32 << depth).powi(2);
    for i in 0..input.samples.len() {
        let deeper = if depth == last { 0.0 } else { input.share(i, depth + 1, base) };
        let share = input.share(i, depth, base) - deeper;
        if share <= 0.0 {
            continue;
        }
        let (cell, place) = locate(input.samples.position[i], depth);
        let corners = lattice.corners(cell).expect("occupied cells have their corners");
        let v = input.samples.normal[i] * (-share * input.area[i] * per_area);
        for (corner, b) in corners.into_iter().zip(hats(place)) {
            field[corner] = std::array::from_fn(|k| field[corner][k] + b * v[k]);
        }
    }
}

/// ⟨∇B_i, V⟩ at nodes given by their neighbour rows.
fn divergence(neighbours: &[[u32; 9]], field: &[[f64; 3]]) -> Vec<f64> {
    let stencil = gradient_stencil();
    let at = |rows: &[u32; 9]| -> f64 {
        rows.iter()
            .enumerate()
            .map(|(r, &first)| {
                let first = first as usize;
                let dot = |n: usize| {
                    let (s, v) = (stencil[3 * r + n], field[first + n]);
                    s[0] * v[0] + s[1] * v[1] + s[2] * v[2]
                };
                dot(0) + dot(1) + dot(2)
            })
            .sum()
    };
    neighbours.par_iter().map(at).collect()
}

/// Calls `f` with the coarser nodes that a node lies between and the share of each.
#[inline]
fn for_parents(node: Cell, mut f: impl FnMut(Cell, f64)) {
    let share = 0.5_f64.powi(node.iter().map(|c| i32::from(c & 1)).sum());
    let up = |axis: usize| node[axis] / 2..=node[axis].div_ceil(2);
    for z in up(2) {
        for y in up(1) {
            for x in up(0) {
                f([x, y, z], share);
            }
        }
    }
}

/// Place of corner j in the 27-neighbourhood of corner i of the same cell.
#[inline]
fn step_between(i: usize, j: usize) -> usize {
    let step = |axis: usize| 1 + ((j >> axis) & 1) - ((i >> axis) & 1);
    step(0) + 3 * step(1) + 9 * step(2)
}

/// Index in `all` of each of `some`; both sorted.
fn positions(all: &[u64], some: &[u64]) -> Vec<u32> {
    let mut at = 0;
    some.iter()
        .map(|key| {
            while all[at] != *key {
                at += 1;
            }
            at as u32
        })
        .collect()
}
