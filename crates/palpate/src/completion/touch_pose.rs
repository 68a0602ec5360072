//! Touch poses are known to millimetres and degrees; what they touch is often known better.
//!
//! Each touch is fitted, alone, to the surface that everything **else** says: what the camera saw, what the other touches felt, and copies of
//! both by the accepted symmetries. Point to plane and normal to normal, Gauss–Newton on SE(3), Cauchy weights, with the stated pose σ as the
//! prior; all touches at once from the last round's poses, so the order does not matter.

use super::guess_sigma::GuessSigma;
use super::motion::Copying;
use crate::evidence::{Evidence, Provenance, Sample, SampleIndex, pose_row};
use crate::geometry::{Isometry, Point, Vector};
use crate::scene::PoseSigma;
use crate::symmetry::Motion;
use crate::tactile::Patch;
use nalgebra::{Matrix6, Translation3, UnitQuaternion, Vector6};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Parameters of the refinement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TouchPoseParams {
    /// Rounds in which all touches are fitted to one another.
    pub rounds: usize,
    /// Gauss–Newton steps of each touch in a round.
    pub steps: usize,
    /// Points of a touch that are fitted.
    pub points: usize,
    /// How many independent readings the seen points under a touch are worth. Larger: trusts the camera more against the stated pose.
    pub seen_worth: f64,
    /// How many independent readings the copies by one symmetry are worth, and another touch: their points share one error.
    pub guess_worth: f64,
    /// σ of a difference of normals, radians.
    pub normal_sigma: f64,
    /// Residuals beyond this many σ count less and less (Cauchy).
    pub cauchy: f64,
    /// Cosine of the normals from which a surface is the one that was touched. Smaller: rounds edges into one another.
    pub agreement: f64,
    /// A surface farther along the tangent plane than this says nothing of a point, metres.
    pub tangential: f64,
}

impl Default for TouchPoseParams {
    fn default() -> Self {
        Self {
            rounds: 3,
            steps: 3,
            points: 40,
            seen_worth: 12.0,
            guess_worth: 2.0,
            normal_sigma: 0.25,
            cauchy: 1.5,
            agreement: 0.85,
            tangential: 3e-3,
        }
    }
}

/// A touch after refinement.
#[derive(Debug, Clone)]
pub struct RefinedTouch {
    /// The patch in its new pose.
    pub patch: Patch,
    /// Posterior covariance of the pose in the sensor frame: rotation (radians), then translation (metres).
    pub covariance: Matrix6<f64>,
    /// How many points found a measured surface of others, and how many a guessed one, in the last round.
    pub matched: [usize; 2],
    /// How far the stated pose was corrected, in σ: √(ξᵀ Σ⁻¹ ξ / 6).
    pub correction: f64,
}

/// Refines the poses of all touches.
///
/// * `evidence` – of the camera and these very `patches`; `Provenance::Felt` counts them
/// * `copies` – copies of the evidence and their σ
/// * `sigma` – of the stated poses; where both are 0 nothing moves
///
/// O(rounds · touches · points · copies).
pub fn refine_touches(
    evidence: &Evidence,
    patches: &[Patch],
    copies: (&[Copying], &GuessSigma),
    sigma: &PoseSigma,
    params: &TouchPoseParams,
) -> Vec<RefinedTouch> {
    let prior = precision(sigma);
    let others = Others::new(evidence, patches, copies);
    let mut fits = vec![Fit::stated(&Matrix6::from_diagonal(&prior.map(|p| 1.0 / p))); patches.len()];
    for _ in 0..params.rounds {
        let placed: Vec<Placed> =
            patches.iter().zip(&fits).enumerate().map(|(i, (p, f))| others.place(i, p, f)).collect();
        fits = (0..patches.len())
            .into_par_iter()
            .map(|i| fit(i, &patches[i], &fits[i], &others, &placed, &prior, params))
            .collect();
    }
    patches.iter().zip(&fits).map(|(patch, fit)| fit.finished(patch, &prior)).collect()
}

/// Of a pose: rotation, then translation.
pub(super) fn precision(sigma: &PoseSigma) -> Vector6<f64> {
    // A prior without width in one part is exact in it; the floor keeps the matrix invertible.
    let (turn, shift) = (sigma.rotation.max(1e-6), sigma.translation.max(1e-7));
    Vector6::new(turn, turn, turn, shift, shift, shift).map(|s| 1.0 / (s * s))
}

