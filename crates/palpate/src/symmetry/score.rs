use super::element::{Motion, SymmetryElement};
use super::params::SymmetryParams;
use crate::evidence::{Evidence, Match, Sample, thinned};
use crate::geometry::{Point, Vector};
use nalgebra::{Rotation3, Unit};
use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// How the moved evidence fits the evidence; means over samples, each 0–1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Score {
    /// Share that lands on a measured surface with an agreeing normal.
    pub support: f64,
    /// The part of `support` that comes from elsewhere: a sample that maps near itself proves nothing.
    pub informative: f64,
    /// Depth inside proven free space, beyond the tolerance, capped.
    pub violation: f64,
    /// Beside a measured surface that faces the same way, but not on it.
    pub contradiction: f64,
    /// Share that lands where nothing is known: what the hypothesis would add.
    pub neutral: f64,
    /// Violation and contradiction of the felt samples alone; 0 without touches. Touches are few, and each is exact.
    pub felt_opposition: f64,
}

impl Score {
    /// The objective of search and refinement.
    pub fn value(&self) -> f64 {
        self.informative - 1.5 * self.violation - 0.5 * self.contradiction
    }

    /// All that speaks against the hypothesis.
    pub fn opposition(&self) -> f64 {
        self.violation + self.contradiction
    }

    fn mean(sum: &Self, count: f64) -> Self {
        let n = count.max(1.0);
        Self {
            support: sum.support / n,
            informative: sum.informative / n,
            violation: sum.violation / n,
            contradiction: sum.contradiction / n,
            neutral: sum.neutral / n,
            felt_opposition: sum.felt_opposition,
        }
    }
}

/// Distances at which a moved sample supports, contradicts or violates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tolerances {
    violation: f64,
    violation_range: f64,
    support: f64,
}

impl Tolerances {
    /// For the search: a candidate some degrees off must still be seen.
    pub(super) fn coarse(params: &SymmetryParams) -> Self {
        Self {
            violation: params.violation_tolerance + 0.0035,
            violation_range: 1.5 * params.violation_range,
            support: 3.0 * params.support_tolerance,
        }
    }

    pub(super) fn fine(params: &SymmetryParams) -> Self {
        Self {
            violation: params.violation_tolerance,
            violation_range: params.violation_range,
            support: params.support_tolerance,
        }
    }
}

/// Farther along the tangent plane than this, metres, a sample says nothing of the query.
const TANGENTIAL: f64 = 0.004;
/// Farther along the normal than this, metres, it is another surface.
const SAME_SURFACE: f64 = 0.012;
/// Contradiction is complete this far past the support tolerance, metres.
const CONTRADICTION_RANGE: f64 = 0.0045;
/// Cosine from which normals agree, and the range over which agreement becomes full.
const AGREEMENT: f64 = 0.5;
const AGREEMENT_RANGE: f64 = 0.35;
/// Depth by which a point behind untouched gel violates, metres: the layer is thin, the claim is exact.
const PAD_DEPTH: f64 = 0.004;
/// Edge of the cell in which one sample per direction votes, metres: touch patches are dense and must not dominate.
const VOTE_CELL: f64 = 0.004;
/// Fewer felt votes than this weigh less on their own.
const LEAST_FELT: f64 = 12.0;
/// Votes that tell how hollow the object is; what is nearer than this along the normal is the same surface, metres; and what is within
/// this of the line along the normal is met by it.
const HOLLOW_VOTES: usize = 1200;
const HOLLOW_NEAR: f64 = 0.008;
const HOLLOW_WIDTH: f64 = 0.004;
/// A sample whose normal turns proves something from this distance on, metres.
const OTHER_SIDE: f64 = 0.004;
/// Length of the table of rotations for axes and spheres.
const TURNS: usize = 64;

/// Votes between two looks at the score so far.
pub(super) const BLOCK: usize = 16;

/// Where a moved sample comes to.
#[derive(Clone, Copy, Default)]
struct Landing {
    /// How deep in proven free space, metres.
    depth: f64,
    /// The measured sample there whose normal agrees.
    found: Option<Match>,
}

/// What stays on a body of revolution when it is turned.
pub(super) struct Body<'a> {
    fitting: Vec<&'a Sample>,
    motions: Vec<Motion>,
    /// Share of the votes that do not.
    pub(super) misfits: f64,
}

