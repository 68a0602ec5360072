use super::copies::{copy_of, corrected};
use super::inscribed::{Ball, inscribed_balls};
use super::kriging::{Grid, Kriging, Place};
use super::motion::Copying;
use super::orbit::{Covered, MovedEvidence, OrbitParams, in_free_space, leaves_orbit};
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
/// Sides farther than this are not looked for, metres, and the steps in which they are, as a share of the distance.
const FARTHEST: f64 = 0.15;
const STRIDE: f64 = 0.15;
/// Side of the cells that samples are thinned to, metres.
const CELL: f64 = 3e-3;
/// Side of the cells that copies of guesses are thinned to, metres.
const COPIES: f64 = 1e-3;
/// Two thicknesses that differ by more than this factor are not of one part: beside a sample whose other side is known to be elsewhere there is
/// no guess.
const OTHERWISE: f64 = 2.5;
/// How far from such a sample, metres.
const BESIDE: f64 = 6e-3;
/// Fewer known thicknesses than this prove no thin part.
const LEAST: usize = 12;
/// Guesses that the process knows less of than this are not made: share of its variance left.
const DOUBT: f64 = 0.6;
/// In the logarithm of the thickness.
const GRID: Grid = Grid {
    sigmas: &[0.15, 0.3, 0.6, 1.2],
    lengths: &[20e-3, 40e-3, 80e-3, 160e-3],
    noises: &[0.08, 0.16, 0.3],
    usual: 0.5,
    across: 2.0,
    or_noise: false,
};
/// Of being thin (1) or thick (0).
const THIN_GRID: Grid = Grid { sigmas: &[0.5, 1.0], noises: &[0.1, 0.2, 0.4], usual: 1.0, ..GRID };
/// Guesses are made where parts are rather thin than thick …
const THIN: f64 = 0.5;
/// … and flat: least cosine between normals as far apart as the part is thick. The foot of a wing is not part of it.
const FLAT: f64 = 0.8;
/// Nor in the heart of a thick part: within this share of the radius of a ball inscribed there.
const HEART: f64 = 0.7;

/// The far sides of thin parts: where a part's two sides are known, it is about as thick as that nearby.
///
/// A wing, a wall or a blade of which the camera sees one side shows its thickness where a touch knows the other side, or one of the two, and
/// all along the occluding contour ([`inscribed_balls`]): there the far side begins. The logarithm of the thickness is carried along the
/// surface, from where it is known to where only one side is; the guess there is that side, moved into the body by the thickness and turned
/// about. Whether the part is thin at all is carried along in the same way, as 1 or 0 (indicator kriging: Journel, *Nonparametric estimation
/// of spatial distributions*, 1983): parts thicker than 20 mm keep a wing's thickness from the fuselage, and the lip of a can from its side.
/// The accepted symmetries copy the guesses as they copy what was measured.
///
/// Returns guesses and their weights: `params.weight`, less what the process does not know; of copies, that of the symmetry, less the mean of it.
/// O(samples · (log samples + cells²) + guesses · copyings · log samples), at most 150 cells.
pub(super) fn far_sides(evidence: &Evidence, moved: &MovedEvidence, params: &OrbitParams) -> (Vec<Sample>, Vec<f64>) {
    let surface = Surface::new(thinned(evidence.samples.iter().chain(&moved.kept), CELL));
    let balls = inscribed_balls(&evidence.contour, &surface.samples);
    let Some(thickness) = Thickness::learn(&surface, &balls) else { return Default::default() };
    let covered = Covered::new(&surface.samples, params);
    let vacant = |far: &Sample| {
        evidence.free_space.signed_distance(&far.position) <= 0.0 && !covered.holds(&far.position, &far.normal)
    };
    let guess = |i: usize| {
        let near = surface.samples[i];
        if surface.sides[i].is_some() || matches!(near.provenance, Provenance::Moved { .. }) {
            return None;
        }
        let (depth, doubt) = thickness.at(&place(&near))?;
        let position = near.position - near.normal * depth;
        let far = Sample { position, normal: -near.normal, sigma: near.sigma.hypot(2e-3), ..near };
        let in_thick = || balls.iter().any(|b| b.diameter > THICKEST && b.holds(&position, HEART));
        let fits = doubt <= DOUBT && surface.is_flat(&near, depth) && !surface.is_otherwise(&near, depth);
        (fits && vacant(&far) && !in_thick()).then_some(Guess { near, far, depth, sure: 1.0 - doubt })
    };
    let made: Vec<Option<Guess>> = (0..surface.samples.len()).into_par_iter().map(guess).collect();
    let guesses: Vec<&Guess> = made.iter().flatten().collect();
    let mut out: Vec<(Sample, f64)> = guesses.iter().map(|g| (g.far, params.weight * g.sure)).collect();
    let sure = guesses.iter().map(|g| g.sure).sum::<f64>() / guesses.len().max(1) as f64;
    for (family, correction) in moved.corrections.iter().enumerate() {
        let members: Vec<(u32, &Copying)> =
            (0..).zip(&moved.copyings).filter(|c| c.1.family as usize == family).collect();
        let copyings: Vec<&Copying> = members.iter().map(|m| m.1).collect();
        let leaves = |s: &Sample| leaves_orbit(evidence, &copyings, &s.position, params);
        let belongs = |g: &&&Guess| !leaves(&g.near) && !leaves(&g.far) && surface.agrees(g, &copyings, &made);
        let copied: Vec<&Guess> = guesses.par_iter().filter(belongs).copied().collect();
        let copy = |g: &Guess, (m, copying): &(u32, &Copying)| {
            let near = copy_of(&g.near, copying, *m);
            if correction.refutes(&near.position) || in_free_space(evidence, &near.position, params) {
                return None;
            }
            let [near, far] = [near, copy_of(&g.far, copying, *m)].map(|s| corrected(s, correction));
            (!surface.is_otherwise(&near, g.depth) && vacant(&far)).then_some(far)
        };
        let copies: Vec<Sample> =
            members.par_iter().flat_map_iter(|m| copied.iter().filter_map(|g| copy(g, m))).collect();
        let weight = copyings.first().map_or(0.0, |first| params.weight_of(first)) * sure;
        out.extend(thinned(copies.iter(), COPIES).into_iter().map(|far| (far, weight)));
    }
    out.into_iter().unzip()
}

