//! How far each vertex of the mesh may be from the true surface, and on what that rests.
//!
//! Calibrated on simulated scenes; `docs/uncertainty.md` says how, and where it fails.

use super::Warning;
use crate::completion::{GuessSigma, MovedEvidence, copying_radius};
use crate::evidence::{Evidence, Provenance, Sample, SampleIndex, thinned};
use crate::geometry::{KdTree, Point, TriangleMesh, Vector};
use crate::symmetry::Symmetry;
use rayon::prelude::*;

/// What a vertex rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum VertexProvenance {
    /// The camera measured the surface here.
    Seen = 0,
    /// A touch measured it here.
    Felt = 1,
    /// A symmetry copied measured surface to here.
    Guessed = 2,
    /// No evidence is near: smoothness and free space alone shaped it.
    Extrapolated = 3,
}

impl VertexProvenance {
    /// The kind that a file's number stands for.
    pub fn from_number(number: u8) -> Option<Self> {
        [Self::Seen, Self::Felt, Self::Guessed, Self::Extrapolated].into_iter().find(|kind| *kind as u8 == number)
    }
}

/// What is known of the vertices of a mesh, one entry each, in their order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VertexKnowledge {
    /// Standard deviation of the distance to the true surface, metres.
    pub sigma: Vec<f64>,
    /// What the vertex rests on.
    pub provenance: Vec<VertexProvenance>,
    /// What σ was made of.
    pub terms: Vec<SigmaTerms>,
}

/// Share of vertices without evidence from which the user is told.
const MUCH_EXTRAPOLATED: f64 = 0.15;

impl VertexKnowledge {
    /// What the user should know of it.
    pub(super) fn warning(&self) -> Option<Warning> {
        let beyond = |p: &VertexProvenance| *p == VertexProvenance::Extrapolated;
        let sigmas: Vec<f64> =
            self.sigma.iter().zip(&self.provenance).filter(|(_, p)| beyond(p)).map(|(s, _)| *s).collect();
        let share = sigmas.len() as f64 / self.sigma.len().max(1) as f64;
        let mut sorted = sigmas;
        sorted.sort_unstable_by(f64::total_cmp);
        let sigma = *sorted.get(sorted.len() / 2)?;
        (share > MUCH_EXTRAPOLATED).then_some(Warning::Extrapolated { share, sigma })
    }
}

/// What the σ of a vertex is made of, metres. Infinite distances say that nothing of the kind agrees with the vertex's normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SigmaTerms {
    /// Distance along the surface to the nearest measured sample that faces the same way.
    pub measured_distance: f64,
    /// σ of that sample.
    pub measured_sigma: f64,
    /// Distance of the vertex from that sample's plane.
    pub measured_offset: f64,
    /// Whether it was felt.
    pub felt: bool,
    /// Distance along the surface to the nearest copied sample that faces the same way.
    pub guess_distance: f64,
    /// Distance of the vertex from that sample's plane.
    pub guess_offset: f64,
    /// σ of that sample by the covariance of its symmetry and the lever arm.
    pub guess_lever: f64,
    /// How far its copy misses the measured surface where both are.
    pub guess_miss: f64,
    /// How far the surface turns on the way from the nearest sample: sine of the angle between the normals times the distance.
    pub bend: f64,
    /// How far away the nearest proven free space is: the surface cannot lie beyond.
    pub room: f64,
}

/// The copies of the evidence, indexed.
pub(super) struct Guesses {
    samples: Vec<Sample>,
    index: SampleIndex,
    tree: KdTree,
    sources: Vec<crate::symmetry::Motion>,
    sigma: GuessSigma,
}

