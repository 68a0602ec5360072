//! The pull towards ½ at the samples, merged to one a cell: Σ w (χ(p) − ½)².

use super::basis::{STIFFNESS, hats};
use super::octree::corner;
use super::runs::Runs;
use rayon::prelude::*;

/// A sample that stands for all of a cell.
pub(super) struct CellSample {
    /// Lattice indices of the cell's corners, see [`super::octree::Lattice::corner_rows`].
    pub(super) corners: [u32; 4],
    /// Where in the cell, 0 to 1 along each axis.
    pub(super) place: [f64; 3],
    /// Area in the unit cube.
    pub(super) area: f64,
}

struct Pull {
    corners: [u32; 4],
    /// The corners' hats at the sample, times the root of its weight.
    hats: [f32; 8],
    /// Root of the weight.
    weight: f32,
}

/// The screening of one depth, kept as samples, not as a matrix: a product costs a read and a write of eight nodes a sample.
pub(super) struct Screening {
    pulls: Vec<Pull>,
    /// Unknowns that a sample touches, ascending, and where their entries start.
    touched: Vec<(u32, u32)>,
    /// Sample · 8 + corner.
    entries: Vec<u32>,
}

impl Screening {
    /// * `per_area` – weight of a sample over its area
    pub(super) fn new(cells: Vec<CellSample>, per_area: f64, unknowns: &Runs) -> Self {
        let pull = |s: &CellSample| {
            let weight = (per_area * s.area).sqrt();
            Pull { corners: s.corners, hats: hats(s.place).map(|b| (b * weight) as f32), weight: weight as f32 }
        };
        let pulls: Vec<Pull> = if per_area > 0.0 { cells.par_iter().map(pull).collect() } else { Vec::new() };
        let mut pairs: Vec<(u32, u32)> = pulls
            .par_iter()
            .enumerate()
            .flat_map_iter(|(s, pull)| {
                (0..8).filter_map(move |c| {
                    let unknown = unknowns.unknown_at(corner(&pull.corners, c))?;
                    Some((unknown as u32, (8 * s + c) as u32))
                })
            })
            .collect();
        pairs.par_sort_unstable();
        let mut touched = Vec::new();
        for (k, &(unknown, _)) in pairs.iter().enumerate() {
            if k == 0 || pairs[k - 1].0 != unknown {
                touched.push((unknown, k as u32));
            }
        }
        touched.push((u32::MAX, pairs.len() as u32));
        Self { pulls, touched, entries: pairs.iter().map(|p| p.1).collect() }
    }

    /// For each sample, how far the function is below the target, times the root of its weight.
    pub(super) fn pull(&self, values: &[f32], target: f32) -> Vec<f32> {
        let read = |p: &Pull| -> f32 {
            let value: f32 = (0..8).map(|c| p.hats[c] * values[corner(&p.corners, c)]).sum();
            p.weight * target - value
        };
        self.pulls.par_iter().with_min_len(4096).map(read).collect()
    }

    /// Adds the samples' pulls to the unknowns from `first` on.
    pub(super) fn add(&self, part: &mut [f32], first: usize, pull: &[f32]) {
        for (at, entries) in self.rows(first, part.len()) {
            let add =
                |entry: &u32| self.pulls[*entry as usize / 8].hats[*entry as usize % 8] * pull[*entry as usize / 8];
            part[at - first] += entries.iter().map(add).sum::<f32>();
        }
    }

    /// One over the operator's diagonal: stiffness, of which `inside` is in the domain, and screening.
    pub(super) fn inverse_diagonal(&self, inside: impl Iterator<Item = f32>) -> Vec<f32> {
        let mut diagonal: Vec<f32> = inside.map(|w| w * STIFFNESS[0] as f32).collect();
        let len = diagonal.len();
        for (at, entries) in self.rows(0, len) {
            let square = |entry: &u32| self.pulls[*entry as usize / 8].hats[*entry as usize % 8].powi(2);
            diagonal[at] += entries.iter().map(square).sum::<f32>();
        }
        for d in &mut diagonal {
            *d = 1.0 / *d;
        }
        diagonal
    }

    /// Unknowns from `first` on, at most `len`, with their entries.
    fn rows(&self, first: usize, len: usize) -> impl Iterator<Item = (usize, &[u32])> {
        let start = self.touched.partition_point(|t| (t.0 as usize) < first);
        self.touched[start..]
            .windows(2)
            .take_while(move |w| (w[0].0 as usize) < first + len)
            .map(|w| (w[0].0 as usize, &self.entries[w[0].1 as usize..w[1].1 as usize]))
    }
}
