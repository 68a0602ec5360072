use crate::surface::SurfaceError;
use serde::{Deserialize, Serialize};

/// Deepest octree that can be asked for (4096 cells along the domain).
const MAX_DEPTH: u32 = 12;

/// What the function does at the border of the domain.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Boundary {
    /// It is zero: the surface closes inside the domain.
    #[default]
    Dirichlet,
    /// It may end at any value, at right angles: an open surface runs on to the border, where it is cut off and capped.
    Neumann,
}

/// Tunables of [`crate::surface::screened_poisson`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoissonParams {
    /// Depth of the octree: the finest cells are (domain edge)/2^depth. Larger keeps finer detail and more noise, at about four times the cost a step;
    /// depths that less than a hundredth of the samples are dense enough for are left out. `None` (default) chooses from spacing and noise, at most 10.
    pub depth: Option<u32>,
    /// Finest cell over the median spacing of the samples, used when `depth` is `None`. Larger is smoother and cheaper. `None` (default) is 0.85 for
    /// samples with little noise; for others the cell is 0.3 · (longest edge · noise · spacing)^⅓ if that is larger. With noise below half the spacing such
    /// cells are halved where noise does not explain the misfit.
    pub cell_per_spacing: Option<f64>,
    /// Standard deviation of the samples along their normals, metres. `None` (default) reads it from neighbours that disagree.
    pub noise: Option<f64>,
    /// Weight of passing through the samples against matching their normals (α of the paper, scale-free). Larger follows the samples, noise
    /// included; 0 is unscreened Poisson. `None` (default) follows the noise: between 1 and 32.
    pub screening: Option<f64>,
    /// Samples that a cell must hold before it is refined further. Larger smooths more where samples are sparse: 1–5 for clean, up to 20 for noisy ones.
    pub samples_per_node: f64,
    /// Edge of the cubic domain over the longest edge of the cloud's box. Larger lets the surface bulge further where the cloud is open.
    pub scale: f64,
    /// What holds at the border of the domain.
    pub boundary: Boundary,
    /// Keep only the component with the largest area.
    pub largest_component: bool,
    /// Cut away the surface where its density is below this share of the median density at the samples; larger cuts more. This opens the mesh.
    /// 0 (default) cuts nothing; 0.4 leaves out what was guessed across wide gaps.
    pub trim: f64,
}

impl Default for PoissonParams {
    fn default() -> Self {
        Self {
            depth: None,
            cell_per_spacing: None,
            noise: None,
            screening: None,
            samples_per_node: 1.0,
            scale: 1.1,
            boundary: Boundary::Dirichlet,
            largest_component: false,
            trim: 0.0,
        }
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
        if let Some(cells) = self.cell_per_spacing
            && !(0.1..=100.0).contains(&cells)
        {
            return invalid("cell_per_spacing", cells.to_string(), "must be from 0.1 to 100");
        }
        if let Some(noise) = self.noise
            && !(noise >= 0.0 && noise.is_finite())
        {
            return invalid("noise", noise.to_string(), "must be zero or more and finite, metres");
        }
        if let Some(screening) = self.screening
            && !(0.0..=1e6).contains(&screening)
        {
            return invalid("screening", screening.to_string(), "must be from 0 to 1e6");
        }
        if !(self.samples_per_node > 0.0 && self.samples_per_node <= 1e6) {
            return invalid("samples_per_node", self.samples_per_node.to_string(), "must be above 0, at most 1e6");
        }
        if !(self.scale >= 1.05 && self.scale <= 100.0) {
            return invalid("scale", self.scale.to_string(), "must be from 1.05 to 100");
        }
        if !(0.0..=10.0).contains(&self.trim) {
            return invalid("trim", self.trim.to_string(), "must be from 0 to 10");
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
            (PoissonParams { cell_per_spacing: Some(f64::NAN), ..good.clone() }, "cell_per_spacing"),
            (PoissonParams { noise: Some(f64::INFINITY), ..good.clone() }, "noise"),
            (PoissonParams { screening: Some(-1.0), ..good.clone() }, "screening"),
            (PoissonParams { trim: -0.5, ..good.clone() }, "trim"),
            (PoissonParams { samples_per_node: 0.0, ..good.clone() }, "samples_per_node"),
            (PoissonParams { scale: 1.0, ..good }, "scale"),
        ];
        for (params, name) in bad {
            let found = params.validate();
            assert!(matches!(found, Err(SurfaceError::InvalidParameter { field, .. }) if field == name), "{found:?}");
        }
    }
}