/// Scores hypotheses against the evidence.
pub(super) struct Scorer<'a> {
    pub(super) evidence: &'a Evidence,
    pub(super) params: &'a SymmetryParams,
    /// The voting samples in a seeded random order: any prefix is a fair subsample.
    pub(super) votes: Vec<Sample>,
    pub(super) centroid: Point,
    /// Half the diagonal of the samples' box, metres.
    pub(super) radius: f64,
    /// See [`hollowness`].
    pub(super) hollowness: f64,
    turns: Vec<(f64, f64)>,
    spins: Vec<Rotation3<f64>>,
}

impl<'a> Scorer<'a> {
    pub(super) fn new(evidence: &'a Evidence, params: &'a SymmetryParams) -> Self {
        let mut votes = thinned(evidence.samples.iter(), VOTE_CELL);
        votes.shuffle(&mut Pcg64Mcg::seed_from_u64(params.seed));
        let sum: Vector = votes.iter().map(|s| s.position.coords).sum();
        let centroid = Point::from(sum / votes.len().max(1) as f64);
        let radius = crate::geometry::Aabb::of(votes.iter().map(|s| &s.position)).map_or(0.0, |b| 0.5 * b.diagonal());
        let golden = 0.618_033_988_749_895;
        // Rotations of 20° to 340° in an order whose every stretch is spread evenly.
        let turn = |k: usize| ((k as f64 * golden).fract() * 320.0 + 20.0).to_radians();
        let turns = (0..TURNS).map(|k| turn(k).sin_cos()).collect();
        let axis = |k: usize| {
            let (z, a) = (1.0 - (2 * k + 1) as f64 / TURNS as f64, k as f64 * golden * std::f64::consts::TAU);
            let r = (1.0 - z * z).sqrt();
            Unit::new_normalize(Vector::new(r * a.cos(), r * a.sin(), z))
        };
        // The angle's sequence must not run in step with the axis'.
        let spins = (0..TURNS).map(|k| Rotation3::from_axis_angle(&axis(k * 37 % TURNS), turn(k))).collect();
        let hollowness = hollowness(&votes[..votes.len().min(HOLLOW_VOTES)]);
        Self { evidence, params, votes, centroid, radius, hollowness, turns, spins }
    }

    /// Scores an element on the first `count` votes.
    pub(super) fn score(&self, element: &SymmetryElement, tolerances: &Tolerances, count: usize) -> Score {
        self.score_while(element, tolerances, count, |_, _| true).unwrap_or_default()
    }

    /// The same, but gives up (`None`) once the votes so far, after any block of them, score below `floor`.
    pub(super) fn score_unless_bad(
        &self,
        element: &SymmetryElement,
        tolerances: &Tolerances,
        count: usize,
        floor: f64,
    ) -> Option<Score> {
        self.score_while(element, tolerances, count, |_, value| value >= floor)
    }

    /// Scores an element, block by block, while `keep` says so of the votes counted and the value up to there.
    pub(super) fn score_while(
        &self,
        element: &SymmetryElement,
        tolerances: &Tolerances,
        count: usize,
        keep: impl FnMut(usize, f64) -> bool,
    ) -> Option<Score> {
        match element {
            SymmetryElement::Reflection(plane) => self.mean(tolerances, count, keep, |_, s| {
                (plane.reflect_point(&s.position), plane.reflect_vector(&s.normal))
            }),
            SymmetryElement::Axis { point, direction, order } => self.mean(tolerances, count, keep, |k, s| {
                let (sin, cos) = match order {
                    None => self.turns[k % TURNS],
                    Some(n) => {
                        let turn = 1 + k as u32 % n.saturating_sub(1).max(1);
                        (std::f64::consts::TAU * f64::from(turn) / f64::from((*n).max(2))).sin_cos()
                    }
                };
                let rotate =
                    |v: Vector| v * cos + direction.cross(&v) * sin + **direction * (direction.dot(&v) * (1.0 - cos));
                (point + rotate(s.position - point), rotate(s.normal))
            }),
            SymmetryElement::Sphere { center } => self.mean(tolerances, count, keep, |k, s| {
                let spin = &self.spins[k % TURNS];
                (center + spin * (s.position - center), spin * s.normal)
            }),
        }
    }

