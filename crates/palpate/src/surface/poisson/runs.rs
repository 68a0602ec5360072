//! Unknowns in runs along x, so that a node's 27 neighbours need nine indices a run, not a node, and the stencils work on consecutive numbers.

use super::basis::{MASS, STIFFNESS, gradient_stencil};
use super::octree::{Cell, Lattice};
use super::spans::Spans;
use rayon::prelude::*;
use std::ops::Range;

/// Unknowns in a block: the unit of parallel work and of summation, so that sums do not depend on the number of threads.
const BLOCK: usize = 8192;

/// Unknowns next to each other along x.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// Place of the first among the unknowns.
    first: u32,
    /// How many.
    len: u32,
    /// For the nine rows round the run, y fastest: lattice index of the node one before the first.
    rows: [u32; 9],
    /// Coordinates of the first.
    start: Cell,
    /// Cells along an axis of the domain.
    cells: i16,
}

/// The unknowns of a depth: nodes of a lattice all of whose 26 neighbours are in the lattice too.
pub(super) struct Runs {
    runs: Vec<Run>,
    /// Runs of each block.
    blocks: Vec<Range<usize>>,
    len: usize,
}

impl Runs {
    /// The unknowns at `nodes` of the lattice.
    pub(super) fn new(lattice: &Lattice, nodes: &Spans) -> Self {
        let spans = nodes.list();
        let mut len = 0;
        let firsts: Vec<u32> = spans
            .iter()
            .map(|span| {
                len += span.1;
                len - span.1
            })
            .collect();
        let run = |(&(start, len), &first): (&(Cell, u32), &u32)| Run::new(lattice, start, len, first);
        let runs: Vec<Run> = spans.par_iter().zip(&firsts).with_min_len(256).map(run).collect();
        let mut blocks = Vec::new();
        let mut start = 0;
        for (i, run) in runs.iter().enumerate() {
            if (run.first - runs[start].first) as usize >= BLOCK {
                blocks.push(start..i);
                start = i;
            }
        }
        blocks.push(start..runs.len());
        Self { runs, blocks, len: len as usize }
    }

    /// Number of unknowns.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// The unknowns of a block.
    fn unknowns(&self, block: &Range<usize>) -> Range<usize> {
        let at = |run: usize| self.runs.get(run).map_or(self.len, |r| r.first as usize);
        at(block.start)..at(block.end)
    }

    /// Where the block's part of values on the lattice ends that starts after the block before.
    fn lattice_end(&self, block: &Range<usize>) -> usize {
        self.runs[block.clone()].last().map_or(0, Run::lattice_end)
    }

