use super::BeliefParams;
use crate::evidence::Evidence;
use crate::geometry::{Bvh, Point, TriangleMesh, Vector};
use crate::pipeline::{ReconstructParams, Reconstruction, Stages, reconstruct};
use crate::scene::Scene;
use crate::symmetry::{Rejection, Symmetry, SymmetryElement, SymmetryEstimator};
use rayon::prelude::*;

/// How the surface would lie if another set of symmetries held.
#[derive(Debug, Clone)]
pub(super) struct Mode {
    /// How likely that is.
    pub(super) probability: f64,
    /// Where the surface would be along the normal at each point of the belief, metres, positive outwards.
    pub(super) offsets: Vec<f64>,
}

/// An estimator that answers what it is given.
struct Given(Symmetry);

impl SymmetryEstimator for Given {
    fn estimate(&self, _: &Evidence) -> Symmetry {
        self.0.clone()
    }
}

/// The least probability that an accepted hypothesis is wrong.
const LEAST_DOUBT: f64 = 0.05;
/// The probability of a rejected one that is tried.
const REJECTED: f64 = 0.1;

/// Other sets of symmetries with their probability: none at all, the accepted ones less one, and the accepted ones with a rejected plane.
fn alternatives(symmetry: &Symmetry, rejected: usize) -> Vec<(f64, Symmetry)> {
    let accepted = &symmetry.accepted;
    let doubt = |confidence: f64| (1.0 - confidence).clamp(LEAST_DOUBT, 0.5);
    let with = |accepted| Symmetry { accepted, rejected: Vec::new() };
    let mut sets = Vec::new();
    if !accepted.is_empty() {
        let all_wrong: f64 = accepted.iter().map(|h| doubt(h.confidence)).product();
        sets.push((all_wrong.max(LEAST_DOUBT), with(Vec::new())));
    }
    if accepted.len() > 1 {
        for left_out in 0..accepted.len() {
            let mut rest = accepted.clone();
            let dropped = rest.remove(left_out);
            sets.push((doubt(dropped.confidence), with(rest)));
        }
    }
    let plausible = symmetry.rejected.iter().filter(|h| {
        matches!(h.element, SymmetryElement::Reflection(_))
            && matches!(h.rejection, Some(Rejection::Opposed { .. } | Rejection::LittleSupport { .. }))
            && h.score.value() > 0.0
    });
    for h in plausible.take(rejected) {
        let mut more = accepted.clone();
        more.push(crate::symmetry::Hypothesis { rejection: None, ..h.clone() });
        sets.push((REJECTED, with(more)));
    }
    sets
}

/// Solves the surface under other sets of symmetries and measures how far it lies from the current one at `points`.
pub(super) fn modes(
    scene: &Scene,
    current: &Reconstruction,
    params: &ReconstructParams,
    belief: &BeliefParams,
    (points, normals): (&[Point], &[Vector]),
) -> Vec<Mode> {
    if belief.hypotheses == 0.0 {
        return Vec::new();
    }
    let sets = alternatives(&current.symmetry, belief.rejected);
    let solve = |(probability, symmetry): (f64, Symmetry)| {
        let given = Given(symmetry);
        let stages = Stages { symmetry: Some(&given), ..Stages::default() };
        // Evidence that gives no surface without a symmetry says nothing against the symmetry.
        let mesh = reconstruct(scene, params, &stages).ok()?.mesh;
        Some(Mode { probability, offsets: offsets(&mesh, points, normals, belief.largest_difference) })
    };
    sets.into_par_iter().filter_map(solve).collect()
}

/// Distance along the normal to where another mesh passes, outwards or inwards, whichever is nearer; ± `largest` where it does not.
fn offsets(mesh: &TriangleMesh, points: &[Point], normals: &[Vector], largest: f64) -> Vec<f64> {
    let bvh = Bvh::new(mesh);
    let of = |(p, n): (&Point, &Vector)| {
        let outwards = bvh.cast_ray(p, n, largest).map(|hit| hit.distance);
        let inwards = bvh.cast_ray(p, &-n, largest).map(|hit| hit.distance);
        match (outwards, inwards) {
            (Some(o), Some(i)) => {
                if o <= i {
                    o
                } else {
                    -i
                }
            }
            (Some(o), None) => o,
            (None, Some(i)) => -i,
            (None, None) => -largest,
        }
    };
    points.iter().zip(normals).map(of).collect()
}
