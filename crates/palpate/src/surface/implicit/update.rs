use super::data::DataTerm;
use super::level::Level;
use super::solver::{self, Effort, Pulls};
use super::{
    ImplicitField, ImplicitParams, ImplicitProblem, WeightedSample, components, free_targets, mark_round, thin,
};
use crate::geometry::{Aabb, Point, Vector};

/// Nodes of the changed part within this many cells of the surface move.
const REACH: f32 = 4.0;

impl ImplicitField {
    /// Solves again only near changed places, from the solution that is there.
    ///
    /// * `problem` – all samples, old and new
    /// * `changed` – where samples came or went, metres
    /// * `radius` – how far round a change the surface may follow, metres; beyond it the old solution is the boundary
    ///
    /// O(samples) to pick those nearby, then O(changed surface / spacing² · iterations). Points outside the grid are left out: an object
    /// that turns out to be larger than its box needs [`super::solve_implicit`].
    pub fn update(&mut self, problem: &ImplicitProblem, changed: &[Point], radius: f64, params: &ImplicitParams) {
        let level = &mut self.level;
        let spacing = level.spacing;
        let near = centers(changed, 0.5 * radius);
        let mut round = vec![false; level.values.len()];
        let cells = (radius / spacing).ceil() as usize;
        for p in &near {
            mark_round(level, p, cells, &mut round);
        }
        let close = |s: &&WeightedSample| near.iter().any(|p| (s.position - p).amax() < radius + 2.0 * spacing);
        let pick = |samples: &[WeightedSample]| samples.iter().filter(close).copied().collect::<Vec<_>>();
        let (measured, guessed) = (pick(problem.measured), pick(problem.guessed));
        let local = ImplicitProblem { measured: &measured, guessed: &guessed, ..*problem };
        let samples = thin::merged(&local, params.sample_spacing * spacing);
        let mut mask: Vec<bool> = level.values.iter().map(|v| v.abs() < REACH).collect();
        for s in &samples {
            mark_round(level, &s.position, params.band_cells, &mut mask);
        }
        mask.iter_mut().zip(&round).for_each(|(m, r)| *m &= r);
        level.activate(&mask);
        let pulls = Pulls {
            free_weight: params.free_weight as f32,
            free_target: free_targets(level, problem.free_fine),
            prior_weight: Vec::new(),
        };
        let data = DataTerm::new(level, &samples);
        let effort = Effort { passes: 2, iterations: 40, tolerance: params.tolerance };
        solver::solve(level, &data, &pulls, params.smoothness as f32, effort);
        level.close_border();
        let anchors: Vec<Point> = problem.measured.iter().map(|s| s.position).collect();
        components::clean(level, &anchors, params.component_share);
    }

    /// Whether the grid reaches at least `margin` (metres) beyond every point.
    pub fn covers<'a>(&self, points: impl IntoIterator<Item = &'a Point>, margin: f64) -> bool {
        let inner = inner_box(&self.level, margin);
        points.into_iter().all(|p| inner.contains(p))
    }
}

fn inner_box(level: &Level, margin: f64) -> Aabb {
    let [nx, ny, nz] = level.dims;
    let room = Vector::repeat(margin + 2.0 * level.spacing);
    Aabb { min: level.origin + room, max: level.position(nx - 1, ny - 1, nz - 1) - room }
}

/// The first point of each cube of the given edge, in order.
fn centers(points: &[Point], edge: f64) -> Vec<Point> {
    let mut keyed: Vec<([i64; 3], usize)> =
        points.iter().enumerate().map(|(i, p)| ([0, 1, 2].map(|a| (p[a] / edge).floor() as i64), i)).collect();
    keyed.sort_unstable();
    keyed.dedup_by_key(|k| k.0);
    keyed.into_iter().map(|(_, i)| points[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::super::solve_implicit;
    use super::*;

    fn sphere(radius: f64, keep: impl Fn(&Vector) -> bool) -> Vec<WeightedSample> {
        let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
        let normal = |i: usize| {
            let z = 1.0 - (2 * i + 1) as f64 / 6000.0;
            let (r, a) = ((1.0 - z * z).sqrt(), golden * i as f64);
            Vector::new(r * a.cos(), r * a.sin(), z)
        };
        (0..6000)
            .map(normal)
            .filter(keep)
            .map(|n| WeightedSample { position: Point::from(n * radius), normal: n, weight: 1.0, orientation: 1.0 })
            .collect()
    }

    #[test]
    fn an_update_agrees_with_a_solution_from_the_start_and_leaves_the_rest() {
        let params = ImplicitParams { spacing: 2e-3, dense_cells: 20_000, ..ImplicitParams::default() };
        let free = |_: &Point| f64::NEG_INFINITY;
        let bounds = Aabb { min: Point::new(-0.06, -0.06, -0.06), max: Point::new(0.06, 0.06, 0.06) };
        let problem = |measured| ImplicitProblem { measured, guessed: &[], bounds, free: &free, free_fine: &free };
        // The cap round +z is a guess that is 2 mm too far out until a touch tells.
        let body = sphere(0.04, |n| n.z < 0.8);
        let wrong: Vec<_> =
            sphere(0.042, |n| n.z > 0.9).into_iter().map(|s| WeightedSample { weight: 0.05, ..s }).collect();
        let touch = sphere(0.04, |n| n.z > 0.9);
        let before: Vec<_> = body.iter().chain(&wrong).copied().collect();
        let after: Vec<_> = body.iter().chain(&touch).copied().collect();
        let mut field = solve_implicit(&problem(&before), &params);
        let top = Point::new(0.0, 0.0, 0.04);
        let south = Point::new(0.0, 0.0, -0.0405);
        let (untouched, moved) = (field.signed_distance(&south), field.signed_distance(&top));
        assert!(moved < -1e-3, "the guess is believed: {moved}");
        let changed: Vec<Point> = wrong.iter().chain(&touch).map(|s| s.position).collect();
        assert!(field.covers(&changed, 0.004) && !field.covers(&[Point::new(0.1, 0.0, 0.0)], 0.0));
        field.update(&problem(&after), &changed, 0.01, &params);
        let whole = solve_implicit(&problem(&after), &params);
        let (updated, whole) = (field.signed_distance(&top), whole.signed_distance(&top));
        assert!(updated.abs() < 1e-4 && (updated - whole).abs() < 1e-4, "{updated} against {whole}");
        assert_eq!(field.signed_distance(&south), untouched);
    }
}
