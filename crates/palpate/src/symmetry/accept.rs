use super::element::{Motion, SymmetryElement};
use super::estimate::{Hypothesis, Rejection};
use super::params::SymmetryParams;
use super::planes::same;
use super::score::{Score, Scorer, Tolerances};
use crate::geometry::{Plane, Vector};

/// Two refined planes closer than this are one: cosine of the normals and offset at the centroid, metres.
const SAME_COSINE: f64 = 0.995;
const SAME_OFFSET: f64 = 0.004;

/// Whether the evidence accepts an element with this score; else why not.
///
/// Support only excludes "nothing lands anywhere"; what tells right from wrong is the opposition, which a right element hardly has.
pub(super) fn judge(element: &SymmetryElement, score: &Score, params: &SymmetryParams) -> Option<Rejection> {
    let (least, ratio) = match element {
        SymmetryElement::Reflection(_) => (params.plane_support, params.plane_ratio),
        _ => (params.axis_support, params.axis_ratio),
    };
    if score.informative <= least {
        return Some(Rejection::LittleSupport { needed: least });
    }
    let allowed = ratio * score.informative + params.slack;
    (score.opposition() >= allowed).then_some(Rejection::Opposed { allowed })
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
/// dropped if it is clearly more opposed, or if the rotation that the two imply is opposed. Planes through an accepted axis are spared:
/// a body of revolution is symmetric in all of them. (A box with a nearly square base has a diagonal plane that is almost right.)
pub(super) fn resolve_conflicts(
    scorer: &Scorer,
    mut planes: Vec<Hypothesis>,
    axis: Option<&Vector>,
) -> Vec<Hypothesis> {
    let opposition = |h: &Hypothesis| h.score.opposition() / h.score.informative.max(1e-9);
    planes.sort_by(|a, b| opposition(a).total_cmp(&opposition(b)));
    let mut kept: Vec<usize> = Vec::new();
    for i in 0..planes.len() {
        if planes[i].rejection.is_some() {
            continue;
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

fn conflict(scorer: &Scorer, new: &Hypothesis, old: &Hypothesis, axis: Option<&Vector>) -> Option<Rejection> {
    let (SymmetryElement::Reflection(p), SymmetryElement::Reflection(q)) = (&new.element, &old.element) else {
        return None;
    };
    if same(p, q, &scorer.centroid, SAME_COSINE, SAME_OFFSET) {
        return Some(Rejection::Redundant);
    }
    let cosine = p.normal.dot(&q.normal).abs();
    let contains = |plane: &Plane| axis.is_some_and(|a| plane.normal.dot(a).abs() < 0.2);
    if !(0.17..0.97).contains(&cosine) || (contains(p) && contains(q)) {
        return None;
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