impl Guesses {
    pub(super) fn new(evidence: &Evidence, symmetry: &Symmetry, moved: &MovedEvidence, arc: f64) -> Self {
        let radius = copying_radius(evidence, symmetry);
        let samples = thinned(moved.kept.iter(), THINNED);
        Self {
            index: SampleIndex::new(&samples, SPACING, REACH),
            tree: tree(&samples),
            samples,
            sources: moved.copyings.iter().map(|c| c.motion.inverse()).collect(),
            sigma: GuessSigma::new(evidence, symmetry, &moved.copyings, radius, arc),
        }
    }

    /// Takes in copies of further evidence by the same motions. Those that were dropped meanwhile stay: what replaced them is nearer.
    pub(super) fn extend(&mut self, new: &[Sample]) {
        let from = self.samples.len();
        self.samples.extend(new);
        self.index.insert(&self.samples, from, SPACING, REACH);
    }

    /// The σ of the copies.
    pub(super) fn sigma(&self) -> &GuessSigma {
        &self.sigma
    }

    /// Where the evidence lay that was copied to `p`, and on which copy that rests; `None` where no copy is near.
    pub(super) fn source(&self, p: &Point, normal: &Vector) -> Option<(Point, usize)> {
        let found = self.index.nearest_agreeing(&self.samples, p, normal, AGREES)?;
        let Provenance::Moved { motion } = self.samples[found.sample].provenance else { return None };
        Some((self.sources[motion as usize].point(p), motion as usize))
    }
}

/// Side of the cells that copies are thinned to, metres: well below the distances that σ grows over.
const THINNED: f64 = 1.5e-3;
/// Spacing of the look-up of copies, metres.
const SPACING: f64 = 2e-3;
/// Reach of the look-ups, metres; beyond it a tree is asked.
pub(super) const REACH: f64 = 10e-3;
/// Cosine from which a sample speaks for a vertex.
const AGREES: f64 = 0.3;
/// Neighbours asked for one that faces the same way, beyond the reach of the index.
const NEIGHBOURS: usize = 12;

/// σ and provenance of every vertex. O(vertices) look-ups, a tree query where evidence is far.
pub(super) fn vertex_knowledge(mesh: &TriangleMesh, evidence: &Evidence, guesses: &Guesses) -> VertexKnowledge {
    knowledge_where(mesh, evidence, guesses, |_| None)
}

/// The same, but what `known` says of a vertex (by its number) is taken over.
pub(super) fn knowledge_where(
    mesh: &TriangleMesh,
    evidence: &Evidence,
    guesses: &Guesses,
    known: impl Fn(usize) -> Option<SigmaTerms> + Sync,
) -> VertexKnowledge {
    let tree = tree(&evidence.samples);
    let measured = Nearest { samples: &evidence.samples, index: &evidence.index, tree: &tree };
    let copied = Nearest { samples: &guesses.samples, index: &guesses.index, tree: &guesses.tree };
    let normals = mesh.vertex_normals();
    let of = |i: usize| terms(&mesh.vertices[i], &normals[i], &measured, &copied, evidence, guesses);
    let terms: Vec<SigmaTerms> =
        (0..mesh.vertices.len()).into_par_iter().map(|i| known(i).unwrap_or_else(|| of(i))).collect();
    let (sigma, provenance) = terms.iter().map(model).unzip();
    VertexKnowledge { sigma, provenance, terms }
}

fn tree(samples: &[Sample]) -> KdTree {
    KdTree::new(&samples.iter().map(|s| s.position).collect::<Vec<_>>())
}

/// Nearest sample that faces the same way: by the grid where one is near, else by a tree.
struct Nearest<'a> {
    samples: &'a [Sample],
    index: &'a SampleIndex,
    /// Of the samples, or of the first of them.
    tree: &'a KdTree,
}

/// The sample found: its number, distance from its plane and along it, and the cosine of the normals.
type Found = (usize, f64, f64, f64);

