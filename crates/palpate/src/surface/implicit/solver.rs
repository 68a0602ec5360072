use super::{data::DataTerm, hessian, level::Level};
use rayon::prelude::*;
use std::ops::Range;

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
        if let Some(&w) = self.prior_weight.get(n)
            && w > 0.0
            && f < 1.0
        {
            weight += w;
            target += w;
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
    let mut values = std::mem::take(&mut level.values);
    let mut system = System::new(level, data, pulls, smoothness, values.len());
    let mut first = None;
    for _ in 0..effort.passes {
        let start = system.pass(&mut values, effort, first);
        first = first.or(Some(start));
    }
    level.values = values;
}

/// The linear system of one active set and the vectors of its solution. Every loop runs plane by plane over the runs of active
/// nodes; sums are taken per run and added in order, so they do not depend on the number of threads.
struct System<'a> {
    level: &'a Level,
    data: &'a DataTerm,
    pulls: &'a Pulls,
    smoothness: f32,
    /// Diagonal of data and smoothness.
    diagonal: Vec<f32>,
    /// Weight of the acting pulls.
    pull: Vec<f32>,
    /// Inverse of the whole diagonal.
    inverse: Vec<f32>,
    residual: Vec<f32>,
    direction: Vec<f32>,
    applied: Vec<f32>,
}

impl<'a> System<'a> {
    fn new(level: &'a Level, data: &'a DataTerm, pulls: &'a Pulls, smoothness: f32, nodes: usize) -> Self {
        let [nx, ny, nz] = level.dims;
        let zeros = || vec![0.0f32; nodes];
        let mut diagonal = zeros();
        planes(level, [&mut diagonal], |k, [out]| {
            data.diagonal_plane(level, k, out);
            for (n, m) in nodes_of(level, k) {
                let (i, j) = (m % nx, m / nx);
                let inner = i >= 2 && i + 2 < nx && j >= 2 && j + 2 < ny && k >= 2 && k + 2 < nz;
                out[m] += smoothness * if inner { 42.0 } else { hessian::diagonal(level, n) };
            }
            0.0
        });
        let (pull, inverse) = (zeros(), zeros());
        let (residual, direction, applied) = (zeros(), zeros(), zeros());
        Self { level, data, pulls, smoothness, diagonal, pull, inverse, residual, direction, applied }
    }

    /// One active-set pass; returns the squared preconditioned residual it started from. `first` is that of the first pass: later
    /// passes stop relative to it, since they start closer.
    fn pass(&mut self, x: &mut [f32], effort: Effort, first: Option<f64>) -> f64 {
        let start = self.linearise(x);
        let mut rho = start;
        let goal = first.unwrap_or(start) * effort.tolerance * effort.tolerance;
        for _ in 0..effort.iterations {
            if rho <= goal || rho <= f64::MIN_POSITIVE {
                break;
            }
            let curvature = self.apply();
            if curvature <= 0.0 || !curvature.is_finite() {
                break;
            }
            let next = self.step((rho / curvature) as f32, x);
            self.turn((next / rho) as f32);
            rho = next;
        }
        start
    }

    /// Residual, pulls and preconditioner at `x`, and the first direction.
    fn linearise(&mut self, x: &[f32]) -> f64 {
        let (level, data, pulls, smoothness) = (self.level, self.data, self.pulls, self.smoothness);
        let (rows, diagonal) = (data.misfits(level, x), &self.diagonal);
        let arrays = [&mut self.residual[..], &mut self.direction, &mut self.pull, &mut self.inverse];
        planes(level, arrays, |k, [residual, direction, pull, inverse]| {
            clear(level, k, residual);
            hessian::apply_plane(level, x, -smoothness, k, residual);
            data.scatter_plane(level, &rows, k, residual);
            let mut sum = 0.0;
            for (n, m) in nodes_of(level, k) {
                let (weight, target) = pulls.acting(n, x[n]);
                residual[m] += target - weight * x[n];
                pull[m] = weight;
                inverse[m] = 1.0 / (diagonal[n] + weight).max(1e-9);
                direction[m] = inverse[m] * residual[m];
                sum += f64::from(residual[m] * direction[m]);
            }
            sum
        })
    }

    /// applied = A · direction; returns direction · applied.
    fn apply(&mut self) -> f64 {
        let (level, data, smoothness) = (self.level, self.data, self.smoothness);
        let (p, pull) = (&self.direction, &self.pull);
        let rows = data.rows(level, p);
        planes(level, [&mut self.applied], |k, [out]| {
            clear(level, k, out);
            hessian::apply_plane(level, p, smoothness, k, out);
            data.scatter_plane(level, &rows, k, out);
            runs_of(level, k, |run, local| {
                let (p, pull, out) = (&p[run.clone()], &pull[run], &mut out[local]);
                for ((out, p), pull) in out.iter_mut().zip(p).zip(pull) {
                    *out += pull * p;
                }
                dot(p, out)
            })
        })
    }

