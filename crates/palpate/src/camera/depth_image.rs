use super::PinholeCamera;
use crate::geometry::{Isometry, Plane, Raster};

/// What a pixel without a reading says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Background {
    /// Nothing is there: the whole ray is free.
    Absent,
    /// The sensor failed: nothing is known.
    Unknown,
}

/// Depth noise model: σ(z) = `sigma` + `sigma_quadratic` · z², metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthNoise {
    /// Constant part, metres.
    pub sigma: f64,
    /// Quadratic part, 1/metre.
    pub sigma_quadratic: f64,
}

impl DepthNoise {
    /// Standard deviation of a reading at depth `z`, metres.
    pub fn sigma_at(&self, z: f64) -> f64 {
        self.sigma + self.sigma_quadratic * z * z
    }
}

/// One RGB-D frame and what is known of where it was taken.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Model of the depth camera.
    pub camera: PinholeCamera,
    /// Camera pose.
    pub world_from_camera: Isometry,
    /// Metres along the optical axis; NaN = no reading. Shape (height, width).
    pub depth: Raster<f32>,
    /// What NaN means.
    pub background: Background,
    /// Depth noise.
    pub noise: DepthNoise,
    /// sRGB, registered to the depth image.
    pub color: Option<Raster<[u8; 3]>>,
    /// True where the object is seen; absent = to be segmented.
    pub mask: Option<Raster<bool>>,
    /// Support plane in the **world** frame, normal up; absent = to be estimated.
    pub support: Option<Plane>,
}
