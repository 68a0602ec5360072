use super::reach::Reachable;
use super::{ExploreError, NextTouchParams};
use crate::camera::segment_object;
use crate::evidence::Evidence;
use crate::geometry::{Isometry, Plane, Point, TriangleMesh, Vector};
use crate::scene::Scene;
use crate::simulate::{aim, sample_surface};
use crate::tactile::{PressError, PressParams, Pressed, TactileSensor, press};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;

/// Width of the maps that candidates are tried with, pixels: 0.6 mm a pixel on a pad of 19 mm.
const TRIAL_COLS: usize = 32;
/// Places drawn for each candidate wanted before giving up.
const DRAWS: usize = 60;

/// A pose in which the fingertip is expected to touch the object.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The aimed surface point and the approach: +z into the object.
    pub world_from_aim: Isometry,
    /// Expected pose of the sensor frame when pressed.
    pub world_from_sensor: Isometry,
    /// The aimed point on the current surface, world frame, metres.
    pub point: Point,
    /// The surface's outward normal there.
    pub normal: Vector,
    /// Points of the current surface expected under the pad, world frame.
    pub footprint: Vec<Point>,
}

/// What does not change while an object is explored: the sensor, the free space, and what the arm can reach.
pub struct Planner {
    sensor: TactileSensor,
    reachable: Reachable,
    seen: Evidence,
    approach: f64,
    free_tolerance: f64,
    press: PressParams,
}

impl Planner {
    /// Prepares the tests of poses for a scene; its touches do not matter.
    ///
    /// # Errors
    /// [`ExploreError::NoSupport`] if neither the scene nor the reach says where the support is; others if the object cannot be seen.
    pub fn new(scene: &Scene, params: &NextTouchParams) -> Result<Self, ExploreError> {
        params.validate()?;
        let sensor = match &scene.sensor {
            Some(sensor) => sensor.clone(),
            None => TactileSensor::preset(&params.sensor)?,
        };
        sensor.validate()?;
        let reconstruct = &params.reconstruct;
        let mut segment = reconstruct.segment.clone();
        segment.seed = segment.seed.wrapping_add(reconstruct.seed);
        let visible = segment_object(&scene.frame, &segment)?;
        let reachable = params.reach.prepare(visible.support.as_ref(), false)?;
        let seen = Evidence::gather(&scene.frame, &visible, &[], &reconstruct.evidence)?;
        let (approach, free_tolerance) = (params.approach, params.free_tolerance);
        Ok(Self { sensor, reachable, seen, approach, free_tolerance, press: params.press.clone() })
    }

    /// The fingertip.
    pub fn sensor(&self) -> &TactileSensor {
        &self.sensor
    }

    /// The support plane that is seen or stated in the scene.
    pub fn support(&self) -> Option<&Plane> {
        self.seen.support.as_ref()
    }

    /// Whether the fingertip may be at this pose: above the support and within reach, body included.
    pub fn allows(&self, world_from_sensor: &Isometry) -> bool {
        self.reachable.allows(world_from_sensor, &self.sensor, self.approach.max(self.press.body_length), 0.0)
    }

    /// Up to `count` reachable poses, area-uniform over the current surface, seeded.
    ///
    /// A place is left out if it lies in space that the camera proves free, within half a pad of a place in `missed`; or if for four
    /// yaws the fingertip leaves its reach, the pad does not fit (more than [`PressParams::max_retreat`] before the aimed point
    /// something else is touched), or the object is in the way of the approach.
    ///
    /// # Errors
    /// [`ExploreError::NothingReachable`] if there is none.
    pub fn candidates(
        &self,
        mesh: &TriangleMesh,
        count: usize,
        seed: u64,
        missed: &[Point],
    ) -> Result<Vec<Candidate>, ExploreError> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x9e37_79b9_7f4a_7c15);
        let draws: Vec<(Point, Vector, [f64; 4])> = sample_surface(mesh, DRAWS * count, &mut rng)
            .into_iter()
            .map(|(p, n)| (p, n, [(); 4].map(|()| TAU * rng.random::<f64>())))
            .collect();
        let apart = 0.5 * self.sensor.pad_size().0.min(self.sensor.pad_size().1);
        let (mut found, mut too_low, mut blocked, mut tried) = (Vec::new(), 0, 0, 0);
        for (point, normal, yaws) in draws {
            if found.len() == count {
                break;
            }
            tried += 1;
            if self.seen.free_space.clearance(&point) > self.free_tolerance
                || missed.iter().any(|m| (m - point).norm() < apart)
            {
                blocked += 1;
                continue;
            }
            let poses = yaws.map(|yaw| aim(&point, &normal, yaw));
            let above = |p: &Isometry| {
                self.reachable.allows(p, &self.sensor, self.approach.max(self.press.body_length), self.press.depth)
            };
            let Some(pose) = poses.into_iter().find(above) else {
                too_low += 1;
                continue;
            };
            match self.expect(mesh, &pose) {
                Some(footprint_and_pose) => {
                    let (footprint, world_from_sensor) = footprint_and_pose;
                    found.push(Candidate { world_from_aim: pose, world_from_sensor, point, normal, footprint });
                }
                None => blocked += 1,
            }
        }
        if found.is_empty() {
            return Err(ExploreError::NothingReachable { tried, too_low, blocked });
        }
        Ok(found)
    }

    /// The press as it would be if the current surface were right: points under the pad, and the pressed pose.
    fn expect(&self, mesh: &TriangleMesh, pose: &Isometry) -> Option<(Vec<Point>, Isometry)> {
        let params = PressParams {
            body_length: self.approach.max(self.press.body_length),
            kernels: Vec::new(),
            ..self.press.clone()
        };
        let Pressed { contact, world_from_sensor, .. } = press(mesh, pose, &self.sensor, TRIAL_COLS, &params).ok()?;
        let (rows, cols) = contact.mask.shape();
        let mut points = Vec::new();
        for row in (1..rows).step_by((rows / 4).max(1)) {
            for col in (1..cols).step_by((cols / 5).max(1)) {
                if contact.mask[(row, col)] {
                    let (x, y) = self.sensor.pixel_position(row, col, rows, cols);
                    points.push(world_from_sensor * Point::new(x, y, f64::from(contact.height_map[(row, col)])));
                }
            }
        }
        Some((points, world_from_sensor))
    }

    /// A guarded move on the true mesh: the fingertip comes from `approach` before the aimed point and stops at first contact, wherever
    /// that is, presses, and gives up `approach` past the aimed point or where it would leave its reach.
    ///
    /// * `cols` – width of the height map, pixels
    ///
    /// # Errors
    /// Why it is a miss.
    pub fn guarded_press(
        &self,
        truth: &TriangleMesh,
        candidate: &Candidate,
        cols: usize,
    ) -> Result<Pressed, PressError> {
        let length = 2.0 * self.approach.max(self.press.body_length);
        let params = PressParams { max_retreat: self.approach, body_length: length, ..self.press.clone() };
        let pressed = press(truth, &candidate.world_from_aim, &self.sensor, cols, &params)?;
        let travel = (candidate.world_from_aim.inverse() * Point::from(pressed.world_from_sensor.translation.vector)).z;
        if travel > self.approach || !self.allows(&pressed.world_from_sensor) {
            return Err(PressError::Missed);
        }
        Ok(pressed)
    }
}
