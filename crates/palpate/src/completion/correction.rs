use super::kriging::{Grid, Kriging, Place};
use super::motion::Copying;
use crate::evidence::{Evidence, Sample, cell_and_side};
use crate::geometry::Point;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Farther along the surface than this a measured sample says nothing of a copy, metres.
const TANGENTIAL: f64 = 2.5e-3;
/// A sample that maps nearer to itself than this proves nothing, metres.
const ELSEWHERE: f64 = 6e-3;
/// A copy lands beside a measured surface, and not on another one, up to this offset, metres.
const BESIDE: f64 = 15e-3;
/// Least cosine between the normals of a copy and of what it lands beside.
const AGREEMENT: f64 = 0.5;
/// For corrections: larger misses are no detail of a symmetric shape, metres; and on an edge the miss is no offset.
const CORRECTABLE: f64 = 6e-3;
const CORRECTABLE_AGREEMENT: f64 = 0.85;
/// A miss larger than this once corrected refutes the copies around it, metres.
const REFUTES: f64 = 2.5e-3;
/// How far around, metres, and the side of the cells in which comparisons count once.
const AROUND: f64 = 12e-3;
const CELL: f64 = 3e-3;
/// Metres.
const GRID: Grid = Grid {
    sigmas: &[4e-4, 8e-4, 1.6e-3, 3.2e-3],
    lengths: &[15e-3, 30e-3, 60e-3, 120e-3],
    noises: &[2.5e-4, 5e-4, 1e-3],
    usual: 1e-3,
    across: 1.0,
    facing: 4,
    or_noise: true,
};

/// What touches say of the copies of one family: an object is seldom exactly symmetric, and a touch on the guessed side says by how much it is
/// not, around the touch too.
///
/// Only where the copy or what it lands beside was felt: seen samples are beside their copies along the outline alone, where both are worst.
#[derive(Debug, Clone, Default)]
pub(super) struct Correction {
    /// How far copies should move along their normal, metres; `None` where they miss by noise alone.
    shift: Option<Kriging>,
    /// Where copies were compared, and whether they missed by more than a correction explains; those that did come first.
    compared: Vec<(Point, bool)>,
}

impl Correction {
    fn of(misses: &[Miss]) -> Self {
        let correctable = |m: &&Miss| m.offset.abs() < CORRECTABLE && m.agreement > CORRECTABLE_AGREEMENT;
        let observed: Vec<(Place, f64)> = misses.iter().filter(correctable).map(|m| (m.at, m.offset)).collect();
        let shift = Kriging::fit(&observed, &GRID);
        // Per cell and side: how many comparisons, how many of them too far off, and a place.
        let mut cells: BTreeMap<[i32; 6], (usize, usize, Point)> = BTreeMap::new();
        let left = |m: &Miss| m.offset - shift.as_ref().map_or(0.0, |s| s.mean(&m.at));
        let left: Vec<f64> = misses.par_iter().map(left).collect();
        for (m, left) in misses.iter().zip(left) {
            let cell = cells.entry(cell_and_side(&m.at.0, &m.at.1, CELL)).or_insert((0, 0, m.at.0));
            cell.0 += 1;
            cell.1 += usize::from(left.abs() > REFUTES);
        }
        let mut compared: Vec<(Point, bool)> = cells.values().map(|&(all, off, p)| (p, 2 * off > all)).collect();
        compared.sort_by_key(|c| !c.1);
        Self { shift, compared }
    }

    /// How far a copy at this place should move along its normal, metres.
    pub(super) fn shift(&self, at: &Place) -> f64 {
        self.shift.as_ref().map_or(0.0, |s| s.mean(at))
    }

    /// Whether most of the comparisons around say that the copies there are wrong.
    pub(super) fn refutes(&self, p: &Point) -> bool {
        let is_near = |c: &&(Point, bool)| (c.0 - p).norm_squared() < AROUND * AROUND;
        // The refuted ones come first and are few: most places are decided by them.
        let mut refuted = self.compared.iter().take_while(|c| c.1);
        if refuted.all(|c| !is_near(&c)) {
            return false;
        }
        let near = self.compared.iter().filter(is_near);
        let (all, off) = near.fold((0, 0), |(all, off), c| (all + 1, off + usize::from(c.1)));
        2 * off > all
    }
}

