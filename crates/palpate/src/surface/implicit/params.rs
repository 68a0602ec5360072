use crate::surface::SurfaceError;
use serde::{Deserialize, Serialize};

/// Parameters of the implicit function.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImplicitParams {
    /// Wanted spacing of the finest grid, metres. Larger is faster and smoother; 1.1 mm is about the depth noise.
    pub spacing: f64,
    /// Cells of the finest dense grid. More carries finer detail into the narrow band and costs time; 150,000 is 2–3 mm on a bottle.
    pub dense_cells: usize,
    /// Most nodes of the narrow band's box (28 bytes each). Where the box is too large for `spacing`, the spacing grows.
    pub max_nodes: usize,
    /// μ: weight of the Hessian. Larger bridges gaps more smoothly and blurs edges.
    pub smoothness: f64,
    /// γ: weight of the free-space inequality. Larger makes it harder.
    pub free_weight: f64,
    /// Samples are averaged in cubes of this many cells, so that their density does not act as a weight.
    pub sample_spacing: f64,
    /// Nodes within this many cells of a sample belong to the band.
    pub band_cells: usize,
    /// Relative residual at which the solver stops.
    pub tolerance: f64,
    /// Components that carry a smaller share of what the measured samples weigh are dropped. One touch weighs more than this.
    pub component_share: f64,
    /// When the object is a shell, and what follows.
    pub shell: ShellParams,
    /// What is taken to be outside where nothing is known.
    pub prior: PriorParams,
}

/// Parameters of shells: bowls and plates, thinner than the grid resolves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShellParams {
    /// The thickness of the wall if the user knows that the object is a shell, metres: what lies deeper behind the surface is cut away.
    /// One view of a plate cannot tell it from a mound. Absent: nothing is cut, and the evidence decides about the spacing.
    pub wall: Option<f64>,
    /// Share of the samples with an opposing sample close behind them from which the object is a shell. Larger: fewer are.
    pub pairs: f64,
    /// Their median distance up to which it is one, metres. Larger: thicker walls count.
    pub thickest: f64,
    /// Spacing of the finest grid of a shell, metres.
    pub spacing: f64,
    /// μ of a shell at most. Larger pulls its two faces into one where they are close.
    pub smoothness: f64,
}

impl Default for ShellParams {
    fn default() -> Self {
        Self { wall: None, pairs: 0.25, thickest: 1.5e-3, spacing: 0.75e-3, smoothness: 2.5e-3 }
    }
}

/// Parameters of the outside prior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PriorParams {
    /// ω: weight where the winding number says outside.
    pub winding_weight: f64,
    /// Weight added where it is far under the threshold. Larger empties what evidence surrounds.
    pub winding_sure_weight: f64,
    /// u₀: winding numbers below it count as outside, when guessed samples close the surface. Larger cuts more away.
    pub winding_threshold: f64,
    /// u₀ when there are few guessed samples: a half-open surface has low winding numbers inside.
    pub winding_threshold_unguessed: f64,
    /// Samples are thinned to this spacing for the winding number, metres.
    pub winding_sample_spacing: f64,
    /// Weight beyond the convex hull of measured and guessed samples.
    pub hull_weight: f64,
    /// The hull is grown by this much, metres.
    pub hull_margin: f64,
    /// The hull ends in a direction if samples within this of its extreme face that way, metres. Larger: the hull trusts edges.
    pub hull_turn: f64,
    /// Hull and `winding_threshold` are used from this ratio of guessed to measured samples on: the hull of the visible side alone
    /// would cut the hidden side off.
    pub hull_from_share: f64,
}

impl ImplicitParams {
    /// Those of [`super::implicit_surface`]: a cloud of alike points wants more smoothness than evidence of many kinds, and has no touches that weigh more.
    pub fn of_cloud() -> Self {
        Self {
            smoothness: 0.02,
            component_share: 0.02,
            shell: ShellParams { smoothness: 0.02, ..ShellParams::default() },
            prior: PriorParams { winding_weight: 0.01, winding_sure_weight: 0.0, ..PriorParams::default() },
            ..Self::default()
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`SurfaceError::InvalidParameter`] names the first that is out of range.
    pub fn validate(&self) -> Result<(), SurfaceError> {
        let rules: [(&'static str, f64, f64); 15] = [
            ("implicit.spacing", self.spacing, f64::MIN_POSITIVE),
            ("implicit.dense_cells", self.dense_cells as f64, 1000.0),
            ("implicit.max_nodes", self.max_nodes as f64, 1000.0),
            ("implicit.smoothness", self.smoothness, f64::MIN_POSITIVE),
            ("implicit.free_weight", self.free_weight, 0.0),
            ("implicit.sample_spacing", self.sample_spacing, 1e-3),
            ("implicit.band_cells", self.band_cells as f64, 1.0),
            ("implicit.tolerance", self.tolerance, f64::MIN_POSITIVE),
            ("implicit.shell.spacing", self.shell.spacing, f64::MIN_POSITIVE),
            ("implicit.shell.smoothness", self.shell.smoothness, f64::MIN_POSITIVE),
            ("implicit.shell.wall", self.shell.wall.unwrap_or(1.0), f64::MIN_POSITIVE),
            ("implicit.prior.winding_weight", self.prior.winding_weight, 0.0),
            ("implicit.prior.winding_sure_weight", self.prior.winding_sure_weight, 0.0),
            ("implicit.prior.hull_weight", self.prior.hull_weight, 0.0),
            ("implicit.prior.winding_sample_spacing", self.prior.winding_sample_spacing, f64::MIN_POSITIVE),
        ];
        for (field, value, least) in rules {
            if !(value.is_finite() && value >= least) {
                let rule = "must be finite and large enough (positive; weights at least 0; counts of cells and nodes at least 1000)";
                return Err(SurfaceError::InvalidParameter { field, value: value.to_string(), rule });
            }
        }
        Ok(())
    }
}

impl Default for ImplicitParams {
    fn default() -> Self {
        Self {
            spacing: 1.1e-3,
            dense_cells: 150_000,
            max_nodes: 14_000_000,
            smoothness: 0.014,
            free_weight: 2.0,
            sample_spacing: 0.8,
            band_cells: 3,
            tolerance: 5e-3,
            component_share: 0.005,
            shell: ShellParams::default(),
            prior: PriorParams::default(),
        }
    }
}

impl Default for PriorParams {
    fn default() -> Self {
        Self {
            winding_weight: 0.005,
            winding_sure_weight: 0.2,
            winding_threshold: 0.2,
            winding_threshold_unguessed: 0.15,
            winding_sample_spacing: 4e-3,
            hull_weight: 0.05,
            hull_margin: 4e-3,
            hull_turn: 4e-3,
            hull_from_share: 0.15,
        }
    }
}
