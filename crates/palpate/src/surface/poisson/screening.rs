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

/// No sample lies in a cell.
const NONE: u32 = u32::MAX;

/// The unknowns of a block that samples touch.
#[derive(Default)]
struct Touched {
    /// Places in the block, ascending, and where their entries start; one more at the end.
    rows: Vec<(u32, u32)>,
    /// Sample · 8 + corner.
    entries: Vec<u32>,
}

/// The screening of one depth, kept as samples, not as a matrix: a product costs a read and a write of eight nodes a sample.
pub(super) struct Screening {
    pulls: Vec<Pull>,
    /// For each block of the unknowns.
    touched: Vec<Touched>,
    inverse_diagonal: Vec<f32>,
}

impl Screening {
    /// O(unknowns + samples).
    ///
    /// * `per_area` – weight of a sample over its area
    /// * `nodes` – how many the lattice has
    pub(super) fn new(cells: &[CellSample], per_area: f64, unknowns: &Runs, nodes: usize) -> Self {
        let pull = |s: &CellSample| {
            let weight = (per_area * s.area).sqrt();
            Pull { corners: s.corners, hats: hats(s.place).map(|b| (b * weight) as f32), weight: weight as f32 }
        };
        let pulls: Vec<Pull> = if per_area > 0.0 { cells.par_iter().map(pull).collect() } else { Vec::new() };
        // The sample of each cell, at the cell's first node.
        let mut sample_of = vec![NONE; nodes];
        for (s, pull) in pulls.iter().enumerate() {
            sample_of[corner(&pull.corners, 0)] = s as u32;
        }
        let mut inverse_diagonal = vec![0.0; unknowns.len()];
        let touched = unknowns.map_blocks(&mut inverse_diagonal, |diagonal, unknowns| {
            let mut touched = Touched::default();
            for (k, unknown) in unknowns.enumerate() {
                let start = touched.entries.len();
                for (step, from_last) in (0..8).zip((0..8).rev()) {
                    let sample = sample_of[unknown.before[step >> 1] + (step & 1)];
                    if sample != NONE {
                        touched.entries.push(8 * sample + from_last);
                    }
                }
                let entries = &mut touched.entries[start..];
                entries.sort_unstable();
                let square = |entry: &u32| pulls[*entry as usize / 8].hats[*entry as usize % 8].powi(2);
                let screened = unknown.inside * STIFFNESS[0] as f32 + entries.iter().map(square).sum::<f32>();
                diagonal[k] = 1.0 / screened;
                if !entries.is_empty() {
                    touched.rows.push((k as u32, start as u32));
                }
            }
            touched.rows.push((u32::MAX, touched.entries.len() as u32));
            touched
        });
        Self { pulls, touched, inverse_diagonal }
    }

    /// For each sample, how far the function is below the target, times the root of its weight.
    pub(super) fn pull(&self, values: &[f32], target: f32) -> Vec<f32> {
        let read = |p: &Pull| -> f32 {
            let value: f32 = (0..8).map(|c| p.hats[c] * values[corner(&p.corners, c)]).sum();
            p.weight * target - value
        };
        self.pulls.par_iter().with_min_len(4096).map(read).collect()
    }

    /// Adds the samples' pulls to the unknowns of a block.
    pub(super) fn add(&self, part: &mut [f32], block: usize, pull: &[f32]) {
        let Touched { rows, entries } = &self.touched[block];
        let add = |entry: &u32| self.pulls[*entry as usize / 8].hats[*entry as usize % 8] * pull[*entry as usize / 8];
        for row in rows.windows(2) {
            let own = &entries[row[0].1 as usize..row[1].1 as usize];
            part[row[0].0 as usize] += own.iter().map(add).sum::<f32>();
        }
    }

    /// One over the operator's diagonal: stiffness within the domain, and screening.
    pub(super) fn inverse_diagonal(&self) -> &[f32] {
        &self.inverse_diagonal
    }
}
