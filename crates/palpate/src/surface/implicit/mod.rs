//! One implicit function from weighted oriented samples, free space and a prior of what is outside (method.md §5).
//!
//! E(f) = Σ wᵢ f(pᵢ)² + Σ wᵢ |∇f(pᵢ) − nᵢ|² + μ Σ |Hess f|² + γ Σ_free max(0, t − f)² + Σ ω(x) max(0, 1 − f)²
//!
//! f is a signed distance in cells, negative inside, trilinear on a regular grid. Solved coarse to fine on dense grids of a
//! bounded number of cells, then in a narrow band round the surface at the wanted spacing: time and memory of the fine levels
//! follow the surface. The first two terms, the fourth and the free-space inequality: Calakli & Taubin, *SSD: Smooth Signed
//! Distance Surface Reconstruction*, 2011, §3, extended by the one-sided terms.

mod cloud;
mod components;
mod data;
mod hessian;
mod level;
mod params;
mod prior;
mod shell;
mod solver;
mod thin;
mod update;

pub use cloud::implicit_surface;
pub use params::{ImplicitParams, PriorParams, ShellParams};

use super::isosurface_grid::extract_grid;
use crate::geometry::{Aabb, Point, TriangleMesh, Vector};
use data::DataTerm;
use level::Level;
use rayon::prelude::*;
use solver::{Effort, Pulls};

/// A sample of the surface as the solver takes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightedSample {
    /// Position, metres.
    pub position: Point,
    /// Outward unit normal.
    pub normal: Vector,
    /// How much its position counts: 1 for a measurement, less for a guess.
    pub weight: f64,
    /// How much its normal counts. A guess knows the shape better than the place.
    pub orientation: f64,
}

/// A lower bound of the signed distance at a point, metres, positive in proven free space; ≤ 0 or −∞ where nothing is proven.
pub type FreeBound<'a> = dyn Fn(&Point) -> f64 + Sync + 'a;

/// What the function is fitted to.
pub struct ImplicitProblem<'a> {
    /// Measured samples: weight about 1.
    pub measured: &'a [WeightedSample],
    /// Guessed samples: low weight.
    pub guessed: &'a [WeightedSample],
    /// Box that holds the object; the grid covers it.
    pub bounds: Aabb,
    /// Free space for the dense levels.
    pub free: &'a FreeBound<'a>,
    /// Free space for the narrow band, where cells may be thinner than the carved grid's.
    pub free_fine: &'a FreeBound<'a>,
}

/// The solved function.
pub struct ImplicitField {
    level: Level,
    /// μ that it was solved with: shells have less.
    smoothness: f64,
}

/// Solves for the implicit function.
///
/// Dense levels: O(cells · iterations); band: O(surface / spacing² · iterations) arithmetic, O(box / spacing³) bytes.
pub fn solve_implicit(problem: &ImplicitProblem, params: &ImplicitParams) -> ImplicitField {
    let guessed = params.shell.wall.map(|wall| shell::beside_walls(problem, wall));
    let problem = &ImplicitProblem { guessed: guessed.as_deref().unwrap_or(problem.guessed), ..*problem };
    let is_shell = shell::is_shell(problem, &params.shell);
    let fine = ImplicitParams {
        spacing: params.spacing.min(params.shell.spacing),
        smoothness: params.smoothness.min(params.shell.smoothness),
        ..params.clone()
    };
    let params = if is_shell { &fine } else { params };
    let mut level = solve_dense(problem, params);
    for spacing in band_spacings(&level.surface_box(1.5), level.spacing, params) {
        level = solve_band(&level, spacing, problem, params);
    }
    if let Some(wall) = params.shell.wall {
        shell::clamp(&mut level, problem, wall);
    }
    level.close_border();
    components::clean(&mut level, problem.measured, params.component_share);
    ImplicitField { level, smoothness: params.smoothness }
}

/// Spacing of the finest dense level: the cell budget spread over the box, but not finer than wanted.
fn dense_spacing(bounds: &Aabb, params: &ImplicitParams) -> f64 {
    let mut spacing = (bounds.size().product() / params.dense_cells as f64).cbrt().max(params.spacing);
    while Level::node_count(bounds, spacing) > 1.15 * params.dense_cells as f64 {
        spacing *= 1.03;
    }
    spacing
}

