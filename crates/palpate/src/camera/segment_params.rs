use super::{CameraError, SmoothParams};
use serde::{Deserialize, Serialize};

/// How the object is found in a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentParams {
    /// Pixel (u, v) on the wanted object; absent = the object nearest the image centre.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pick: Option<(f64, f64)>,
    /// Largest distance from `pick` to the object, pixels. Larger: forgives a pick on a hole; 10.
    pub pick_radius: f64,
    /// Seed of the plane search.
    pub seed: u64,
    /// Inlier distance of the plane search, metres. Larger: bridges waves of the sensor, blurs low objects; 8 mm, as real depth
    /// cameras bend a table by up to 5 mm.
    pub plane_tolerance: f64,
    /// Least share of the readings on a support plane. Larger: fewer false planes, small tables missed; 0.1.
    pub min_plane_share: f64,
    /// What rises less than this many robust σ of the plane's readings is part of the plane. Larger: cuts more of the object's
    /// foot, lets fewer waves through; 3.
    pub margin_sigmas: f64,
    /// Smallest such height, metres; 2 mm.
    pub min_margin: f64,
    /// Largest such height, metres; 15 mm.
    pub max_margin: f64,
    /// An object rises at least this far above the plane, metres. Larger: waves and sheets of paper are not objects; 6 mm.
    pub min_height: f64,
    /// Slope of the steepest surface that is not an edge, metres per metre. Larger: keeps more mixed pixels; 6 (80°).
    pub max_slope: f64,
    /// Pixels of one object are linked over this many missing ones, pixels. Larger: bridges wider dropouts, slower; 3.
    pub link_pixels: usize,
    /// … if they are closer than this, metres. Larger: joins parts split by noise, and neighbouring objects; 10 mm.
    pub link_distance: f64,
    /// Clusters over the same ground of the support plane are one object if they come closer than this, metres. Larger: joins
    /// parts behind wider gaps; 25 mm.
    pub fragment_gap: f64,
    /// Points farther from their neighbours than the average by this many standard deviations are outliers. Larger: keeps
    /// more; 4.
    pub outlier_sigmas: f64,
    /// Fewest pixels of an object. Larger: ignores more clutter; 200.
    pub min_pixels: usize,
    /// The denoising that follows.
    pub smooth: SmoothParams,
}

impl Default for SegmentParams {
    fn default() -> Self {
        Self {
            pick: None,
            pick_radius: 10.0,
            seed: 0,
            plane_tolerance: 0.008,
            min_plane_share: 0.1,
            margin_sigmas: 3.0,
            min_margin: 0.002,
            max_margin: 0.015,
            min_height: 0.006,
            max_slope: 6.0,
            link_pixels: 3,
            link_distance: 0.01,
            fragment_gap: 0.025,
            outlier_sigmas: 4.0,
            min_pixels: 200,
            smooth: SmoothParams::default(),
        }
    }
}

impl SegmentParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`SegmentError::Params`] names the first field out of range.
    pub fn validate(&self) -> Result<(), SegmentError> {
        let positive = [
            ("plane_tolerance", self.plane_tolerance),
            ("margin_sigmas", self.margin_sigmas),
            ("min_margin", self.min_margin),
            ("max_slope", self.max_slope),
            ("link_distance", self.link_distance),
            ("fragment_gap", self.fragment_gap),
            ("outlier_sigmas", self.outlier_sigmas),
        ];
        let mut fault = positive
            .into_iter()
            .find(|(_, value)| !(value.is_finite() && *value > 0.0))
            .map(|(field, value)| (field, value, "finite and positive"));
        let checks = [
            (self.pick_radius >= 0.0, "pick_radius", self.pick_radius, "0 or more, in pixels"),
            ((0.0..1.0).contains(&self.min_plane_share), "min_plane_share", self.min_plane_share, "in [0, 1)"),
            (self.max_margin >= self.min_margin, "max_margin", self.max_margin, "at least min_margin"),
            (self.min_height >= 0.0, "min_height", self.min_height, "0 or more, in metres"),
            ((1..=10).contains(&self.link_pixels), "link_pixels", self.link_pixels as f64, "between 1 and 10"),
            (self.min_pixels >= 1, "min_pixels", self.min_pixels as f64, "at least 1"),
        ];
        fault = fault.or(checks.into_iter().find(|c| !c.0).map(|(_, field, value, rule)| (field, value, rule)));
        match fault.or(self.smooth.fault()) {
            Some((field, value, rule)) => Err(SegmentError::Params { field, value, rule }),
            None => Ok(()),
        }
    }
}

/// Why no object was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentError {
    /// The frame itself is unusable.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A parameter is out of range.
    #[error("segment parameter {field} is {value}; it must be {rule}")]
    Params {
        /// Name of the field.
        field: &'static str,
        /// What was found.
        value: f64,
        /// What is needed.
        rule: &'static str,
    },
    /// Nothing stands on the support plane.
    #[error(
        "no object above the support plane: the largest group that rises over it has {found} pixels; at least {needed}, rising {min_height} m, are required"
    )]
    NoObject {
        /// Pixels of the largest group.
        found: usize,
        /// Pixels needed.
        needed: usize,
        /// Height needed, metres.
        min_height: f64,
    },
    /// The picked pixel is not on the image.
    #[error("the picked pixel ({u}, {v}) is outside the image of {width} x {height} pixels")]
    PickOutside {
        /// Column.
        u: f64,
        /// Row.
        v: f64,
        /// Image width.
        width: usize,
        /// Image height.
        height: usize,
    },
    /// There is no object at the picked pixel.
    #[error("no object within {radius} pixels of the picked pixel ({u}, {v})")]
    PickMissed {
        /// Column.
        u: f64,
        /// Row.
        v: f64,
        /// Pixels searched around it.
        radius: f64,
    },
    /// Too little is left of the object.
    #[error("{found} points of the object are left after {stage}; at least {needed} are required")]
    TooFewPoints {
        /// Points left.
        found: usize,
        /// Points needed.
        needed: usize,
        /// The step after which they were counted.
        stage: &'static str,
    },
}