    /// Scores any motion on the first `count` votes.
    pub(super) fn score_motion(&self, motion: &Motion, tolerances: &Tolerances, count: usize) -> Score {
        let moved = |_: usize, s: &Sample| (motion.point(&s.position), motion.vector(&s.normal));
        self.mean(tolerances, count, |_, _| true, moved).unwrap_or_default()
    }

    #[inline]
    fn mean(
        &self,
        tolerances: &Tolerances,
        count: usize,
        mut keep: impl FnMut(usize, f64) -> bool,
        moved: impl Fn(usize, &Sample) -> (Point, Vector),
    ) -> Option<Score> {
        let (mut sum, mut felt) = (Score::default(), 0.0_f64);
        let votes = &self.votes[..count.min(self.votes.len())];
        let (mut points, mut normals) = ([Point::origin(); BLOCK], [Vector::zeros(); BLOCK]);
        for (block, first) in votes.chunks(BLOCK).zip((0..).step_by(BLOCK)) {
            for (k, s) in block.iter().enumerate() {
                (points[k], normals[k]) = moved(first + k, s);
            }
            let landings = self.landings(&points, &normals);
            for (k, s) in block.iter().enumerate() {
                let before = sum.opposition();
                self.vote(&mut sum, tolerances, s, &points[k], &normals[k], &landings[k]);
                if s.is_felt() {
                    felt += 1.0;
                    sum.felt_opposition += sum.opposition() - before;
                }
            }
            let counted = first + block.len();
            if !keep(counted, Score::mean(&sum, counted as f64).value()) {
                return None;
            }
        }
        let felt_opposition = sum.felt_opposition / felt.max(LEAST_FELT);
        Some(Score { felt_opposition, ..Score::mean(&sum, votes.len() as f64) })
    }

