use super::element::{Motion, SymmetryElement, tangents};
use super::estimate::{Hypothesis, Rejection, hypothesis};
use super::params::SymmetryParams;
use super::planes::same;
use super::refine::refine_perpendicular;
use super::resting::impossible;
use super::score::{Body, Score, Scorer, Tolerances};
use crate::geometry::{Plane, Vector};

/// Two refined planes closer than this are one: cosine of the normals and offset at the centroid, metres.
const SAME_COSINE: f64 = 0.995;
const SAME_OFFSET: f64 = 0.004;
/// Planes count as perpendicular below this cosine and as parallel above that one.
const PERPENDICULAR: f64 = 0.17;
const PARALLEL: f64 = 0.97;
/// Cosine of normal and axis up to which a plane holds the axis, from which it cuts the axis at a right angle (2°), and from which it may if
/// squaring costs it its acceptance (5°: what an axis may be off).
const HOLDS: f64 = 0.2;
const SQUARE: f64 = 0.9994;
const ALMOST_SQUARE: f64 = 0.9962;
/// Contradiction per informative support from which touches may reject an axis.
const BESIDE: f64 = 0.1;
/// Opposition per informative support up to which an axis gives way to no plane.
const EXACT: f64 = 0.02;
/// Share of the samples that may be a handle which opposes the axis, and the opposition that the rest may have per informative support.
const HANDLE: f64 = 0.3;
const BODY_RATIO: f64 = 0.1;
/// Score by which a found plane must beat the one half way up.
const CLEARLY: f64 = 0.1;

/// Whether the evidence accepts an element with this score; else why not.
///
/// Support only excludes "nothing lands anywhere"; what tells right from wrong is the opposition, which a right element hardly has.
pub(super) fn judge(scorer: &Scorer, element: &SymmetryElement, score: &Score) -> Option<Rejection> {
    let params = scorer.params;
    let (least, ratio) = match element {
        SymmetryElement::Reflection(_) => (params.plane_support, params.plane_ratio),
        _ => (params.axis_support, params.axis_ratio),
    };
    if score.informative <= least {
        return Some(Rejection::LittleSupport { needed: least });
    }
    let allowed = ratio * score.informative + params.slack;
    let opposed = (score.opposition() >= allowed).then_some(Rejection::Opposed { allowed });
    match element {
        SymmetryElement::Reflection(_) | SymmetryElement::Sphere { .. } if opposed.is_some() => opposed,
        SymmetryElement::Reflection(plane) => {
            let allowed = params.felt_opposition;
            if score.felt_opposition > allowed {
                return Some(Rejection::Felt { allowed });
            }
            impossible(scorer, plane)
        }
        SymmetryElement::Axis { point, direction, .. } => {
            let body = scorer.body(point, direction);
            if opposed.is_some() && !is_handle_alone(scorer, &body) {
                return opposed;
            }
            // A touched handle violates an axis that is right; only beside the surface, not beyond it, a touch speaks of another shape.
            let allowed = params.axis_felt_opposition;
            if score.felt_opposition > allowed && score.contradiction > BESIDE * score.informative {
                return Some(Rejection::Felt { allowed });
            }
            let share = body.misfits;
            (share > params.misfits).then_some(Rejection::Misfits { share })
        }
        SymmetryElement::Sphere { .. } => {
            let allowed = params.sphere_opposition;
            (score.opposition() > allowed).then_some(Rejection::Opposed { allowed })
        }
    }
}

/// Whether an axis is opposed by a small part alone, while the rest is a body of revolution beyond doubt: a pitcher with its handle.
fn is_handle_alone(scorer: &Scorer, body: &Body) -> bool {
    if body.misfits >= HANDLE {
        return false;
    }
    let params = scorer.params;
    let score = scorer.score_body(body, &Tolerances::fine(params));
    score.informative > params.axis_support && score.opposition() < BODY_RATIO * score.informative + params.slack
}

