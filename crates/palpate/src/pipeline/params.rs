use super::paper::PaperParams;
use crate::camera::SegmentParams;
use crate::completion::OrbitParams;
use crate::evidence::EvidenceParams;
use crate::surface::{BallPivotingParams, ImplicitParams, PoissonParams};
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
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
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
    /// The published method (`paper`).
    pub paper: PaperParams,
    /// Implicit function.
    pub implicit: ImplicitParams,
    /// Screened Poisson.
    pub poisson: PoissonParams,
    /// Ball pivoting.
    pub ball_pivoting: BallPivotingParams,
}

/// When a touch is left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TouchParams {
    /// Half of a touch's points further than this inside space the camera proves free: its pose cannot be right, metres.
    pub max_in_free_space: f64,
    /// Further than this many diagonals of the visible side from it: not this object.
    pub max_diagonals: f64,
}

impl Default for TouchParams {
    fn default() -> Self {
        Self { max_in_free_space: 10e-3, max_diagonals: 1.0 }
    }
}

impl ReconstructParams {
    /// The surface that will be used.
    pub fn surface(&self) -> Surface {
        self.surface.unwrap_or(match self.method {
            Method::Fused => Surface::Implicit,
            Method::Paper => Surface::Poisson,
        })
    }
}
