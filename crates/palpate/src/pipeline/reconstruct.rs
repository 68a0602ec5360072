use super::{Method, ReconstructError, ReconstructParams, VertexKnowledge, fused, paper};
use crate::geometry::{Isometry, PointCloud, Topology, TriangleMesh};
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
    /// The object is larger than what a fingertip explores: a wrong unit of the depth image?
    Large {
        /// Its longest side, metres.
        side: f64,
    },
    /// The surface has more handles than an object has: it is torn.
    Handles {
        /// Its genus.
        genus: usize,
    },
    /// The vertices have no colours though some were asked for.
    NotColored {
        /// What is missing.
        reason: &'static str,
    },
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
        !matches!(self, Self::NoSupport | Self::Extrapolated { .. } | Self::Large { .. } | Self::Handles { .. })
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
            Self::Large { side } => write!(
                f,
                "the object is {side:.2} m long; is the unit of the depth image right (metres_per_unit: 0.001 and 0.0001 are usual)?"
            ),
            Self::Handles { genus } => write!(
                f,
                "the surface has {genus} handles (genus {genus}), more than an object has: it is torn where the evidence disagrees"
            ),
            Self::NotColored { reason } => write!(f, "the vertices are not coloured: {reason}"),
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

/// Longest side up to which an object is one that a fingertip explores, metres.
const LARGE: f64 = 0.6;
/// Genus up to which a surface is that of an object. A mug has 1, a rack 5.
const HANDLES: usize = 5;

/// What the user should know of a mesh.
pub(super) fn mesh_warnings(mesh: &TriangleMesh) -> Vec<Warning> {
    let topology = Topology::of(mesh);
    let side = mesh.bounds().map_or(0.0, |b| b.size().max());
    let open = (!topology.is_closed()).then_some(Warning::Open);
    let large = (side > LARGE).then_some(Warning::Large { side });
    let handles = topology.genus().filter(|g| *g > HANDLES).map(|genus| Warning::Handles { genus });
    open.into_iter().chain(large).chain(handles).collect()
}

/// Share of the outline on the image border from which the object counts as cut.
const BORDER_SHARE: f64 = 0.01;

/// The warning that belongs to a frame whose border cuts the object.
pub(super) fn cut_by_border(visible: &crate::camera::Visible) -> Option<Warning> {
    (visible.border_share > BORDER_SHARE).then_some(Warning::CutByBorder { share: visible.border_share })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    /// So many tori side by side: genus is summed over the pieces.
    fn tori(count: u32, size: f64) -> TriangleMesh {
        let at = |k: u32, i: u32, j: u32| 16 * k + 4 * (i % 4) + j % 4;
        let vertices =
            (0..16 * count).map(|v| Point::new(size * f64::from(v % 16) / 15.0, f64::from(v / 16), 0.0) * 0.1);
        let squares = (0..count).flat_map(|k| (0..16).map(move |s| (k, s / 4, s % 4)));
        let faces = squares.flat_map(|(k, i, j)| {
            let [a, b, c, d] = [at(k, i, j), at(k, i + 1, j), at(k, i + 1, j + 1), at(k, i, j + 1)];
            [[a, b, c], [a, c, d]]
        });
        TriangleMesh::new(vertices.collect(), faces.collect()).expect("indices are in range")
    }

    #[test]
    fn a_torn_surface_and_a_wrong_unit_are_said() {
        assert_eq!(mesh_warnings(&tori(5, 1.0)), []);
        assert_eq!(mesh_warnings(&tori(6, 1.0)), [Warning::Handles { genus: 6 }]);
        let large = mesh_warnings(&tori(1, 10.0));
        assert!(matches!(large[..], [Warning::Large { side }] if (side - 1.0).abs() < 1e-9), "{large:?}");
        assert!(large[0].to_string().contains("metres_per_unit") && !large[0].is_loss());
        let mut open = tori(1, 1.0);
        open.faces.pop();
        assert_eq!(mesh_warnings(&open), [Warning::Open]);
    }
}
