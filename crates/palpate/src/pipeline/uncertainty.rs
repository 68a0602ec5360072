//! How far each vertex of the mesh may be from the true surface, and on what that rests.
//!
//! Calibrated on simulated scenes; `docs/uncertainty.md` says how, and where it fails.

use crate::completion::{GuessSigma, MovedEvidence, copying_radius};
use crate::evidence::{Evidence, Provenance, Sample, SampleIndex};
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
    sources: Vec<crate::symmetry::Motion>,
    sigma: GuessSigma,
}

impl Guesses {
    pub(super) fn new(evidence: &Evidence, symmetry: &Symmetry, moved: &MovedEvidence, arc: f64) -> Self {
        let radius = copying_radius(evidence, symmetry);
        Self {
            samples: moved.kept.clone(),
            index: SampleIndex::new(&moved.kept, 2e-3, REACH),
            sources: moved.copyings.iter().map(|c| c.motion.inverse()).collect(),
            sigma: GuessSigma::new(evidence, symmetry, &moved.copyings, radius, arc),
        }
    }

    /// Where the evidence lay that was copied to `p`, and on which copy that rests; `None` where no copy is near.
    pub(super) fn source(&self, p: &Point, normal: &Vector) -> Option<(Point, usize)> {
        let found = self.index.nearest_agreeing(&self.samples, p, normal, AGREES)?;
        let Provenance::Moved { motion } = self.samples[found.sample].provenance else { return None };
        Some((self.sources[motion as usize].point(p), motion as usize))
    }
}

/// Reach of the look-ups, metres; beyond it a tree is asked.
const REACH: f64 = 10e-3;
/// Cosine from which a sample speaks for a vertex.
const AGREES: f64 = 0.3;
/// Neighbours asked for one that faces the same way, beyond the reach of the index.
const NEIGHBOURS: usize = 12;

/// σ and provenance of every vertex. O(vertices) look-ups, a tree query where evidence is far.
pub(super) fn vertex_knowledge(mesh: &TriangleMesh, evidence: &Evidence, guesses: &Guesses) -> VertexKnowledge {
    let measured = Nearest::new(&evidence.samples, &evidence.index);
    let copied = Nearest::new(&guesses.samples, &guesses.index);
    let normals = mesh.vertex_normals();
    let terms: Vec<SigmaTerms> = mesh
        .vertices
        .par_iter()
        .zip(&normals)
        .map(|(p, n)| terms(p, n, &measured, &copied, evidence, guesses))
        .collect();
    let (sigma, provenance) = terms.iter().map(model).unzip();
    VertexKnowledge { sigma, provenance, terms }
}

/// Nearest sample that faces the same way: by the grid where one is near, else by a tree.
struct Nearest<'a> {
    samples: &'a [Sample],
    index: &'a SampleIndex,
    tree: KdTree,
}

/// The sample found: its number, distance from its plane and along it, and the cosine of the normals.
type Found = (usize, f64, f64, f64);

impl<'a> Nearest<'a> {
    fn new(samples: &'a [Sample], index: &'a SampleIndex) -> Self {
        let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
        Self { samples, index, tree: KdTree::new(&points) }
    }

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
        felt: sample.is_some_and(|s| matches!(s.provenance, Provenance::Felt { .. })),
        guess_distance: g.as_ref().map_or(f64::INFINITY, |f| f.2),
        guess_offset: g.as_ref().map_or(0.0, |f| f.1),
        guess_lever: lever,
        guess_miss: miss,
        bend: nearest.map_or(0.0, bend),
        room: (-evidence.free_space.signed_distance(p)).max(0.0),
    }
}

/// σ by what is nearest: the better of what was measured and what was guessed.
fn model(t: &SigmaTerms) -> (f64, VertexProvenance) {
    let measured = t.measured_sigma.hypot(0.3 * t.measured_distance).hypot(t.measured_offset);
    let guessed = t.guess_lever.hypot(t.guess_miss).hypot(1e-3).hypot(0.3 * t.guess_distance).hypot(t.guess_offset);
    let sigma = measured.min(guessed).hypot(2e-4);
    let near = t.measured_distance.min(t.guess_distance);
    let provenance = if near > 6e-3 {
        VertexProvenance::Extrapolated
    } else if measured <= guessed {
        if t.felt { VertexProvenance::Felt } else { VertexProvenance::Seen }
    } else {
        VertexProvenance::Guessed
    };
    (sigma, provenance)
}