    /// The votes that stay on the body in most turns about an axis, and the share of the others: of those, more than an eighth of the turns end
    /// in free space.
    ///
    /// On a body of revolution with a handle these are the handle's; on a box with a square base, nearly all.
    pub(super) fn body(&self, point: &Point, direction: &Unit<Vector>) -> Body<'_> {
        let turns = self.turns.iter().step_by(4);
        let motions: Vec<Motion> =
            turns.map(|(sin, cos)| Motion::rotation(point, direction, sin.atan2(*cos))).collect();
        let votes = &self.votes[..self.votes.len().min(300)];
        let free = |p: Point| self.evidence.free_space.clearance(&p) > self.params.violation_tolerance;
        let fits = |s: &&Sample| motions.iter().filter(|m| free(m.point(&s.position))).count() * 8 <= motions.len();
        let fitting: Vec<&Sample> = votes.iter().filter(fits).collect();
        let misfits = (votes.len() - fitting.len()) as f64 / votes.len().max(1) as f64;
        Body { fitting, motions, misfits }
    }

    /// Scores the turns of a body of revolution without what does not fit.
    pub(super) fn score_body(&self, body: &Body, tolerances: &Tolerances) -> Score {
        let mut sum = Score::default();
        for (s, m) in body.fitting.iter().flat_map(|s| body.motions.iter().map(move |m| (s, m))) {
            let (p, n) = (m.point(&s.position), m.vector(&s.normal));
            self.vote_alone(&mut sum, tolerances, s, &p, &n);
        }
        Score::mean(&sum, (body.fitting.len() * body.motions.len()) as f64)
    }

    /// The vote of one sample that moved to `p` with normal `n`.
    pub(super) fn of_one(&self, before: &Sample, p: &Point, n: &Vector, tolerances: &Tolerances) -> Score {
        let mut sum = Score::default();
        self.vote_alone(&mut sum, tolerances, before, p, n);
        sum
    }

    fn vote_alone(&self, sum: &mut Score, tolerances: &Tolerances, before: &Sample, p: &Point, n: &Vector) {
        self.vote(sum, tolerances, before, p, n, &self.landings(&[*p], &[*n])[0]);
    }

    /// What moved samples find.
    #[inline]
    fn landings<const N: usize>(&self, points: &[Point; N], normals: &[Vector; N]) -> [Landing; N] {
        let Evidence { free_space, index, samples, .. } = self.evidence;
        let (depths, pads) = (free_space.clearances(points), free_space.pad_clearances(points));
        let found = index.all_nearest_agreeing(samples, points, normals, AGREEMENT);
        let mut landings = [Landing::default(); N];
        for (k, landing) in landings.iter_mut().enumerate() {
            landing.depth = if pads[k] > 0.0 { depths[k].max(PAD_DEPTH) } else { depths[k] };
            landing.found = found[k];
        }
        landings
    }

    /// Adds the vote of one sample that moved from `before` to `p` with normal `n` and found `landing` there.
    #[inline]
    fn vote(&self, sum: &mut Score, t: &Tolerances, before: &Sample, p: &Point, n: &Vector, landing: &Landing) {
        let Landing { depth, found } = landing;
        let violation = ((depth - t.violation) / t.violation_range).clamp(0.0, 1.0);
        sum.violation += violation;
        let Some(m) = found.filter(|m| m.tangential < TANGENTIAL && m.plane_offset < SAME_SURFACE.max(t.support))
        else {
            sum.neutral += f64::from(violation == 0.0);
            return;
        };
        if m.plane_offset < t.support {
            let agreement = ((m.agreement - AGREEMENT) / AGREEMENT_RANGE).min(1.0);
            let support = (1.0 - (m.plane_offset / t.support).powi(2)) * agreement;
            let moved = (p - before.position).norm_squared();
            // To the other side of a thin part is a short way, but another surface.
            let turned = (1.0 - n.dot(&before.normal)) * 0.5 * (moved / OTHER_SIDE.powi(2)).min(1.0);
            sum.support += support;
            sum.informative += support * (moved / self.params.informative_distance.powi(2)).min(1.0).max(turned);
        } else {
            sum.contradiction += ((m.plane_offset - t.support) / CONTRADICTION_RANGE).min(1.0);
        }
    }

    /// Signed distances of the moved votes from the measured surface they support, in order: what refinement makes small.
    pub(super) fn residuals(
        &self,
        element: &SymmetryElement,
        tolerances: &Tolerances,
        count: usize,
    ) -> Vec<Option<f64>> {
        let motion = |k: usize| match element {
            SymmetryElement::Reflection(plane) => Motion::reflection(plane),
            SymmetryElement::Axis { point, direction, .. } => {
                let (sin, cos) = self.turns[k % TURNS];
                Motion::rotation(point, direction, sin.atan2(cos))
            }
            SymmetryElement::Sphere { center } => {
                let linear = self.spins[k % TURNS].into_inner();
                Motion { linear, translation: center.coords - linear * center.coords }
            }
        };
        let (evidence, count) = (self.evidence, count.min(self.votes.len()));
        let residual = |(k, s): (usize, &Sample)| {
            let motion = motion(k);
            let (p, n) = (motion.point(&s.position), motion.vector(&s.normal));
            let m = evidence.index.nearest_agreeing(&evidence.samples, &p, &n, AGREEMENT)?;
            let q = &evidence.samples[m.sample];
            (m.tangential < TANGENTIAL && m.plane_offset < tolerances.support).then(|| (p - q.position).dot(&q.normal))
        };
        self.votes[..count].iter().enumerate().map(residual).collect()
    }
}

