use super::copies::{OVERLAP, copy_of, corrected};
use super::correction::Correction;
use super::inscribed::inscribed_balls;
use super::known_sides::{CELL, FLAT, KnownSides, THICKEST, similar};
use super::motion::Copying;
use super::orbit::{Covered, MovedEvidence, OrbitParams, in_free_space, leaves_orbit};
use super::thickness::Thickness;
use crate::evidence::{Evidence, Provenance, Sample, firsts, thinned};
use crate::geometry::Point;
use rayon::prelude::*;

/// Guesses that the process knows less of than this are not made: share of its variance left.
const DOUBT: f64 = 0.6;
/// No guess is made in the heart of a thick part: within this share of the radius of a ball inscribed there.
const HEART: f64 = 0.7;

/// The far sides of thin parts: where a part's two sides are known, it is about as thick as that nearby.
///
/// A wing, a wall or a blade of which the camera sees one side shows its thickness where a touch knows the other side, or one of the two, and
/// all along the occluding contour ([`inscribed_balls`]): there the far side begins. The logarithm of the thickness is carried along the
/// surface, from where it is known to where only one side is; the guess there is that side, moved into the body by the thickness and turned
/// about. Whether the part is thin at all is carried along in the same way, as 1 or 0 (indicator kriging: Journel, *Nonparametric estimation
/// of spatial distributions*, 1983): parts thicker than 20 mm keep a wing's thickness
/// from the fuselage, and the lip of a can from its side; free space close behind a place shows that it is thin.
/// The accepted symmetries copy the guesses as they copy what was measured.
///
/// Returns guesses and their weights: `params.weight`, less what the process does not know; of copies, that of the symmetry, less the mean of it.
/// O(samples · (log samples + cells²) + guesses · copyings · log samples), at most 150 cells.
pub(super) fn far_sides(evidence: &Evidence, moved: &MovedEvidence, params: &OrbitParams) -> (Vec<Sample>, Vec<f64>) {
    let free = |p: &Point| evidence.free_space.signed_distance(p);
    let known = KnownSides::new(thinned(evidence.samples.iter().chain(&moved.kept), CELL), free);
    let balls = inscribed_balls(&evidence.contour, &known.samples, free);
    let Some(thickness) = Thickness::learn(&known, &balls) else { return Default::default() };
    let covered = Covered::new(&known.samples, params);
    let vacant = |far: &Sample| free(&far.position) <= 0.0 && !covered.holds(&far.position, &far.normal);
    let guess = |i: usize| {
        let near = known.samples[i];
        if known.sides[i].is_some() || matches!(near.provenance, Provenance::Moved { .. }) {
            return None;
        }
        let (depth, doubt) = thickness.at(&(near.position, near.normal))?;
        let position = near.position - near.normal * depth;
        let far = Sample { position, normal: -near.normal, sigma: near.sigma.hypot(2e-3), ..near };
        let in_thick = || balls.iter().any(|b| b.diameter > THICKEST && b.holds(&position, HEART));
        let fits = doubt <= DOUBT && known.is_flat(&near, depth) && !known.is_otherwise(&near, depth);
        (fits && vacant(&far) && !in_thick()).then_some(Guess { near, far, depth, sure: 1.0 - doubt })
    };
    let guesses: Vec<Option<Guess>> = (0..known.samples.len()).into_par_iter().map(guess).collect();
    let made = || guesses.iter().flatten();
    let mut out: Vec<(Sample, f64)> = made().map(|g| (g.far, params.weight * g.sure)).collect();
    let sure = made().map(|g| g.sure).sum::<f64>() / out.len().max(1) as f64;
    for (family, correction) in moved.corrections.iter().enumerate() {
        let members: Vec<(u32, &Copying)> =
            (0..).zip(&moved.copyings).filter(|c| c.1.family as usize == family).collect();
        let weight = members.first().map_or(0.0, |(_, first)| params.weight_of(first)) * sure;
        let copies = copies(evidence, &known, &guesses, &members, correction, params, vacant);
        out.extend(copies.into_iter().map(|far| (far, weight)));
    }
    out.into_iter().unzip()
}

/// A guessed far side, or a copy of one.
#[derive(Clone, Copy)]
struct Guess {
    /// The sample whose far side it is.
    near: Sample,
    far: Sample,
    /// How far apart they are, metres.
    depth: f64,
    /// What the process knows there, 0–1.
    sure: f64,
}

