use super::kriging::{Grid, Kriging, Place};
use super::orbit::{Covered, MovedEvidence, OrbitParams};
use crate::evidence::{Evidence, Provenance, Sample, thinned};
use crate::geometry::{KdTree, Point};
use rayon::prelude::*;

/// The thinnest and thickest part whose far side is guessed, metres.
const THINNEST: f64 = 8e-4;
const THICKEST: f64 = 20e-3;
/// The far side faces away: greatest cosine between the two normals.
const AWAY: f64 = -0.7;
/// A sample this near to the line through another, straight into the body, is on that line, metres.
const WIDTH: f64 = 2.5e-3;
/// Side of the cells that samples are thinned to, metres.
const CELL: f64 = 3e-3;
/// Fewer known thicknesses than this prove no thin part.
const LEAST: usize = 12;
/// Guesses that the process knows less of than this are not made: share of its variance left.
const DOUBT: f64 = 0.6;
/// In the logarithm of the thickness.
const GRID: Grid = Grid {
    sigmas: &[0.15, 0.3, 0.6, 1.2],
    lengths: &[20e-3, 40e-3, 80e-3],
    noises: &[0.08, 0.16, 0.3],
    usual: 0.5,
    or_noise: false,
};
/// Of being thin (1) or thick (0).
const THIN_GRID: Grid = Grid {
    sigmas: &[0.5, 1.0],
    lengths: &[20e-3, 40e-3, 80e-3],
    noises: &[0.1, 0.2, 0.4],
    usual: 1.0,
    or_noise: false,
};
/// Guesses are made where parts are rather thin than thick.
const THIN: f64 = 0.5;

/// The far sides of thin parts: where a part's two sides are known, it is about as thick as that nearby.
///
/// A wing, a wall or a blade of which the camera sees one side shows its thickness where a touch knows the other side, or one of the two.
/// The logarithm of the thickness is carried along the surface, from where it is known to where only one side is; the guess there is that
/// side, moved into the body by the thickness and turned about. Whether the part is thin at all is carried along in the same way, as 1 or 0
/// (indicator kriging: Journel, *Nonparametric estimation of spatial distributions*, 1983): parts thicker than 20 mm keep a wing's thickness
/// from the fuselage, and the lip of a can from its side.
///
/// Returns guesses and their weights: `params.weight`, less what the process does not know. O(samples · log samples), nothing
/// without touches.
pub(super) fn far_sides(evidence: &Evidence, moved: &MovedEvidence, params: &OrbitParams) -> (Vec<Sample>, Vec<f64>) {
    if !evidence.samples.iter().any(Sample::is_felt) {
        return Default::default();
    }
    let all: Vec<Sample> = thinned(evidence.samples.iter().chain(&moved.kept), CELL);
    let points: Vec<Point> = all.iter().map(|s| s.position).collect();
    let tree = KdTree::new(&points);
    let depths: Vec<Option<Side>> = all.par_iter().map(|s| far_side(s, &all, &tree)).collect();
    let felt = depths.iter().flatten().filter(|side| side.felt);
    let mut known: Vec<f64> = felt.map(|side| side.depth).filter(|depth| *depth <= THICKEST).collect();
    if known.len() < LEAST {
        return Default::default();
    }
    let middle = known.len() / 2;
    let usual = known.select_nth_unstable_by(middle, f64::total_cmp).1.ln();
    let felt: Vec<(Place, f64)> = all
        .iter()
        .zip(&depths)
        .filter_map(|(s, side)| Some(((s.position, s.normal), side.filter(|side| side.felt)?.depth)))
        .collect();
    let is_thin: Vec<(Place, f64)> = felt.iter().map(|(at, d)| (*at, f64::from(*d <= THICKEST))).collect();
    let observed: Vec<(Place, f64)> =
        felt.iter().filter(|(_, d)| *d <= THICKEST).map(|(at, d)| (*at, d.ln() - usual)).collect();
    let (Some(kriging), Some(thin)) = (Kriging::fit(&observed, &GRID), Kriging::fit(&is_thin, &THIN_GRID)) else {
        return Default::default();
    };
    let covered = Covered::new(&all, params);
    let guess = |(s, side): (&Sample, &Option<Side>)| {
        if side.is_some() || matches!(s.provenance, Provenance::Moved { .. }) {
            return None;
        }
        if thin.mean(&(s.position, s.normal)) < THIN {
            return None;
        }
        let (mean, doubt) = kriging.mean_and_doubt(&(s.position, s.normal));
        let thickness = (usual + mean).exp();
        let position = s.position - s.normal * thickness;
        let free = evidence.free_space.signed_distance(&position) > 0.0;
        if doubt > DOUBT || !(THINNEST..=THICKEST).contains(&thickness) || free || covered.holds(&position, &-s.normal)
        {
            return None;
        }
        Some((Sample { position, normal: -s.normal, sigma: s.sigma.hypot(2e-3), ..*s }, params.weight * (1.0 - doubt)))
    };
    let guesses: Vec<(Sample, f64)> = all.par_iter().zip(&depths).filter_map(guess).collect();
    guesses.into_iter().unzip()
}

/// The other side of a sample's part.
#[derive(Clone, Copy)]
struct Side {
    /// How far it is, metres; more than [`THICKEST`] for "thick".
    depth: f64,
    /// Whether one of the two was felt: of two sides that were seen or guessed, one is often the outline's blur or a wrong guess.
    felt: bool,
}

/// The next surface straight into the body that faces away; `None` where no other side is known.
fn far_side(s: &Sample, all: &[Sample], tree: &KdTree) -> Option<Side> {
    let steps = (3.0 * THICKEST / WIDTH) as usize;
    let mut best: Option<Side> = None;
    for k in 1..=steps {
        let reach = k as f64 * WIDTH;
        if best.is_some_and(|b| b.depth < reach - 2.0 * WIDTH) {
            break;
        }
        for (i, _) in tree.within(&(s.position - s.normal * reach), 1.5 * WIDTH) {
            let d = all[i].position - s.position;
            let depth = -d.dot(&s.normal);
            let beside = (d + s.normal * depth).norm();
            let away = all[i].normal.dot(&s.normal) < AWAY;
            if away && depth > 0.5 * THINNEST && beside < WIDTH && best.is_none_or(|b| depth < b.depth) {
                best = Some(Side { depth, felt: s.is_felt() || all[i].is_felt() });
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::geometry::Vector;

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
        let off = |s: &&Sample| (s.position.z - (0.04 - 0.5 * thickness)).abs();
        let worst = below.iter().map(off).fold(0.0, f64::max);
        assert!(worst < 1e-3, "a guess is {worst} off");
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
    fn a_block_has_no_thin_part() {
        assert!(guesses(Vector::new(0.05, 0.04, 0.03)).is_empty());
    }
}
