use super::kriging::{Grid, Kriging, Place};
use super::motion::Copying;
use crate::evidence::{Evidence, Sample};
use rayon::prelude::*;

/// A copy lands beside a measured surface, and not on another one, up to this offset, metres.
const BESIDE: f64 = 6e-3;
/// Farther along the surface than this a measured sample says nothing of a copy, metres.
const TANGENTIAL: f64 = 2.5e-3;
/// Least cosine between the normals of a copy and of what it lands beside: on an edge the miss is no offset.
const AGREEMENT: f64 = 0.85;
/// A sample that maps nearer to itself than this proves nothing, metres.
const ELSEWHERE: f64 = 6e-3;
/// Metres.
const GRID: Grid = Grid {
    sigmas: &[4e-4, 8e-4, 1.6e-3, 3.2e-3],
    lengths: &[15e-3, 30e-3, 60e-3, 120e-3],
    noises: &[2.5e-4, 5e-4, 1e-3],
    usual: 1e-3,
    or_noise: true,
};

/// By how much each family of copies misses what was measured, carried over to where nothing was: an object is seldom exactly symmetric,
/// and a touch on the guessed side says by how much it is not, around the touch too. `None` for a family that misses by noise alone.
///
/// The value at a place of a copy is how far it should move along its normal, metres.
///
/// Only where the copy or what it lands beside was felt: seen samples are beside their copies along the outline alone, where both are worst.
///
/// O(samples · copyings), nothing without touches.
pub(super) fn corrections(evidence: &Evidence, families: &[Vec<&Copying>]) -> Vec<Option<Kriging>> {
    let touched = evidence.samples.iter().any(Sample::is_felt);
    let correction = |members: &Vec<&Copying>| {
        let misses: Vec<_> = members.iter().filter(|_| touched).flat_map(|c| misses(evidence, c)).collect();
        Kriging::fit(&misses, &GRID)
    };
    families.par_iter().map(correction).collect()
}

/// The copies that land beside a measured sample, and by how much along its normal, where one of the two was felt.
fn misses<'a>(evidence: &'a Evidence, copying: &'a Copying) -> impl Iterator<Item = (Place, f64)> + 'a {
    let samples = &evidence.samples;
    samples.iter().filter_map(move |s| {
        let (position, normal) = (copying.motion.point(&s.position), copying.motion.vector(&s.normal));
        if (position - s.position).norm() < ELSEWHERE {
            return None;
        }
        let found = evidence.index.nearest_agreeing(samples, &position, &normal, AGREEMENT)?;
        let there = &samples[found.sample];
        if !(s.is_felt() || there.is_felt()) {
            return None;
        }
        let miss = (there.position - position).dot(&there.normal);
        (found.tangential < TANGENTIAL && miss.abs() < BESIDE).then_some(((position, normal), miss))
    })
}

#[cfg(test)]
mod tests {
    use crate::completion::{OrbitParams, move_evidence};
    use crate::evidence::testing::{Solid, touch, view};
    use crate::evidence::{Evidence, EvidenceParams, Sample};
    use crate::geometry::{Plane, Point, Vector};
    use crate::symmetry::{Hypothesis, Score, Symmetry, SymmetryElement};

    /// The camera looks from +x; the plane is 1 mm before the middle, so that copies of the front lie 2 mm inside the back.
    fn misplaced() -> (Evidence, Symmetry) {
        let center = Point::new(0.0, 0.0, 0.03);
        let solids = [Solid::Box(center, Vector::new(0.025, 0.045, 0.03), 0.0)];
        let (frame, visible) = view(&solids, 0.0);
        let back = touch(&solids, Point::new(-0.2, 0.01, 0.03), Point::new(0.0, 0.01, 0.03));
        let evidence =
            Evidence::gather(&frame, &visible, &[back], &EvidenceParams::default()).expect("the box is seen");
        let plane = Plane::new(Vector::x(), &(center + Vector::x() * 1e-3)).expect("it has a direction");
        let score = Score { support: 0.8, informative: 0.8, ..Score::default() };
        let element = SymmetryElement::Reflection(plane);
        let hypothesis = Hypothesis { element, score, confidence: 1.0, covariance: None, rejection: None };
        (evidence, Symmetry { accepted: vec![hypothesis], rejected: Vec::new() })
    }

    /// Mean distance of the copies of the front, beside the touch, from the back.
    fn miss(correct: bool) -> f64 {
        let (evidence, symmetry) = misplaced();
        let moved = move_evidence(&evidence, &symmetry, &OrbitParams { correct, ..OrbitParams::default() });
        let beside = |s: &&Sample| {
            let away = (s.position - Point::new(-0.025, 0.01, 0.03)).yz().norm();
            s.normal.x < -0.9 && (0.008..0.02).contains(&away)
        };
        let copies: Vec<f64> = moved.kept.iter().filter(beside).map(|s| (s.position.x + 0.025).abs()).collect();
        assert!(copies.len() > 30, "{} copies", copies.len());
        copies.iter().sum::<f64>() / copies.len() as f64
    }

    #[test]
    fn a_touch_corrects_the_guess_around_it() {
        let (without, with) = (miss(false), miss(true));
        assert!(without > 1.5e-3, "the plane is not misplaced: {without}");
        assert!(with < 0.6e-3, "{with} of {without} is left");
    }
}
