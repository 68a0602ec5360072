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

/// The linear system of one active set and the vectors of its solution.
///
/// Only what a stencil reads lies in the grid (the function and the direction); all else is kept for the active nodes alone, one after the
/// other: a band is a tenth of its box, and its runs are shorter than a line of the cache. Every loop runs plane by plane over the runs of
/// active nodes; sums are taken per run and added in order, so they do not depend on the number of threads.
struct System<'a> {
    level: &'a Level,
    data: &'a DataTerm,
    pulls: &'a Pulls,
    smoothness: f32,
    border: hessian::Border,
    /// Active nodes per plane.
    counts: Vec<usize>,
    /// Diagonal of data and smoothness.
    diagonal: Vec<f32>,
    /// Weight of the acting pulls.
    pull: Vec<f32>,
    /// Inverse of the whole diagonal.
    inverse: Vec<f32>,
    residual: Vec<f32>,
    applied: Vec<f32>,
    /// What the pass has added to the function so far.
    change: Vec<f32>,
    /// In the grid.
    direction: Vec<f32>,
}

impl<'a> System<'a> {
    fn new(level: &'a Level, data: &'a DataTerm, pulls: &'a Pulls, smoothness: f32, nodes: usize) -> Self {
        let counts: Vec<usize> =
            level.runs.iter().map(|runs| runs.iter().map(|&(_, len)| len as usize).sum()).collect();
        let zeros = || vec![0.0f32; counts.iter().sum()];
        let mut diagonal = zeros();
        let border = hessian::Border::new(level);
        planes(level.plane_len(), split(&counts, [&mut diagonal]), |k, [out], scratch| {
            scratch.fill(0.0);
            data.diagonal_plane(level, k, scratch);
            hessian::diagonal_plane(level, &border, smoothness, k, scratch);
            for (out, (_, m)) in out.iter_mut().zip(nodes_of(level, k)) {
                *out = scratch[m];
            }
            0.0
        });
        let (pull, inverse, residual, applied, change) = (zeros(), zeros(), zeros(), zeros(), zeros());
        let direction = vec![0.0; nodes];
        Self {
            level,
            data,
            pulls,
            smoothness,
            border,
            counts,
            diagonal,
            pull,
            inverse,
            residual,
            applied,
            change,
            direction,
        }
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
            let next = self.step((rho / curvature) as f32);
            self.turn((next / rho) as f32);
            rho = next;
        }
        self.add_change(x);
        start
    }

    /// Residual, pulls and preconditioner at `x`, and the first direction.
    fn linearise(&mut self, x: &[f32]) -> f64 {
        let (level, data, pulls, smoothness, border) =
            (self.level, self.data, self.pulls, self.smoothness, &self.border);
        let rows = data.misfits(level, x);
        let own = [&mut self.residual[..], &mut self.pull, &mut self.inverse, &mut self.change, &mut self.diagonal];
        let arrays = split(&self.counts, own).zip(self.direction.chunks_mut(level.plane_len()));
        planes(level.plane_len(), arrays, |k, ([residual, pull, inverse, change, diagonal], direction), scratch| {
            hessian::apply_plane(level, border, x, -smoothness, k, scratch);
            data.scatter_plane(level, &rows, k, scratch);
            change.fill(0.0);
            let mut sum = 0.0;
            for (own, (n, m)) in nodes_of(level, k).enumerate() {
                let (weight, target) = pulls.acting(n, x[n]);
                let r = scratch[m] + target - weight * x[n];
                let scale = 1.0 / (diagonal[own] + weight).max(1e-9);
                (residual[own], pull[own], inverse[own]) = (r, weight, scale);
                direction[m] = scale * r;
                sum += f64::from(r * direction[m]);
            }
            sum
        })
    }

    /// applied = A · direction; returns direction · applied.
    fn apply(&mut self) -> f64 {
        let (level, data, smoothness, border) = (self.level, self.data, self.smoothness, &self.border);
        let p = &self.direction;
        let rows = data.rows(level, p);
        let arrays = split(&self.counts, [&mut self.applied[..], &mut self.pull]);
        planes(level.plane_len(), arrays, |k, [applied, pull], scratch| {
            hessian::apply_plane(level, border, p, smoothness, k, scratch);
            data.scatter_plane(level, &rows, k, scratch);
            runs_of(level, k, |run, local, own| {
                let (p, scratch, pull, out) = (&p[run], &scratch[local], &pull[own.clone()], &mut applied[own]);
                for (((out, p), pull), scratch) in out.iter_mut().zip(p).zip(pull).zip(scratch) {
                    *out = scratch + pull * p;
                }
                dot(p, out)
            })
        })
    }

    /// Moves by `alpha` along the direction; returns the new squared preconditioned residual.
    fn step(&mut self, alpha: f32) -> f64 {
        let (level, p) = (self.level, &self.direction);
        let own = [&mut self.change[..], &mut self.residual, &mut self.applied, &mut self.inverse];
        planes(0, split(&self.counts, own), |k, [change, residual, applied, inverse], _| {
            for (r, a) in residual.iter_mut().zip(&*applied) {
                *r -= alpha * a;
            }
            runs_of(level, k, |run, _, own| {
                for (x, p) in change[own].iter_mut().zip(&p[run]) {
                    *x += alpha * p;
                }
                0.0
            });
            dot_weighted(residual, inverse)
        })
    }

    /// direction = inverse · residual + beta · direction.
    fn turn(&mut self, beta: f32) {
        let level = self.level;
        let own = split(&self.counts, [&mut self.residual[..], &mut self.inverse]);
        let arrays = own.zip(self.direction.chunks_mut(level.plane_len()));
        planes(0, arrays, |k, ([residual, inverse], p), _| {
            runs_of(level, k, |_, local, own| {
                for ((p, r), inverse) in p[local].iter_mut().zip(&residual[own.clone()]).zip(&inverse[own]) {
                    *p = inverse * r + beta * *p;
                }
                0.0
            })
        });
    }

    /// x += change.
    fn add_change(&mut self, x: &mut [f32]) {
        let level = self.level;
        let arrays = split(&self.counts, [&mut self.change[..]]).zip(x.chunks_mut(level.plane_len()));
        planes(0, arrays, |k, ([change], x), _| {
            runs_of(level, k, |_, local, own| {
                for (x, change) in x[local].iter_mut().zip(&change[own]) {
                    *x += change;
                }
                0.0
            })
        });
    }
}