    /// Moves by `alpha` along the direction; returns the new squared preconditioned residual.
    fn step(&mut self, alpha: f32, x: &mut [f32]) -> f64 {
        let level = self.level;
        let (p, applied, inverse) = (&self.direction, &self.applied, &self.inverse);
        planes(level, [x, &mut self.residual], |k, [x, r]| {
            runs_of(level, k, |run, local| {
                let (x, r) = (&mut x[local.clone()], &mut r[local]);
                for (x, p) in x.iter_mut().zip(&p[run.clone()]) {
                    *x += alpha * p;
                }
                for (r, a) in r.iter_mut().zip(&applied[run.clone()]) {
                    *r -= alpha * a;
                }
                dot_weighted(r, &inverse[run])
            })
        })
    }

    /// direction = inverse · residual + beta · direction.
    fn turn(&mut self, beta: f32) {
        let level = self.level;
        let (r, inverse) = (&self.residual, &self.inverse);
        planes(level, [&mut self.direction], |k, [p]| {
            runs_of(level, k, |run, local| {
                for ((p, r), inverse) in p[local].iter_mut().zip(&r[run.clone()]).zip(&inverse[run]) {
                    *p = inverse * r + beta * *p;
                }
                0.0
            })
        });
    }
}

/// Calls `visit(k, plane k of each array)` in parallel and adds what it returns in order.
fn planes<const N: usize>(
    level: &Level,
    arrays: [&mut [f32]; N],
    visit: impl Fn(usize, [&mut [f32]; N]) -> f64 + Sync,
) -> f64 {
    let plane = level.plane_len();
    let mut iters = arrays.map(|a| a.chunks_mut(plane));
    let chunks: Vec<[&mut [f32]; N]> = (0..level.dims[2])
        .map(|_| iters.each_mut().map(|i| i.next().expect("every array has one chunk per plane")))
        .collect();
    let sums: Vec<f64> = chunks.into_par_iter().enumerate().with_min_len(4).map(|(k, chunk)| visit(k, chunk)).collect();
    sums.iter().sum()
}

/// Calls `visit(run in the grid, run in the plane)` for the runs of plane `k` and adds what it returns.
#[inline]
fn runs_of(level: &Level, k: usize, mut visit: impl FnMut(Range<usize>, Range<usize>) -> f64) -> f64 {
    let offset = k * level.plane_len();
    let mut sum = 0.0;
    for &(start, len) in &level.runs[k] {
        let run = start as usize..(start + len) as usize;
        sum += visit(run.clone(), run.start - offset..run.end - offset);
    }
    sum
}

/// The active nodes of plane `k`: index in the grid and in the plane.
fn nodes_of(level: &Level, k: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
    let offset = k * level.plane_len();
    level.runs[k]
        .iter()
        .flat_map(move |&(start, len)| (start as usize..(start + len) as usize).map(move |n| (n, n - offset)))
}

/// Zeroes the active nodes of a plane. What the data term scatters beside them is never read.
fn clear(level: &Level, k: usize, out: &mut [f32]) {
    runs_of(level, k, |_, local| {
        out[local].fill(0.0);
        0.0
    });
}

/// Σ aᵢ bᵢ in eight lanes, which the compiler turns into vector code.
#[inline]
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut lanes = [0.0f32; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = a8.remainder().iter().zip(b8.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a8.zip(b8) {
        for l in 0..8 {
            lanes[l] += a[l] * b[l];
        }
    }
    f64::from(rest) + lanes.iter().map(|&l| f64::from(l)).sum::<f64>()
}

/// Σ rᵢ² wᵢ, likewise.
#[inline]
fn dot_weighted(r: &[f32], w: &[f32]) -> f64 {
    let mut lanes = [0.0f32; 8];
    let (r8, w8) = (r.chunks_exact(8), w.chunks_exact(8));
    let rest: f32 = r8.remainder().iter().zip(w8.remainder()).map(|(r, w)| r * r * w).sum();
    for (r, w) in r8.zip(w8) {
        for l in 0..8 {
            lanes[l] += r[l] * r[l] * w[l];
        }
    }
    f64::from(rest) + lanes.iter().map(|&l| f64::from(l)).sum::<f64>()
}
