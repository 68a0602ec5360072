use super::accept::judge;
use super::estimate::{Rejection, Symmetry};
use super::params::SymmetryParams;
use super::score::{Scorer, Tolerances};
use crate::evidence::Evidence;

/// The first accepted hypothesis that the evidence, having grown, would not accept any more, and why.
///
/// Only opposition can turn an accepted hypothesis: one that was accepted on other grounds than its own support (the plane half way up, one that was
/// made perpendicular) need not pass the rest of the judgement.
///
/// O(hypotheses · samples).
pub fn contradicted(evidence: &Evidence, symmetry: &Symmetry, params: &SymmetryParams) -> Option<(usize, Rejection)> {
    if symmetry.accepted.is_empty() {
        return None;
    }
    let scorer = Scorer::new(evidence, params);
    let fine = Tolerances::fine(params);
    symmetry.accepted.iter().enumerate().find_map(|(i, h)| {
        let score = scorer.score(&h.element, &fine, params.refine_samples);
        let before = h.score;
        let worse = score.opposition() > before.opposition() || score.felt_opposition > before.felt_opposition;
        let rejection = judge(&scorer, &h.element, &score).filter(|_| worse)?;
        matches!(rejection, Rejection::Opposed { .. } | Rejection::Felt { .. } | Rejection::Misfits { .. })
            .then_some((i, rejection))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::geometry::{Point, Vector};
    use crate::symmetry::{EvidenceSearch, SymmetryElement, SymmetryEstimator};

    #[test]
    fn a_touch_where_the_copy_is_not_turns_the_plane_and_one_on_it_does_not() {
        let middle = Point::new(0.0, 0.0, 0.03);
        let half = Vector::new(0.04, 0.025, 0.03);
        let solids = [Solid::Box(middle, half, 0.4)];
        // What the camera cannot see: the far sides stand out by 8 mm.
        let other = [Solid::Box(middle, half + Vector::new(0.008, 0.008, 0.0), 0.4)];
        let (frame, visible) = view(&solids, 0.0005);
        let params = EvidenceParams::default();
        let search = EvidenceSearch::default();
        let turned = |solids: &[Solid]| {
            let mut evidence = Evidence::gather(&frame, &visible, &[], &params).expect("seen");
            let symmetry = search.estimate(&evidence);
            assert!(symmetry.accepted.iter().any(|h| matches!(h.element, SymmetryElement::Reflection(_))));
            assert!(contradicted(&evidence, &symmetry, &search.params).is_none(), "as it was found");
            let away = (middle - evidence.camera_center).normalize();
            for (i, aside) in [-0.6, -0.2, 0.2, 0.6].into_iter().enumerate() {
                let from =
                    middle + (Vector::new(away.x, away.y, 0.0) + aside * Vector::new(-away.y, away.x, 0.0)) * 0.2;
                let patch = touch(solids, from, middle);
                evidence.add_touch(&patch, i as u32, &nalgebra::Matrix6::zeros(), &params);
            }
            contradicted(&evidence, &symmetry, &search.params)
        };
        assert!(turned(&solids).is_none());
        assert!(matches!(turned(&other), Some((_, Rejection::Felt { .. } | Rejection::Opposed { .. }))));
    }
}
