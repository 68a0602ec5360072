use super::ExploreError;
use crate::geometry::{Isometry, Plane, Point, Vector};
use crate::tactile::TactileSensor;
use serde::{Deserialize, Serialize};

/// What the arm can reach, beside staying above the support. Everything is optional; the default allows every pose.
///
/// Read from TOML by `palpate next-touch --reach`:
///
/// ```toml
/// no_support = false                       # true: the object stands free, the underside may be touched
/// support_clearance = 0.002                # the fingertip stays this far above the support, metres
/// support = { normal = [0, 0, 1], offset = 0.0 }          # overrides the scene's
/// keep_in = [{ normal = [1, 0, 0], offset = -0.2 }]       # the fingertip stays where normal · x ≥ offset
/// approach = { direction = [0, 0, -1], max_angle_deg = 95.0 }   # the press direction lies in this cone
/// workspace = { min = [-0.3, -0.3, 0.0], max = [0.3, 0.3, 0.5] }  # the fingertip stays in this box
/// ```
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Reach {
    /// The object stands free: there is no support to stay above.
    pub no_support: bool,
    /// The fingertip stays this far above the support, metres, ≥ 0.
    pub support_clearance: f64,
    /// The support plane, instead of the scene's.
    pub support: Option<HalfSpace>,
    /// Half-spaces that the whole fingertip stays in.
    pub keep_in: Vec<HalfSpace>,
    /// Directions to press in.
    pub approach: Option<ApproachCone>,
    /// Box that the whole fingertip stays in.
    pub workspace: Option<Workspace>,
}

/// All x with normal · x ≥ offset, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HalfSpace {
    /// Direction inwards; need not have length 1 (the offset counts for the unit normal).
    pub normal: [f64; 3],
    /// Distance of the border from the origin along the unit normal, metres.
    pub offset: f64,
}

/// Directions within an angle of one, world frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachCone {
    /// Direction in which the fingertip would move best; [0, 0, −1] presses down.
    pub direction: [f64; 3],
    /// Largest angle to it, degrees, in (0, 180].
    pub max_angle_deg: f64,
}

/// A box, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Workspace {
    /// Lower corner.
    pub min: [f64; 3],
    /// Upper corner.
    pub max: [f64; 3],
}

impl HalfSpace {
    fn plane(&self, field: &'static str) -> Result<Plane, ExploreError> {
        let fault = |found| ExploreError::Params { field, found, needed: "a plane: finite, its normal not zero" };
        let normal = Vector::from(self.normal);
        let unit = normal.try_normalize(1e-9).filter(|n| n.iter().all(|c| c.is_finite()) && self.offset.is_finite());
        let unit = unit.ok_or_else(|| fault(if self.offset.is_finite() { normal.norm() } else { self.offset }))?;
        Plane::new(unit, &Point::from(unit * self.offset)).ok_or_else(|| fault(self.offset))
    }
}

/// The tests of a pose, ready to use.
pub(super) struct Reachable {
    planes: Vec<Plane>,
    cone: Option<(Vector, f64)>,
}

impl Reach {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`ExploreError::Params`] with field, value and rule.
    pub fn validate(&self) -> Result<(), ExploreError> {
        self.prepare(None, true).map(|_| ())
    }

    /// * `seen` – the scene's support plane, if it has one
    pub(super) fn prepare(&self, seen: Option<&Plane>, lenient: bool) -> Result<Reachable, ExploreError> {
        let clearance = self.support_clearance;
        if !(clearance >= 0.0 && clearance.is_finite()) {
            let needed = "at least 0 and finite";
            return Err(ExploreError::Params { field: "reach.support_clearance", found: clearance, needed });
        }
        let stated = self.support.map(|s| s.plane("reach.support")).transpose()?;
        let support = stated.or(seen.copied()).filter(|_| !self.no_support);
        if support.is_none() && !self.no_support && !lenient {
            return Err(ExploreError::NoSupport);
        }
        let mut planes: Vec<Plane> =
            support.map(|p| Plane { normal: p.normal, offset: p.offset + clearance }).into_iter().collect();
        for half in &self.keep_in {
            planes.push(half.plane("reach.keep_in")?);
        }
        if let Some(Workspace { min, max }) = self.workspace {
            for axis in 0..3 {
                if !(min[axis] < max[axis] && (max[axis] - min[axis]).is_finite()) {
                    let needed = "finite, with min below max on every axis";
                    return Err(ExploreError::Params { field: "reach.workspace", found: min[axis], needed });
                }
                let mut normal = [0.0; 3];
                normal[axis] = 1.0;
                planes.push(HalfSpace { normal, offset: min[axis] }.plane("reach.workspace")?);
                normal[axis] = -1.0;
                planes.push(HalfSpace { normal, offset: -max[axis] }.plane("reach.workspace")?);
            }
        }
        let cone = self.approach.map(|c| c.prepare()).transpose()?;
        Ok(Reachable { planes, cone })
    }
}

impl ApproachCone {
    fn prepare(&self) -> Result<(Vector, f64), ExploreError> {
        let angle = self.max_angle_deg;
        if !(angle > 0.0 && angle <= 180.0) {
            let needed = "in (0, 180]";
            return Err(ExploreError::Params { field: "reach.approach.max_angle_deg", found: angle, needed });
        }
        let direction = Vector::from(self.direction);
        let unit = direction.try_normalize(1e-9).filter(|d| d.iter().all(|c| c.is_finite()));
        let found = direction.norm();
        let fault = ExploreError::Params { field: "reach.approach.direction", found, needed: "finite and not zero" };
        Ok((unit.ok_or(fault)?, angle.to_radians().cos()))
    }
}

impl Reachable {
    /// Whether a fingertip at this pose lies where it may: a box over the pad, from `behind` to `ahead` along the sensor's z, metres.
    pub(super) fn allows(&self, world_from_tip: &Isometry, sensor: &TactileSensor, behind: f64, ahead: f64) -> bool {
        let (w, h) = sensor.pad_size();
        let mut corners = [-0.5, 0.5].into_iter().flat_map(|x| {
            [-0.5, 0.5].into_iter().flat_map(move |y| [-behind, ahead].map(|z| Point::new(x * w, y * h, z)))
        });
        let inside = |p: Point| self.planes.iter().all(|plane| plane.signed_distance(&(world_from_tip * p)) >= 0.0);
        let press = world_from_tip * Vector::z();
        self.cone.is_none_or(|(d, cosine)| press.dot(&d) >= cosine) && corners.all(inside)
    }
}
