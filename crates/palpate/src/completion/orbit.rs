use super::copies::{copies, corrected, merged};
use super::correction::{Correction, corrections};
use super::far_sides::far_sides;
use super::motion::{Copying, copyings, families};
use crate::evidence::{Evidence, Sample};
use crate::geometry::{KdTree, Point, Vector};
use crate::symmetry::Symmetry;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Parameters of moving the evidence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OrbitParams {
    /// A moved sample further than this inside proven free space is contradicted, metres. Larger tolerates worse planes.
    pub free_tolerance: f64,
    /// A moved sample with a measured one of agreeing normal within this distance adds nothing, metres.
    pub measured_radius: f64,
    /// How much a difference of normals counts in that distance, metres per unit.
    pub normal_scale: f64,
    /// Share of contradicted copies round an axis beyond which the sample is not part of the body of revolution.
    pub orbit_violations: f64,
    /// Samples this close to a contradicted one share its fate, metres.
    pub orbit_radius: f64,
    /// Spacing of copies round an axis, metres of arc.
    pub arc: f64,
    /// Weight of a moved sample against a measured one, at full score.
    pub weight: f64,
    /// Score from which a hypothesis has the full weight.
    pub full_score: f64,
    /// What the normal of a moved sample counts, relative to its position. Larger: touches shift the guessed surface as a whole instead of
    /// denting it.
    pub orientation: f64,
    /// Whether copies are moved by what touches say they miss nearby. Off leaves them where the symmetry puts them.
    pub correct: bool,
    /// Whether parts of which one side is known are guessed to be as thick as they are nearby.
    pub far_sides: bool,
}

impl Default for OrbitParams {
    fn default() -> Self {
        Self {
            free_tolerance: 3e-3,
            measured_radius: 5e-3,
            normal_scale: 6e-3,
            orbit_violations: 0.05,
            orbit_radius: 4e-3,
            arc: 8e-3,
            weight: 0.1,
            full_score: 0.4,
            orientation: 5.0,
            correct: true,
            far_sides: true,
        }
    }
}

impl OrbitParams {
    /// Weight of the samples that a copying makes.
    pub(super) fn weight_of(&self, copying: &Copying) -> f64 {
        self.weight * (copying.score / self.full_score).clamp(0.0, 1.0)
    }

    /// Whether a measured sample at this distance stands in for a guess with this normal: position and normal count together.
    pub(super) fn replaces(&self, measured: &Sample, distance: f64, normal: &Vector) -> bool {
        distance < self.measured_radius
            && measured.normal.dot(normal) > 0.5
            && distance.hypot(self.normal_scale * (measured.normal - normal).norm()) < self.measured_radius
    }
}

/// The measured samples moved by the accepted symmetries, and those that evidence contradicted.
#[derive(Debug, Clone, Default)]
pub struct MovedEvidence {
    /// Guesses that nothing contradicts and no measurement replaces.
    pub kept: Vec<Sample>,
    /// Weight of each kept guess against a measurement.
    pub weights: Vec<f64>,
    /// Guessed far sides of thin parts.
    pub far_sides: Vec<Sample>,
    /// Weight of each of them.
    pub far_weights: Vec<f64>,
    /// Guesses that lie in proven free space.
    pub contradicted: Vec<Sample>,
    /// The copies made; `Provenance::Moved` points into it.
    pub copyings: Vec<Copying>,
    /// By how much each family of copies was moved, and later ones are.
    pub(super) corrections: Vec<Correction>,
}

