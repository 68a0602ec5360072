/// Why a cloud could not be meshed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SurfaceError {
    /// There are too few points to span a surface.
    #[error("{found} distinct points; at least {needed} are required")]
    TooFewPoints {
        /// Points in the cloud, duplicates counted once.
        found: usize,
        /// Points needed.
        needed: usize,
    },
    /// The cloud has no normals.
    #[error("the cloud has no normals; an outward unit normal per point is required")]
    NoNormals,
    /// A coordinate or a normal is NaN or infinite.
    #[error("point {index} is not finite (position or normal)")]
    NotFinite {
        /// Index of the first such point.
        index: usize,
    },
    /// A normal has no direction.
    #[error("the normal of point {index} has length {length:e}; a direction is required")]
    ZeroNormal {
        /// Index of the first such point.
        index: usize,
        /// Its length.
        length: f64,
    },
    /// There must be one weight per point.
    #[error("{found} weights for {needed} points")]
    WeightCount {
        /// Weights given.
        found: usize,
        /// Points in the cloud.
        needed: usize,
    },
    /// A weight is negative, NaN or infinite.
    #[error("the weight of point {index} is {weight}; a finite number of at least 0 is required")]
    InvalidWeight {
        /// Index of the first such point.
        index: usize,
        /// The weight found.
        weight: f64,
    },
    /// The points do not span a volume.
    #[error("the points span no volume: extent {extent:e} m across their flattest direction")]
    Degenerate {
        /// Extent along the flattest direction, metres.
        extent: f64,
    },
    /// A parameter is out of its range.
    #[error("{field} = {value}: {rule}")]
    InvalidParameter {
        /// Name of the field.
        field: &'static str,
        /// The value found.
        value: String,
        /// What is allowed.
        rule: &'static str,
    },
    /// No triangle could be made.
    #[error("no triangle could be made of {points} points: {reason}")]
    NoSurface {
        /// Points in the cloud.
        points: usize,
        /// What stood in the way.
        reason: String,
    },
}
