use crate::geometry::Raster;

/// Shape of the relaxed gel in the sensor frame: z, metres, 0 at the apex, ≤ 0 elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub enum RelaxedGel {
    /// z = 0 everywhere.
    Flat,
    /// A sphere cap with its apex at the pad's centre.
    Dome {
        /// Radius of the sphere, metres.
        radius: f64,
    },
    /// A measured surface of any resolution that spans the pad.
    Map(Raster<f32>),
}

/// Geometry of a visuo-tactile fingertip.
#[derive(Debug, Clone, PartialEq)]
pub struct TactileSensor {
    /// Preset name, or "custom".
    pub model: String,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Size of a sensor pixel on the gel, metres.
    pub pixel_pitch: f64,
    /// Shape of the gel when nothing touches it.
    pub relaxed_gel: RelaxedGel,
}