/// Copies by one family of the guesses that are part of what it moves onto itself, one a cell: those that `vacant` and all that is known allow.
///
/// * `guesses` – of each known sample
fn copies(
    evidence: &Evidence,
    known: &KnownSides,
    guesses: &[Option<Guess>],
    members: &[(u32, &Copying)],
    correction: &Correction,
    params: &OrbitParams,
    vacant: impl Fn(&Sample) -> bool + Sync,
) -> Vec<Sample> {
    let copyings: Vec<&Copying> = members.iter().map(|m| m.1).collect();
    let leaves = |s: &Sample| leaves_orbit(evidence, &copyings, &s.position, params);
    let belongs = |g: &&Guess| !leaves(&g.near) && !leaves(&g.far) && agrees(known, g, &copyings, guesses);
    let copied: Vec<&Guess> = guesses.par_iter().flatten().filter(belongs).collect();
    let copy = |g: &Guess, (m, copying): &(u32, &Copying)| Guess {
        near: copy_of(&g.near, copying, *m),
        far: copy_of(&g.far, copying, *m),
        ..*g
    };
    let copy = &copy;
    let copies: Vec<Guess> = members.par_iter().flat_map_iter(|m| copied.iter().map(move |g| copy(g, m))).collect();
    // An axis lays the copies over one another: first thinned, then asked.
    let copies = firsts(copies.iter(), OVERLAP, |g| (g.far.position, g.far.normal));
    let stays = |g: &Guess| {
        if correction.refutes(&g.near.position) || in_free_space(evidence, &g.near.position, params) {
            return None;
        }
        let [near, far] = [g.near, g.far].map(|s| corrected(s, correction));
        (vacant(&far) && !known.is_otherwise(&near, g.depth)).then_some(far)
    };
    copies.par_iter().filter_map(stays).collect()
}

