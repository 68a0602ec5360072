use crate::surface::SurfaceError;
use serde::{Deserialize, Serialize};

/// How the balls are chosen and what happens to what they leave open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BallPivotingParams {
    /// Ball radii, metres, rolled from small to large. A ball must be larger than the gaps between points and smaller than the
    /// details to keep; larger bridges more. Default: 1.5, 2.5, 4 and 6 times the median spacing, which closes evenly sampled
    /// surfaces with the first and sparser parts with the others; with [`Self::fill_holes`] balls of twice the size follow one
    /// another up to a quarter of the cloud's diagonal, to bridge islands of points.
    pub radii: Option<Vec<f64>>,
    /// Of points closer together than this only the first is used, metres; larger thins more. Default: a tenth of the smallest
    /// radius, so that near-duplicates do not become slivers.
    pub merge_distance: Option<f64>,
    /// Rounds of moving the points onto the smooth surface of their neighbours before meshing: where noise is near the spacing, balls make islands of it.
    /// More smooth more. `None` (default) reads the noise from the points: none up to 0.08 of the spacing, else one, as wide as the noise asks for. 0: the
    /// mesh goes through the points as they are.
    pub project: Option<u32>,
    /// Whether every hole is closed afterwards, the border of a surface that is open by nature included. Off: the balls' work as it is.
    pub fill_holes: bool,
    /// Pieces with less than this share of the whole area are dropped, before holes are filled; larger drops more. Default 0: none.
    pub min_piece_share: f64,
}

impl Default for BallPivotingParams {
    fn default() -> Self {
        Self { radii: None, merge_distance: None, project: None, fill_holes: false, min_piece_share: 0.0 }
    }
}

impl BallPivotingParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`SurfaceError::InvalidParameter`] names the first field that is out of range.
    pub fn validate(&self) -> Result<(), SurfaceError> {
        let invalid = |field, value: String, rule| Err(SurfaceError::InvalidParameter { field, value, rule });
        if let Some(radii) = &self.radii {
            if radii.is_empty() {
                return invalid("radii", "[]".into(), "at least one radius is required");
            }
            if let Some(r) = radii.iter().find(|r| !(r.is_finite() && **r > 0.0)) {
                return invalid("radii", r.to_string(), "a radius must be positive and finite, metres");
            }
        }
        match self.merge_distance {
            Some(d) if !(d.is_finite() && d >= 0.0) => {
                invalid("merge_distance", d.to_string(), "must be zero or more and finite, metres")
            }
            _ if self.project.is_some_and(|rounds| rounds > 100) => {
                invalid("project", self.project.unwrap_or_default().to_string(), "must be at most 100")
            }
            _ if !(0.0..=1.0).contains(&self.min_piece_share) => {
                invalid("min_piece_share", self.min_piece_share.to_string(), "must lie in 0..=1")
            }
            _ => Ok(()),
        }
    }
}