/// Spacings of the narrow-band levels: equal steps of at most a factor two down to the wanted one, as far as memory allows.
fn band_spacings(bounds: &Aabb, from: f64, params: &ImplicitParams) -> Vec<f64> {
    let mut target = params.spacing;
    while Level::node_count(bounds, target) > params.max_nodes as f64 {
        target *= 1.02;
    }
    let steps = (from / target).log2().ceil().max(0.0) as i32;
    if from <= target * 1.02 {
        Vec::new()
    } else {
        (1..=steps).map(|s| from * (target / from).powf(f64::from(s) / f64::from(steps))).collect()
    }
}

fn solve_dense(problem: &ImplicitProblem, params: &ImplicitParams) -> Level {
    let fine = dense_spacing(&problem.bounds, params);
    let (winding_samples, winding_spacing) = winding_cloud(problem, params);
    let winding = prior::Winding::new(&winding_samples, winding_spacing);
    let moved_share = problem.guessed.len() as f64 / problem.measured.len().max(1) as f64;
    let with_hull = moved_share > params.prior.hull_from_share;
    let hull = with_hull.then(|| prior::Hull::new(&winding_samples, params.prior.hull_turn));
    let mut prior_params = params.prior.clone();
    if !with_hull {
        prior_params.winding_threshold = prior_params.winding_threshold_unguessed;
    }
    let mut previous: Option<Level> = None;
    let efforts = [(4.0, 3, 250), (2.0, 3, 80), (1.0, 2, 40)];
    let mut prior_level: Option<(Level, Vec<f32>)> = None;
    for (factor, passes, iterations) in efforts {
        let mut level = Level::covering(&problem.bounds, fine * factor);
        if let Some(coarse) = &previous {
            level.upsample_from(coarse);
        }
        // The winding number is smooth: two coarser levels evaluate it, the finest one interpolates.
        let weights = match &prior_level {
            Some((coarse, weights)) if factor < 2.0 => interpolate(&level, coarse, weights),
            _ => prior::weights(&level, &winding, hull.as_ref(), &prior_params),
        };
        let pulls = Pulls {
            free_weight: params.free_weight as f32,
            free_target: free_targets(&level, problem.free),
            prior_weight: weights.clone(),
        };
        let samples = thin::merged(problem, params.sample_spacing * level.spacing);
        let data = DataTerm::new(&level, &samples);
        let effort = Effort { passes, iterations, tolerance: params.tolerance };
        solver::solve(&mut level, &data, &pulls, params.smoothness as f32, effort);
        prior_level = Some((level.clone(), weights));
        previous = Some(level);
    }
    previous.expect("three levels were solved")
}

/// One narrow-band level: only nodes near the coarser surface or near a sample move, the rest holds the coarser solution.
fn solve_band(coarse: &Level, spacing: f64, problem: &ImplicitProblem, params: &ImplicitParams) -> Level {
    let mut level = Level::covering(&coarse.surface_box(1.5), spacing);
    level.upsample_from(coarse);
    let samples = thin::merged(problem, params.sample_spacing * spacing);
    let reach = (1.5 * coarse.spacing / spacing) as f32;
    let mut mask: Vec<bool> = level.values.par_iter().map(|v| v.abs() < reach).collect();
    for s in &samples {
        mark_round(&level, &s.position, params.band_cells, &mut mask);
    }
    level.activate(&mask);
    drop(mask);
    let effort = Effort { passes: 3, iterations: 50, tolerance: params.tolerance };
    solve_active(&mut level, &samples, problem, params, effort);
    level
}

/// Solves the active nodes with every term but the prior, which is for the coarse grids.
fn solve_active(
    level: &mut Level,
    samples: &[WeightedSample],
    problem: &ImplicitProblem,
    params: &ImplicitParams,
    effort: Effort,
) {
    let pulls = Pulls {
        free_weight: params.free_weight as f32,
        free_target: free_targets(level, problem.free_fine),
        prior_weight: Vec::new(),
    };
    let data = DataTerm::new(level, samples);
    solver::solve(level, &data, &pulls, params.smoothness as f32, effort);
}

fn mark_round(level: &Level, p: &Point, cells: usize, mask: &mut [bool]) {
    let Some((b, _)) = level.locate(p) else { return };
    let range = |a: usize| b[a].saturating_sub(cells - 1)..=(b[a] + cells).min(level.dims[a] - 1);
    for k in range(2) {
        for j in range(1) {
            let row = level.index(0, j, k);
            mask[row + range(0).start()..=row + range(0).end()].fill(true);
        }
    }
}