/// The patch carried to another pose.
fn moved(patch: &Patch, world_from_sensor: &Isometry) -> Patch {
    let carry = world_from_sensor * patch.world_from_sensor.inverse();
    Patch {
        points: patch.points.iter().map(|p| carry * p).collect(),
        normals: patch.normals.iter().map(|n| carry * n).collect(),
        clearance: patch.clearance.iter().map(|p| carry * p).collect(),
        world_from_sensor: *world_from_sensor,
    }
}

#[derive(Clone)]
pub(super) struct Fit {
    /// Correction of the pose in the sensor frame: rotation, translation.
    xi: Vector6<f64>,
    covariance: Matrix6<f64>,
    matched: [usize; 2],
}

impl Fit {
    /// The pose as it is stated.
    pub(super) fn stated(covariance: &Matrix6<f64>) -> Self {
        Self { xi: Vector6::zeros(), covariance: *covariance, matched: [0; 2] }
    }

    pub(super) fn finished(&self, patch: &Patch, prior: &Vector6<f64>) -> RefinedTouch {
        RefinedTouch {
            patch: moved(patch, &self.pose(patch)),
            covariance: self.covariance,
            matched: self.matched,
            correction: (self.xi.component_mul(&self.xi).dot(prior) / 6.0).sqrt(),
        }
    }

    fn pose(&self, patch: &Patch) -> Isometry {
        let x = &self.xi;
        let turn = UnitQuaternion::from_scaled_axis(Vector::new(x[0], x[1], x[2]));
        patch.world_from_sensor * Isometry::from_parts(Translation3::new(x[3], x[4], x[5]), turn)
    }
}

/// A surface point that a touch's point should lie on.
struct Target {
    position: Point,
    normal: Vector,
    sigma: f64,
    /// 0 = seen, 1 + family of copies = guessed, then one per other touch: errors within a group are shared.
    group: usize,
}

/// The felt samples of a touch where the last round put them.
pub(super) struct Placed {
    samples: Vec<(Point, Vector)>,
    center: Point,
    radius: f64,
    /// σ of the pose along the press.
    sigma: f64,
}

impl Placed {
    /// A touch that tells the others nothing.
    pub(super) fn nothing() -> Self {
        Self { samples: Vec::new(), center: Point::origin(), radius: 0.0, sigma: 0.0 }
    }
}

/// All surfaces but the touch's own.
pub(super) struct Others<'a> {
    seen: Vec<Sample>,
    index: SampleIndex,
    felt: Vec<Vec<Sample>>,
    /// Motion, its inverse, and its family.
    copies: Vec<(Motion, Motion, usize)>,
    families: usize,
    sigma: &'a GuessSigma,
}