/// Whether parts are known to be as thick as a guess says where the copyings put it on a measured surface: at half of these places, at least. The
/// lip of a can is thin at one place and nothing of the kind at the others that it is turned to.
///
/// * `guesses` – of each sample
fn agrees(known: &KnownSides, g: &Guess, copyings: &[&Copying], guesses: &[Option<Guess>]) -> bool {
    let agrees_at = |copying: &&Copying| {
        let (p, n) = (copying.motion.point(&g.near.position), copying.motion.vector(&g.near.normal));
        let (i, distance) = known.tree.nearest_n(&p, 1).into_iter().next()?;
        let s = &known.samples[i];
        if distance > CELL || s.normal.dot(&n) < FLAT || matches!(s.provenance, Provenance::Moved { .. }) {
            return None;
        }
        let guessed = guesses[i].as_ref().is_some_and(|other| similar(other.depth, g.depth));
        Some(guessed || known.sides[i].is_some_and(|side| similar(side.depth, g.depth)))
    };
    let met: Vec<bool> = copyings.iter().filter_map(agrees_at).collect();
    2 * met.iter().filter(|agrees| **agrees).count() >= met.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::completion::move_evidence;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::evidence::{EvidenceParams, SampleIndex};
    use crate::geometry::{Plane, Vector};
    use crate::symmetry::{Hypothesis, Score, Symmetry, SymmetryElement};

    /// Guesses for a board whose middle is 40 mm above the support, seen from above and felt from below at the origin.
    fn guesses(half: Vector) -> Vec<Sample> {
        let solids = [Solid::Box(Point::new(0.0, 0.0, 0.04), half, 0.3)];
        let (frame, visible) = view(&solids, 0.0);
        let below = [Vector::zeros(), Vector::new(0.012, 0.0, 0.0)]
            .map(|v| touch(&solids, Point::from(v), Point::new(0.0, 0.0, 0.04) + v));
        let evidence =
            Evidence::gather(&frame, &visible, &below, &EvidenceParams::default()).expect("the board is seen");
        far_sides(&evidence, &MovedEvidence::default(), &OrbitParams::default()).0
    }

    #[test]
    fn a_board_is_as_thick_beside_a_touch_as_at_it() {
        let thickness = 0.008;
        let guesses = guesses(Vector::new(0.05, 0.04, 0.5 * thickness));
        let below: Vec<&Sample> = guesses.iter().filter(|s| s.normal.z < -0.9).collect();
        assert!(below.len() > 20, "{} guesses of the underside", below.len());
        // At the touches themselves exactly; towards the edges the contour has its say, and takes the wall beside a sharp edge for rounder.
        let off = |s: &Sample| (s.position.z - (0.04 - 0.5 * thickness)).abs();
        let worst = |within: f64| {
            let inner =
                below.iter().filter(|s| (s.position.coords.xy() - nalgebra::Vector2::new(0.006, 0.0)).norm() < within);
            inner.map(|s| off(s)).fold(0.0, f64::max)
        };
        assert!(
            worst(0.02) < 1e-3 && worst(1.0) < 2e-3,
            "{} off beside the touches, {} anywhere",
            worst(0.02),
            worst(1.0)
        );
        let reach = below.iter().map(|s| s.position.coords.xy().norm()).fold(0.0, f64::max);
        assert!(reach > 0.012, "no guess beyond the touches: {reach}");
    }

    #[test]
    fn a_fin_says_little_of_the_block_below_it() {
        let fin = Solid::Box(Point::new(0.0, 0.0, 0.075), Vector::new(0.05, 0.002, 0.015), 0.0);
        let block = Solid::Box(Point::new(0.0, 0.0, 0.03), Vector::new(0.05, 0.02, 0.03), 0.0);
        let solids = [fin, block];
        let (frame, visible) = crate::evidence::testing::view_from(&solids, 0.0, -1.5, 0.5);
        // Behind the fin near its foot, and behind the block.
        let places = [-0.036, -0.024, -0.012, 0.0, 0.012, 0.024, 0.036].map(|x| [(x, 0.066), (x, 0.084), (x, 0.025)]);
        let behind: Vec<_> = places
            .concat()
            .iter()
            .map(|&(x, z)| touch(&solids, Point::new(x, 0.2, z), Point::new(x, 0.0, z)))
            .collect();
        let evidence =
            Evidence::gather(&frame, &visible, &behind, &EvidenceParams::default()).expect("block and fin are seen");
        let guesses = far_sides(&evidence, &MovedEvidence::default(), &OrbitParams::default()).0;
        let at_fin = guesses.iter().filter(|s| s.position.z > 0.07).count();
        let within = |s: &&Sample| s.position.z < 0.056 && s.position.y.abs() < 0.018;
        assert!(at_fin > 20, "{at_fin} guesses behind the fin");
        // Close to the fin's foot a few are left; 21 without the question whether parts are thin.
        let inside = guesses.iter().filter(within).count();
        assert!(inside < 9, "{inside} guesses inside the block");
    }

    #[test]
    fn the_contour_alone_shows_how_thick_a_board_is() {
        let (half, middle) = (Vector::new(0.05, 0.04, 0.005), 0.04);
        let (frame, visible) = view(&[Solid::Box(Point::new(0.0, 0.0, middle), half, 0.3)], 0.0003);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the board is seen");
        let guesses = far_sides(&evidence, &MovedEvidence::default(), &OrbitParams::default()).0;
        let below: Vec<&Sample> = guesses.iter().filter(|s| s.normal.z < -0.9).collect();
        assert!(below.len() > 100, "{} guesses of the underside", below.len());
        let worst = below.iter().map(|s| (s.position.z - (middle - half.z)).abs()).fold(0.0, f64::max);
        assert!(worst < 3e-3, "a guess is {worst} off");
    }

    #[test]
    fn what_is_thin_at_one_place_of_a_ring_is_not_copied_round_it() {
        let axis = SymmetryElement::Axis { point: Point::origin(), direction: Vector::z_axis(), order: None };
        let turns: Vec<Copying> =
            axis.motions(30).into_iter().map(|motion| Copying { motion, score: 1.0, family: 0 }).collect();
        let turns: Vec<&Copying> = turns.iter().collect();
        // Half a ring was seen, turned outward.
        let sample = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / 30.0).sin_cos();
            let normal = Vector::new(cos, sin, 0.0);
            Sample { position: Point::from(normal * 0.05), normal, sigma: 1e-3, provenance: Provenance::Seen }
        };
        let known = KnownSides::new((0..16).map(sample).collect(), |_| -1.0);
        let guess = |k: usize, depth: f64| {
            let near = sample(k);
            let far = Sample { position: near.position - near.normal * depth, normal: -near.normal, ..near };
            Guess { near, far, depth, sure: 1.0 }
        };
        let at = |thin: std::ops::Range<usize>| (0..16).map(|k| thin.contains(&k).then(|| guess(k, 2e-3))).collect();
        let (everywhere, lip): (Vec<_>, Vec<_>) = (at(0..16), at(3..6));
        assert!(agrees(&known, &guess(4, 2e-3), &turns, &everywhere));
        assert!(!agrees(&known, &guess(4, 2e-3), &turns, &lip));
        assert!(!agrees(&known, &guess(4, 8e-3), &turns, &everywhere), "of another thickness");
    }

    /// A board 8 mm thick, its underside 36 mm above the support, of which the camera saw the half where x > 0.
    fn half_a_board() -> (Evidence, [Solid; 1]) {
        let solids = [Solid::Box(Point::new(0.0, 0.0, 0.04), Vector::new(0.05, 0.04, 0.004), 0.0)];
        let (frame, visible) = view(&solids, 0.0003);
        let mut evidence =
            Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the board is seen");
        evidence.samples.retain(|s| s.position.x > 0.0);
        evidence.contour.retain(|c| c.position.x > 0.0);
        evidence.index = SampleIndex::new(&evidence.samples, 2e-3, 12e-3);
        (evidence, solids)
    }

    fn halves_alike() -> Symmetry {
        let plane = Plane::new(Vector::x(), &Point::origin()).expect("it has a direction");
        let score = Score { support: 1.0, informative: 0.5, ..Score::default() };
        let element = SymmetryElement::Reflection(plane);
        Symmetry {
            accepted: vec![Hypothesis { element, score, confidence: 1.0, covariance: None, rejection: None }],
            rejected: Vec::new(),
        }
    }

    #[test]
    fn symmetries_copy_the_guesses() {
        let (evidence, _) = half_a_board();
        let underside = |symmetry: &Symmetry| -> Vec<Sample> {
            let moved = move_evidence(&evidence, symmetry, &OrbitParams::default());
            assert_eq!(moved.far_sides.len(), moved.far_weights.len());
            moved.far_sides.into_iter().filter(|s| s.normal.z < -0.9 && s.position.x < 0.0).collect()
        };
        assert!(underside(&Symmetry::default()).is_empty(), "nothing is known of that half");
        let copies = underside(&halves_alike());
        assert!(copies.len() > 50, "{} copies", copies.len());
        let off = |s: &Sample| (s.position.z - 0.036).abs();
        assert!(copies.iter().all(|s| off(s) < 3e-3), "{} off", copies.iter().map(off).fold(0.0, f64::max));
    }

    #[test]
    fn a_touch_takes_the_place_of_the_guesses_there() {
        let (mut evidence, solids) = half_a_board();
        let (params, orbit) = (EvidenceParams::default(), OrbitParams::default());
        let mut moved = move_evidence(&evidence, &halves_alike(), &orbit);
        let beside = |m: &MovedEvidence, x: f64| {
            let near = |s: &&Sample| s.normal.z < -0.9 && (s.position - Point::new(x, 0.0, 0.036)).norm() < 4e-3;
            m.far_sides.iter().filter(near).count()
        };
        let before = [0.025, -0.025].map(|x| beside(&moved, x));
        assert!(before[0] > 2 && before[1] > 2, "{before:?} guesses");
        let below = touch(&solids, Point::new(-0.025, 0.0, 0.0), Point::new(-0.025, 0.0, 0.04));
        let [from, _] = evidence.add_touch(&below, 0, &nalgebra::Matrix6::zeros(), &params);
        let change = moved.follow(&evidence, from, &orbit);
        assert!(change.dropped.iter().filter(|s| s.normal.z < -0.9).count() >= before[1], "{:?}", change.dropped.len());
        assert_eq!(beside(&moved, -0.025), 0, "a guess is left where the touch was");
        assert_eq!(beside(&moved, 0.025), before[0], "the other half was not touched");
        assert_eq!(moved.far_sides.len(), moved.far_weights.len());
    }

    #[test]
    fn a_block_has_no_thin_part() {
        assert!(guesses(Vector::new(0.05, 0.04, 0.03)).is_empty());
    }
}
