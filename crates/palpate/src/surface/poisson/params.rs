use crate::surface::SurfaceError;
use serde::{Deserialize, Serialize};

/// Deepest octree that can be asked for (4096 cells along the domain).
const MAX_DEPTH: u32 = 12;

/// Tunables of [`crate::surface::screened_poisson`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoissonParams {
    /// Depth of the octree: the finest cells are (domain edge)/2^depth. Larger keeps finer detail and more noise, at about four times the cost a step.
    /// `None` (default) makes the finest cell [`Self::cell_per_spacing`] times the spacing of the samples, at most depth 10.
    pub depth: Option<u32>,
    /// Finest cell over the median spacing of the samples, used when `depth` is `None`. Larger is smoother and cheaper. 1.3 lost the
    /// least over clouds with noise of 0 to ⅓ of the spacing: noise-free ones are best below 1, noise of ⅓ of the spacing at 1.7.
    pub cell_per_spacing: f64,
    /// Weight of passing through the samples against matching their normals (α of the paper, scale-free). Larger follows the samples, noise
    /// included; 0 is unscreened Poisson. The paper's 4 is for quadratic functions; with our linear ones 2 has the smaller error on noisy clouds.
    pub screening: f64,
    /// Samples that a cell must hold before it is refined further. Larger smooths more where samples are sparse: 1–5 for clean, up to 20 for noisy ones.
    pub samples_per_node: f64,
    /// Edge of the cubic domain over the longest edge of the cloud's box. Larger lets the surface bulge further where the cloud is open.
    pub scale: f64,
}

impl Default for PoissonParams {
    fn default() -> Self {
        Self { depth: None, cell_per_spacing: 1.3, screening: 2.0, samples_per_node: 1.5, scale: 1.1 }
    }
}

impl PoissonParams {
    /// Checks every field's range.
    ///
    /// # Errors
    /// [`SurfaceError::InvalidParameter`] names the field, its value and the rule.
    pub fn validate(&self) -> Result<(), SurfaceError> {
        let invalid = |field, value: String, rule| Err(SurfaceError::InvalidParameter { field, value, rule });
        if let Some(depth) = self.depth
            && !(2..=MAX_DEPTH).contains(&depth)
        {
            return invalid("depth", depth.to_string(), "must be from 2 to 12");
        }
        if !(self.cell_per_spacing >= 0.1 && self.cell_per_spacing <= 100.0) {
            return invalid("cell_per_spacing", self.cell_per_spacing.to_string(), "must be from 0.1 to 100");
        }
        if !(self.screening >= 0.0 && self.screening <= 1e6) {
            return invalid("screening", self.screening.to_string(), "must be from 0 to 1e6");
        }
        if !(self.samples_per_node > 0.0 && self.samples_per_node <= 1e6) {
            return invalid("samples_per_node", self.samples_per_node.to_string(), "must be above 0, at most 1e6");
        }
        if !(self.scale >= 1.05 && self.scale <= 100.0) {
            return invalid("scale", self.scale.to_string(), "must be from 1.05 to 100");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_bad_fields_are_named() {
        let good = PoissonParams::default();
        assert_eq!(good.validate(), Ok(()));
        let bad = [
            (PoissonParams { depth: Some(1), ..good.clone() }, "depth"),
            (PoissonParams { depth: Some(13), ..good.clone() }, "depth"),
            (PoissonParams { cell_per_spacing: f64::NAN, ..good.clone() }, "cell_per_spacing"),
            (PoissonParams { screening: -1.0, ..good.clone() }, "screening"),
            (PoissonParams { samples_per_node: 0.0, ..good.clone() }, "samples_per_node"),
            (PoissonParams { scale: 1.0, ..good }, "scale"),
        ];
        for (params, name) in bad {
            let found = params.validate();
            assert!(matches!(found, Err(SurfaceError::InvalidParameter { field, .. }) if field == name), "{found:?}");
        }
    }
}
