use super::{Method, ReconstructError, ReconstructParams, VertexKnowledge, fused, paper};
use crate::geometry::{Isometry, PointCloud, TriangleMesh};
use crate::scene::Scene;
use crate::symmetry::{EvidenceSearch, Symmetry, SymmetryEstimator};
use crate::tactile::{Patch, TactileDecoder};
use nalgebra::Matrix6;
use std::fmt;

/// The parts that another crate may supply, and who wants to hear how far the work is.
#[derive(Default)]
pub struct Stages<'a> {
    /// Decodes touches that have no recorded contact; absent = such a touch is an error.
    pub decoder: Option<&'a dyn TactileDecoder>,
    /// Estimates the symmetry; absent = the evidence search with the parameters given.
    pub symmetry: Option<&'a dyn SymmetryEstimator>,
    /// Called with the name of each stage as it begins.
    pub on_stage: Option<&'a dyn Fn(&'static str)>,
}

/// Something the user should know about the result.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// A touch was left out.
    TouchLeftOut {
        /// Index in the order taken.
        touch: usize,
        /// Why.
        reason: String,
    },
    /// The image border cuts the object.
    CutByBorder {
        /// Share of the outline on the border.
        share: f64,
    },
    /// The mesh has holes.
    Open,
    /// Nothing says what the object stands on: how far down it reaches is guessed.
    NoSupport,
    /// Much of the surface rests on no evidence at all.
    Extrapolated {
        /// Share of the vertices.
        share: f64,
        /// Their median σ, metres.
        sigma: f64,
    },
}

impl Warning {
    /// Whether something that was recorded was not used or the result is not what was asked for; else it only says what is not known.
    pub fn is_loss(&self) -> bool {
        !matches!(self, Self::NoSupport | Self::Extrapolated { .. })
    }
}

/// A touch as it was used.
#[derive(Debug, Clone, PartialEq)]
pub struct SettledTouch {
    /// Index in the order taken.
    pub touch: usize,
    /// Its pose, refined where the scene states how uncertain poses are.
    pub world_from_sensor: Isometry,
    /// Covariance of the pose in the sensor's frame: rotation (radians), then translation (metres).
    pub covariance: Matrix6<f64>,
}

/// A closed mesh and everything it was made from, **world** frame, metres.
#[derive(Debug, Clone, Default)]
pub struct Reconstruction {
    /// The result.
    pub mesh: TriangleMesh,
    /// What the camera saw of the object.
    pub visible: PointCloud,
    /// What the touches felt.
    pub felt: PointCloud,
    /// Guessed points that were used.
    pub moved: PointCloud,
    /// Guessed points that were contradicted and removed.
    pub removed: PointCloud,
    /// All points that the surface was fitted to.
    pub joined: PointCloud,
    /// Accepted and rejected symmetries.
    pub symmetry: Symmetry,
    /// Number of touches used.
    pub touches_used: usize,
    /// The touches used, with the poses used; `fused` only.
    pub touches: Vec<SettledTouch>,
    /// What is known of each vertex of the mesh; `fused` only, where [`ReconstructParams::uncertainty`] asks for it.
    pub knowledge: Option<VertexKnowledge>,
    /// What the user should know.
    pub warnings: Vec<Warning>,
}

/// Reconstructs the object of a scene.
///
/// # Errors
/// [`ReconstructError`] names the stage, and the touch if it is one.
pub fn reconstruct(
    scene: &Scene,
    params: &ReconstructParams,
    stages: &Stages,
) -> Result<Reconstruction, ReconstructError> {
    let params = &params.seeded()?;
    let search = EvidenceSearch { params: params.symmetry };
    let stages = Stages {
        decoder: stages.decoder,
        symmetry: Some(stages.symmetry.unwrap_or(&search)),
        on_stage: stages.on_stage,
    };
    match params.method {
        Method::Fused => Ok(fused::reconstruct(scene, params, &stages)?.0),
        Method::Paper => paper::reconstruct(scene, params, &stages),
    }
}

impl Stages<'_> {
    pub(super) fn begin(&self, stage: &'static str) {
        if let Some(on_stage) = self.on_stage {
            on_stage(stage);
        }
    }

    pub(super) fn estimator(&self) -> &dyn SymmetryEstimator {
        self.symmetry.expect("the door sets the estimator")
    }
}

/// All patches as one cloud.
pub(super) fn felt_cloud(patches: &[Patch]) -> PointCloud {
    let points = patches.iter().flat_map(|p| p.points.iter().copied()).collect();
    let normals = patches.iter().flat_map(|p| p.normals.iter().copied()).collect();
    PointCloud::with_normals(points, normals).expect("a patch has one normal per point")
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TouchLeftOut { touch, reason } => write!(f, "touch {touch} was left out: {reason}"),
            Self::CutByBorder { share } => write!(
                f,
                "the image border cuts the object ({:.0} % of its outline): what lies beyond is guessed",
                100.0 * share
            ),
            Self::Open => write!(f, "the mesh is not closed"),
            Self::NoSupport => {
                f.write_str("no support plane is stated or seen: how far down the object reaches is guessed")
            }
            Self::Extrapolated { share, sigma } => write!(
                f,
                "{:.0} % of the surface rests on no evidence (median σ {:.0} mm there): a touch or another view would help",
                100.0 * share,
                1e3 * sigma
            ),
        }
    }
}

/// Share of the outline on the image border from which the object counts as cut.
const BORDER_SHARE: f64 = 0.01;

/// The warning that belongs to a frame whose border cuts the object.
pub(super) fn cut_by_border(visible: &crate::camera::Visible) -> Option<Warning> {
    (visible.border_share > BORDER_SHARE).then_some(Warning::CutByBorder { share: visible.border_share })
}
