use super::level::Level;
use super::solver::Effort;
use super::{
    ImplicitField, ImplicitParams, ImplicitProblem, WeightedSample, components, mark_round, shell, solve_active, thin,
};
use crate::geometry::{Aabb, Point};
use rayon::prelude::*;

/// Nodes of the changed part within this many cells of the surface move, and of where it goes.
const REACH: f32 = 4.0;
/// One of the changes within a cube of this edge stands for them, metres.
const APART: f64 = 4e-3;
/// Nodes at the border of a part that hold the old solution: the stencils of the others reach so far.
const RIM: usize = 2;

impl ImplicitField {
    /// Solves again only near changed places, from the solution that is there. Returns the boxes in which the field may differ.
    ///
    /// * `problem` – all samples, old and new
    /// * `changed` – where samples came or went, and how far round that the surface may follow, metres; beyond it the old solution is the boundary
    ///
    /// Changes apart are solved apart, each on its own part of the grid: O(samples) to pick those nearby, then
    /// O(changed surface / spacing² · iterations). Points outside the grid are left out: an object that turns out to be larger than its
    /// box needs [`super::solve_implicit`].
    pub fn update(
        &mut self,
        problem: &ImplicitProblem,
        changed: &[(Point, f64)],
        params: &ImplicitParams,
    ) -> Vec<Aabb> {
        let params = &ImplicitParams { smoothness: self.smoothness, ..params.clone() };
        let near = centers(changed);
        let parts = parts(&self.level, &near);
        let solve = |&part: &Part| solve_part(&self.level, part, problem, &near, params);
        let solved: Vec<Level> = parts.par_iter().map(solve).collect();
        for ((low, _), part) in parts.iter().zip(&solved) {
            self.level.paste(part, *low, RIM);
        }
        solved.iter().map(Level::bounds).collect()
    }

    /// Makes the grid reach at least `margin` (metres) beyond every point; what is added is outside. `false`, and nothing done, if that takes more
    /// than [`ImplicitParams::max_nodes`].
    ///
    /// O(nodes) where it grows.
    pub fn reach<'a>(
        &mut self,
        points: impl IntoIterator<Item = &'a Point>,
        margin: f64,
        params: &ImplicitParams,
    ) -> bool {
        let Some(wanted) = Aabb::of(points).map(|b| b.inflated(margin + 2.0 * self.level.spacing)) else { return true };
        let bounds = self.level.bounds();
        let nodes = |length: f64| (length / self.level.spacing).ceil().max(0.0) as usize;
        let before = [0, 1, 2].map(|a| nodes(bounds.min[a] - wanted.min[a]));
        let after = [0, 1, 2].map(|a| nodes(wanted.max[a] - bounds.max[a]));
        if before == [0; 3] && after == [0; 3] {
            return true;
        }
        let dims = [0, 1, 2].map(|a| self.level.dims[a] + before[a] + after[a]);
        let fits = dims.iter().map(|&d| d as f64).product::<f64>() <= params.max_nodes as f64;
        if fits {
            self.level = self.level.grown(before, after);
        }
        fits
    }
}

/// Lowest node and the node past the highest, on each axis.
type Part = ([usize; 3], [usize; 3]);

/// Disjoint parts of the grid that hold every centre with its radius and the rim; parts that would overlap are one.
fn parts(level: &Level, near: &[(Point, f64)]) -> Vec<Part> {
    let mut parts: Vec<Part> = Vec::new();
    for (p, radius) in near {
        let Some((base, _)) = level.locate(p) else { continue };
        let cells = (radius / level.spacing).ceil() as usize + RIM;
        let mut part = (
            [0, 1, 2].map(|a| base[a].saturating_sub(cells)),
            [0, 1, 2].map(|a| level.dims[a].min(base[a] + cells + 2)),
        );
        // A part grown by another may reach a third.
        while let Some(other) = parts.iter().position(|p| overlap(p, &part)) {
            let (low, high) = parts.remove(other);
            part = ([0, 1, 2].map(|a| low[a].min(part.0[a])), [0, 1, 2].map(|a| high[a].max(part.1[a])));
        }
        parts.push(part);
    }
    parts
}

fn overlap(a: &Part, b: &Part) -> bool {
    (0..3).all(|i| a.0[i] < b.1[i] && b.0[i] < a.1[i])
}

fn solve_part(
    level: &Level,
    (low, high): Part,
    problem: &ImplicitProblem,
    near: &[(Point, f64)],
    params: &ImplicitParams,
) -> Level {
    let mut part = level.crop(low, high);
    let bounds = part.bounds();
    let close = bounds.inflated(2.0 * level.spacing + params.shell.wall.map_or(0.0, shell::reach));
    let pick = |samples: &[WeightedSample]| {
        samples.iter().filter(|s| close.contains(&s.position)).copied().collect::<Vec<_>>()
    };
    let (measured, mut guessed) = (pick(problem.measured), pick(problem.guessed));
    if let Some(wall) = params.shell.wall {
        guessed = shell::beside_walls(&ImplicitProblem { measured: &measured, guessed: &guessed, ..*problem }, wall);
    }
    let local = ImplicitProblem { measured: &measured, guessed: &guessed, ..*problem };
    let samples = thin::merged(&local, params.sample_spacing * part.spacing);
    // Where the surface must go far, the nodes on the way move too.
    let far = near.iter().filter(|(p, _)| bounds.contains(p)).map(|(p, _)| part.sample(p).abs()).fold(0.0, f32::max);
    let mut mask: Vec<bool> = part.values.iter().map(|v| v.abs() < REACH + far).collect();
    for s in &samples {
        mark_round(&part, &s.position, params.band_cells, &mut mask);
    }
    let mut round = vec![false; mask.len()];
    for (p, radius) in near {
        mark_round(&part, p, (radius / part.spacing).ceil() as usize, &mut round);
    }
    mask.iter_mut().zip(&round).for_each(|(m, r)| *m &= r);
    part.activate(&mask);
    let effort = Effort { passes: 2, iterations: 40, tolerance: params.tolerance };
    solve_active(&mut part, &samples, problem, params, effort);
    if let Some(wall) = params.shell.wall {
        shell::clamp(&mut part, &local, wall);
    }
    let weight: f64 = problem.measured.iter().map(|s| s.weight).sum();
    components::clean_part(&mut part, &measured, params.component_share * weight);
    part
}