/// The parts of arrays over the active nodes that belong to each plane.
fn split<'a, const N: usize>(
    counts: &[usize],
    mut arrays: [&'a mut [f32]; N],
) -> impl Iterator<Item = [&'a mut [f32]; N]> {
    counts.iter().map(move |&count| arrays.each_mut().map(|a| a.split_off_mut(..count).expect("counts fit")))
}

/// Calls `visit(k, what `arrays` has for plane k, room)` in parallel and adds what it returns in order. What a visit leaves in the room, of
/// `room` numbers, the next one finds there.
fn planes<A: Send>(
    room: usize,
    arrays: impl Iterator<Item = A>,
    visit: impl Fn(usize, A, &mut [f32]) -> f64 + Sync,
) -> f64 {
    let arrays: Vec<A> = arrays.collect();
    let sums: Vec<f64> = arrays
        .into_par_iter()
        .enumerate()
        .with_min_len(4)
        .map_init(|| vec![0.0f32; room], |room, (k, arrays)| visit(k, arrays, room))
        .collect();
    sums.iter().sum()
}

/// Calls `visit(run in the grid, run in the plane, run among the plane's active nodes)` for the runs of plane `k` and adds what it returns.
#[inline]
fn runs_of(level: &Level, k: usize, mut visit: impl FnMut(Range<usize>, Range<usize>, Range<usize>) -> f64) -> f64 {
    let offset = k * level.plane_len();
    let (mut sum, mut own) = (0.0, 0);
    for &(start, len) in &level.runs[k] {
        let (start, len) = (start as usize, len as usize);
        sum += visit(start..start + len, start - offset..start + len - offset, own..own + len);
        own += len;
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
