//! The multigrid cascade: coarse to fine, conjugate gradients at each depth on what the coarser depths left.

use super::basis::STIFFNESS;
use super::system::{Level, Operator, Weighted};
use rayon::prelude::*;

/// Coarsest depth solved.
const BASE_DEPTH: u32 = 3;

/// Conjugate gradients stop when the residual has shrunk by this factor …
const TOLERANCE: f64 = 1e-3;

/// … or after this many iterations.
const MAX_ITERATIONS: usize = 60;

/// Sums run over fixed chunks of this length, so that they do not depend on the number of threads.
const CHUNK: usize = 8192;

/// Solves for the indicator-like function (1 inside, 0 at the domain's border), coarse to fine.
///
/// Returns the depths from coarse to fine, each holding the function's values at its nodes.
///
/// # References
/// Kazhdan & Hoppe, *Screened Poisson surface reconstruction*, ACM Trans. Graph. 32(3), 2013, §4: at depth d the screening weighs 2^d α (eq. 9), and the
/// residual of the coarser solution is taken at that depth's weight.
pub(super) fn solve(input: &Weighted, depth: u32, alpha: f64) -> Vec<Level> {
    let base = BASE_DEPTH.min(depth);
    let mut levels: Vec<Level> = (base..=depth).into_par_iter().map(|d| Level::new(input, d, base, depth)).collect();
    let neighbours: Vec<Vec<[u32; 9]>> = levels.iter().map(|l| l.lattice.neighbour_rows(&l.active)).collect();
    for l in (0..levels.len()).rev() {
        let (coarse, fine) = levels.split_at_mut(l + 1);
        coarse[l].gather_constraints(fine.first(), &neighbours[l]);
    }
    for (l, neighbours) in neighbours.into_iter().enumerate() {
        let (coarse, fine) = levels.split_at_mut(l);
        let level = &mut fine[0];
        level.start_from(coarse.last(), &neighbours);
        let (operator, residual) = level.assemble(alpha, neighbours);
        let correction = conjugate_gradients(&operator, &level.active, level.lattice.len(), residual);
        level.correct(&correction);
        if let Some(done) = coarse.last_mut() {
            done.finish();
        }
    }
    if let Some(last) = levels.last_mut() {
        last.finish();
    }
    levels
}

/// The operator at the active nodes, applied to values at all nodes.
pub(super) fn apply(operator: &Operator, active: &[u32], values: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; active.len()];
    apply_into(operator, values, &mut out);
    out
}

fn apply_into(operator: &Operator, values: &[f64], out: &mut [f64]) {
    out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
        for (k, out) in out.iter_mut().enumerate() {
            let i = chunk * CHUNK + k;
            let rows = operator.neighbours[i].map(|first| {
                let first = first as usize;
                [values[first], values[first + 1], values[first + 2]]
            });
            let ends = |r: usize| rows[r][0] + rows[r][2];
            let edges = ends(1) + ends(3) + ends(5) + ends(7) + rows[0][1] + rows[2][1] + rows[6][1] + rows[8][1];
            let corners = ends(0) + ends(2) + ends(6) + ends(8);
            *out = STIFFNESS[0] * rows[4][1] + STIFFNESS[1] * edges + STIFFNESS[2] * corners;
            if let Some(screen) = operator.row(i) {
                *out += rows.iter().flatten().zip(screen).map(|(v, &s)| v * f64::from(s)).sum::<f64>();
            }
        }
    });
}

/// Jacobi-preconditioned conjugate gradients from zero; `nodes` is the length of the lattice that `active` indexes.
fn conjugate_gradients(operator: &Operator, active: &[u32], nodes: usize, mut residual: Vec<f64>) -> Vec<f64> {
    let inverse_diagonal: Vec<f64> =
        (0..active.len()).map(|i| 1.0 / (STIFFNESS[0] + operator.row(i).map_or(0.0, |r| f64::from(r[13])))).collect();
    let mut x = vec![0.0; active.len()];
    let mut direction = vec![0.0; active.len()];
    let mut spread = vec![0.0; nodes];
    let mut applied = vec![0.0; active.len()];
    let mut rho = weighted_dot(&residual, &residual, &inverse_diagonal);
    let target = TOLERANCE * TOLERANCE * rho;
    let mut beta = 0.0;
    for _ in 0..MAX_ITERATIONS {
        if rho <= target || rho <= f64::MIN_POSITIVE {
            break;
        }
        for (((d, r), m), &i) in direction.iter_mut().zip(&residual).zip(&inverse_diagonal).zip(active) {
            *d = r * m + beta * *d;
            spread[i as usize] = *d;
        }
        apply_into(operator, &spread, &mut applied);
        let curvature = dot(&direction, &applied);
        if curvature <= 0.0 {
            break;
        }
        let step = rho / curvature;
        for (((x, d), r), a) in x.iter_mut().zip(&direction).zip(&mut residual).zip(&applied) {
            *x += step * d;
            *r -= step * a;
        }
        let next = weighted_dot(&residual, &residual, &inverse_diagonal);
        beta = next / rho;
        rho = next;
    }
    x
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let partial: Vec<f64> =
        a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum()).collect();
    partial.iter().sum()
}

fn weighted_dot(a: &[f64], b: &[f64], w: &[f64]) -> f64 {
    let partial: Vec<f64> = a
        .par_chunks(CHUNK)
        .zip(b.par_chunks(CHUNK))
        .zip(w.par_chunks(CHUNK))
        .map(|((a, b), w)| a.iter().zip(b).zip(w).map(|((a, b), w)| a * b * w).sum())
        .collect();
    partial.iter().sum()
}
