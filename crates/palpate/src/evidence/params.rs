use serde::{Deserialize, Serialize};

/// Why no evidence could be gathered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvidenceError {
    /// The visible raster and the frame disagree.
    #[error("the visible side is {found_rows}×{found_cols} pixels; the frame's depth image is {rows}×{cols}")]
    SizeMismatch {
        /// Rows of the visible raster.
        found_rows: usize,
        /// Columns of the visible raster.
        found_cols: usize,
        /// Rows of the depth image.
        rows: usize,
        /// Columns of the depth image.
        cols: usize,
    },
    /// Too little was measured.
    #[error("{found} surface samples were measured; at least {needed} are required")]
    TooFewSamples {
        /// Samples after averaging.
        found: usize,
        /// The least number that makes a reconstruction meaningful.
        needed: usize,
    },
    /// A parameter is out of its range.
    #[error("evidence parameter '{field}' is {value}; it must be {rule}")]
    Parameter {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        rule: &'static str,
    },
}

/// How measurements become evidence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceParams {
    /// Edge of the voxel in which seen points are averaged, metres. Larger: fewer, smoother samples. 2 mm is about two pixels at 0.7 m.
    pub seen_voxel: f64,
    /// Edge of the voxel in which felt points are averaged, metres. Larger: fewer samples per touch. 1.2 mm keeps edges within a patch.
    pub felt_voxel: f64,
    /// Share of the sensor's depth noise that denoising and averaging leave, 0–1. Larger: the camera is trusted less. Pixel noise averages
    /// out, the sensor's correlated part does not: one half.
    pub seen_sigma_share: f64,
    /// Least σ of a seen sample, metres. Larger: the camera is trusted less. No depth camera is better than a fifth of a millimetre.
    pub seen_sigma_floor: f64,
    /// σ of a felt point along its normal when its touch pose is exact, metres. Larger: touches are trusted less.
    pub felt_sigma: f64,
    /// σ of a touch pose's translation per axis, metres; a property of the robot, so the pipeline takes it from the scene.
    pub pose_sigma_translation: f64,
    /// σ of a touch pose's rotation per axis, radians; taken from the scene.
    pub pose_sigma_rotation: f64,
    /// Part of a pixel given up at the silhouette, pixels. Larger: less free space beside the object. A pixel's centre is within half a
    /// pixel of the silhouette, and a little for noise.
    pub silhouette_margin_px: f64,
    /// Depth given up in front of the measured surface, metres. Larger: less free space. Half a σ of the default camera.
    pub depth_margin: f64,
    /// Jump of depth within 3×3 pixels from which the nearer surface bounds the free space and has its occluding contour, metres.
    pub depth_jump: f64,
    /// Thickness of the free layer behind the untouched gel, metres. Larger: more free space per touch, up to the pad's real thickness.
    pub pad_thickness: f64,
    /// Cells of the carved grid along its longest side. Larger: finer free space at cubic cost.
    pub grid_cells: usize,
    /// Free margin of the carved grid round the hull, metres.
    pub grid_margin: f64,
}

impl Default for EvidenceParams {
    fn default() -> Self {
        Self {
            seen_voxel: 0.002,
            felt_voxel: 0.0012,
            seen_sigma_share: 0.5,
            seen_sigma_floor: 0.0002,
            felt_sigma: 0.00008,
            pose_sigma_translation: 0.0,
            pose_sigma_rotation: 0.0,
            silhouette_margin_px: 0.6,
            depth_margin: 0.0005,
            depth_jump: 0.008,
            pad_thickness: 0.003,
            grid_cells: 120,
            grid_margin: 0.012,
        }
    }
}

impl EvidenceParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`EvidenceError::Parameter`] names the first field that is out of range.
    pub fn validate(&self) -> Result<(), EvidenceError> {
        let positive = [
            ("seen_voxel", self.seen_voxel),
            ("felt_voxel", self.felt_voxel),
            ("seen_sigma_share", self.seen_sigma_share),
            ("seen_sigma_floor", self.seen_sigma_floor),
            ("felt_sigma", self.felt_sigma),
            ("depth_jump", self.depth_jump),
        ];
        let not_negative = [
            ("pose_sigma_translation", self.pose_sigma_translation),
            ("pose_sigma_rotation", self.pose_sigma_rotation),
            ("silhouette_margin_px", self.silhouette_margin_px),
            ("depth_margin", self.depth_margin),
            ("pad_thickness", self.pad_thickness),
            ("grid_margin", self.grid_margin),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(EvidenceError::Parameter { field, value, rule: "finite and above 0" });
            }
        }
        for (field, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(EvidenceError::Parameter { field, value, rule: "finite and at least 0" });
            }
        }
        if !(8..=512).contains(&self.grid_cells) {
            let value = self.grid_cells as f64;
            return Err(EvidenceError::Parameter { field: "grid_cells", value, rule: "from 8 to 512" });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_field_is_named() {
        assert!(EvidenceParams::default().validate().is_ok());
        let bad = EvidenceParams { felt_voxel: f64::NAN, ..EvidenceParams::default() };
        assert!(bad.validate().expect_err("NaN is no length").to_string().contains("'felt_voxel'"));
        let bad = EvidenceParams { grid_cells: 4, ..EvidenceParams::default() };
        assert!(bad.validate().expect_err("too coarse").to_string().contains("from 8 to 512"));
    }
}
