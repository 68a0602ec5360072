use super::accept::confidence;
use super::element::{SymmetryElement, tilted};
use super::estimate::{Hypothesis, Rejection};
use super::score::{Score, Scorer, Tolerances};
use crate::geometry::{Plane, Point, Vector};

/// Share of the samples that may stand out at the top: noise.
const OUTLIERS: f64 = 0.002;
/// First and last step of the tilt, radians, and its most.
const STEPS: [f64; 2] = [0.02, 0.0006];
const MOST_TILT: f64 = 0.08;
/// Share of the most tilt up to which an optimum counts as one.
const INSIDE: f64 = 0.9;
/// Score that a tilt must gain.
const WORTH_TILTING: f64 = 0.01;
/// Cosine from which an axis stands upright.
const UPRIGHT: f64 = 0.98;
/// A plane whose normal is closer to upright than this cosine decides alone where the underside is.
const LEVEL: f64 = 0.9;
/// An object floats or sinks by no more than this, metres: depth noise and the thickness of what is not alike.
const FLOAT: f64 = 0.0025;

/// The plane half way up, almost parallel to the support: an object that is alike above and below and rests on its support reaches
/// exactly as far down as its support.
///
/// A camera that looks down sees next to nothing of such a symmetry (a wrench that lies flat shows its upper side alone), so support
/// is not asked for; contact fixes the offset, the score the tilt, and what is left is whether anything contradicts. `None` without a
/// support plane.
pub(super) fn resting_plane(scorer: &Scorer, axis: Option<&Vector>) -> Option<Hypothesis> {
    let params = scorer.params;
    let support = scorer.evidence.support?;
    let tolerances = Tolerances::fine(params);
    let at = |a: f64, b: f64| -> Option<(Plane, Score)> {
        let plane = touching(scorer, &support, &Plane { normal: tilted(&support.normal, a, b), offset: 0.0 })?;
        Some((plane, scorer.score(&SymmetryElement::Reflection(plane), &tolerances, params.refine_samples)))
    };
    let level = at(0.0, 0.0)?;
    let (mut tilt, mut best) = ([0.0, 0.0], level);
    // What stands upright on its axis is not tilted.
    let upright = axis.is_some_and(|a| a.dot(&support.normal).abs() > UPRIGHT);
    let mut step = if upright { 0.0 } else { STEPS[0] };
    while step > STEPS[1] {
        let mut improved = false;
        for [a, b] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
            let to = [tilt[0] + a * step, tilt[1] + b * step];
            let Some(candidate) = at(to[0], to[1]).filter(|_| to[0].hypot(to[1]) < MOST_TILT) else { continue };
            if candidate.1.value() > best.1.value() + 1e-6 {
                (tilt, best, improved) = (to, candidate, true);
                break;
            }
        }
        if !improved {
            step *= 0.5;
        }
    }
    // An optimum at the end of the range is none: the object is alike above and below about no plane near level.
    let inside = tilt[0].hypot(tilt[1]) < INSIDE * MOST_TILT;
    let (plane, score) = if inside && best.1.value() > level.1.value() + WORTH_TILTING { best } else { level };
    let element = SymmetryElement::Reflection(plane);
    let allowed = params.resting_slack + params.resting_ratio * score.informative;
    let rejection = if score.opposition() > allowed {
        Some(Rejection::Opposed { allowed })
    } else if score.felt_opposition > params.felt_opposition {
        Some(Rejection::Felt { allowed: params.felt_opposition })
    } else {
        impossible(scorer, &plane)
    };
    Some(Hypothesis { element, score, confidence: confidence(&element, &score, params), covariance: None, rejection })
}

/// Why an almost level plane, which decides alone where the underside is, cannot be: the object would float above its support or sink
/// into it, or a vessel would be closed above and open below. `None` for what may be, for planes that are not level, and without a
/// support.
pub(super) fn impossible(scorer: &Scorer, plane: &Plane) -> Option<Rejection> {
    let support = scorer.evidence.support?;
    if plane.normal.dot(&support.normal).abs() < LEVEL {
        return None;
    }
    let touching = touching(scorer, &support, plane)?;
    // Raising the plane by d raises what it makes of the top by 2 d.
    let gap = 2.0 * (plane.offset - touching.offset) * plane.normal.dot(&support.normal);
    if gap.abs() > FLOAT {
        return Some(Rejection::Floats { height: gap });
    }
    let share = scorer.hollowness;
    (share > scorer.params.hollowness).then_some(Rejection::Vessel { share })
}

/// The plane of the same normal at which the reflected samples just touch the support.
fn touching(scorer: &Scorer, support: &Plane, plane: &Plane) -> Option<Plane> {
    let upright = plane.normal.dot(&support.normal);
    let reach = |p: &Point| support.signed_distance(p) - 2.0 * plane.normal.dot(&p.coords) * upright;
    let mut lowest: Vec<f64> = scorer.evidence.samples.iter().map(|s| reach(&s.position)).collect();
    let rank = (OUTLIERS * (lowest.len().checked_sub(1)? as f64)) as usize;
    let lowest = *lowest.select_nth_unstable_by(rank, f64::total_cmp).1;
    Some(Plane { normal: plane.normal, offset: -lowest / (2.0 * upright) })
}
