//! The multigrid cascade: coarse to fine, conjugate gradients at each depth on what the coarser depths left.

use super::params::Boundary;
use super::screening::Screening;
use super::system::{Extent, Level, Weighted, negate};
use rayon::prelude::*;

/// Coarsest depth solved.
const BASE_DEPTH: u32 = 3;

/// Conjugate gradients stop when the residual has shrunk by this factor …
pub(super) const TOLERANCE: f64 = 1e-3;

/// … or after this many iterations.
const MAX_ITERATIONS: usize = 60;

/// Solves for the indicator-like function (1 inside, 0 at the domain's border unless that is Neumann's), coarse to fine.
///
/// * `alpha` – screening weight at each depth
/// * `tolerance` – see [`TOLERANCE`]
///
/// Returns the depths from coarse to fine, each holding the function's values at its nodes.
///
/// # References
/// Kazhdan & Hoppe, *Screened Poisson surface reconstruction*, ACM Trans. Graph. 32(3), 2013, §4: at depth d the screening weighs 2^d α (eq. 9), and the
/// residual of the coarser solution is taken at that depth's weight.
pub(super) fn solve(
    input: &Weighted,
    depth: u32,
    alpha: impl Fn(u32) -> f64,
    boundary: Boundary,
    tolerance: f64,
) -> Vec<Level> {
    let base = BASE_DEPTH.min(depth);
    let extent = Extent { base, last: depth, boundary };
    let mut levels: Vec<Level> = (base..=depth).into_par_iter().map(|d| Level::new(input, d, extent)).collect();
    for l in (0..levels.len()).rev() {
        let (coarse, fine) = levels.split_at_mut(l + 1);
        coarse[l].gather_constraints(fine.first());
    }
    for l in 0..levels.len() {
        let (coarse, fine) = levels.split_at_mut(l);
        let level = &mut fine[0];
        level.start_from(coarse.last());
        let (screening, residual) = level.assemble(alpha(level.depth));
        if let Some(done) = coarse.last_mut() {
            done.finish();
        }
        let correction = conjugate_gradients(level, &screening, residual, tolerance);
        level.correct(&correction);
    }
    if let Some(last) = levels.last_mut() {
        last.finish();
    }
    levels
}

/// Jacobi-preconditioned conjugate gradients from zero, at the unknowns.
fn conjugate_gradients(level: &Level, screening: &Screening, mut residual: Vec<f32>, tolerance: f64) -> Vec<f32> {
    let unknowns = &level.unknowns;
    let inverse_diagonal = screening.inverse_diagonal();
    let mut x = vec![0.0; unknowns.len()];
    let mut applied = vec![0.0; unknowns.len()];
    // On the lattice, zero at the nodes that are no unknowns.
    let mut direction = vec![0.0; level.lattice.len()];
    let mut rho = unknowns.norm(&residual, inverse_diagonal);
    let target = tolerance * tolerance * rho;
    let mut beta = 0.0;
    for _ in 0..MAX_ITERATIONS {
        if rho <= target || rho <= f64::MIN_POSITIVE {
            break;
        }
        unknowns.turn(&mut direction, &residual, inverse_diagonal, beta as f32);
        level.mirror(&mut direction);
        let pull = screening.pull(&direction, 0.0);
        let curvature = unknowns.stiffness(&direction, &mut applied, |part, block| {
            // A pull is against the function.
            negate(part);
            screening.add(part, block, &pull);
            negate(part);
        });
        if curvature <= 0.0 {
            break;
        }
        let step = (rho / curvature) as f32;
        let next = unknowns.advance(&mut x, &mut residual, [&direction, &applied, inverse_diagonal], step);
        beta = next / rho;
        rho = next;
    }
    x
}
