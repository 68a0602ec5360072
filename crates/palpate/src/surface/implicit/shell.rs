use super::{ImplicitProblem, ShellParams, WeightedSample, level::Level, thin};
use crate::geometry::{KdTree, Point};
use rayon::prelude::*;

/// Spacing of the samples that are paired, metres.
const PAIR_SPACING: f64 = 2e-3;
/// A partner faces away (cosine), lies at most this far behind, and at most this far aside, metres.
const OPPOSED: f64 = -0.6;
const DEEPEST: f64 = 8e-3;
const ASIDE: f64 = 2e-3;
/// How far a guess of the other side may be from where the stated wall ends, metres.
const SLACK: f64 = 2e-3;
/// Farther aside than this from the nearest sample, the distance itself is the depth, metres.
const TANGENTIAL: f64 = 4e-3;
/// A wall thinner than this many cells would tear between the nodes.
const LEAST_CELLS: f64 = 1.35;

/// Whether the object is a shell: the user says so, or both sides of much of the surface are measured or guessed, close together.
///
/// Boxes and tools have next to no pairs; a bowl pairs half to four fifths of its samples, 1 mm apart.
pub(super) fn is_shell(problem: &ImplicitProblem, params: &ShellParams) -> bool {
    if params.wall.is_some() {
        return true;
    }
    let samples = thin::merged(problem, PAIR_SPACING);
    let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
    let tree = KdTree::new(&points);
    let mut gaps: Vec<f64> = samples.par_iter().filter_map(|s| gap(s, &samples, &tree)).collect();
    if gaps.is_empty() || (gaps.len() as f64) < params.pairs * samples.len() as f64 {
        return false;
    }
    let middle = gaps.len() / 2;
    *gaps.select_nth_unstable_by(middle, f64::total_cmp).1 < params.thickest
}

/// Distance to the nearest sample behind that faces the other way.
fn gap(s: &WeightedSample, samples: &[WeightedSample], tree: &KdTree) -> Option<f64> {
    let near = tree.within(&s.position, DEEPEST.hypot(ASIDE));
    let behind = near.into_iter().filter_map(|(i, _)| {
        let q = &samples[i];
        let d = s.position - q.position;
        let depth = d.dot(&s.normal);
        let aside = (d - s.normal * depth).norm_squared();
        (q.normal.dot(&s.normal) < OPPOSED && depth > 0.0 && depth <= DEEPEST && aside <= ASIDE * ASIDE)
            .then_some(depth)
    });
    behind.min_by(f64::total_cmp)
}

/// How far behind a measured sample guesses are looked at, metres.
pub(super) fn reach(wall: f64) -> f64 {
    (wall + SLACK).hypot(ASIDE)
}

/// The guesses that a stated wall does not know better: those with no measured surface on the other side of it.
///
/// Copies of felt patches are off by what the symmetry is off; a millimetre suffices to lay them through the measured side of a thin wall.
pub(super) fn beside_walls(problem: &ImplicitProblem, wall: f64) -> Vec<WeightedSample> {
    let measured = thin::merged(&ImplicitProblem { guessed: &[], ..*problem }, PAIR_SPACING);
    let points: Vec<Point> = measured.iter().map(|s| s.position).collect();
    let tree = KdTree::new(&points);
    let known = |s: &&WeightedSample| {
        let near = tree.within(&s.position, reach(wall));
        near.into_iter().any(|(i, _)| {
            let q = &measured[i];
            let d = q.position - s.position;
            let depth = d.dot(&q.normal);
            let aside = (d - q.normal * depth).norm_squared();
            q.normal.dot(&s.normal) < OPPOSED && depth > -SLACK && depth < wall + SLACK && aside <= ASIDE * ASIDE
        })
    };
    problem.guessed.par_iter().filter(|s| !known(s)).copied().collect()
}

