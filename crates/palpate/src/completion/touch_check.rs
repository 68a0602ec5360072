//! Which touches cannot be where they say they are?
//!
//! Two things that a real fingertip never does: it does not touch where the camera looks through, and it does not reach its place through a
//! surface that was measured: behind the gel is the fingertip, as wide as the pad and some centimetres long. Both hold for thin shells,
//! handles and cavities alike, because neither asks what the object looks like.

use super::guess_sigma::GuessSigma;
use super::motion::Copying;
use crate::evidence::{Evidence, Provenance};
use crate::geometry::{Aabb, Isometry, Point, Vector};
use crate::scene::PoseSigma;
use crate::tactile::Patch;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt;

/// When a touch is not believed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TouchCheckParams {
    /// Half of the touch's points may be this deep in space that the camera proves free, plus three σ of the pose, metres.
    pub free_depth: f64,
    /// A measured surface may be this far behind the gel, plus three σ of the pose, metres. Larger: forgives surfaces that graze the pad's rim.
    pub body_margin: f64,
    /// Length of the fingertip behind the gel, metres. Larger: finds touches that are buried deeper, if the fingertip is as long.
    pub body_length: f64,
    /// Samples of the measured surface in the fingertip from which the touch is impossible; each stands for about 2 mm of surface.
    pub body_samples: usize,
    /// A copied surface in the fingertip counts only if at least this many other touches lie on the copies of that symmetry,
    pub guess_witnesses: usize,
    /// and at most this share of the other touches contradicts it.
    pub guess_contradictions: f64,
}

impl Default for TouchCheckParams {
    fn default() -> Self {
        Self {
            free_depth: 3e-3,
            body_margin: 3e-3,
            body_length: 25e-3,
            body_samples: 6,
            guess_witnesses: 3,
            guess_contradictions: 0.1,
        }
    }
}

/// Why a touch is not believed.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Objection {
    /// Half of it lies this deep in space that the camera proves free, metres.
    InFreeSpace {
        /// Median depth.
        depth: f64,
        /// Depth allowed.
        allowed: f64,
    },
    /// The fingertip would pass through the surface that the camera measured.
    ThroughSeen {
        /// Samples inside the fingertip.
        samples: usize,
    },
    /// The fingertip would pass through what other touches felt, or they through what it felt.
    ThroughFelt {
        /// How many other touches.
        touches: usize,
        /// One of them.
        other: usize,
    },
    /// The fingertip would pass through a copy of the measured surface that other touches confirm.
    ThroughGuess {
        /// Samples inside the fingertip.
        samples: usize,
        /// Touches that lie on copies of the same symmetry.
        witnesses: usize,
    },
}

impl fmt::Display for Objection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InFreeSpace { depth, allowed } => write!(
                f,
                "it lies {:.1} mm inside space that the camera proves free, {:.1} mm are allowed",
                1e3 * depth,
                1e3 * allowed
            ),
            Self::ThroughSeen { samples } => {
                write!(f, "the fingertip would reach it through the seen surface ({samples} samples of it)")
            }
            Self::ThroughFelt { touches, other } => {
                write!(f, "it and {touches} other touches exclude one another, among them touch {other}")
            }
            Self::ThroughGuess { samples, witnesses } => write!(
                f,
                "the fingertip would reach it through the copied surface ({samples} samples) that {witnesses} other touches confirm"
            ),
        }
    }
}

/// Says of each touch what speaks against it, if anything does.
///
/// Where two touches exclude one another, the one with more such conflicts is blamed; of an equal pair neither is.
///
/// * `evidence` – of the camera and these very `patches`; `Provenance::Felt` counts them
/// * `sigma` – of each pose: translation along the press, and rotation
///
/// O(touches · samples · copies).
pub fn objections(
    evidence: &Evidence,
    patches: &[Patch],
    copies: (&[Copying], &GuessSigma),
    sigma: &[PoseSigma],
    params: &TouchCheckParams,
) -> Vec<Option<Objection>> {
    let bodies: Vec<Option<Fingertip>> =
        patches.iter().zip(sigma).map(|(patch, sigma)| Fingertip::new(patch, sigma, params)).collect();
    let mut found: Vec<Option<Objection>> = (0..patches.len())
        .into_par_iter()
        .map(|i| {
            in_free_space(evidence, &patches[i], &sigma[i], params)
                .or_else(|| through_seen(evidence, bodies[i].as_ref()?, params))
        })
        .collect();
    through_felt(evidence, &bodies, params, &mut found);
    through_guess(evidence, patches, &bodies, copies, params, &mut found);
    found
}