/// A guessed far side.
struct Guess {
    /// The sample whose far side it is.
    near: Sample,
    far: Sample,
    /// How far apart they are, metres.
    depth: f64,
    /// What the process knows there, 0–1.
    sure: f64,
}

/// Whether two thicknesses are of one part.
fn similar(a: f64, b: f64) -> bool {
    (a / b).ln().abs() < OTHERWISE.ln()
}

fn place(s: &Sample) -> Place {
    (s.position, s.normal)
}

/// How thick parts are, as a function of place.
struct Thickness {
    /// Of the logarithm of the thickness, less `usual`.
    depth: Kriging,
    /// Whether thin.
    thin: Kriging,
    usual: f64,
}

impl Thickness {
    /// From the known sides that touch took part in, and the balls at the contour; `None` if hardly any part is thin.
    fn learn(surface: &Surface, balls: &[Ball]) -> Option<Self> {
        let felt = |(s, side): (&Sample, &Option<Side>)| Some((place(s), side.filter(|side| side.felt)?.depth));
        let felt = surface.samples.iter().zip(&surface.sides).filter_map(felt);
        let known: Vec<(Place, f64)> = felt.chain(balls.iter().map(|b| (b.opposite, b.diameter))).collect();
        let mut thin: Vec<f64> = known.iter().map(|k| k.1).filter(|depth| *depth <= THICKEST).collect();
        if thin.len() < LEAST {
            return None;
        }
        let middle = thin.len() / 2;
        let usual = thin.select_nth_unstable_by(middle, f64::total_cmp).1.ln();
        let is_thin: Vec<(Place, f64)> = known.iter().map(|(at, d)| (*at, f64::from(*d <= THICKEST))).collect();
        let depth: Vec<(Place, f64)> =
            known.iter().filter(|(_, d)| *d <= THICKEST).map(|(at, d)| (*at, d.ln() - usual)).collect();
        Some(Self { depth: Kriging::fit(&depth, &GRID)?, thin: Kriging::fit(&is_thin, &THIN_GRID)?, usual })
    }

    /// The thickness at a place, metres, and how much of the process' variance is left; `None` where parts are not thin.
    fn at(&self, place: &Place) -> Option<(f64, f64)> {
        if self.thin.mean(place) < THIN {
            return None;
        }
        let (mean, doubt) = self.depth.mean_and_doubt(place);
        let depth = (self.usual + mean).exp();
        (THINNEST..=THICKEST).contains(&depth).then_some((depth, doubt))
    }
}

/// The other side of a sample's part.
#[derive(Clone, Copy)]
struct Side {
    /// How far it is, metres; more than [`THICKEST`] for "thick".
    depth: f64,
    /// Whether one of the two was felt: of two sides that were seen or guessed, one is often the outline's blur or a wrong guess.
    felt: bool,
}