/// 0–1: how much support there is, less what opposition takes of what is allowed.
pub(super) fn confidence(element: &SymmetryElement, score: &Score, params: &SymmetryParams) -> f64 {
    let ratio = if matches!(element, SymmetryElement::Reflection(_)) { params.plane_ratio } else { params.axis_ratio };
    let opposed = score.opposition() / (ratio * score.informative + params.slack);
    ((score.informative / 0.4).min(1.0) * (1.0 - 0.5 * opposed)).clamp(0.0, 1.0)
}

/// Keeps the planes that agree with one another, the least opposed first.
///
/// An object that is exact in one plane is exact in its others, so a plane that is neither parallel nor perpendicular to a kept one is
/// dropped if it is clearly more opposed, or if the rotation that the two imply is opposed. Of two almost parallel planes only one can be
/// right. Of the planes through an accepted axis, which implies them all, one is kept, and planes oblique to it go. (A box with a nearly square base
/// has a diagonal plane that is almost right.) A plane almost perpendicular to kept ones is made so if that costs it no score: the
/// plane that faces the camera has little support of its own.
///
/// * `resting` – the plane half way up, if there is a support
pub(super) fn resolve_conflicts(
    scorer: &Scorer,
    mut planes: Vec<Hypothesis>,
    mut resting: Option<Hypothesis>,
    axis: Option<&Vector>,
) -> Vec<Hypothesis> {
    if let Some(resting) = &mut resting {
        settle_resting(&mut planes, resting);
    }
    planes.extend(resting);
    let opposition = |h: &Hypothesis| h.score.opposition() / h.score.informative.max(1e-9);
    planes.sort_by(|a, b| opposition(a).total_cmp(&opposition(b)));
    let mut kept: Vec<usize> = Vec::new();
    for i in 0..planes.len() {
        if planes[i].rejection.is_some() {
            continue;
        }
        if axis.is_none() {
            let fixed: Vec<Plane> = kept.iter().filter_map(|&k| plane_of(&planes[k])).collect();
            if let Some(h) = squared(scorer, &planes[i], &fixed) {
                planes[i] = h;
            }
        }
        if let Some(axis) = axis
            && let Some(aligned) = aligned(scorer, &planes[i], axis)
        {
            planes[i] = aligned;
            if planes[i].rejection.is_some() {
                continue;
            }
        }
        let conflict = kept.iter().copied().find_map(|k| conflict(scorer, &planes[i], &planes[k], axis));
        match conflict {
            Some(rejection) => planes[i].rejection = Some(rejection),
            None if kept.len() == scorer.params.planes => planes[i].rejection = Some(Rejection::Redundant),
            None => kept.push(i),
        }
    }
    planes
}

/// Of the plane half way up and the found planes almost parallel to it only one can be right: contact with the support decides for the
/// former, unless a found one scores clearly better.
fn settle_resting(found: &mut [Hypothesis], resting: &mut Hypothesis) {
    let Some(plane) = plane_of(resting).filter(|_| resting.rejection.is_none()) else { return };
    for h in found {
        let parallel = plane_of(h).is_some_and(|p| p.normal.dot(&plane.normal).abs() > PARALLEL);
        if !parallel || h.rejection.is_some() {
            continue;
        }
        if h.score.value() > resting.score.value() + CLEARLY {
            resting.rejection = Some(Rejection::Redundant);
            return;
        }
        h.rejection = Some(Rejection::Redundant);
    }
}

/// Rejects an axis that a better plane is oblique to: one with more support, and less than a third of the opposition for it.
///
/// Nearly round things have axes that are almost right, and planes that are.
pub(super) fn give_way(axis: &mut Hypothesis, planes: &[Hypothesis]) {
    let SymmetryElement::Axis { direction, .. } = &axis.element else { return };
    let ratio = |h: &Hypothesis| h.score.opposition() / h.score.informative.max(1e-9);
    if axis.rejection.is_some() || ratio(axis) < EXACT {
        return;
    }
    let better = |p: &&Hypothesis| p.score.informative > axis.score.informative && 3.0 * ratio(p) < ratio(axis);
    let oblique = |p: &Plane| (HOLDS..PARALLEL).contains(&p.normal.dot(direction).abs());
    let accepted = planes.iter().filter(|p| p.rejection.is_none());
    let with = accepted.filter(better).filter_map(plane_of).find(oblique);
    axis.rejection = with.map(|with| Rejection::Conflict { with });
}

