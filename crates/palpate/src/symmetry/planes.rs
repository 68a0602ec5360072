use super::element::SymmetryElement;
use super::refine::refine_near;
use super::score::{Score, Scorer, Tolerances};
use crate::geometry::{Plane, Point, Vector};
use rayon::prelude::*;

/// Planes closer than this are one candidate: cosine of the normals, and offset at the evidence's centroid, metres.
const SAME_COSINE: f64 = 0.96;
const SAME_OFFSET: f64 = 0.012;
/// A candidate whose score falls below this, on any number of blocks of votes, is given up.
const FLOOR: f64 = -0.12;

/// A plane is upright whose normal has a smaller cosine with "up" than this.
const UPRIGHT: f64 = 0.85;
/// How far a plane across the best one may be from perpendicular to it, radians: what the best one itself may be off.
const TURN: f64 = 0.07;

/// The best distinct planes of a search over directions and offsets, best first.
pub(super) fn search_planes(scorer: &Scorer) -> Vec<Plane> {
    let params = scorer.params;
    let tolerances = Tolerances::coarse(params);
    let normals = directions(&scorer.evidence.up(), params.directions, params.horizontal_directions);
    let mut scored: Vec<(f64, Plane)> = normals
        .par_iter()
        .flat_map_iter(|normal| {
            let (low, high) = extent(scorer, normal);
            let margin = 0.15 * (high - low);
            let step = (high - low + 2.0 * margin) / params.offsets as f64;
            (0..params.offsets).filter_map(move |k| {
                let offset = low - margin + (k as f64 + 0.5) * step;
                let plane = Plane::new(*normal, &Point::from(normal * offset))?;
                let element = SymmetryElement::Reflection(plane);
                let score = scorer.score_unless_bad(&element, &tolerances, params.search_samples, FLOOR)?;
                (score.informative > 0.02).then(|| (score.value(), plane))
            })
        })
        .collect();
    // Stable: equal scores keep the order of the search.
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let planes: Vec<Plane> = scored.into_iter().map(|s| s.1).collect();
    distinct(&planes, &scorer.centroid, params.plane_candidates, SAME_COSINE, SAME_OFFSET)
}

/// The best offset of a plane with a given normal; `None` if none lands anywhere.
pub(super) fn search_offsets(scorer: &Scorer, normal: &Vector) -> Option<Plane> {
    let params = scorer.params;
    let tolerances = Tolerances::coarse(params);
    let (low, high) = extent(scorer, normal);
    let count = 4 * params.offsets;
    let at = |k: usize| low + (high - low) * (k as f64 + 0.5) / count as f64;
    let mut best: Option<(f64, Plane)> = None;
    for plane in (0..count).filter_map(|k| Plane::new(*normal, &Point::from(normal * at(k)))) {
        let element = SymmetryElement::Reflection(plane);
        let value = scorer.score(&element, &tolerances, params.search_samples).value();
        if best.as_ref().is_none_or(|b| value > b.0) {
            best = Some((value, plane));
        }
    }
    best.filter(|b| b.0 > 0.0).map(|b| b.1)
}

/// Upright planes about perpendicular to the best found one, refined with the fine tolerances alone: what stands and has one upright plane of
/// symmetry often has the other.
///
/// The search may miss it. The side that faces the camera gives such a plane little support, so that a wrong one up to 15° beside it may score
/// higher; of the two the search keeps that, and refinement with wide tolerances goes there.
pub(super) fn across_best(scorer: &Scorer, found: &[(Plane, Score)]) -> Vec<(Plane, Score)> {
    let up = scorer.evidence.up();
    let best = found.first().map(|(plane, _)| plane.normal.into_inner());
    let Some(along) = best.filter(|n| n.dot(&up).abs() < UPRIGHT) else { return Vec::new() };
    let across = up.cross(&along).normalize();
    let near = |turn: f64| {
        let plane = search_offsets(scorer, &(across * turn.cos() + up.cross(&across) * turn.sin()))?;
        match refine_near(scorer, &SymmetryElement::Reflection(plane)) {
            (SymmetryElement::Reflection(plane), score) => Some((plane, score)),
            _ => None,
        }
    };
    [-TURN, 0.0, TURN].into_par_iter().filter_map(near).collect()
}