    /// Cuts values of the unknowns into blocks.
    fn cut<'a, T>(&self, mut values: &'a mut [T]) -> Vec<&'a mut [T]> {
        let mut cut = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let (own, rest) = values.split_at_mut(self.unknowns(block).len());
            cut.push(own);
            values = rest;
        }
        cut
    }

    /// For each unknown, `change(its value, the value at its node)`.
    pub(super) fn gather(&self, values: &mut [f32], nodes: &[f32], change: impl Fn(&mut f32, f32) + Sync) {
        self.cut(values).into_par_iter().zip(&self.blocks).for_each(|(part, block)| {
            let first = self.unknowns(block).start;
            for run in &self.runs[block.clone()] {
                let own = &mut part[run.first as usize - first..][..run.len as usize];
                own.iter_mut().zip(&nodes[run.node()..]).for_each(|(v, n)| change(v, *n));
            }
        });
    }

    /// `change(the values at the nodes of a run of unknowns, the first unknown)`, in parallel.
    pub(super) fn scatter(&self, nodes: &mut [f32], change: impl Fn(&mut [f32], usize) + Sync) {
        self.for_runs(nodes, |run, own, (): &mut ()| change(own, run.first as usize));
    }

    /// `change(run, the values at its nodes, scratch)`, in parallel.
    fn for_runs<S: Default>(&self, nodes: &mut [f32], change: impl Fn(&Run, &mut [f32], &mut S) + Sync) {
        let mut rest = nodes;
        let mut done = 0;
        let mut parts = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let end = self.lattice_end(block).max(done);
            let (own, after) = rest.split_at_mut(end - done);
            parts.push((own, done, block));
            rest = after;
            done = end;
        }
        parts.into_par_iter().for_each(|(part, start, block)| {
            let mut scratch = S::default();
            for run in &self.runs[block.clone()] {
                change(run, &mut part[run.node() - start..][..run.len as usize], &mut scratch);
            }
        });
    }

    /// Σ residual² · inverse diagonal.
    pub(super) fn norm(&self, residual: &[f32], inverse_diagonal: &[f32]) -> f64 {
        let norm = |block: &Range<usize>| {
            let own = self.unknowns(block);
            weighted_norm(&residual[own.clone()], &inverse_diagonal[own])
        };
        self.blocks.par_iter().map(norm).collect::<Vec<_>>().iter().sum()
    }

    /// direction ← inverse diagonal · residual + beta · direction, the direction held on the lattice.
    pub(super) fn turn(&self, direction: &mut [f32], residual: &[f32], inverse_diagonal: &[f32], beta: f32) {
        self.scatter(direction, |own, first| {
            let preconditioned = residual[first..].iter().zip(&inverse_diagonal[first..]);
            own.iter_mut().zip(preconditioned).for_each(|(d, (r, m))| *d = r * m + beta * *d);
        });
    }

    /// x ← x + step · direction and residual ← residual − step · applied; returns the residual's [`Self::norm`].
    ///
    /// * `[direction, applied, inverse diagonal]` – the direction held on the lattice
    pub(super) fn advance(&self, x: &mut [f32], residual: &mut [f32], along: [&[f32]; 3], step: f32) -> f64 {
        let [direction, applied, inverse_diagonal] = along;
        let parts = self.cut(x).into_par_iter().zip(self.cut(residual)).zip(&self.blocks);
        let sums: Vec<f64> = parts
            .map(|((x, residual), block)| {
                let own = self.unknowns(block);
                for run in &self.runs[block.clone()] {
                    let x = &mut x[run.first as usize - own.start..][..run.len as usize];
                    x.iter_mut().zip(&direction[run.node()..]).for_each(|(x, d)| *x += step * d);
                }
                residual.iter_mut().zip(&applied[own.clone()]).for_each(|(r, a)| *r -= step * a);
                weighted_norm(residual, &inverse_diagonal[own])
            })
            .collect();
        sums.iter().sum()
    }

    /// The stiffness ∫∇B_i·∇B_j applied to values on the lattice, for each unknown; `finish(block's part, number of the block)` may add to it.
    ///
    /// Returns Σ value · result over the unknowns.
    pub(super) fn stiffness(&self, values: &[f32], out: &mut [f32], finish: impl Fn(&mut [f32], usize) + Sync) -> f64 {
        let parts = self.cut(out);
        let sums: Vec<f64> = parts
            .into_par_iter()
            .zip(&self.blocks)
            .enumerate()
            .map(|(number, (part, block))| {
                let first = self.unknowns(block).start;
                for run in &self.runs[block.clone()] {
                    let at = run.first as usize - first;
                    run.stiffness(values, &mut part[at..at + run.len as usize]);
                }
                finish(part, number);
                self.runs[block.clone()].iter().fold(0.0, |sum, run| {
                    let own = &part[run.first as usize - first..][..run.len as usize];
                    let dot = |s: f64, (a, b): (&f32, &f32)| s + f64::from(*a) * f64::from(*b);
                    values[run.node()..][..run.len as usize].iter().zip(own).fold(sum, dot)
                })
            })
            .collect();
        sums.iter().sum()
    }

    /// ⟨∇B_i, V⟩ for each unknown, of a field given on the lattice, added to `out` on the lattice.
    pub(super) fn add_divergence(&self, field: &[[f32; 3]], out: &mut [f32]) {
        let stencil = gradient_stencil().map(|s| s.map(|c| c as f32));
        self.for_runs(out, |run, own, scratch: &mut Vec<f32>| {
            run.divergence(field, &stencil, scratch);
            own.iter_mut().zip(scratch).for_each(|(o, d)| *o += *d);
        });
    }

    /// What `make(the block's part of values, its unknowns in order)` makes of each block, in parallel.
    pub(super) fn map_blocks<S: Send>(
        &self,
        values: &mut [f32],
        make: impl Fn(&mut [f32], &mut dyn Iterator<Item = Unknown>) -> S + Sync,
    ) -> Vec<S> {
        let parts = self.cut(values).into_par_iter().zip(&self.blocks);
        let unknown = |run: &Run, k: usize| Unknown {
            inside: run.inside_at(k),
            before: [0, 1, 3, 4].map(|r| run.rows[r] as usize + k),
        };
        let unknowns = |block: &Range<usize>| {
            self.runs[block.clone()].iter().flat_map(move |r| (0..r.len as usize).map(move |k| unknown(r, k)))
        };
        parts.map(|(part, block)| make(part, &mut unknowns(block))).collect()
    }
}