/// A plane neither holds an axis of revolution nor cuts it at a right angle, but for errors: with both, the object would be a ball. One
/// that almost cuts it at a right angle is made to, if the evidence accepts that; what stays oblique is rejected. `None`: it is right as it is.
///
/// Copies by an oblique plane, turned about the axis, would smear over twice the angle.
fn aligned(scorer: &Scorer, h: &Hypothesis, axis: &Vector) -> Option<Hypothesis> {
    let plane = plane_of(h)?;
    let cosine = plane.normal.dot(axis).abs();
    if !(HOLDS..SQUARE).contains(&cosine) {
        return None;
    }
    if cosine > PARALLEL {
        let (u, v) = tangents(axis);
        let squared = refine_perpendicular(scorer, &plane, &u, Some(&v)).map(|(e, score)| hypothesis(scorer, e, score));
        if let Some(squared) = squared.filter(|s| s.rejection.is_none()) {
            return Some(squared);
        }
        if cosine > ALMOST_SQUARE {
            return None;
        }
    }
    Some(Hypothesis { rejection: Some(Rejection::AgainstAxis), ..h.clone() })
}

fn plane_of(h: &Hypothesis) -> Option<Plane> {
    if let SymmetryElement::Reflection(plane) = h.element { Some(plane) } else { None }
}

/// The hypothesis made exactly perpendicular to the nearly perpendicular ones of `fixed`, if it keeps its score and its acceptance.
fn squared(scorer: &Scorer, h: &Hypothesis, fixed: &[Plane]) -> Option<Hypothesis> {
    let plane = plane_of(h)?;
    let normals: Vec<Vector> =
        fixed.iter().map(|f| f.normal.into_inner()).filter(|n| n.dot(&plane.normal).abs() < PERPENDICULAR).collect();
    let first = *normals.first()?;
    let (element, score) = refine_perpendicular(scorer, &plane, &first, normals.get(1))?;
    let squared = hypothesis(scorer, element, score);
    let kept = score.value() > 0.95 * h.score.value() - 0.005;
    (kept && squared.rejection.is_none()).then_some(squared)
}