/// The first `count` planes that differ from all before them.
pub(super) fn distinct(planes: &[Plane], at: &Point, count: usize, cosine: f64, offset: f64) -> Vec<Plane> {
    let mut kept: Vec<Plane> = Vec::new();
    for plane in planes {
        if kept.len() == count {
            break;
        }
        if kept.iter().all(|k| !same(k, plane, at, cosine, offset)) {
            kept.push(*plane);
        }
    }
    kept
}

/// Whether two planes coincide to the given cosine and offset at a point.
pub(super) fn same(a: &Plane, b: &Plane, at: &Point, cosine: f64, offset: f64) -> bool {
    let dot = a.normal.dot(&b.normal);
    dot.abs() > cosine && (a.signed_distance(at) - dot.signum() * b.signed_distance(at)).abs() < offset
}

fn extent(scorer: &Scorer, normal: &Vector) -> (f64, f64) {
    scorer.votes.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| {
        let d = normal.dot(&s.position.coords);
        (low.min(d), high.max(d))
    })
}

/// `up`, `horizontal` normals round the horizon and `count` over the half-sphere round `up` (Fibonacci lattice).
fn directions(up: &Vector, count: usize, horizontal: usize) -> Vec<Vector> {
    let (u, v) = super::element::tangents(up);
    let at = |angle: f64, z: f64| up * z + (u * angle.cos() + v * angle.sin()) * (1.0 - z * z).max(0.0).sqrt();
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let lattice = (0..count).map(|k| at(golden * k as f64, (k as f64 + 0.5) / count as f64));
    let horizon = (0..horizontal).map(|k| at(std::f64::consts::PI * k as f64 / horizontal as f64, 0.0));
    std::iter::once(*up).chain(horizon).chain(lattice).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::testing::{Solid, view};
    use crate::evidence::{Evidence, EvidenceParams};
    use crate::symmetry::SymmetryParams;

    #[test]
    fn directions_cover_the_half_sphere() {
        let all = directions(&Vector::new(0.6, 0.0, 0.8), 200, 60);
        assert_eq!(all.len(), 261);
        assert!(all.iter().all(|d| (d.norm() - 1.0).abs() < 1e-12));
        for k in 0..50 {
            let t = f64::from(k);
            let query = Vector::new(t.sin(), (1.7 * t).cos(), (2.3 * t).sin()).normalize();
            let best = all.iter().map(|d| d.dot(&query).abs()).fold(0.0, f64::max);
            assert!(best > 12.0_f64.to_radians().cos(), "{query} is {} from the nearest", best.acos().to_degrees());
        }
    }

    #[test]
    fn across_a_plane_that_is_three_degrees_off_the_other_is_found() {
        let (center, yaw) = (Point::new(0.01, -0.005, 0.04), 0.4_f64);
        let solid = Solid::Box(center, Vector::new(0.05, 0.02, 0.04), yaw);
        let (frame, visible) = view(&[solid], 0.0);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the box is seen");
        let params = SymmetryParams::default();
        let scorer = Scorer::new(&evidence, &params);
        let (off, side) = (yaw + 3_f64.to_radians(), Vector::new(-yaw.sin(), yaw.cos(), 0.0));
        let best = Plane::new(Vector::new(off.cos(), off.sin(), 0.0), &center).expect("a direction");
        let found = across_best(&scorer, &[(best, Score::default())]);
        let (plane, _) = found.iter().max_by(|a, b| a.1.value().total_cmp(&b.1.value())).expect("a plane across");
        let angle = plane.normal.dot(&side).abs().min(1.0).acos().to_degrees();
        // What sticks out of the silhouette by less than the violation tolerance is not seen to.
        let miss = plane.signed_distance(&center).abs();
        assert!(angle < 0.6 && miss < params.violation_tolerance, "{angle}°, {miss} m");
        assert!(
            across_best(&scorer, &[(Plane::new(Vector::z(), &center).expect("a direction"), found[0].1)]).is_empty()
        );
    }

    #[test]
    fn a_flipped_plane_is_the_same() {
        let p = Plane::new(Vector::x(), &Point::new(0.1, 0.0, 0.0)).expect("a direction");
        let near = Plane::new(-Vector::x(), &Point::new(0.104, 0.0, 0.0)).expect("a direction");
        let far = Plane::new(Vector::x(), &Point::new(0.12, 0.0, 0.0)).expect("a direction");
        assert_eq!(distinct(&[p, near, far], &Point::origin(), 5, 0.96, 0.012), vec![p, far]);
    }
}