impl Nearest<'_> {
    fn find(&self, p: &Point, n: &Vector) -> Option<Found> {
        if let Some(m) = self.index.nearest_agreeing(self.samples, p, n, AGREES) {
            return Some((m.sample, m.plane_offset, m.tangential, m.agreement));
        }
        let near = self.tree.nearest_n(p, NEIGHBOURS);
        let (i, d) = *near.iter().find(|(i, _)| self.samples[*i].normal.dot(n) > AGREES).or(near.last())?;
        let s = &self.samples[i];
        let along = (p - s.position).dot(&s.normal).abs();
        // One that faces another way is no surface to be beside, only the nearest that is known.
        if s.normal.dot(n) > AGREES {
            Some((i, along, (d * d - along * along).max(0.0).sqrt(), s.normal.dot(n)))
        } else {
            Some((i, 0.0, d, s.normal.dot(n)))
        }
    }
}

fn terms(
    p: &Point,
    n: &Vector,
    measured: &Nearest,
    copied: &Nearest,
    evidence: &Evidence,
    guesses: &Guesses,
) -> SigmaTerms {
    let m = measured.find(p, n);
    let g = copied.find(p, n);
    let bend = |f: &Found| (1.0 - f.3 * f.3).max(0.0).sqrt() * f.2;
    let (lever, miss) = g.as_ref().map_or((0.0, 0.0), |f| {
        let s = &guesses.samples[f.0];
        let Provenance::Moved { motion } = s.provenance else { return (0.0, 0.0) };
        let motion = motion as usize;
        let source = guesses.sources[motion].point(&s.position);
        (guesses.sigma.lever(motion, &source, &s.normal), guesses.sigma.miss(motion))
    });
    let sample = m.as_ref().map(|f| &measured.samples[f.0]);
    let nearest = match (&m, &g) {
        (Some(a), Some(b)) => Some(if a.2 <= b.2 { a } else { b }),
        (a, b) => a.as_ref().or(b.as_ref()),
    };
    SigmaTerms {
        measured_distance: m.as_ref().map_or(f64::INFINITY, |f| f.2),
        measured_sigma: sample.map_or(0.0, |s| s.sigma),
        measured_offset: m.as_ref().map_or(0.0, |f| f.1),
        felt: sample.is_some_and(Sample::is_felt),
        guess_distance: g.as_ref().map_or(f64::INFINITY, |f| f.2),
        guess_offset: g.as_ref().map_or(0.0, |f| f.1),
        guess_lever: lever,
        guess_miss: miss,
        bend: nearest.map_or(0.0, bend),
        room: (-evidence.free_space.signed_distance(p)).max(0.0),
    }
}

/// Coefficients of σ, fitted to 15 development objects (3 views; 0, 5 and 20 touches) by the likelihood of a Student t with ν = 4, then scaled
/// so that 90 % of the errors lie within 1.645 σ. `docs/uncertainty.md` holds the protocol; `examples/uncertainty_report.rs` writes its data.
mod fitted {
    /// Least σ of a vertex at a felt and at a seen sample, metres: what the cells and the smoothing leave.
    pub(super) const FLOOR: [f64; 2] = [0.054e-3, 0.194e-3];
    /// Share of the sample's own σ, felt and seen: the fit averages, and seen neighbours more than felt ones.
    pub(super) const SAMPLE: [f64; 2] = [0.423, 0.068];
    /// Growth with the distance along the surface, and beyond [`super::FAR`].
    pub(super) const MEASURED_GROWTH: f64 = 0.161;
    pub(super) const MEASURED_FAR: f64 = 2.08;
    /// Share of the distance from the sample's plane: where mesh and measurement disagree, one of them is wrong.
    pub(super) const MEASURED_OFFSET: f64 = 0.42;
    /// Least σ of a guess, metres, and the shares of its parts.
    pub(super) const GUESS_FLOOR: f64 = 0.479e-3;
    pub(super) const LEVER: f64 = 0.246;
    pub(super) const MISS: f64 = 1.05;
    pub(super) const GUESS_OFFSET: f64 = 0.919;
    pub(super) const GUESS_GROWTH: f64 = 0.436;
    pub(super) const GUESS_FAR: f64 = 0.435;
    /// Share of the bend: edges are rounded.
    pub(super) const BEND: f64 = 0.207;
}