/// The first change of each cube, with the largest radius there, in order.
fn centers(changed: &[(Point, f64)]) -> Vec<(Point, f64)> {
    let mut keyed: Vec<([i64; 3], usize)> =
        changed.iter().enumerate().map(|(i, (p, _))| ([0, 1, 2].map(|a| (p[a] / APART).floor() as i64), i)).collect();
    keyed.sort_unstable();
    let widest = |cube: &[([i64; 3], usize)]| cube.iter().map(|k| changed[k.1].1).fold(0.0, f64::max);
    keyed.chunk_by(|a, b| a.0 == b.0).map(|cube| (changed[cube[0].1].0, widest(cube))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::solve_implicit;
    use super::*;
    use crate::geometry::Vector;

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
        let changed: Vec<(Point, f64)> = wrong.iter().chain(&touch).map(|s| (s.position, 0.01)).collect();
        let dims = field.level.dims;
        assert!(
            field.reach(changed.iter().map(|c| &c.0), 0.004, &params) && field.level.dims == dims,
            "it does as it is"
        );
        let boxes = field.update(&problem(&after), &changed, &params);
        assert!(boxes.len() == 1 && boxes[0].contains(&top) && !boxes[0].contains(&south), "{boxes:?}");
        let whole = solve_implicit(&problem(&after), &params);
        let (updated, whole) = (field.signed_distance(&top), whole.signed_distance(&top));
        assert!(updated.abs() < 1e-4 && (updated - whole).abs() < 1e-4, "{updated} against {whole}");
        assert_eq!(field.signed_distance(&south), untouched);
    }

    #[test]
    fn a_grid_grows_without_changing_what_it_holds() {
        let params = ImplicitParams { spacing: 2e-3, dense_cells: 20_000, ..ImplicitParams::default() };
        let free = |_: &Point| f64::NEG_INFINITY;
        let bounds = Aabb { min: Point::new(-0.06, -0.06, -0.06), max: Point::new(0.06, 0.06, 0.06) };
        let measured = sphere(0.04, |_| true);
        let problem = ImplicitProblem { measured: &measured, guessed: &[], bounds, free: &free, free_fine: &free };
        let mut field = solve_implicit(&problem, &params);
        let before = field.extract();
        let far = [Point::new(-0.08, 0.0, 0.0), Point::new(0.0, 0.05, 0.07)];
        let holds = |field: &ImplicitField, p: &Point| field.level.bounds().inflated(-0.004).contains(p);
        assert!(!far.iter().any(|p| holds(&field, p)));
        assert!(field.reach(&far, 0.004, &params) && far.iter().all(|p| holds(&field, p)));
        let after = field.extract();
        assert_eq!(after.faces, before.faces);
        assert!(after.vertices.iter().zip(&before.vertices).all(|(a, b)| (a - b).norm() < 1e-12));
        let few = ImplicitParams { max_nodes: 1000, ..params };
        let dims = field.level.dims;
        assert!(!field.reach(&[Point::new(0.2, 0.0, 0.0)], 0.004, &few) && field.level.dims == dims);
    }

    #[test]
    fn changes_apart_are_solved_apart_and_near_ones_together() {
        let level = Level::covering(&Aabb { min: Point::origin(), max: Point::new(0.2, 0.1, 0.1) }, 1e-3);
        let at = |x: f64| (Point::new(x, 0.05, 0.05), 0.01);
        let found = parts(&level, &[at(0.03), at(0.15), at(0.06), at(0.045)]);
        assert_eq!(found.len(), 2, "{found:?}");
        let ([x0, ..], [x1, ..]) = found[1];
        assert!(x0 < 20 && x1 > 70, "the third joins the first and the last: {found:?}");
        assert!(parts(&level, &[at(0.5)]).is_empty(), "outside the grid");
    }

    #[test]
    fn a_part_is_put_back_without_its_rim() {
        let mut level = Level::covering(&Aabb { min: Point::origin(), max: Point::new(9.0, 9.0, 9.0) }, 1.0);
        let mut part = level.crop([1, 2, 3], [8, 9, 10]);
        assert_eq!(part.bounds().min, Point::new(1.0, 2.0, 3.0));
        part.values.fill(-1.0);
        level.paste(&part, [1, 2, 3], RIM);
        assert_eq!(level.values.iter().filter(|v| **v < 0.0).count(), 27);
        assert!(level.values[level.index(3, 4, 5)] < 0.0 && level.values[level.index(2, 4, 5)] > 0.0);
    }
}
