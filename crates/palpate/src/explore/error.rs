use crate::camera::SegmentError;
use crate::evidence::EvidenceError;
use crate::metrics::MetricsError;
use crate::pipeline::ReconstructError;
use crate::simulate::SimulateError;
use crate::tactile::{PressError, SensorError};

/// Why no touch could be proposed or simulated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExploreError {
    /// A parameter is out of range.
    #[error("{field} is {found}; it must be {needed}")]
    Params {
        /// Name of the field.
        field: &'static str,
        /// Value found.
        found: f64,
        /// Values allowed.
        needed: &'static str,
    },
    /// Nothing says where the table is.
    #[error(
        "no support plane is known: the scene states none and none is seen; state one in scene.toml ([support]) or in the reach \
         file ([support], or no_support = true for an object that stands free)"
    )]
    NoSupport,
    /// The truth is open: its inside is not defined.
    #[error("mesh '{name}' is not closed ({boundary_edges} boundary edges); exploring needs a closed one")]
    Open {
        /// Name of the object.
        name: String,
        /// Its edges with one face.
        boundary_edges: usize,
    },
    /// No pose of the fingertip passes every test.
    #[error(
        "no reachable pose: of {tried} places on the surface {too_low} are out of reach, {blocked} have no room for the pad"
    )]
    NothingReachable {
        /// Places tried.
        tried: usize,
        /// The fingertip would leave its workspace or enter the support.
        too_low: usize,
        /// The pad does not fit, or the object is in the way.
        blocked: usize,
    },
    /// The reconstruction failed.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// The object could not be found in the frame.
    #[error("seeing the object")]
    Segment(#[from] SegmentError),
    /// The evidence does not suffice.
    #[error("gathering the evidence")]
    Evidence(#[from] EvidenceError),
    /// The sensor is unknown or inconsistent.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The press parameters are out of range.
    #[error("press: {0}")]
    Press(#[from] PressError),
    /// The scene could not be simulated.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// The result could not be judged.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
}