/// Target of the free-space inequality at the active nodes: t = min(bound / h, 2) where the bound exceeds 0.3 h, else 0.
fn free_targets(level: &Level, bound: &FreeBound) -> Vec<f32> {
    let nx = level.dims[0];
    let plane = level.plane_len();
    let mut out = vec![0.0f32; level.values.len()];
    out.par_chunks_mut(plane).enumerate().for_each(|(k, out)| {
        for &(start, len) in &level.runs[k] {
            for n in start as usize..(start + len) as usize {
                let m = n - k * plane;
                let cells = bound(&level.position(m % nx, m / nx, k)) / level.spacing;
                if cells > 0.3 {
                    out[m] = cells.min(2.0) as f32;
                }
            }
        }
    });
    out
}

/// All samples thinned to a few thousand for the winding number, with their spacing.
fn winding_cloud(problem: &ImplicitProblem, params: &ImplicitParams) -> (Vec<WeightedSample>, f64) {
    let mut spacing = params.prior.winding_sample_spacing;
    loop {
        let samples = thin::merged(problem, spacing);
        if samples.len() <= 4000 {
            return (samples, spacing);
        }
        spacing *= 1.25;
    }
}

fn interpolate(level: &Level, coarse: &Level, weights: &[f32]) -> Vec<f32> {
    let mut carrier = coarse.clone();
    carrier.values = weights.to_vec();
    let [nx, ny, _] = level.dims;
    let mut out = vec![0.0f32; level.values.len()];
    out.par_chunks_mut(level.plane_len()).enumerate().for_each(|(k, out)| {
        for j in 0..ny {
            for i in 0..nx {
                out[j * nx + i] = carrier.sample(&level.position(i, j, k));
            }
        }
    });
    out
}

impl ImplicitField {
    /// Signed distance (approximate), metres, negative inside.
    pub fn signed_distance(&self, p: &Point) -> f64 {
        f64::from(self.level.sample(p)) * self.level.spacing
    }

    /// Spacing of the finest grid, metres.
    pub fn spacing(&self) -> f64 {
        self.level.spacing
    }

    /// The zero surface: closed, two-manifold, oriented outwards by construction (the border of the grid is outside).
    ///
    /// O(nodes) to find the cells that it crosses, then O(surface).
    pub fn extract(&self) -> TriangleMesh {
        let level = &self.level;
        let at = |c: [i32; 3]| level.position(c[0] as usize, c[1] as usize, c[2] as usize);
        extract_grid(&level.values, level.dims, at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(radius: f64, count: usize, keep: impl Fn(&Vector) -> bool) -> Vec<WeightedSample> {
        let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
        (0..count)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / count as f64;
                let (r, a) = ((1.0 - z * z).sqrt(), golden * i as f64);
                Vector::new(r * a.cos(), r * a.sin(), z)
            })
            .filter(keep)
            .map(|n| WeightedSample { position: Point::from(n * radius), normal: n, weight: 1.0, orientation: 1.0 })
            .collect()
    }

    fn cube(half: f64) -> Aabb {
        Aabb { min: Point::new(-half, -half, -half), max: Point::new(half, half, half) }
    }

    fn params() -> ImplicitParams {
        ImplicitParams { spacing: 2e-3, dense_cells: 20_000, ..ImplicitParams::default() }
    }

    #[test]
    fn a_sphere_is_recovered_to_a_small_part_of_a_cell() {
        let measured = sphere(0.04, 4000, |_| true);
        let problem = ImplicitProblem {
            measured: &measured,
            guessed: &[],
            bounds: cube(0.06),
            free: &|_| f64::NEG_INFINITY,
            free_fine: &|_| f64::NEG_INFINITY,
        };
        let field = solve_implicit(&problem, &params());
        for n in sphere(1.0, 200, |_| true) {
            let on = field.signed_distance(&Point::from(n.normal * 0.04));
            let off = field.signed_distance(&Point::from(n.normal * 0.042));
            assert!(on.abs() < 1e-4, "{on}");
            assert!((off - 2e-3).abs() < 4e-4, "{off}");
        }
    }

    #[test]
    fn free_space_bounds_the_side_that_nobody_saw() {
        let measured = sphere(0.04, 4000, |n| n.z > 0.2);
        let below = |p: &Point| -0.02 - p.z;
        let problem =
            ImplicitProblem { measured: &measured, guessed: &[], bounds: cube(0.06), free: &below, free_fine: &below };
        let field = solve_implicit(&problem, &params());
        assert!(field.signed_distance(&Point::origin()) < 0.0);
        let mesh = field.extract();
        assert!(crate::geometry::Topology::of(&mesh).is_closed());
        assert!(mesh.volume() > 0.0);
        assert!(field.signed_distance(&Point::new(0.0, 0.0, -0.025)) > 0.0);
        assert!(field.signed_distance(&Point::new(0.0, 0.0, 0.04)).abs() < 2e-4);
    }
}