/// Share of the votes that look at another part of the object from near: the inner side of a vessel's wall. 0 for a convex body.
fn hollowness(votes: &[Sample]) -> f64 {
    let looks_at_another = |p: &&Sample| {
        votes.iter().any(|q| {
            let d = q.position - p.position;
            let along = d.dot(&p.normal);
            along > HOLLOW_NEAR && (d - p.normal * along).norm_squared() < HOLLOW_WIDTH * HOLLOW_WIDTH
        })
    };
    votes.par_iter().filter(looks_at_another).count() as f64 / votes.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::geometry::Plane;

    const CENTER: Point = Point::new(0.0, 0.0, 0.03);

    /// A box, seen, and touched on two sides.
    fn evidence() -> Evidence {
        let solids = [Solid::Box(CENTER, Vector::new(0.045, 0.025, 0.03), 0.8)];
        let (frame, visible) = view(&solids, 0.0);
        let side = Vector::new(0.8_f64.cos(), 0.8_f64.sin(), 0.0) * 0.1;
        let mut patches = [side, -side].map(|side| touch(&solids, CENTER + side, CENTER));
        for patch in &mut patches {
            // A rim of gel that touches nothing.
            let gel = (0..256).map(|i| Point::new(f64::from(i % 16 - 8) * 1e-3, f64::from(i / 16 - 8) * 1e-3, 0.0));
            let rim = gel.filter(|p| p.x.abs().max(p.y.abs()) > 0.0045);
            patch.clearance = rim.map(|p| patch.world_from_sensor * p).collect();
        }
        Evidence::gather(&frame, &visible, &patches, &EvidenceParams::default()).expect("the box is seen")
    }

    fn upright(yaw: f64, shift: f64) -> SymmetryElement {
        let n = Vector::new(yaw.cos(), yaw.sin(), 0.0);
        SymmetryElement::Reflection(Plane::new(n, &(CENTER + n * shift)).expect("a direction"))
    }

    #[test]
    fn what_samples_find_together_is_what_each_finds_alone() {
        let (evidence, params) = (evidence(), SymmetryParams::default());
        let scorer = Scorer::new(&evidence, &params);
        let (mut free, mut pads, mut met) = (0, 0, 0);
        for shift in [0.0, 0.001, 0.015, 3.0] {
            let SymmetryElement::Reflection(plane) = upright(0.8, shift) else { unreachable!("made of a plane") };
            for four in scorer.votes.chunks_exact(4) {
                let points: [Point; 4] = std::array::from_fn(|k| plane.reflect_point(&four[k].position));
                let normals: [Vector; 4] = std::array::from_fn(|k| plane.reflect_vector(&four[k].normal));
                let landings = scorer.landings(&points, &normals);
                for k in 0..4 {
                    let (clearance, pad) =
                        (evidence.free_space.clearance(&points[k]), evidence.free_space.pad_clearance(&points[k]));
                    assert_eq!(landings[k].depth, if pad > 0.0 { clearance.max(PAD_DEPTH) } else { clearance });
                    let found = evidence.index.nearest_agreeing(&evidence.samples, &points[k], &normals[k], AGREEMENT);
                    assert_eq!(landings[k].found, found, "at {}", points[k]);
                    (free, pads) = (free + usize::from(clearance > 0.0), pads + usize::from(pad > 0.0));
                    met += usize::from(found.is_some());
                }
            }
        }
        assert!(free > 50 && pads > 0 && met > 50, "{free} in free space, {pads} behind gel, {met} on the surface");
    }

    #[test]
    fn a_score_is_the_mean_of_its_votes() {
        let (evidence, params) = (evidence(), SymmetryParams::default());
        let scorer = Scorer::new(&evidence, &params);
        let fine = Tolerances::fine(&params);
        let turn = |k: usize| {
            let (sin, cos) = scorer.turns[k % TURNS];
            Motion::rotation(&CENTER, &Vector::z_axis(), sin.atan2(cos))
        };
        let SymmetryElement::Reflection(plane) = upright(0.8, 0.004) else { unreachable!("made of a plane") };
        let motions: [(SymmetryElement, &dyn Fn(usize) -> Motion); 2] = [
            (SymmetryElement::Reflection(plane), &|_| Motion::reflection(&plane)),
            (SymmetryElement::Axis { point: CENTER, direction: Vector::z_axis(), order: None }, &turn),
        ];
        // Not a multiple of a block.
        let count = 2 * BLOCK + 5;
        for (element, motion) in motions {
            let score = scorer.score(&element, &fine, count);
            let one = |(k, s): (usize, &Sample)| {
                let m = motion(k);
                scorer.of_one(s, &m.point(&s.position), &m.vector(&s.normal), &fine)
            };
            let alone: Vec<Score> = scorer.votes[..count].iter().enumerate().map(one).collect();
            let mean = |of: fn(&Score) -> f64| alone.iter().map(of).sum::<f64>() / count as f64;
            let parts: [fn(&Score) -> f64; 5] =
                [|s| s.support, |s| s.informative, |s| s.violation, |s| s.contradiction, |s| s.neutral];
            for part in parts {
                assert!((part(&score) - mean(part)).abs() < 1e-6, "{element:?}: {score:?}");
            }
            assert!(score.opposition() > 0.0 && score.neutral > 0.0, "{score:?}");
        }
    }
}