/// Evidence farther along the surface than this no longer carries a vertex, metres.
const FAR: f64 = 6e-3;
/// Stands for "there is none", metres.
const NOWHERE: f64 = 1.0;

/// σ and provenance of a vertex: what was measured and what was guessed, each with what it is worth at this distance, joined by precision.
fn model(t: &SigmaTerms) -> (f64, VertexProvenance) {
    use fitted as c;
    let kind = usize::from(!t.felt);
    let square = |terms: &[f64]| terms.iter().map(|x| x * x).sum::<f64>();
    let (m, g) = (t.measured_distance.min(NOWHERE), t.guess_distance.min(NOWHERE));
    let measured = square(&[
        c::FLOOR[kind],
        c::SAMPLE[kind] * t.measured_sigma,
        c::MEASURED_GROWTH * m,
        c::MEASURED_FAR * (m - FAR).max(0.0),
        c::MEASURED_OFFSET * t.measured_offset,
    ]);
    let guessed = square(&[
        c::GUESS_FLOOR,
        c::LEVER * t.guess_lever,
        c::MISS * t.guess_miss,
        c::GUESS_OFFSET * t.guess_offset,
        c::GUESS_GROWTH * g,
        c::GUESS_FAR * (g - FAR).max(0.0),
    ]);
    let sigma = (1.0 / (1.0 / measured + 1.0 / guessed) + square(&[c::BEND * t.bend])).sqrt();
    let provenance = match (m.min(g) > FAR, measured <= guessed, t.felt) {
        (true, ..) => VertexProvenance::Extrapolated,
        (_, true, true) => VertexProvenance::Felt,
        (_, true, false) => VertexProvenance::Seen,
        _ => VertexProvenance::Guessed,
    };
    (sigma, provenance)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terms(measured_distance: f64, guess_distance: f64) -> SigmaTerms {
        SigmaTerms {
            measured_distance,
            measured_sigma: 5e-4,
            measured_offset: 0.0,
            felt: false,
            guess_distance,
            guess_offset: 0.0,
            guess_lever: 5e-4,
            guess_miss: 5e-4,
            bend: 0.0,
            room: 0.0,
        }
    }

    #[test]
    fn doubt_grows_from_felt_over_seen_and_guessed_to_extrapolated() {
        let none = f64::INFINITY;
        let (felt, kind) = model(&SigmaTerms { felt: true, measured_sigma: 1e-4, ..terms(0.0, none) });
        assert_eq!(kind, VertexProvenance::Felt);
        let (seen, kind) = model(&terms(0.0, none));
        assert_eq!(kind, VertexProvenance::Seen);
        let (guessed, kind) = model(&terms(40e-3, 0.0));
        assert_eq!(kind, VertexProvenance::Guessed);
        let (beyond, kind) = model(&terms(15e-3, none));
        assert_eq!(kind, VertexProvenance::Extrapolated);
        let (farther, kind) = model(&terms(40e-3, none));
        assert_eq!(kind, VertexProvenance::Extrapolated);
        assert!(
            felt < seen && seen < guessed && guessed < beyond && beyond < farther,
            "{felt} {seen} {guessed} {beyond}"
        );
        assert!(model(&terms(none, none)).0.is_finite());
    }

    #[test]
    fn disagreement_lever_and_miss_each_add_doubt() {
        let base = terms(40e-3, 1e-3);
        let sigma = model(&base).0;
        for more in [
            SigmaTerms { guess_offset: 2e-3, ..base },
            SigmaTerms { guess_lever: 8e-3, ..base },
            SigmaTerms { guess_miss: 2e-3, ..base },
            SigmaTerms { bend: 5e-3, ..base },
        ] {
            assert!(model(&more).0 > 1.1 * sigma, "{more:?}");
        }
    }
}
