use crate::geometry::{Isometry, Raster};

/// What the gel felt: its deformed surface and where the object touched it.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// z of the gel surface in the sensor frame, metres (indented < 0). Row, col over the whole pad.
    pub height_map: Raster<f32>,
    /// True where the object touches; same shape.
    pub mask: Raster<bool>,
}

/// One press of the fingertip.
#[derive(Debug, Clone)]
pub struct Touch {
    /// Recorded height map and mask, if any.
    pub contact: Option<Contact>,
    /// Tactile image, sRGB, if any.
    pub image: Option<Raster<[u8; 3]>>,
    /// Pose of the sensor frame in the pressed pose.
    pub world_from_sensor: Isometry,
}
