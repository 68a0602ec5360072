use super::PaperError;
use crate::camera::SegmentError;
use crate::evidence::EvidenceError;
use crate::surface::SurfaceError;
use crate::symmetry::SymmetryError;
use crate::tactile::{DecodeError, LiftError};

/// Why a reconstruction failed: one variant per stage. The message names the stage; the reason is its `source`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReconstructError {
    /// The object could not be found in the frame.
    #[error("seeing the object")]
    Segment(#[from] SegmentError),
    /// A tactile image could not be decoded.
    #[error("touch {touch}")]
    Decode {
        /// Index of the touch in the order taken.
        touch: usize,
        /// What is wrong.
        source: DecodeError,
    },
    /// A contact could not be lifted.
    #[error("touch {touch}")]
    Lift {
        /// Index of the touch in the order taken.
        touch: usize,
        /// What is wrong.
        source: LiftError,
    },
    /// A parameter of lifting is out of range.
    #[error(transparent)]
    LiftParams(LiftError),
    /// There are touches but no sensor.
    #[error("the scene has {touches} touches but no sensor: its pixel pitch and relaxed gel are needed")]
    NoSensor {
        /// Number of touches.
        touches: usize,
    },
    /// The evidence does not suffice.
    #[error("gathering the evidence")]
    Evidence(#[from] EvidenceError),
    /// No surface could be made.
    #[error("meshing")]
    Surface(#[from] SurfaceError),
    /// The published method failed.
    #[error("method 'paper'")]
    Paper(#[from] PaperError),
    /// A parameter is out of range.
    #[error("parameter '{field}' is {value}; it must be {rule}")]
    Params {
        /// Name of the field.
        field: &'static str,
        /// Value found.
        value: f64,
        /// What is allowed.
        rule: &'static str,
    },
    /// A parameter of the symmetry search is out of range.
    #[error("seeking symmetry")]
    Symmetry(#[from] SymmetryError),
    /// Touches are followed by the implicit surface of `fused`.
    #[error("touches can only be followed with method 'fused' and surface 'implicit'")]
    NotIncremental,
    /// Colours are a matter of `fused`.
    #[error("method 'paper' knows nothing of single vertices: its color can only be 'none'")]
    ColorPaper,
    /// The implicit surface is a matter of `fused`.
    #[error("method 'paper' meshes by 'poisson' or 'ball-pivoting', not by 'implicit'")]
    ImplicitPaper,
}