/// Moves every measured sample by every motion of the accepted symmetries and drops what evidence contradicts or already covers. Copies
/// that overlap become one.
///
/// A sample some of whose copies round an axis violate free space is not part of the body of revolution (a mug's handle) and is
/// dropped at every angle, with its neighbours; for a reflection the neighbours of a violating sample are dropped too.
/// O(samples · motions · log samples).
pub fn move_evidence(evidence: &Evidence, symmetry: &Symmetry, params: &OrbitParams) -> MovedEvidence {
    if evidence.samples.is_empty() {
        return MovedEvidence::default();
    }
    let copyings = copyings(symmetry, copying_radius(evidence, symmetry), params.arc);
    let families = families(&copyings);
    let outcasts = outcasts(evidence, &families, params);
    let corrections =
        if params.correct { corrections(evidence, &families) } else { vec![Correction::default(); families.len()] };
    let covered = Covered::new(&evidence.samples, params);
    let mut out = MovedEvidence::default();
    for (family, correction) in corrections.iter().enumerate() {
        let members: Vec<(u32, &Copying)> = (0..).zip(&copyings).filter(|c| c.1.family as usize == family).collect();
        let (copies, outcasts) = copies(&evidence.samples, &members, &outcasts[family]);
        let judge = |copy: &Sample| {
            let moved = corrected(*copy, correction);
            if correction.refutes(&copy.position) || in_free_space(evidence, &moved.position, params) {
                Verdict::Contradicted(moved)
            } else if covered.holds(&moved.position, &moved.normal) {
                Verdict::Covered
            } else {
                Verdict::Kept(moved)
            }
        };
        out.contradicted.extend(outcasts.into_iter().map(|copy| corrected(copy, correction)));
        let verdicts: Vec<Verdict> = copies.par_iter().map(judge).collect();
        for verdict in verdicts {
            match verdict {
                Verdict::Kept(moved) => out.kept.push(moved),
                Verdict::Contradicted(moved) => out.contradicted.push(moved),
                Verdict::Covered => {}
            }
        }
        let weight = members.first().map_or(0.0, |(_, copying)| params.weight_of(copying));
        out.weights.resize(out.kept.len(), weight);
    }
    if families.len() > 1 {
        (out.kept, out.weights) = merged(&out.kept, &out.weights);
    }
    (out.copyings, out.corrections) = (copyings, corrections);
    if params.far_sides {
        (out.far_sides, out.far_weights) = far_sides(evidence, &out, params);
    }
    out
}

/// What becomes of a copy.
enum Verdict {
    Kept(Sample),
    /// It lies in proven free space.
    Contradicted(Sample),
    /// A measurement stands there.
    Covered,
}

pub(super) fn in_free_space(evidence: &Evidence, p: &Point, params: &OrbitParams) -> bool {
    evidence.free_space.signed_distance(p) > params.free_tolerance
}

/// Distance (90th percentile) of the samples from the axis that will be used, or from their middle, metres: what [`copyings`] is given.
pub fn copying_radius(evidence: &Evidence, symmetry: &Symmetry) -> f64 {
    use crate::symmetry::SymmetryElement::{Axis, Reflection, Sphere};
    let of = |p: &Point| {
        symmetry.accepted.iter().find_map(|h| match &h.element {
            Axis { point, direction, .. } => Some((p - point).cross(direction).norm()),
            Sphere { center } => Some((p - center).norm()),
            Reflection(_) => None,
        })
    };
    let center = evidence.bounds.center();
    if evidence.samples.is_empty() {
        return 0.0;
    }
    let mut radii: Vec<f64> =
        evidence.samples.iter().map(|s| of(&s.position).unwrap_or_else(|| (s.position - center).norm())).collect();
    let outer = (radii.len() * 9 / 10).min(radii.len() - 1);
    *radii.select_nth_unstable_by(outer, f64::total_cmp).1
}

/// For each family of motions: which samples, or neighbours of samples, are contradicted by their copies.
fn outcasts(evidence: &Evidence, families: &[Vec<&Copying>], params: &OrbitParams) -> Vec<Vec<bool>> {
    let points: Vec<Point> = evidence.samples.iter().map(|s| s.position).collect();
    let tree = KdTree::new(&points);
    families
        .par_iter()
        .map(|members| {
            let mut bad = vec![false; points.len()];
            for (s, p) in points.iter().enumerate() {
                bad[s] = leaves_orbit(evidence, members, p, params);
            }
            let mut spread = bad.clone();
            for s in (0..points.len()).filter(|&s| bad[s]) {
                for (n, _) in tree.within(&points[s], params.orbit_radius) {
                    spread[n] = true;
                }
            }
            spread
        })
        .collect()
}

/// Whether too many copies of a point by the motions of one family lie in free space.
pub(super) fn leaves_orbit(evidence: &Evidence, family: &[&Copying], p: &Point, params: &OrbitParams) -> bool {
    let violations = family.iter().filter(|m| in_free_space(evidence, &m.motion.point(p), params)).count();
    violations as f64 > params.orbit_violations * family.len() as f64
}

/// Whether a measured sample of agreeing normal is near: the distance counts position and normal together, so the inner wall of a
/// bowl does not cover a guess of the outer one.
pub(super) struct Covered<'a> {
    samples: &'a [Sample],
    tree: KdTree,
    params: &'a OrbitParams,
}

impl<'a> Covered<'a> {
    pub(super) fn new(samples: &'a [Sample], params: &'a OrbitParams) -> Self {
        let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
        let tree = KdTree::new(&points);
        Self { samples, tree, params }
    }

    pub(super) fn holds(&self, p: &Point, n: &Vector) -> bool {
        self.tree.nearest_n(p, 8).iter().any(|&(i, distance)| self.params.replaces(&self.samples[i], distance, n))
    }
}
