//! Nonlinear least squares over a few rigid motions and points, by central differences: small problems, exact enough.

use crate::geometry::{Isometry, Vector};
use nalgebra::{DMatrix, DVector, Translation3, UnitQuaternion};

/// Steps before giving up.
const STEPS: usize = 100;

/// What was found.
pub(super) struct Solved<T> {
    pub(super) state: T,
    /// Weighted residuals.
    pub(super) residuals: DVector<f64>,
    /// (JᵀJ)⁻¹; `None` if the problem does not determine the state.
    pub(super) cofactor: Option<DMatrix<f64>>,
}

/// Minimises the squared residuals over states that are moved by `unknowns` small numbers.
pub(super) fn minimise<T: Clone>(
    start: T,
    unknowns: usize,
    moved: impl Fn(&T, &[f64]) -> T,
    residuals: impl Fn(&T) -> DVector<f64>,
) -> Solved<T> {
    let jacobian = |state: &T| {
        let h = 1e-6;
        let columns: Vec<DVector<f64>> = (0..unknowns)
            .map(|k| {
                let mut step = vec![0.0; unknowns];
                step[k] = h;
                let high = residuals(&moved(state, &step));
                step[k] = -h;
                (high - residuals(&moved(state, &step))) / (2.0 * h)
            })
            .collect();
        DMatrix::from_columns(&columns)
    };
    let (mut state, mut r) = (start.clone(), residuals(&start));
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let j = jacobian(&state);
        let (normal, right) = (j.transpose() * &j, -(j.transpose() * &r));
        let mut done = false;
        while damping < 1e10 {
            let mut damped = normal.clone();
            (0..unknowns).for_each(|i| damped[(i, i)] *= 1.0 + damping);
            let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else {
                damping *= 10.0;
                continue;
            };
            let next = moved(&state, step.as_slice());
            let next_r = residuals(&next);
            // Written so that NaN fails too.
            if next_r.norm_squared() <= r.norm_squared() {
                done = r.norm_squared() - next_r.norm_squared() <= 1e-14 * r.norm_squared();
                (state, r) = (next, next_r);
                damping = (damping * 0.1).max(1e-12);
                break;
            }
            damping *= 10.0;
        }
        if done || damping >= 1e10 {
            break;
        }
    }
    let j = jacobian(&state);
    let normal = j.transpose() * &j;
    let cofactor = inverse(&normal);
    Solved { state, residuals: r, cofactor }
}

/// Inverse, `None` if one direction is 10¹⁰ times less certain than another of the same unit-free scale.
fn inverse(normal: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = normal.nrows();
    let scale = DVector::from_fn(n, |i, _| 1.0 / normal[(i, i)].sqrt());
    if !scale.iter().all(|s| s.is_finite()) {
        return None;
    }
    let scaled = DMatrix::from_fn(n, n, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.clone().symmetric_eigenvalues();
    if eigen.min() < 1e-9 * eigen.max() {
        return None;
    }
    let inverse = scaled.cholesky()?.inverse();
    Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]))
}

/// A pose turned (about its parent's axes, at its own origin) and shifted by six numbers.
pub(super) fn moved_pose(pose: &Isometry, step: &[f64]) -> Isometry {
    let turn = UnitQuaternion::from_scaled_axis(Vector::new(step[0], step[1], step[2]));
    let shift = Vector::new(step[3], step[4], step[5]);
    Isometry::from_parts(Translation3::from(pose.translation.vector + shift), turn * pose.rotation)
}