fn in_free_space(
    evidence: &Evidence,
    patch: &Patch,
    sigma: &PoseSigma,
    params: &TouchCheckParams,
) -> Option<Objection> {
    let mut depths: Vec<f64> = patch.points.iter().map(|p| evidence.free_space.clearance(p)).collect();
    let middle = depths.len() / 2;
    let depth = *depths.get_mut(..).filter(|d| !d.is_empty())?.select_nth_unstable_by(middle, f64::total_cmp).1;
    let allowed = params.free_depth + 3.0 * sigma.translation;
    (depth > allowed).then_some(Objection::InFreeSpace { depth, allowed })
}

fn through_seen(evidence: &Evidence, body: &Fingertip, params: &TouchCheckParams) -> Option<Objection> {
    let seen = evidence.samples.iter().filter(|s| s.provenance == Provenance::Seen);
    let samples = seen.filter(|s| body.holds(&s.position)).count();
    (samples >= params.body_samples).then_some(Objection::ThroughSeen { samples })
}

/// Pairs of touches that exclude one another; the touch in most pairs is blamed until none is in more than its partner.
fn through_felt(
    evidence: &Evidence,
    bodies: &[Option<Fingertip>],
    params: &TouchCheckParams,
    found: &mut [Option<Objection>],
) {
    let n = bodies.len();
    let mut inside = vec![0usize; n * n];
    for s in &evidence.samples {
        let Provenance::Felt { touch } = s.provenance else { continue };
        for (i, body) in bodies.iter().enumerate().filter(|(i, _)| *i != touch as usize) {
            inside[i * n + touch as usize] += usize::from(body.as_ref().is_some_and(|b| b.holds(&s.position)));
        }
    }
    let exclude = |i: usize, j: usize| inside[i * n + j].max(inside[j * n + i]) >= params.body_samples;
    loop {
        let open = |i: usize| found[i].is_none();
        let partners = |i: usize| (0..n).filter(move |&j| j != i && exclude(i, j));
        let conflicts: Vec<usize> =
            (0..n).map(|i| if open(i) { partners(i).filter(|&j| open(j)).count() } else { 0 }).collect();
        let Some(worst) = (0..n).max_by_key(|&i| (conflicts[i], n - i)).filter(|&i| conflicts[i] >= 2) else { return };
        let Some(other) = partners(worst).find(|&j| open(j)) else { return };
        found[worst] = Some(Objection::ThroughFelt { touches: conflicts[worst], other });
    }
}

/// Copies of the seen surface inside a fingertip, if enough other touches confirm the symmetry that made them.
fn through_guess(
    evidence: &Evidence,
    patches: &[Patch],
    bodies: &[Option<Fingertip>],
    (copies, sigma): (&[Copying], &GuessSigma),
    params: &TouchCheckParams,
    found: &mut [Option<Objection>],
) {
    let families = copies.iter().map(|c| c.family as usize + 1).max().unwrap_or(0);
    let seen: Vec<_> = evidence.samples.iter().filter(|s| s.provenance == Provenance::Seen).collect();
    for family in 0..families {
        let members: Vec<(usize, &Copying)> =
            copies.iter().enumerate().filter(|(_, c)| c.family as usize == family).collect();
        let inside: Vec<usize> = bodies
            .par_iter()
            .map(|body| {
                let Some(body) = body else { return 0 };
                let center = body.sensor_from_world.inverse() * body.bounds.center();
                let count = |(m, c): &(usize, &Copying)| {
                    // Most copies are nowhere near: one look-up tells.
                    if evidence.index.nearest(&c.motion.inverse().point(&center)).is_none() {
                        return 0;
                    }
                    let wide = body.widened(3.0 * sigma.miss(*m));
                    let free = |p: &Point| evidence.free_space.signed_distance(p) < 1e-3;
                    seen.iter().map(|s| c.motion.point(&s.position)).filter(|p| wide.holds(p) && free(p)).count()
                };
                members.iter().map(count).max().unwrap_or(0)
            })
            .collect();
        let on: Vec<bool> = patches.iter().map(|p| lies_on_copy(evidence, p, &members, sigma)).collect();
        let against = |i: usize| inside[i] >= params.body_samples;
        for i in (0..patches.len()).filter(|&i| against(i) && !on[i]) {
            let judged = (0..patches.len()).filter(|&j| j != i && found[j].is_none());
            let (mut witnesses, mut contradictions, mut others) = (0, 0, 0);
            for j in judged {
                others += 1;
                witnesses += usize::from(on[j]);
                contradictions += usize::from(against(j) && !on[j]);
            }
            let confirmed = witnesses >= params.guess_witnesses
                && contradictions as f64 <= params.guess_contradictions * f64::from(others);
            if confirmed && found[i].is_none() {
                found[i] = Some(Objection::ThroughGuess { samples: inside[i], witnesses });
            }
        }
    }
}

