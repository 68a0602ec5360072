use super::Frame;
use crate::geometry::{Plane, Point, PointCloud, Raster, Vector};

/// The object's visible side: denoised depth and oriented normals on the camera's raster.
#[derive(Debug, Clone)]
pub struct Visible {
    /// True where the object is seen (before denoising dropped any pixel).
    pub mask: Raster<bool>,
    /// Denoised depth, metres; NaN where there is no trustworthy reading **of the object**.
    pub depth: Raster<f32>,
    /// Unit normals in the **camera** frame, facing the camera; zero where `depth` is NaN.
    pub normals: Raster<[f32; 3]>,
    /// Support plane in the **world** frame, given or estimated.
    pub support: Option<Plane>,
    /// Share of the object's outline that lies on the image border (0 = the object is seen whole).
    pub border_share: f64,
}

impl Visible {
    /// The visible points with normals (and colours, if the frame has them), **world** frame, row-major order.
    pub fn cloud(&self, frame: &Frame) -> PointCloud {
        let mut cloud = PointCloud { points: Vec::new(), normals: None, colors: None };
        let (mut normals, mut colors) = (Vec::new(), Vec::new());
        for (row, col, &z) in self.depth.pixels() {
            if !z.is_finite() {
                continue;
            }
            let ray = frame.camera.ray(col as f64, row as f64);
            cloud.points.push(frame.world_from_camera * Point::from(ray * f64::from(z)));
            let n = self.normals[(row, col)];
            normals.push(frame.world_from_camera * Vector::new(n[0].into(), n[1].into(), n[2].into()));
            if let Some(color) = &frame.color {
                colors.push(color[(row, col)]);
            }
        }
        cloud.normals = Some(normals);
        cloud.colors = frame.color.as_ref().map(|_| colors);
        cloud
    }
}
