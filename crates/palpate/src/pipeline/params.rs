use super::paper::{PaperParams, PaperSurface};
use super::{ColorBy, ReconstructError};
use crate::camera::SegmentParams;
use crate::completion::{OrbitParams, TouchCheckParams, TouchPoseParams};
use crate::evidence::EvidenceParams;
use crate::surface::ImplicitParams;
use crate::symmetry::SymmetryParams;
use crate::tactile::LiftParams;
use serde::{Deserialize, Serialize};

/// Which method completes the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Ours: everything known, weighted by what it is worth, in one implicit function.
    #[default]
    Fused,
    /// The published one: mirror, delete by rule, concatenate, mesh.
    Paper,
}

/// Which surface is put through the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Surface {
    /// The implicit function with free space (`fused` only).
    Implicit,
    /// Screened Poisson: closed.
    Poisson,
    /// Ball pivoting: through the points, holes filled where possible.
    BallPivoting,
}

/// Everything that can be set; nests the parameters of the stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReconstructParams {
    /// Method.
    pub method: Method,
    /// Surface; absent = implicit for `fused`, Poisson for `paper`.
    pub surface: Option<Surface>,
    /// Seed of everything random.
    pub seed: u64,
    /// Use only the first touches.
    pub max_touches: Option<usize>,
    /// What measurements weigh (`fused`).
    pub weight: WeightParams,
    /// When a touch is left out.
    pub touches: TouchParams,
    /// From the frame to the object's visible side.
    pub segment: SegmentParams,
    /// From a contact to a patch.
    pub lift: LiftParams,
    /// Samples and free space.
    pub evidence: EvidenceParams,
    /// Symmetry search.
    pub symmetry: SymmetryParams,
    /// Moving the evidence (`fused`).
    pub orbit: OrbitParams,
    /// The published method (`paper`); its surfaces also mesh the evidence of `fused` on request.
    pub paper: PaperParams,
    /// Implicit function.
    pub implicit: ImplicitParams,
    /// Whether σ and provenance of every vertex are worked out (`fused`).
    pub uncertainty: bool,
    /// What the vertices are coloured by (`fused`).
    pub color: ColorBy,
}

/// What a measurement of known σ weighs: w = max(min(1, (full / σ)²), min(most, (fine / σ)²)).
///
/// Inverse variances but for a plateau at 1: what is seen at usual ranges and angles weighs alike.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WeightParams {
    /// σ from which the weight falls below 1, metres. Larger trusts uncertain touches and far readings more; 2 mm is what a guess is
    /// worth at best.
    pub full_sigma: f64,
    /// σ under which the weight rises above 1, metres. Larger lets touches and near cameras draw finer detail.
    pub fine_sigma: f64,
    /// Greatest weight: that of a touch whose pose is exact.
    pub most: f64,
}

impl Default for WeightParams {
    fn default() -> Self {
        Self { full_sigma: 2e-3, fine_sigma: 4.5e-4, most: 32.0 }
    }
}

impl WeightParams {
    pub(super) fn of(&self, sigma: f64) -> f64 {
        let over = |reference: f64| (reference / sigma.max(1e-9)).powi(2);
        over(self.full_sigma).min(1.0).max(over(self.fine_sigma).min(self.most))
    }
}

impl Default for ReconstructParams {
    fn default() -> Self {
        Self {
            method: Method::default(),
            surface: None,
            seed: 0,
            max_touches: None,
            weight: WeightParams::default(),
            touches: TouchParams::default(),
            segment: SegmentParams::default(),
            lift: LiftParams::default(),
            evidence: EvidenceParams::default(),
            symmetry: SymmetryParams::default(),
            orbit: OrbitParams::default(),
            paper: PaperParams::default(),
            implicit: ImplicitParams::default(),
            uncertainty: true,
            color: ColorBy::None,
        }
    }
}

/// When a touch is left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TouchParams {
    /// Half of a touch's points further than this inside space the camera proves free: its pose cannot be right, metres.
    pub max_in_free_space: f64,
    /// Further than this many diagonals of the visible side from it: not this object.
    pub max_diagonals: f64,
    /// Whether poses are refined before fusion, where the scene states their σ (`fused`).
    pub refine: bool,
    /// Whether touches that the other evidence rules out are left out (`fused`).
    pub judge: bool,
    /// The refinement.
    pub pose: TouchPoseParams,
    /// The judgement.
    pub check: TouchCheckParams,
}

impl Default for TouchParams {
    fn default() -> Self {
        Self {
            max_in_free_space: 10e-3,
            max_diagonals: 1.0,
            refine: true,
            judge: true,
            pose: TouchPoseParams::default(),
            check: TouchCheckParams::default(),
        }
    }
}

impl TouchParams {
    fn validate(&self) -> Result<(), ReconstructError> {
        let (pose, check) = (&self.pose, &self.check);
        let positive = [
            ("touches.pose.seen_worth", pose.seen_worth),
            ("touches.pose.guess_worth", pose.guess_worth),
            ("touches.pose.normal_sigma", pose.normal_sigma),
            ("touches.pose.cauchy", pose.cauchy),
            ("touches.pose.tangential", pose.tangential),
            ("touches.check.free_depth", check.free_depth),
            ("touches.check.body_margin", check.body_margin),
            ("touches.check.body_length", check.body_length),
        ];
        if check.body_samples == 0 {
            return Err(ReconstructError::Params {
                field: "touches.check.body_samples",
                value: 0.0,
                rule: "at least 1",
            });
        }
        all_positive(&positive)
    }
}