/// Whether most of a patch lies on a copy of the seen surface that faces the same way.
fn lies_on_copy(evidence: &Evidence, patch: &Patch, members: &[(usize, &Copying)], sigma: &GuessSigma) -> bool {
    let step = (patch.points.len() / 20).max(1);
    let on = |(m, c): &(usize, &Copying)| {
        let back = c.motion.inverse();
        let allowed = 2e-3 + 2.0 * sigma.miss(*m);
        let points = patch.points.iter().zip(&patch.normals).step_by(step);
        let (mut hits, mut all) = (0, 0);
        for (p, n) in points {
            let (at, facing) = (back.point(p), back.vector(n));
            all += 1;
            let found = evidence.index.nearest_agreeing(&evidence.samples, &at, &facing, 0.7);
            hits += usize::from(found.is_some_and(|f| f.plane_offset < allowed && f.tangential < 3e-3));
        }
        hits * 2 > all
    };
    members.iter().any(on)
}

/// The box behind the gel that must be free of the object.
struct Fingertip {
    sensor_from_world: Isometry,
    bounds: Aabb,
}

impl Fingertip {
    /// `None` for a pose so uncertain, or a pad so small, that nothing is sure to be inside.
    fn new(patch: &Patch, sigma: &PoseSigma, params: &TouchCheckParams) -> Option<Self> {
        let sensor_from_world = patch.world_from_sensor.inverse();
        let local: Vec<Point> = patch.points.iter().chain(&patch.clearance).map(|p| sensor_from_world * p).collect();
        let gel = Aabb::of(&local)?;
        let reach = 0.5 * gel.size().xy().norm();
        let margin = params.body_margin + 3.0 * sigma.translation.hypot(sigma.rotation * reach);
        // At the sides the pad may pass a surface closely.
        let side = 1e-3 + 2.0 * sigma.translation.hypot(sigma.rotation * params.body_length);
        let (low, high) = (gel.min.z - params.body_length, gel.min.z - margin);
        let bounds = Aabb {
            min: Point::new(gel.min.x + side, gel.min.y + side, low),
            max: Point::new(gel.max.x - side, gel.max.y - side, high),
        };
        bounds.size().iter().all(|s| *s > 0.0).then_some(Self { sensor_from_world, bounds })
    }

    fn holds(&self, p: &Point) -> bool {
        self.bounds.contains(&(self.sensor_from_world * p))
    }

    /// The box with a wider margin to the gel and to the sides; may be empty.
    fn widened(&self, margin: f64) -> Self {
        let m = Vector::new(margin, margin, margin);
        let bounds = Aabb { min: self.bounds.min + Vector::new(margin, margin, 0.0), max: self.bounds.max - m };
        Self { sensor_from_world: self.sensor_from_world, bounds }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::symmetry::Symmetry;

    fn shifted(patch: &Patch, by: Vector) -> Patch {
        let moved = |p: &Point| p + by;
        let mut pose = patch.world_from_sensor;
        pose.translation.vector += by;
        Patch {
            points: patch.points.iter().map(moved).collect(),
            normals: patch.normals.clone(),
            clearance: patch.clearance.iter().map(moved).collect(),
            world_from_sensor: pose,
        }
    }

    /// Four touches of a box, the first moved by `by`; what is objected to each.
    fn judged(by: Vector) -> Vec<Option<Objection>> {
        let solids = [Solid::Box(Point::new(0.0, 0.0, 0.03), Vector::new(0.04, 0.04, 0.03), 0.35)];
        let (frame, visible) = view(&solids, 0.0005);
        let toward = [[0.0, 0.0], [0.02, 0.015], [-0.02, 0.01], [0.01, -0.02]];
        let mut patches: Vec<Patch> =
            toward.iter().map(|[x, y]| touch(&solids, Point::new(*x, *y, 0.2), Point::new(*x, *y, 0.0))).collect();
        patches[0] = shifted(&patches[0], by);
        let evidence = Evidence::gather(&frame, &visible, &patches, &EvidenceParams::default()).expect("seen");
        let none = Symmetry::default();
        let sigma = GuessSigma::new(&evidence, &none, &[], 0.05, 8e-3);
        let widths = vec![PoseSigma::default(); patches.len()];
        objections(&evidence, &patches, (&[], &sigma), &widths, &TouchCheckParams::default())
    }

    #[test]
    fn exact_touches_are_believed() {
        assert_eq!(judged(Vector::zeros()), vec![None; 4]);
        assert_eq!(
            judged(Vector::new(0.01, 0.0, 0.0)),
            vec![None; 4],
            "along a face it cannot be told, and does no harm"
        );
    }

    #[test]
    fn a_touch_in_the_open_and_a_buried_one_are_not() {
        let open = judged(Vector::new(0.0, 0.0, 0.02));
        assert!(matches!(open[0], Some(Objection::InFreeSpace { depth, .. }) if depth > 0.01), "{open:?}");
        let buried = judged(Vector::new(0.0, 0.0, -0.02));
        assert!(matches!(buried[0], Some(Objection::ThroughSeen { .. })), "{buried:?}");
        for others in [&open[1..], &buried[1..]] {
            assert_eq!(others, [None, None, None]);
        }
    }
}
