//! Unknowns in runs along x, so that a node's 27 neighbours need nine indices a run, not a node, and the stencils work on consecutive numbers.

use super::basis::{MASS, STIFFNESS, gradient_stencil};
use super::octree::{Cell, Lattice};
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
    /// The unknowns at the sorted `nodes` of the lattice.
    pub(super) fn new(lattice: &Lattice, nodes: &[u32]) -> Self {
        let mut starts = Vec::new();
        for (k, &i) in nodes.iter().enumerate() {
            let here = lattice.nodes[i as usize];
            let follows = k > 0 && lattice.nodes[nodes[k - 1] as usize] == [here[0] - 1, here[1], here[2]];
            if !follows {
                starts.push(k);
            }
        }
        let ends = starts.iter().copied().skip(1).chain([nodes.len()]);
        let spans: Vec<Range<usize>> = starts.iter().zip(ends).map(|(&a, b)| a..b).collect();
        let runs: Vec<Run> = spans.par_iter().map(|span| Run::new(lattice, nodes, span.clone())).collect();
        let mut blocks = Vec::new();
        let mut start = 0;
        for (i, run) in runs.iter().enumerate() {
            if (run.first - runs[start].first) as usize >= BLOCK {
                blocks.push(start..i);
                start = i;
            }
        }
        blocks.push(start..runs.len());
        Self { runs, blocks, len: nodes.len() }
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

    /// Place of each unknown in the lattice: (first unknown, first node, length) of each run.
    pub(super) fn spans(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        self.runs.iter().map(|r| (r.first as usize, r.node(), r.len as usize))
    }

    /// The unknown at a node of the lattice, if it is one.
    pub(super) fn unknown_at(&self, node: usize) -> Option<usize> {
        let at = self.runs.partition_point(|r| r.lattice_end() <= node);
        let run = self.runs.get(at).filter(|r| r.node() <= node)?;
        Some(run.first as usize + node - run.node())
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

    /// Sums over blocks of what `work` returns for the block's index, its part of `values` and the number of its first unknown.
    pub(super) fn sum_over<T: Send>(&self, values: &mut [T], work: impl Fn(&mut [T], usize) -> f64 + Sync) -> f64 {
        let parts = self.cut(values);
        let sums: Vec<f64> = parts
            .into_par_iter()
            .zip(&self.blocks)
            .map(|(part, block)| work(part, self.unknowns(block).start))
            .collect();
        sums.iter().sum()
    }

    /// direction ← inverse diagonal · residual + beta · direction, the direction held on the lattice.
    pub(super) fn turn(&self, direction: &mut [f32], residual: &[f32], inverse_diagonal: &[f32], beta: f32) {
        let mut rest = direction;
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
            for run in &self.runs[block.clone()] {
                let (u, node, len) = (run.first as usize, run.node() - start, run.len as usize);
                let preconditioned = residual[u..u + len].iter().zip(&inverse_diagonal[u..u + len]);
                for (d, (r, m)) in part[node..node + len].iter_mut().zip(preconditioned) {
                    *d = r * m + beta * *d;
                }
            }
        });
    }

    /// x ← x + step · direction, the direction held on the lattice.
    pub(super) fn advance(&self, x: &mut [f32], direction: &[f32], step: f32) {
        let parts = self.cut(x);
        parts.into_par_iter().zip(&self.blocks).for_each(|(part, block)| {
            let first = self.unknowns(block).start;
            for run in &self.runs[block.clone()] {
                let own = &mut part[run.first as usize - first..][..run.len as usize];
                own.iter_mut().zip(&direction[run.node()..]).for_each(|(x, d)| *x += step * d);
            }
        });
    }

    /// The stiffness ∫∇B_i·∇B_j applied to values on the lattice, for each unknown; `finish(block's part, first unknown)` may add to it.
    ///
    /// Returns Σ value · result over the unknowns.
    pub(super) fn stiffness(&self, values: &[f32], out: &mut [f32], finish: impl Fn(&mut [f32], usize) + Sync) -> f64 {
        let parts = self.cut(out);
        let sums: Vec<f64> = parts
            .into_par_iter()
            .zip(&self.blocks)
            .map(|(part, block)| {
                let first = self.unknowns(block).start;
                for run in &self.runs[block.clone()] {
                    let at = run.first as usize - first;
                    run.stiffness(values, &mut part[at..at + run.len as usize]);
                }
                finish(part, first);
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
        let runs = |block: &Range<usize>| -> Vec<f32> {
            let runs = &self.runs[block.clone()];
            runs.iter().flat_map(|run| run.divergence(field, &stencil)).collect()
        };
        let blocks: Vec<Vec<f32>> = self.blocks.par_iter().map(runs).collect();
        for (block, divergence) in self.blocks.iter().zip(blocks) {
            let first = self.unknowns(block).start;
            for run in &self.runs[block.clone()] {
                let own = &divergence[run.first as usize - first..][..run.len as usize];
                out[run.node()..][..run.len as usize].iter_mut().zip(own).for_each(|(o, d)| *o += d);
            }
        }
    }

    /// Share of each unknown's support that lies in the domain, in the order of the unknowns.
    pub(super) fn inside(&self) -> impl Iterator<Item = f32> {
        self.runs.iter().flat_map(|run| (0..run.len as usize).map(|k| run.inside_at(k)))
    }
}

impl Run {
    fn new(lattice: &Lattice, nodes: &[u32], span: Range<usize>) -> Self {
        let [x, y, z]: Cell = lattice.nodes[nodes[span.start] as usize];
        let rows = std::array::from_fn(|r| {
            let node = [x - 1, y + r as i16 % 3 - 1, z + r as i16 / 3 - 1];
            lattice.find(node).expect("unknowns have all their neighbours") as u32
        });
        Self { first: span.start as u32, len: span.len() as u32, rows, start: [x, y, z], cells: lattice.cells }
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

    fn divergence(&self, field: &[[f32; 3]], stencil: &[[f32; 3]; 27]) -> Vec<f32> {
        let mut out = vec![0.0; self.len as usize];
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
            self.scale(&mut out);
        }
        out
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
    use super::super::octree::{all_keys, grown};
    use super::*;

    /// Unknowns at the inner 3 × 2 × 2 nodes of a block, and the lattice round them.
    fn small() -> (Lattice, Runs) {
        let keys: Vec<u64> = all_keys(2..=4).into_iter().collect();
        let lattice = Lattice::new(3, &grown(keys, 0..=8));
        let nodes: Vec<u32> = (0..lattice.len() as u32)
            .filter(|&i| {
                let [x, y, z] = lattice.nodes[i as usize];
                (2..=4).contains(&x) && (2..=3).contains(&y) && (3..=4).contains(&z)
            })
            .collect();
        let runs = Runs::new(&lattice, &nodes);
        (lattice, runs)
    }

    #[test]
    fn the_stencil_is_the_tensor_product_at_every_unknown() {
        let (lattice, runs) = small();
        assert_eq!((runs.len(), runs.spans().count()), (12, 4));
        let values: Vec<f32> = (0..lattice.len()).map(|i| ((i * 37) % 23) as f32).collect();
        let mut out = vec![0.0; 12];
        let energy = runs.stiffness(&values, &mut out, |_, _| ());
        let (mass, stiff) = ([1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0], [-1.0, 2.0, -1.0]);
        let mut expected_energy = 0.0;
        for (first, node, len) in runs.spans() {
            for k in 0..len {
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
                assert_eq!(runs.unknown_at(node + k), Some(first + k));
                expected_energy += expected * f64::from(values[node + k]);
            }
        }
        assert!((energy / expected_energy - 1.0).abs() < 1e-5);
        assert_eq!(runs.unknown_at(0), None);
    }
}