/// An unknown among its neighbours.
pub(super) struct Unknown {
    /// Share of its support that lies in the domain.
    pub(super) inside: f32,
    /// The nodes diagonally before it in x, y and z, before it in x and z, in x and y, and in x: each is followed by the one straight before.
    pub(super) before: [usize; 4],
}

fn weighted_norm(residual: &[f32], inverse_diagonal: &[f32]) -> f64 {
    let weighted = residual.iter().zip(inverse_diagonal);
    weighted.map(|(r, m)| f64::from(*r) * f64::from(*r) * f64::from(*m)).sum()
}

impl Run {
    fn new(lattice: &Lattice, start: Cell, len: u32, first: u32) -> Self {
        let [x, y, z] = start;
        let rows = std::array::from_fn(|r| {
            let node = [x - 1, y + r as i16 % 3 - 1, z + r as i16 / 3 - 1];
            lattice.find(node).expect("unknowns have all their neighbours") as u32
        });
        Self { first, len, rows, start, cells: lattice.cells }
    }

    /// −1 on the low border of the domain, 1 on the high one, else 0.
    fn side(&self, c: i16) -> f32 {
        f32::from(i8::from(c == self.cells) - i8::from(c == 0))
    }

    /// Lattice index of the first.
    fn node(&self) -> usize {
        self.rows[4] as usize + 1
    }

    fn lattice_end(&self) -> usize {
        self.node() + self.len as usize
    }

    fn at_border(&self) -> bool {
        let last = self.start[0] + self.len as i16 - 1;
        self.start.into_iter().chain([last]).any(|c| self.side(c) != 0.0)
    }

    /// Share of the support of the k-th that lies in the domain.
    fn inside_at(&self, k: usize) -> f32 {
        let [x, y, z] = self.start;
        [x + k as i16, y, z].map(|c| if self.side(c) == 0.0 { 1.0 } else { 0.5 }).iter().product()
    }

    fn scale(&self, out: &mut [f32]) {
        if self.at_border() {
            for (k, out) in out.iter_mut().enumerate() {
                *out *= self.inside_at(k);
            }
        }
    }

    fn stiffness(&self, values: &[f32], out: &mut [f32]) {
        let [diagonal, edge, corner] = STIFFNESS.map(|s| s as f32);
        let len = out.len();
        let row = |r: usize| &values[self.rows[r] as usize..][..len + 2];
        let (flat, tilted) = ([row(1), row(3), row(5), row(7)], [row(0), row(2), row(6), row(8)]);
        let centre = row(4);
        for k in 0..len {
            let ends: f32 = flat.iter().map(|r| r[k] + r[k + 2]).sum();
            let middles: f32 = tilted.iter().map(|r| r[k + 1]).sum();
            let corners: f32 = tilted.iter().map(|r| r[k] + r[k + 2]).sum();
            out[k] = diagonal * centre[k + 1] + edge * (ends + middles) + corner * corners;
        }
        self.scale(out);
    }