/// Samples, what is near them and what is behind them.
struct Surface {
    samples: Vec<Sample>,
    tree: KdTree,
    /// The other side of each sample's part, where it is known.
    sides: Vec<Option<Side>>,
}

impl Surface {
    fn new(samples: Vec<Sample>) -> Self {
        let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
        let mut surface = Self { tree: KdTree::new(&points), samples, sides: Vec::new() };
        surface.sides = surface.samples.par_iter().map(|s| surface.far_side(s)).collect();
        surface
    }

    /// The next surface straight into the body that faces away; `None` where no other side is known.
    fn far_side(&self, s: &Sample) -> Option<Side> {
        let mut best: Option<Side> = None;
        let (mut reach, mut step) = (0.0, WIDTH);
        while reach < FARTHEST && best.is_none_or(|b| b.depth > reach - 2.0 * step) {
            (reach, step) = (reach + step, step.max(STRIDE * reach));
            for (i, _) in self.tree.within(&(s.position - s.normal * reach), 1.5 * step) {
                let other = &self.samples[i];
                let d = other.position - s.position;
                let depth = -d.dot(&s.normal);
                let beside = (d + s.normal * depth).norm();
                let away = other.normal.dot(&s.normal) < AWAY;
                if away
                    && (0.5 * THINNEST..FARTHEST).contains(&depth)
                    && beside < WIDTH
                    && best.is_none_or(|b| depth < b.depth)
                {
                    best = Some(Side { depth, felt: s.is_felt() || other.is_felt() });
                }
            }
        }
        best
    }

    /// Whether a sample beside `s` shows that the other side, known there, is not at `depth`.
    fn is_otherwise(&self, s: &Sample, depth: f64) -> bool {
        self.tree.within(&s.position, BESIDE).into_iter().any(|(i, _)| {
            let same = self.samples[i].normal.dot(&s.normal) > FLAT;
            same && self.sides[i].is_some_and(|side| !similar(side.depth, depth))
        })
    }

    /// Whether parts are known to be as thick as a guess says where the copyings put it on a measured surface: at half of these places, at least. The
    /// lip of a can is thin at one place and nothing of the kind at the others that it is turned to.
    ///
    /// * `guesses` – of each sample
    fn agrees(&self, g: &Guess, copyings: &[&Copying], guesses: &[Option<Guess>]) -> bool {
        let agrees_at = |copying: &&Copying| {
            let (p, n) = (copying.motion.point(&g.near.position), copying.motion.vector(&g.near.normal));
            let (i, distance) = self.tree.nearest_n(&p, 1).into_iter().next()?;
            let s = &self.samples[i];
            if distance > CELL || s.normal.dot(&n) < FLAT || matches!(s.provenance, Provenance::Moved { .. }) {
                return None;
            }
            let guessed = guesses[i].as_ref().is_some_and(|other| similar(other.depth, g.depth));
            Some(guessed || self.sides[i].is_some_and(|side| similar(side.depth, g.depth)))
        };
        let met: Vec<bool> = copyings.iter().filter_map(agrees_at).collect();
        2 * met.iter().filter(|agrees| **agrees).count() >= met.len()
    }

    /// Whether the surface hardly turns within `radius` of a sample; what lies as deep as half of that is another side.
    fn is_flat(&self, s: &Sample, radius: f64) -> bool {
        self.tree.within(&s.position, radius).into_iter().all(|(i, _)| {
            let other = &self.samples[i];
            other.normal.dot(&s.normal) > FLAT || (other.position - s.position).dot(&s.normal) < -0.5 * radius
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::geometry::Vector;
    use crate::symmetry::SymmetryElement;

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
        let surface = Surface::new((0..16).map(sample).collect());
        let guess = |k: usize, depth: f64| {
            let near = sample(k);
            let far = Sample { position: near.position - near.normal * depth, normal: -near.normal, ..near };
            Guess { near, far, depth, sure: 1.0 }
        };
        let at = |thin: std::ops::Range<usize>| (0..16).map(|k| thin.contains(&k).then(|| guess(k, 2e-3))).collect();
        let (everywhere, lip): (Vec<_>, Vec<_>) = (at(0..16), at(3..6));
        assert!(surface.agrees(&guess(4, 2e-3), &turns, &everywhere));
        assert!(!surface.agrees(&guess(4, 2e-3), &turns, &lip));
        assert!(!surface.agrees(&guess(4, 8e-3), &turns, &everywhere), "of another thickness");
    }

    #[test]
    fn a_block_has_no_thin_part() {
        assert!(guesses(Vector::new(0.05, 0.04, 0.03)).is_empty());
    }
}