fn conflict(scorer: &Scorer, new: &Hypothesis, old: &Hypothesis, axis: Option<&Vector>) -> Option<Rejection> {
    let (SymmetryElement::Reflection(p), SymmetryElement::Reflection(q)) = (&new.element, &old.element) else {
        return None;
    };
    if same(p, q, &scorer.centroid, SAME_COSINE, SAME_OFFSET) {
        return Some(Rejection::Redundant);
    }
    let cosine = p.normal.dot(&q.normal).abs();
    let contains = |plane: &Plane| axis.is_some_and(|a| plane.normal.dot(a).abs() < HOLDS);
    if contains(p) && contains(q) {
        // The axis implies them all; one is kept for what the body of revolution leaves out, a handle.
        return Some(Rejection::Redundant);
    }
    if cosine < PERPENDICULAR {
        return None;
    }
    if cosine > PARALLEL {
        return Some(Rejection::Redundant);
    }
    if new.score.opposition() > 3.0 * old.score.opposition() + 0.015 {
        return Some(Rejection::Conflict { with: *q });
    }
    let (a, b) = (Motion::reflection(p), Motion::reflection(q));
    let tolerances = Tolerances::fine(scorer.params);
    let scores = [a.then(&b), b.then(&a)].map(|m| scorer.score_motion(&m, &tolerances, scorer.params.refine_samples));
    let mean = |f: fn(&Score) -> f64| 0.5 * (f(&scores[0]) + f(&scores[1]));
    let implied = mean(Score::opposition) > 0.25 * mean(|s| s.informative) + 0.02;
    implied.then_some(Rejection::Conflict { with: *q })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::testing::{Solid, view};
    use crate::evidence::{Evidence, EvidenceParams};
    use crate::geometry::Point;

    #[test]
    fn without_a_support_no_found_plane_is_taken_for_the_one_half_way_up() {
        let center = Point::new(0.0, 0.0, 0.03);
        let (frame, mut visible) = view(&[Solid::Box(center, Vector::new(0.045, 0.025, 0.03), 0.0)], 0.0);
        visible.support = None;
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the box is seen");
        let params = SymmetryParams::default();
        let scorer = Scorer::new(&evidence, &params);
        let accepted = |tilt: f64| {
            let plane = Plane::new(Vector::new(tilt.cos(), tilt.sin(), 0.0), &center).expect("a direction");
            let element = SymmetryElement::Reflection(plane);
            let score = scorer.score(&element, &Tolerances::fine(&params), params.refine_samples);
            Hypothesis { element, score, confidence: 1.0, covariance: None, rejection: None }
        };
        // The right plane, and after it the same one turned by one degree.
        let found = resolve_conflicts(&scorer, vec![accepted(0.0), accepted(0.02)], None, None);
        let kept: Vec<Plane> = found.iter().filter(|h| h.rejection.is_none()).filter_map(plane_of).collect();
        assert!(kept.len() == 1 && kept[0].normal.x.abs() > 0.99999, "{kept:?}");
    }

    #[test]
    fn a_plane_almost_across_the_axis_is_squared_to_it() {
        let center = Point::new(0.0, 0.0, 0.04);
        let (frame, visible) = view(&[Solid::Cylinder(center, 0.03, 0.04)], 0.0);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the can is seen");
        let params = SymmetryParams::default();
        let scorer = Scorer::new(&evidence, &params);
        let tilt = 8.0_f64.to_radians();
        let plane = Plane::new(Vector::new(tilt.sin(), 0.0, tilt.cos()), &center).expect("a direction");
        let element = SymmetryElement::Reflection(plane);
        let tilted =
            Hypothesis { element, score: Score::default(), confidence: 1.0, covariance: None, rejection: None };
        let found = resolve_conflicts(&scorer, vec![tilted], None, Some(&Vector::z()));
        let plane = plane_of(&found[0]).expect("it stays a plane");
        assert!(found[0].rejection.is_none() && plane.normal.z.abs() > 0.99999, "{found:?}");
        assert!(plane.signed_distance(&center).abs() < 2e-3, "{plane:?}");
    }

    #[test]
    fn an_axis_gives_way_to_a_better_plane_that_is_oblique_to_it() {
        let made = |element, informative, violation| Hypothesis {
            element,
            score: Score { informative, violation, ..Score::default() },
            confidence: 1.0,
            covariance: None,
            rejection: None,
        };
        let axis = SymmetryElement::Axis { point: Point::origin(), direction: Vector::z_axis(), order: None };
        let plane = |n: Vector, informative, violation| {
            let plane = Plane::new(n, &Point::origin()).expect("a direction");
            made(SymmetryElement::Reflection(plane), informative, violation)
        };
        let gives_way = |plane: Hypothesis, violation| {
            let mut axis = made(axis, 0.5, violation);
            give_way(&mut axis, &[plane]);
            axis.rejection.is_some()
        };
        let oblique = Vector::new(1.0, 0.0, 1.0);
        assert!(gives_way(plane(oblique, 0.6, 0.01), 0.05));
        assert!(!gives_way(plane(oblique, 0.4, 0.0), 0.05), "less support");
        assert!(!gives_way(plane(oblique, 0.6, 0.03), 0.05), "opposed itself");
        assert!(!gives_way(plane(oblique, 0.6, 0.0), 0.005), "the axis is as good as exact");
        assert!(!gives_way(plane(Vector::x(), 0.6, 0.0), 0.05) && !gives_way(plane(Vector::z(), 0.6, 0.0), 0.05));
    }
}
