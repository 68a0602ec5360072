use super::{data::DataTerm, hessian, level::Level};
use rayon::prelude::*;

/// One-sided quadratic pulls: where f is below its target, w (target − f)² is added.
pub(super) struct Pulls {
    /// Weight and target of the free-space inequality; target 0 = none at this node.
    pub(super) free_weight: f32,
    pub(super) free_target: Vec<f32>,
    /// Weight of the outside prior with target 1; empty = none anywhere.
    pub(super) prior_weight: Vec<f32>,
}

impl Pulls {
    /// Weight and weighted target of all pulls that act on a node of value `f`.
    #[inline]
    fn acting(&self, n: usize, f: f32) -> (f32, f32) {
        let (mut weight, mut target) = (0.0, 0.0);
        let t = self.free_target[n];
        if t > 0.0 && f < t {
            weight += self.free_weight;
            target += self.free_weight * t;
        }
        if let Some(&w) = self.prior_weight.get(n) {
            if w > 0.0 && f < 1.0 {
                weight += w;
                target += w;
            }
        }
        (weight, target)
    }
}

/// How hard to solve one level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    pub(super) passes: usize,
    pub(super) iterations: usize,
    pub(super) tolerance: f64,
}

/// Minimises the energy over the active nodes by conjugate gradients with the Jacobi preconditioner, warm-started from the
/// level's values; the set of acting pulls is updated between passes.
pub(super) fn solve(level: &mut Level, data: &DataTerm, pulls: &Pulls, smoothness: f32, effort: Effort) {
    let n = level.values.len();
    let mut fixed_diagonal = vec![0.0f32; n];
    data.diagonal(level, &mut fixed_diagonal);
    add_hessian_diagonal(level, smoothness, &mut fixed_diagonal);
    let mut work =
        Work { r: vec![0.0; n], p: vec![0.0; n], ap: vec![0.0; n], inverse: vec![0.0; n], pull: vec![0.0; n] };
    let mut values = std::mem::take(&mut level.values);
    let mut first = None;
    for _ in 0..effort.passes {
        let start = pass(level, &mut values, data, pulls, smoothness, effort, &fixed_diagonal, &mut work, first);
        first = first.or(Some(start));
    }
    level.values = values;
}

struct Work {
    r: Vec<f32>,
    p: Vec<f32>,
    ap: Vec<f32>,
    inverse: Vec<f32>,
    pull: Vec<f32>,
}

/// One active-set pass; returns the preconditioned residual norm it started from. `first` is that of the first pass: later
/// passes stop relative to it, since they start closer.
fn pass(
    level: &Level,
    x: &mut [f32],
    data: &DataTerm,
    pulls: &Pulls,
    smoothness: f32,
    effort: Effort,
    fixed_diagonal: &[f32],
    work: &mut Work,
    first: Option<f64>,
) -> f64 {
    let Work { r, p, ap, inverse, pull } = work;
    // r = b − A x
    clear(level, r);
    data.residual(level, x, r);
    hessian::apply(level, x, -smoothness, r);
    {
        let x = &*x;
        for_runs(level, [&mut *r, &mut *inverse, &mut *pull], |n, [r, inverse, pull]| {
            let (weight, target) = pulls.acting(n, x[n]);
            *r += target - weight * x[n];
            *pull = weight;
            *inverse = 1.0 / (fixed_diagonal[n] + weight).max(1e-9);
        });
    }
    {
        let (r, inverse) = (&*r, &*inverse);
        for_runs(level, [&mut *p], |n, [p]| *p = inverse[n] * r[n]);
    }
    let mut rho = dot(level, |n| f64::from(r[n]) * f64::from(inverse[n] * r[n]));
    let start = rho;
    let goal = first.unwrap_or(start) * effort.tolerance * effort.tolerance;
    for _ in 0..effort.iterations {
        if rho <= goal || rho <= f64::MIN_POSITIVE {
            break;
        }
        clear(level, ap);
        data.apply(level, p, ap);
        hessian::apply(level, p, smoothness, ap);
        {
            let (p, pull) = (&*p, &*pull);
            for_runs(level, [&mut *ap], |n, [ap]| *ap += pull[n] * p[n]);
        }
        let curvature = dot(level, |n| f64::from(p[n]) * f64::from(ap[n]));
        if curvature <= 0.0 || !curvature.is_finite() {
            break;
        }
        let alpha = (rho / curvature) as f32;
        {
            let (p, ap) = (&*p, &*ap);
            for_runs(level, [&mut *x, &mut *r], |n, [x, r]| {
                *x += alpha * p[n];
                *r -= alpha * ap[n];
            });
        }
        let next = dot(level, |n| f64::from(r[n]) * f64::from(inverse[n] * r[n]));
        let beta = (next / rho) as f32;
        rho = next;
        let (r, inverse) = (&*r, &*inverse);
        for_runs(level, [&mut *p], |n, [p]| *p = inverse[n] * r[n] + beta * *p);
    }
    start
}

/// Zeroes the active nodes. What the data term scatters beside them is never read.
fn clear(level: &Level, values: &mut [f32]) {
    for_runs(level, [values], |_, [v]| *v = 0.0);
}

fn add_hessian_diagonal(level: &Level, smoothness: f32, out: &mut [f32]) {
    let [nx, ny, nz] = level.dims;
    let plane = level.plane_len();
    for_runs(level, [out], |n, [d]| {
        let (i, j, k) = (n % nx, n / nx % ny, n / plane);
        let inner = i >= 2 && i + 2 < nx && j >= 2 && j + 2 < ny && k >= 2 && k + 2 < nz;
        *d += smoothness * if inner { 42.0 } else { hessian::diagonal(level, n) };
    });
}

/// Calls `visit(node, that node's entry in each array)` for every active node, parallel over planes.
fn for_runs<const N: usize>(level: &Level, arrays: [&mut [f32]; N], visit: impl Fn(usize, [&mut f32; N]) + Sync) {
    let plane = level.plane_len();
    let mut chunks: Vec<[&mut [f32]; N]> = Vec::with_capacity(level.dims[2]);
    let mut iters = arrays.map(|a| a.chunks_mut(plane));
    for _ in 0..level.dims[2] {
        chunks.push(iters.each_mut().map(|i| i.next().expect("every array has one chunk per plane")));
    }
    chunks.into_par_iter().enumerate().for_each(|(k, mut chunk)| {
        for &(start, len) in &level.runs[k] {
            let first = start as usize - k * plane;
            for m in first..first + len as usize {
                visit(k * plane + m, chunk.each_mut().map(|c| &mut c[m]));
            }
        }
    });
}

/// Sum over the active nodes; summed plane by plane, so the result does not depend on the number of threads.
fn dot(level: &Level, term: impl Fn(usize) -> f64 + Sync) -> f64 {
    let planes: Vec<f64> = level
        .runs
        .par_iter()
        .map(|runs| runs.iter().flat_map(|&(start, len)| start as usize..(start + len) as usize).map(&term).sum())
        .collect();
    planes.iter().sum()
}
