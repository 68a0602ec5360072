//! What was recorded of one object: a frame, a sensor and some touches. Values only; files are the business of [`crate::io`].

use crate::camera::Frame;
use crate::tactile::{TactileSensor, Touch};

/// Standard deviation of a touch pose, per axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseSigma {
    /// Metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// Everything that a reconstruction may read. The truth is not part of it.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Name of the object or recording.
    pub name: String,
    /// The RGB-D frame.
    pub frame: Frame,
    /// The fingertip; present if there are touches.
    pub sensor: Option<TactileSensor>,
    /// Uncertainty of the touch poses.
    pub pose_sigma: PoseSigma,
    /// Touches in the order taken.
    pub touches: Vec<Touch>,
}
