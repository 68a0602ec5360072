use super::CameraError;
use crate::geometry::{Point, Vector};
use nalgebra::{Matrix2x3, SMatrix};
use serde::{Deserialize, Serialize};

/// Round trips of valid cameras are exact to this, pixels.
const ROUND_TRIP_PX: f64 = 1e-3;

/// A pinhole camera with Brown–Conrady distortion. Pixel (u, v) has integer coordinates at its centre (OpenCV).
///
/// With x = X/Z, y = Y/Z, r² = x² + y² and L = 1 + k1 r² + k2 r⁴ + k3 r⁶ the image point is
/// u = fx (x L + 2 p1 x y + p2 (r² + 2 x²)) + cx, v = fy (y L + p1 (r² + 2 y²) + 2 p2 x y) + cy.
///
/// # References
/// Brown, *Decentering distortion of lenses*, Photogrammetric Engineering 32(3), 1966.
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
    /// Whether the lens bends rays at all.
    pub fn is_distorted(&self) -> bool {
        self.distortion.iter().any(|&k| k != 0.0)
    }

    /// The ray of a pixel: the undistorted direction with z = 1, camera frame.
    ///
    /// The distortion is inverted by Newton's method; for a camera that passes [`Self::validate`] it converges at every pixel.
    #[inline]
    pub fn ray(&self, u: f64, v: f64) -> Vector {
        let (xd, yd) = ((u - self.cx) / self.fx, (v - self.cy) / self.fy);
        let (x, y) = if self.is_distorted() { self.undistort(xd, yd) } else { (xd, yd) };
        Vector::new(x, y, 1.0)
    }

    /// How the ray changes per pixel along u and along v.
    pub fn ray_derivatives(&self, u: f64, v: f64) -> (Vector, Vector) {
        if !self.is_distorted() {
            return (Vector::new(1.0 / self.fx, 0.0, 0.0), Vector::new(0.0, 1.0 / self.fy, 0.0));
        }
        let ray = self.ray(u, v);
        let [[a, b], [c, d]] = self.distortion_jacobian(ray.x, ray.y);
        let det = a * d - b * c;
        (Vector::new(d, -c, 0.0) / (det * self.fx), Vector::new(-b, a, 0.0) / (det * self.fy))
    }

    /// Pixel (u, v) of a point in the camera frame; `None` at or behind the camera plane.
    #[inline]
    pub fn project(&self, p: &Point) -> Option<(f64, f64)> {
        if p.z <= 1e-9 {
            return None;
        }
        let (mut x, mut y) = (p.x / p.z, p.y / p.z);
        if self.is_distorted() {
            (x, y) = self.distort(x, y);
        }
        Some((self.fx * x + self.cx, self.fy * y + self.cy))
    }

    /// Pixel (u, v) of a point in the camera frame, how it changes with the point, and with fx, fy, cx, cy, k1, k2, p1, p2, k3;
    /// `None` at or behind the camera plane.
    pub fn project_with_jacobians(&self, p: &Point) -> Option<([f64; 2], Matrix2x3<f64>, SMatrix<f64, 2, 9>)> {
        if p.z <= 1e-9 {
            return None;
        }
        let (x, y) = (p.x / p.z, p.y / p.z);
        let (xd, yd) = self.distort(x, y);
        let [[a, b], [c, d]] = self.distortion_jacobian(x, y);
        let (fx, fy) = (self.fx, self.fy);
        let by_point =
            Matrix2x3::new(fx * a, fx * b, -fx * (a * x + b * y), fy * c, fy * d, -fy * (c * x + d * y)) / p.z;
        let r2 = x * x + y * y;
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        #[rustfmt::skip]
        let by_camera = SMatrix::<f64, 2, 9>::from_row_slice(&[
            xd, 0.0, 1.0, 0.0, fx * x * r2, fx * x * r4, fx * 2.0 * x * y, fx * (r2 + 2.0 * x * x), fx * x * r6,
            0.0, yd, 0.0, 1.0, fy * y * r2, fy * y * r4, fy * (r2 + 2.0 * y * y), fy * 2.0 * x * y, fy * y * r6,
        ]);
        Some(([fx * xd + self.cx, fy * yd + self.cy], by_point, by_camera))
    }

    /// Whether a pixel position lies on the image; the outer half pixel counts.
    pub fn contains(&self, u: f64, v: f64) -> bool {
        (-0.5..self.width as f64 - 0.5).contains(&u) && (-0.5..self.height as f64 - 0.5).contains(&v)
    }

    /// Checks that sizes and focal lengths are positive, all numbers finite, and the distortion invertible all over the image.
    ///
    /// # Errors
    /// [`CameraError::Intrinsics`] names the first parameter that is out of range; [`CameraError::NotInvertible`] the pixel.
    pub fn validate(&self) -> Result<(), CameraError> {
        const SIZE: &str = "between 1 and 65536 pixels";
        const FOCAL: &str = "finite and positive, in pixels";
        let check = |ok: bool, field, value, rule| {
            if ok { Ok(()) } else { Err(CameraError::Intrinsics { field, value, rule }) }
        };
        check((1..=65536).contains(&self.width), "width", self.width as f64, SIZE)?;
        check((1..=65536).contains(&self.height), "height", self.height as f64, SIZE)?;
        check(self.fx.is_finite() && self.fx > 0.0, "fx", self.fx, FOCAL)?;
        check(self.fy.is_finite() && self.fy > 0.0, "fy", self.fy, FOCAL)?;
        check(self.cx.is_finite(), "cx", self.cx, "finite, in pixels")?;
        check(self.cy.is_finite(), "cy", self.cy, "finite, in pixels")?;
        for (field, value) in ["k1", "k2", "p1", "p2", "k3"].into_iter().zip(self.distortion) {
            check(value.is_finite(), field, value, "finite")?;
        }
        if self.is_distorted() { self.validate_distortion() } else { Ok(()) }
    }

    /// Distortion is worst far from the centre, but may fold anywhere: a coarse grid over the image covers both.
    fn validate_distortion(&self) -> Result<(), CameraError> {
        const STEPS: usize = 16;
        for i in 0..=STEPS {
            for j in 0..=STEPS {
                let u = (self.width - 1) as f64 * j as f64 / STEPS as f64;
                let v = (self.height - 1) as f64 * i as f64 / STEPS as f64;
                let ray = self.ray(u, v);
                let [[a, b], [c, d]] = self.distortion_jacobian(ray.x, ray.y);
                let error_px = self.project(&Point::from(ray)).map_or(f64::INFINITY, |(pu, pv)| (pu - u).hypot(pv - v));
                // A negative determinant is a second root beyond the fold.
                if !(error_px < ROUND_TRIP_PX && a * d - b * c > 0.0) {
                    return Err(CameraError::NotInvertible { distortion: self.distortion, u, v, error_px });
                }
            }
        }
        Ok(())
    }

    fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// Jacobian of [`Self::distort`], rows of outputs.
    fn distortion_jacobian(&self, x: f64, y: f64) -> [[f64; 2]; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)); // d radial / d x = slope · x
        let cross = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        [
            [radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, cross],
            [cross, radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x],
        ]
    }

    fn undistort(&self, xd: f64, yd: f64) -> (f64, f64) {
        let (mut x, mut y) = (xd, yd);
        for _ in 0..30 {
            let (px, py) = self.distort(x, y);
            let (ex, ey) = (px - xd, py - yd);
            let [[a, b], [c, d]] = self.distortion_jacobian(x, y);
            let det = a * d - b * c;
            // Near a fold Newton's step explodes; the fixed-point step stays put.
            let (dx, dy) = if det > 0.05 { ((d * ex - b * ey) / det, (a * ey - c * ex) / det) } else { (ex, ey) };
            x -= dx;
            y -= dy;
            if dx.abs() + dy.abs() < 1e-14 {
                break;
            }
        }
        (x, y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(distortion: [f64; 5]) -> PinholeCamera {
        PinholeCamera { width: 640, height: 480, fx: 536.3, fy: 535.1, cx: 341.8, cy: 235.6, distortion }
    }

    #[test]
    fn projecting_a_ray_returns_its_pixel() {
        // The second is the calibration of OpenCV's sample images.
        for distortion in [[0.0; 5], [-0.265, -0.047, 0.0018, -0.0003, 0.252], [0.12, -0.3, -0.002, 0.003, 0.1]] {
            let camera = camera(distortion);
            camera.validate().expect("a real camera");
            for (u, v) in [(0.0, 0.0), (639.0, 479.0), (341.8, 235.6), (12.25, 400.5), (600.0, 3.0)] {
                let (pu, pv) = camera.project(&Point::from(camera.ray(u, v) * 0.7)).expect("in front");
                assert!((pu - u).hypot(pv - v) < 1e-9, "{distortion:?} ({u}, {v}) came back as ({pu}, {pv})");
            }
        }
    }

    #[test]
    fn jacobians_are_the_differences_of_projections() {
        let (camera, p) = (camera([-0.265, -0.047, 0.0018, -0.0003, 0.252]), Point::new(0.13, -0.21, 0.6));
        let (pixel, by_point, by_camera) = camera.project_with_jacobians(&p).expect("in front");
        assert_eq!(camera.project(&p), Some((pixel[0], pixel[1])));
        let h = 1e-6;
        for k in 0..3 {
            let (mut low, mut high) = (p, p);
            (low[k], high[k]) = (p[k] - h, p[k] + h);
            let (a, b) = (camera.project(&low).expect("in front"), camera.project(&high).expect("in front"));
            let found = [(b.0 - a.0) / (2.0 * h), (b.1 - a.1) / (2.0 * h)];
            assert!((found[0] - by_point[(0, k)]).abs() < 1e-4 && (found[1] - by_point[(1, k)]).abs() < 1e-4, "{k}");
        }
        let with = |k: usize, by: f64| {
            let mut c = camera;
            match k {
                0 => c.fx += by,
                1 => c.fy += by,
                2 => c.cx += by,
                3 => c.cy += by,
                _ => c.distortion[k - 4] += by,
            }
            c.project(&p).expect("in front")
        };
        for k in 0..9 {
            let (a, b) = (with(k, -h), with(k, h));
            let found = [(b.0 - a.0) / (2.0 * h), (b.1 - a.1) / (2.0 * h)];
            assert!((found[0] - by_camera[(0, k)]).abs() < 1e-4 && (found[1] - by_camera[(1, k)]).abs() < 1e-4, "{k}");
        }
    }

    #[test]
    fn distortion_follows_opencv() {
        // cv::projectPoints of (0.3, -0.2, 1) written out by hand: r² = 0.13.
        let camera = PinholeCamera { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0, ..camera([0.1, 0.2, 0.01, 0.02, 0.3]) };
        let (u, v) = camera.project(&Point::new(0.3, -0.2, 1.0)).expect("in front");
        let radial = 1.0 + 0.1 * 0.13 + 0.2 * 0.0169 + 0.3 * 0.002197;
        assert!((u - (0.3 * radial + 2.0 * 0.01 * -0.06 + 0.02 * (0.13 + 0.18))).abs() < 1e-15);
        assert!((v - (-0.2 * radial + 0.01 * (0.13 + 0.08) + 2.0 * 0.02 * -0.06)).abs() < 1e-15);
    }

    #[test]
    fn ray_derivatives_match_differences() {
        let camera = camera([-0.265, -0.047, 0.0018, -0.0003, 0.252]);
        let (du, dv) = camera.ray_derivatives(100.0, 50.0);
        let h = 1e-4;
        let numeric_u = (camera.ray(100.0 + h, 50.0) - camera.ray(100.0 - h, 50.0)) / (2.0 * h);
        let numeric_v = (camera.ray(100.0, 50.0 + h) - camera.ray(100.0, 50.0 - h)) / (2.0 * h);
        assert!((du - numeric_u).norm() < 1e-9 && (dv - numeric_v).norm() < 1e-9);
    }

    #[test]
    fn validate_names_the_parameter() {
        let wrong = PinholeCamera { fy: -1.0, ..camera([0.0; 5]) };
        assert!(matches!(wrong.validate(), Err(CameraError::Intrinsics { field: "fy", .. })));
        let wrong = PinholeCamera { width: 0, ..camera([0.0; 5]) };
        assert!(matches!(wrong.validate(), Err(CameraError::Intrinsics { field: "width", .. })));
        let wrong = camera([0.0, 0.0, f64::NAN, 0.0, 0.0]);
        assert!(matches!(wrong.validate(), Err(CameraError::Intrinsics { field: "p1", .. })));
        // Strong barrel distortion turns back on itself before the corner.
        assert!(matches!(camera([-2.5, 0.0, 0.0, 0.0, 0.0]).validate(), Err(CameraError::NotInvertible { .. })));
    }

    #[test]
    fn nothing_is_seen_behind_the_camera() {
        assert_eq!(camera([0.0; 5]).project(&Point::new(0.1, 0.1, -0.5)), None);
        assert!(camera([0.0; 5]).contains(-0.4, 479.4) && !camera([0.0; 5]).contains(639.6, 0.0));
    }
}