fn all_positive(fields: &[(&'static str, f64)]) -> Result<(), ReconstructError> {
    match fields.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
        Some(&(field, value)) => Err(ReconstructError::Params { field, value, rule: "positive and finite" }),
        None => Ok(()),
    }
}

fn check_orbit(orbit: &OrbitParams) -> Result<(), ReconstructError> {
    all_positive(&[
        ("orbit.free_tolerance", orbit.free_tolerance),
        ("orbit.measured_radius", orbit.measured_radius),
        ("orbit.normal_scale", orbit.normal_scale),
        ("orbit.orbit_radius", orbit.orbit_radius),
        ("orbit.arc", orbit.arc),
        ("orbit.full_score", orbit.full_score),
    ])?;
    for (field, value, most, rule) in [
        ("orbit.weight", orbit.weight, f64::MAX, "at least 0 and finite"),
        ("orbit.orientation", orbit.orientation, f64::MAX, "at least 0 and finite"),
        ("orbit.orbit_violations", orbit.orbit_violations, 1.0, "in [0, 1]"),
    ] {
        if !(0.0..=most).contains(&value) {
            return Err(ReconstructError::Params { field, value, rule });
        }
    }
    Ok(())
}

impl ReconstructParams {
    /// Checks every stage's parameters.
    ///
    /// # Errors
    /// The first that is out of range, with field, value and rule.
    pub fn validate(&self) -> Result<(), ReconstructError> {
        all_positive(&[
            ("weight.full_sigma", self.weight.full_sigma),
            ("weight.fine_sigma", self.weight.fine_sigma),
            ("weight.most", self.weight.most),
            ("touches.max_in_free_space", self.touches.max_in_free_space),
            ("touches.max_diagonals", self.touches.max_diagonals),
        ])?;
        check_orbit(&self.orbit)?;
        self.touches.validate()?;
        self.lift.validate().map_err(ReconstructError::LiftParams)?;
        self.segment.validate()?;
        self.evidence.validate()?;
        self.symmetry.validate()?;
        self.implicit.validate()?;
        if self.method == Method::Paper {
            self.paper.validate()?;
            if self.surface == Some(Surface::Implicit) {
                return Err(ReconstructError::ImplicitPaper);
            }
            if self.color != ColorBy::None {
                return Err(ReconstructError::ColorPaper);
            }
        }
        Ok(())
    }

    /// Checked, and with the seed added to those of the stages.
    pub(super) fn seeded(&self) -> Result<Self, ReconstructError> {
        self.validate()?;
        let mut params = self.clone();
        params.segment.seed = params.segment.seed.wrapping_add(params.seed);
        params.symmetry.seed = params.symmetry.seed.wrapping_add(params.seed);
        Ok(params)
    }

    /// How the evidence is moved. Who states the wall knows better how thick it is than the contour does: far sides are not guessed then.
    pub(super) fn moving(&self) -> OrbitParams {
        let far_sides = self.orbit.far_sides && self.implicit.shell.wall.is_none();
        OrbitParams { far_sides, ..self.orbit.clone() }
    }

    /// The surface that will be used.
    pub fn surface(&self) -> Surface {
        self.surface.unwrap_or(match self.method {
            Method::Fused => Surface::Implicit,
            Method::Paper => match self.paper.surface {
                PaperSurface::Poisson => Surface::Poisson,
                PaperSurface::BallPivoting => Surface::BallPivoting,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_touch_outweighs_a_sighting_by_its_variance_up_to_a_limit() {
        let weight = WeightParams::default();
        for (sigma, wanted) in [(4e-3, 0.25), (2e-3, 1.0), (5e-4, 1.0), (2.25e-4, 4.0), (8e-5, 31.64), (0.0, 32.0)] {
            assert!((weight.of(sigma) - wanted).abs() < 0.01, "{sigma}: {}", weight.of(sigma));
        }
    }

    #[test]
    fn a_stated_wall_leaves_no_far_side_to_guess() {
        let mut params = ReconstructParams::default();
        assert_eq!(params.moving(), params.orbit);
        params.implicit.shell.wall = Some(1e-3);
        assert_eq!(params.moving(), OrbitParams { far_sides: false, ..params.orbit.clone() });
    }

    #[test]
    fn every_parameter_out_of_range_is_named_before_the_work() {
        let cases: [(fn(&mut ReconstructParams), &str); 11] = [
            (|p| p.orbit.weight = f64::NAN, "'orbit.weight' is NaN"),
            (|p| p.orbit.weight = -0.1, "'orbit.weight' is -0.1; it must be at least 0"),
            (|p| p.orbit.normal_scale = 0.0, "'orbit.normal_scale' is 0"),
            (|p| p.orbit.measured_radius = -1.0, "'orbit.measured_radius' is -1"),
            (|p| p.orbit.orbit_radius = 0.0, "'orbit.orbit_radius' is 0"),
            (|p| p.orbit.orbit_violations = 1.5, "'orbit.orbit_violations' is 1.5; it must be in [0, 1]"),
            (|p| p.orbit.orientation = f64::INFINITY, "'orbit.orientation' is inf"),
            (|p| p.orbit.arc = 0.0, "'orbit.arc' is 0"),
            (|p| p.touches.check.body_samples = 0, "'touches.check.body_samples' is 0; it must be at least 1"),
            (|p| p.lift.spacing = 0.0, "lift.spacing is 0; it must be positive"),
            (|p| (p.method, p.color) = (Method::Paper, ColorBy::Sigma), "color can only be 'none'"),
        ];
        for (change, wanted) in cases {
            let mut params = ReconstructParams::default();
            change(&mut params);
            let said = params.validate().expect_err(wanted).to_string();
            assert!(said.contains(wanted), "{said}");
        }
        assert_eq!(ReconstructParams::default().validate().map_err(|e| e.to_string()), Ok(()));
    }
}
