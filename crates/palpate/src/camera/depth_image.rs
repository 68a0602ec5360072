use super::{CameraError, PinholeCamera};
use crate::geometry::{Isometry, Plane, Point, Raster};

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

    /// This model, or where nothing is stated a typical one: 1 mm at 0.7 m, half of it growing with z².
    pub fn or_typical(self) -> Self {
        if self.sigma > 0.0 || self.sigma_quadratic > 0.0 { self } else { Self { sigma: 5e-4, sigma_quadratic: 1e-3 } }
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

impl Frame {
    /// Checks the camera, the sizes of all images, the noise model, and that there is something to see.
    ///
    /// # Errors
    /// The first fault found, as a [`CameraError`] that names the image, the pixel or the parameter.
    pub fn validate(&self) -> Result<(), CameraError> {
        self.camera.validate()?;
        self.check_size("depth", self.depth.shape())?;
        if let Some(color) = &self.color {
            self.check_size("color", color.shape())?;
        }
        if let Some(mask) = &self.mask {
            self.check_size("mask", mask.shape())?;
            if !mask.as_slice().contains(&true) {
                return Err(CameraError::EmptyMask { pixels: mask.as_slice().len() });
            }
        }
        for (field, value) in [("sigma", self.noise.sigma), ("sigma_quadratic", self.noise.sigma_quadratic)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(CameraError::Noise { field, value });
            }
        }
        if let Some((row, col, &value)) =
            self.depth.pixels().find(|(_, _, z)| !(z.is_nan() || z.is_finite() && **z > 0.0))
        {
            return Err(CameraError::Reading { col, row, value });
        }
        if self.depth.as_slice().iter().all(|z| z.is_nan()) {
            return Err(CameraError::NoReading { pixels: self.depth.as_slice().len() });
        }
        Ok(())
    }

    fn check_size(&self, image: &'static str, (found_rows, found_cols): (usize, usize)) -> Result<(), CameraError> {
        let (width, height) = (self.camera.width, self.camera.height);
        if (found_rows, found_cols) == (height, width) {
            Ok(())
        } else {
            Err(CameraError::Size { image, found_cols, found_rows, width, height })
        }
    }

    /// Every reading as a point in the **camera** frame; NaN where there is none.
    ///
    /// # References
    /// Hartley & Zisserman, *Multiple View Geometry*, 2nd ed., §6.1.
    pub fn unproject(&self) -> Raster<Point> {
        let (rows, cols) = self.depth.shape();
        Raster::par_from_fn(rows, cols, |row, col| {
            let z = f64::from(self.depth[(row, col)]);
            if z.is_nan() {
                Point::new(f64::NAN, f64::NAN, f64::NAN)
            } else {
                Point::from(self.camera.ray(col as f64, row as f64) * z)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Frame {
        let camera = PinholeCamera { width: 8, height: 6, fx: 10.0, fy: 10.0, cx: 3.5, cy: 2.5, distortion: [0.0; 5] };
        Frame {
            camera,
            world_from_camera: Isometry::identity(),
            depth: Raster::filled(6, 8, 0.5),
            background: Background::Unknown,
            noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
            color: None,
            mask: None,
            support: None,
        }
    }

    #[test]
    fn unproject_then_project_is_identity() {
        let frame = frame();
        for (row, col, p) in frame.unproject().pixels() {
            let (u, v) = frame.camera.project(p).expect("in front");
            assert!((u - col as f64).hypot(v - row as f64) < 1e-12 && p.z == 0.5);
        }
    }

    #[test]
    fn faults_are_named() {
        assert_eq!(frame().validate(), Ok(()));
        let empty = Frame { depth: Raster::filled(6, 8, f32::NAN), ..frame() };
        assert_eq!(empty.validate(), Err(CameraError::NoReading { pixels: 48 }));
        let small = Frame { color: Some(Raster::filled(6, 7, [0; 3])), ..frame() };
        assert!(matches!(small.validate(), Err(CameraError::Size { image: "color", found_cols: 7, width: 8, .. })));
        let blind = Frame { mask: Some(Raster::filled(6, 8, false)), ..frame() };
        assert_eq!(blind.validate(), Err(CameraError::EmptyMask { pixels: 48 }));
        let mut negative = frame();
        negative.depth[(2, 3)] = -0.1;
        assert_eq!(negative.validate(), Err(CameraError::Reading { col: 3, row: 2, value: -0.1 }));
        let noisy = Frame { noise: DepthNoise { sigma: -1.0, sigma_quadratic: 0.0 }, ..frame() };
        assert!(matches!(noisy.validate(), Err(CameraError::Noise { field: "sigma", .. })));
    }

    #[test]
    fn typical_noise_is_one_millimetre_at_seventy_centimetres() {
        let typical = DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 }.or_typical();
        assert!((typical.sigma_at(0.7) - 1e-3).abs() < 2e-5);
        let stated = DepthNoise { sigma: 2e-3, sigma_quadratic: 0.0 };
        assert_eq!(stated.or_typical(), stated);
    }
}
