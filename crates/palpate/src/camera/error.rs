/// Why a camera or a frame cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// A parameter of the camera model is out of range.
    #[error("camera {field} is {value}; it must be {rule}")]
    Intrinsics {
        /// Name of the parameter.
        field: &'static str,
        /// What was found.
        value: f64,
        /// What is needed.
        rule: &'static str,
    },
    /// The distortion folds the image over itself, so that a pixel has no single ray.
    #[error(
        "distortion {distortion:?} cannot be inverted at pixel ({u}, {v}): it comes back {error_px:.2} px off; check the order k1 k2 p1 p2 k3"
    )]
    NotInvertible {
        /// The coefficients, k1 k2 p1 p2 k3.
        distortion: [f64; 5],
        /// Column of the pixel.
        u: f64,
        /// Row of the pixel.
        v: f64,
        /// How far the round trip misses, pixels.
        error_px: f64,
    },
    /// An image of the frame has not the camera's size.
    #[error("the {image} image is {found_cols} x {found_rows} pixels, the camera {width} x {height}")]
    Size {
        /// Which image.
        image: &'static str,
        /// Columns found.
        found_cols: usize,
        /// Rows found.
        found_rows: usize,
        /// Columns needed.
        width: usize,
        /// Rows needed.
        height: usize,
    },
    /// A depth reading is infinite, zero or negative.
    #[error("depth at pixel ({col}, {row}) is {value} m; readings are positive, NaN where there is none")]
    Reading {
        /// Column.
        col: usize,
        /// Row.
        row: usize,
        /// What was found, metres.
        value: f32,
    },
    /// The depth image holds nothing.
    #[error("the depth image holds no reading: all {pixels} pixels are empty")]
    NoReading {
        /// Number of pixels looked at.
        pixels: usize,
    },
    /// The mask marks nothing.
    #[error("the mask marks no pixel of {pixels}; 255 = object")]
    EmptyMask {
        /// Number of pixels looked at.
        pixels: usize,
    },
    /// A parameter of the noise model is out of range.
    #[error("depth noise {field} is {value}; it must be finite and not negative")]
    Noise {
        /// Name of the parameter.
        field: &'static str,
        /// What was found.
        value: f64,
    },
}
