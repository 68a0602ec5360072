use crate::geometry::{Point, Vector};
use serde::{Deserialize, Serialize};

/// A pinhole camera with Brown–Conrady distortion. Pixel (u, v) has integer coordinates at its centre (OpenCV).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PinholeCamera {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Focal length along u, pixels.
    pub fx: f64,
    /// Focal length along v, pixels.
    pub fy: f64,
    /// Principal point, u.
    pub cx: f64,
    /// Principal point, v.
    pub cy: f64,
    /// Distortion in OpenCV's order: k1 k2 p1 p2 k3.
    pub distortion: [f64; 5],
}

impl PinholeCamera {
    /// The ray of a pixel: the undistorted direction with z = 1, camera frame.
    pub fn ray(&self, u: f64, v: f64) -> Vector {
        Vector::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// Pixel (u, v) of a point in the camera frame; `None` at or behind the camera plane.
    pub fn project(&self, p: &Point) -> Option<(f64, f64)> {
        (p.z > 1e-9).then(|| (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy))
    }
}