/// Makes what lies deeper than the wall behind the nearest sample outside.
///
/// Free space leaves a wedge of unknown space below the rim of a plate that lies on a table; if the object is known to be a shell, the
/// far side of the wall is where the wall ends, not where proof of emptiness begins. Only for a wall that the user states: a mug whose
/// thick foot nobody sees would be hollowed out. Departs from the energy: a rule, not a term.
pub(super) fn clamp(level: &mut Level, problem: &ImplicitProblem, wall: f64) {
    let samples = thin::merged(problem, level.spacing);
    let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
    if points.is_empty() {
        return;
    }
    let tree = KdTree::new(&points);
    let wall = wall.max(LEAST_CELLS * level.spacing);
    let (nx, plane, origin, spacing) = (level.dims[0], level.plane_len(), level.origin, level.spacing);
    level.values.par_chunks_mut(plane).enumerate().for_each(|(k, values)| {
        for (m, value) in values.iter_mut().enumerate() {
            if *value > 0.2 {
                continue;
            }
            let at = nalgebra::Vector3::new((m % nx) as f64, (m / nx) as f64, k as f64) * spacing;
            let p = origin + at;
            let Some(&(i, distance)) = tree.nearest_n(&p, 1).first() else { continue };
            let depth = -samples[i].normal.dot(&(p - samples[i].position));
            let aside = (distance * distance - depth * depth).max(0.0).sqrt();
            let depth = if aside < TANGENTIAL { depth } else { distance };
            *value = value.max(((depth - wall) / spacing) as f32);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::super::{ImplicitParams, solve_implicit};
    use super::*;
    use crate::geometry::{Aabb, Topology, Vector};

    /// A square of 60 mm at the given height, facing up or down.
    fn square(z: f64, up: f64) -> impl Iterator<Item = WeightedSample> {
        let at = |i: usize| (i as f64 - 30.0) * 1e-3;
        (0..61 * 61).map(move |k| WeightedSample {
            position: Point::new(at(k % 61), at(k / 61), z),
            normal: Vector::new(0.0, 0.0, up),
            weight: 1.0,
            orientation: 1.0,
        })
    }

    fn problem<'a>(measured: &'a [WeightedSample], free: &'a super::super::FreeBound<'a>) -> ImplicitProblem<'a> {
        let bounds = Aabb { min: Point::new(-0.05, -0.05, -0.03), max: Point::new(0.05, 0.05, 0.03) };
        ImplicitProblem { measured, guessed: &[], bounds, free, free_fine: free }
    }

    #[test]
    fn two_close_sides_make_a_shell_and_two_far_ones_do_not() {
        let free = |_: &Point| f64::NEG_INFINITY;
        let sheet = |thickness: f64| square(0.0, 1.0).chain(square(-thickness, -1.0)).collect::<Vec<_>>();
        let params = ShellParams::default();
        assert!(is_shell(&problem(&sheet(1e-3), &free), &params));
        assert!(!is_shell(&problem(&sheet(4e-3), &free), &params));
        assert!(!is_shell(&problem(&square(0.0, 1.0).collect::<Vec<_>>(), &free), &params));
    }

    #[test]
    fn a_stated_wall_makes_a_plate_of_one_seen_side() {
        let seen: Vec<_> = square(0.0, 1.0).collect();
        // The table is 20 mm below; beside the plate everything is free.
        let free = |p: &Point| p.x.abs().max(p.y.abs()) - 0.0305;
        let below = |p: &Point| free(p).max(-0.02 - p.z);
        let volume = |wall: Option<f64>| {
            let shell = ShellParams { wall, ..ShellParams::default() };
            let params = ImplicitParams { dense_cells: 30_000, shell, ..ImplicitParams::default() };
            let mesh = solve_implicit(&problem(&seen, &below), &params).extract();
            assert!(Topology::of(&mesh).is_closed());
            mesh.volume()
        };
        let (block, plate) = (volume(None), volume(Some(3e-3)));
        assert!(block > 0.06 * 0.06 * 0.012, "{block}");
        assert!((plate / (0.06 * 0.06 * 3e-3) - 1.0).abs() < 0.15, "{plate}");
    }

    #[test]
    fn a_stated_wall_outweighs_guesses_that_cross_the_measured_side() {
        let seen: Vec<_> = square(0.0, 1.0).collect();
        // The other side as a symmetry that is a millimetre and a half off would copy it: tilted, from in front of the seen side to behind it.
        let tilted = |s: WeightedSample| WeightedSample {
            position: s.position + Vector::new(0.0, 0.0, 0.05 * s.position.x),
            weight: 0.5,
            orientation: 0.5,
            ..s
        };
        let guessed: Vec<_> = square(0.0, -1.0).map(tilted).collect();
        let free = |p: &Point| p.x.abs().max(p.y.abs()) - 0.0305;
        let below = |p: &Point| free(p).max(-0.02 - p.z);
        let problem = ImplicitProblem { guessed: &guessed, ..problem(&seen, &below) };
        let shell = ShellParams { wall: Some(3e-3), ..ShellParams::default() };
        let params = ImplicitParams { dense_cells: 30_000, shell, ..ImplicitParams::default() };
        let mesh = solve_implicit(&problem, &params).extract();
        let volume = mesh.volume();
        assert!((volume / (0.06 * 0.06 * 3e-3) - 1.0).abs() < 0.15, "{volume}");
    }
}