    fn divergence(&self, field: &[[f32; 3]], stencil: &[[f32; 3]; 27], out: &mut Vec<f32>) {
        out.clear();
        out.resize(self.len as usize, 0.0);
        for (r, &first) in self.rows.iter().enumerate() {
            let row = &field[first as usize..][..out.len() + 2];
            for (k, out) in out.iter_mut().enumerate() {
                for n in 0..3 {
                    let (s, v) = (stencil[3 * r + n], row[k + n]);
                    *out += s[0] * v[0] + s[1] * v[1] + s[2] * v[2];
                }
            }
        }
        if self.at_border() {
            out.iter_mut().enumerate().for_each(|(k, out)| *out += self.border_flux(field, k));
            self.scale(out);
        }
    }

    /// What mirroring the field misses at a border: its part across the border is not continuous there.
    ///
    /// ∫B′B over the inner half of a hat is ∓½ where the whole has 0; the ½ comes with [`Self::scale`].
    fn border_flux(&self, field: &[[f32; 3]], k: usize) -> f32 {
        let [x, y, z] = self.start;
        let sides = [x + k as i16, y, z].map(|c| self.side(c));
        let mut flux = 0.0;
        for (axis, side) in sides.into_iter().enumerate().filter(|(_, side)| *side != 0.0) {
            for n in 0..27 {
                let step = [n % 3, n / 3 % 3, n / 9];
                if step[axis] == 1 {
                    let mass: f64 = (0..3).filter(|&a| a != axis).map(|a| MASS[step[a]]).product();
                    flux += side * mass as f32 * field[self.rows[n / 3] as usize + k + n % 3][axis];
                }
            }
        }
        flux
    }
}

#[cfg(test)]
mod tests {
    use super::super::spans::Spans;
    use super::*;

    /// Unknowns at the inner 3 × 2 × 2 nodes of a block, and the lattice round them.
    fn small() -> (Lattice, Runs) {
        let lattice = Lattice::new(3, &Spans::full(8, &(1..=5)));
        let inner = (2..=4).flat_map(|x| [[x, 2, 3], [x, 3, 3], [x, 2, 4], [x, 3, 4]]);
        let runs = Runs::new(&lattice, &Spans::of(8, inner));
        (lattice, runs)
    }

    #[test]
    fn the_stencil_is_the_tensor_product_at_every_unknown() {
        let (lattice, runs) = small();
        assert_eq!((runs.len(), runs.runs.len()), (12, 4));
        let values: Vec<f32> = (0..lattice.len()).map(|i| ((i * 37) % 23) as f32).collect();
        let mut out = vec![0.0; 12];
        let energy = runs.stiffness(&values, &mut out, |_, _| ());
        let (mass, stiff) = ([1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0], [-1.0, 2.0, -1.0]);
        let mut expected_energy = 0.0;
        for run in &runs.runs {
            let (first, node) = (run.first as usize, run.node());
            for k in 0..run.len as usize {
                let [x, y, z] = lattice.nodes[node + k];
                let mut expected = 0.0;
                for n in 0..27_usize {
                    let step = [n % 3, n / 3 % 3, n / 9];
                    let at = [x + step[0] as i16 - 1, y + step[1] as i16 - 1, z + step[2] as i16 - 1];
                    let value = f64::from(values[lattice.find(at).expect("a neighbour")]);
                    let entry: f64 = (0..3)
                        .map(|axis| {
                            (0..3).map(|a| if a == axis { stiff[step[a]] } else { mass[step[a]] }).product::<f64>()
                        })
                        .sum();
                    expected += entry * value;
                }
                assert!((f64::from(out[first + k]) - expected).abs() < 1e-4, "{} {expected}", out[first + k]);
                expected_energy += expected * f64::from(values[node + k]);
            }
        }
        assert!((energy / expected_energy - 1.0).abs() < 1e-5);
    }
}