impl<'a> Others<'a> {
    pub(super) fn new(evidence: &Evidence, patches: &[Patch], (copies, sigma): (&[Copying], &'a GuessSigma)) -> Self {
        let seen: Vec<Sample> = evidence.samples.iter().filter(|s| s.provenance == Provenance::Seen).copied().collect();
        let mut felt = vec![Vec::new(); patches.len()];
        for s in &evidence.samples {
            if let Provenance::Felt { touch } = s.provenance {
                felt[touch as usize].push(*s);
            }
        }
        let index = SampleIndex::new(&seen, 2e-3, 8e-3);
        let families = copies.iter().map(|c| c.family as usize + 1).max().unwrap_or(0);
        let copies = copies.iter().map(|c| (c.motion, c.motion.inverse(), c.family as usize)).collect();
        Self { seen, index, felt, copies, families, sigma }
    }

    pub(super) fn place(&self, touch: usize, patch: &Patch, fit: &Fit) -> Placed {
        let carry = fit.pose(patch) * patch.world_from_sensor.inverse();
        let samples: Vec<(Point, Vector)> =
            self.felt[touch].iter().map(|s| (carry * s.position, carry * s.normal)).collect();
        let sum: Vector = samples.iter().map(|s| s.0.coords).sum();
        let center = Point::from(sum / samples.len().max(1) as f64);
        let radius = samples.iter().map(|s| (s.0 - center).norm()).fold(0.0, f64::max);
        Placed { samples, center, radius, sigma: fit.covariance[(5, 5)].sqrt() }
    }

    /// Everything near one point of touch `touch` that faces the same way, the touch itself left out.
    fn targets(
        &self,
        touch: usize,
        (p, n): (&Point, &Vector),
        reach: f64,
        placed: &[Placed],
        params: &TouchPoseParams,
    ) -> Vec<Target> {
        let tangential = params.tangential;
        let mut found = Vec::new();
        let near = |q: &Point, m: &Vector| {
            let d = p - q;
            let along = d.dot(m);
            n.dot(m) > params.agreement
                && along.abs() < reach
                && (d.norm_squared() - along * along) < tangential * tangential
        };
        let mut seen = |motion: Option<(usize, &(Motion, Motion, usize))>| {
            let (at, facing) = motion.map_or((*p, *n), |(_, (_, back, _))| (back.point(p), back.vector(n)));
            let Some(m) = self.index.nearest_agreeing(&self.seen, &at, &facing, 0.5) else { return };
            let s = &self.seen[m.sample];
            let (position, normal) =
                motion.map_or((s.position, s.normal), |(_, (go, ..))| (go.point(&s.position), go.vector(&s.normal)));
            if !near(&position, &normal) {
                return;
            }
            let (guess, group) =
                motion.map_or((0.0, 0), |(c, (_, _, family))| (self.guess(c, &s.position, &normal), 1 + family));
            found.push(Target { position, normal, sigma: s.sigma.hypot(guess), group });
        };
        seen(None);
        for copy in self.copies.iter().enumerate() {
            seen(Some(copy));
        }
        let identity = Motion::identity();
        for (j, other) in placed.iter().enumerate().filter(|(j, o)| *j != touch && !o.samples.is_empty()) {
            for c in 0..=self.copies.len() {
                let go = if c == 0 { &identity } else { &self.copies[c - 1].0 };
                if (go.point(&other.center) - p).norm() > other.radius + tangential + reach {
                    continue;
                }
                let best =
                    other.samples.iter().map(|(q, m)| (go.point(q), go.vector(m), q)).filter(|(q, m, _)| near(q, m));
                let Some((q, m, source)) = best.min_by(|a, b| (a.0 - p).norm().total_cmp(&(b.0 - p).norm())) else {
                    continue;
                };
                let guess = if c == 0 { 0.0 } else { self.guess(c - 1, source, &m) };
                // Each other touch is one reading, however many points it has.
                let group = 1 + self.families + j;
                found.push(Target { position: q, normal: m, sigma: other.sigma.hypot(guess).max(1e-4), group });
            }
        }
        found
    }

    fn guess(&self, copying: usize, source: &Point, normal: &Vector) -> f64 {
        self.sigma.miss(copying).hypot(self.sigma.lever(copying, source, normal)).max(5e-4)
    }
}

pub(super) fn fit(
    touch: usize,
    patch: &Patch,
    start: &Fit,
    others: &Others,
    placed: &[Placed],
    prior: &Vector6<f64>,
    params: &TouchPoseParams,
) -> Fit {
    let mut fit = start.clone();
    let step = (patch.points.len() / params.points.max(1)).max(1);
    let local: Vec<(Point, Vector)> = patch
        .points
        .iter()
        .zip(&patch.normals)
        .step_by(step)
        .map(|(p, n)| {
            (patch.world_from_sensor.inverse_transform_point(p), patch.world_from_sensor.inverse_transform_vector(n))
        })
        .collect();
    let wide = (1.0 / prior[5]).sqrt();
    for _ in 0..params.steps {
        let pose = fit.pose(patch);
        let matches: Vec<(Vector6<f64>, f64, [Vector; 2], Target)> = local
            .iter()
            .flat_map(|(p, n)| {
                let (world, normal) = (pose * p, pose * n);
                let reach = 3e-3 + 3.0 * wide.hypot(p.coords.norm() / prior[0].sqrt());
                others.targets(touch, (&world, &normal), reach, placed, params).into_iter().map(move |t| {
                    (pose_row(&pose, &world, &t.normal), (world - t.position).dot(&t.normal), [normal, t.normal], t)
                })
            })
            .collect();
        let mut counts = vec![0.0f64; 1 + others.families + placed.len()];
        for m in &matches {
            counts[m.3.group] += 1.0;
        }
        let (mut information, mut gradient) = (Matrix6::from_diagonal(prior), prior.component_mul(&fit.xi));
        for (row, residual, [normal, wanted], target) in &matches {
            let worth = if target.group == 0 { params.seen_worth } else { params.guess_worth };
            let share = (worth / counts[target.group]).min(1.0);
            // What the pose itself may be off is no reason to doubt a match.
            let expected = target.sigma.hypot((fit.covariance * row).dot(row).max(0.0).sqrt());
            let doubt = 1.0 / (1.0 + (residual / (params.cauchy * expected)).powi(2));
            let w = share * doubt / (target.sigma * target.sigma);
            information += row * row.transpose() * w;
            gradient += row * (w * residual);
            let error = pose.inverse_transform_vector(&(normal - wanted));
            let doubt = doubt / (1.0 + error.norm_squared() / params.normal_sigma.powi(2));
            let w = share * doubt / params.normal_sigma.powi(2);
            let slope = -pose.inverse_transform_vector(normal).cross_matrix();
            let (a, g) = (slope.transpose() * slope * w, slope.transpose() * error * w);
            let mut block = information.fixed_view_mut::<3, 3>(0, 0);
            block += a;
            let mut head = gradient.fixed_rows_mut::<3>(0);
            head += g;
        }
        let Some(covariance) = information.try_inverse() else { break };
        fit.xi -= covariance * gradient;
        fit.covariance = covariance;
        let measured = matches.iter().filter(|m| m.3.group == 0 || m.3.group > others.families).count();
        fit.matched = [measured, matches.len() - measured];
    }
    fit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::completion::copyings;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::symmetry::Symmetry;

    const SIGMA: PoseSigma = PoseSigma { translation: 1.5e-3, rotation: 0.05 };

    fn box_and_touch() -> (Evidence, Patch, Patch) {
        let solids = [Solid::Box(Point::new(0.0, 0.0, 0.03), Vector::new(0.04, 0.04, 0.03), 0.35)];
        let (frame, visible) = view(&solids, 0.0005);
        let exact = touch(&solids, Point::new(0.005, 0.004, 0.2), Point::new(0.005, 0.004, 0.0));
        let error = Isometry::new(Vector::new(4e-4, -3e-4, 2e-3), Vector::new(0.05, -0.06, 0.0));
        let given = moved(&exact, &(exact.world_from_sensor * error));
        let evidence = Evidence::gather(&frame, &visible, std::slice::from_ref(&given), &EvidenceParams::default());
        (evidence.expect("the box is seen"), exact, given)
    }

    fn off(exact: &Patch, patch: &Patch) -> (f64, f64) {
        let d = exact.world_from_sensor.inverse() * patch.world_from_sensor;
        (d.translation.z.abs(), (d * Vector::z()).dot(&Vector::z()).acos())
    }

    #[test]
    fn a_touch_is_set_back_on_the_seen_face_and_says_how_sure_it_is() {
        let (evidence, exact, given) = box_and_touch();
        let none = Symmetry::default();
        let copies = copyings(&none, 0.05, 8e-3);
        let sigma = GuessSigma::new(&evidence, &none, &copies, 0.05, 8e-3);
        let refined = &refine_touches(
            &evidence,
            std::slice::from_ref(&given),
            (&copies, &sigma),
            &SIGMA,
            &TouchPoseParams::default(),
        )[0];
        let ((along, tilt), (was_along, was_tilt)) = (off(&exact, &refined.patch), off(&exact, &given));
        assert!(along < 0.25 * was_along, "{along} m off, was {was_along}");
        assert!(tilt < 0.6 * was_tilt, "tilted by {tilt}, was {was_tilt}");
        let stated = [0.05, 0.05, 0.05, 1.5e-3, 1.5e-3, 1.5e-3];
        let sure = |k: usize| refined.covariance[(k, k)].sqrt() / stated[k];
        assert!(sure(5) < 0.3 && sure(0) < 0.9, "along the press and in tilt it is known better");
        assert!(sure(2) > 0.95 && sure(3) > 0.95, "about and across the press nothing was learnt");
        assert!(refined.matched[0] > 0 && refined.matched[1] == 0);
    }

    #[test]
    fn nothing_near_leaves_the_pose_and_its_sigma_alone() {
        let (evidence, _, given) = box_and_touch();
        let far = moved(&given, &(Isometry::translation(0.0, 0.0, 0.5) * given.world_from_sensor));
        let none = Symmetry::default();
        let sigma = GuessSigma::new(&evidence, &none, &[], 0.05, 8e-3);
        let refined =
            &refine_touches(&evidence, std::slice::from_ref(&far), (&[], &sigma), &SIGMA, &TouchPoseParams::default())
                [0];
        assert!(
            (refined.patch.world_from_sensor.translation.vector - far.world_from_sensor.translation.vector).norm()
                < 1e-9
        );
        assert!((refined.covariance[(5, 5)].sqrt() - 1.5e-3).abs() < 1e-9 && refined.matched == [0, 0]);
    }
}