/// The corrections of each family. O(samples · copyings), nothing without touches.
pub(super) fn corrections(evidence: &Evidence, families: &[Vec<&Copying>]) -> Vec<Correction> {
    let touched = evidence.samples.iter().any(Sample::is_felt);
    let correction = |members: &Vec<&Copying>| {
        let members = if touched { &members[..] } else { &[] };
        let misses: Vec<Miss> = members.par_iter().flat_map_iter(|c| misses(evidence, c)).collect();
        Correction::of(&misses)
    };
    families.par_iter().map(correction).collect()
}

/// A copy beside a measured sample.
struct Miss {
    /// Of the copy.
    at: Place,
    /// From the copy to the sample along the mean of their normals, metres. (Along one of them, two places of a ball would miss one another by
    /// d² / 2R, always outwards: the chord is perpendicular to the mean.)
    offset: f64,
    /// Cosine of the normals.
    agreement: f64,
}

/// The copies that land beside a measured sample, where one of the two was felt.
fn misses<'a>(evidence: &'a Evidence, copying: &'a Copying) -> impl Iterator<Item = Miss> + 'a {
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
        let between = (there.normal + normal).try_normalize(1e-9)?;
        let offset = (there.position - position).dot(&between);
        let beside = found.tangential < TANGENTIAL && offset.abs() < BESIDE;
        beside.then_some(Miss { at: (position, normal), offset, agreement: found.agreement })
    })
}

#[cfg(test)]
mod tests {
    use super::{Correction, Miss, misses};
    use crate::completion::motion::copyings;
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
    fn copies_around_one_that_a_touch_refutes_are_refuted_and_others_are_not() {
        // A sheet of comparisons: 8 mm off where x > 0, but for one in the middle of them that fits.
        let misses: Vec<Miss> = (0..400)
            .map(|i| {
                let at = Point::new(f64::from(i % 20) * 3e-3 - 0.03, f64::from(i / 20) * 3e-3 - 0.03, 0.0);
                let fits = at.x < 0.0 || (i % 20 == 15 && i / 20 == 10);
                Miss { at: (at, Vector::z()), offset: if fits { 2e-4 } else { 8e-3 }, agreement: 1.0 }
            })
            .collect();
        let correction = Correction::of(&misses);
        assert!(correction.refutes(&Point::new(0.016, 0.0, 0.001)));
        assert!(!correction.refutes(&Point::new(-0.016, 0.0, 0.001)));
        assert!(!correction.refutes(&Point::new(0.016, 0.0, 0.05)), "nothing was compared there");
        assert!(correction.shift(&(Point::new(0.016, 0.0, 0.0), Vector::z())).abs() < 1e-3, "8 mm is no detail");
    }

    #[test]
    fn a_touch_corrects_the_guess_around_it() {
        let (without, with) = (miss(false), miss(true));
        assert!(without > 1.5e-3, "the plane is not misplaced: {without}");
        assert!(with < 0.6e-3, "{with} of {without} is left");
    }

    #[test]
    fn two_places_of_a_ball_do_not_miss_one_another() {
        let (center, radius) = (Point::new(0.0, 0.0, 0.016), 0.016);
        let solids = [Solid::Sphere(center, radius)];
        let (frame, visible) = view(&solids, 0.0);
        let back = touch(&solids, center - Vector::x() * 0.1, center);
        let evidence =
            Evidence::gather(&frame, &visible, &[back], &EvidenceParams::default()).expect("the ball is seen");
        let score = Score { support: 0.8, informative: 0.8, ..Score::default() };
        let element = SymmetryElement::Reflection(Plane::new(Vector::x(), &center).expect("it has a direction"));
        let hypothesis = Hypothesis { element, score, confidence: 1.0, covariance: None, rejection: None };
        let symmetry = Symmetry { accepted: vec![hypothesis], rejected: Vec::new() };
        let copyings = copyings(&symmetry, radius, 8e-3);
        let offsets: Vec<f64> = misses(&evidence, &copyings[0]).map(|m| m.offset).collect();
        let mean = offsets.iter().sum::<f64>() / offsets.len() as f64;
        // Along the normal of one of the two it is 0.057 mm, outwards.
        assert!(offsets.len() > 30 && mean.abs() < 3e-5, "{} misses, {mean} m in the mean", offsets.len());
    }
}
