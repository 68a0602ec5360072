//! How far a predicted mesh is from the truth: distances, F-scores, normal consistency, volumetric IoU, and the hidden side alone.
//!
//! Nothing is aligned: both meshes are judged in the frame they come in. Distances run from area-weighted samples of one
//! surface to the other's **triangles**; IoU integrates exact intervals along a jittered lattice of lines.

mod calibration;
mod comparison;
mod distances;
mod inside;
mod oracle_plane;
mod raster;
mod statistics;
mod surface_samples;
mod tactile;
#[cfg(test)]
pub(crate) mod test_shapes;
mod truth;
mod volumetric_iou;

pub use calibration::{Calibration, NORMAL_90, spearman};
pub use comparison::{Comparison, MetricsError, compare};
pub use distances::{Distances, SampleDistances};
pub use oracle_plane::{mirror_error, oracle_plane};
pub use statistics::{Interval, Summary, bootstrap_interval, quantile, summarize};
pub use surface_samples::SurfaceSamples;
pub use tactile::{TactileErrors, TactileMetricsError, compare_contacts};
pub use truth::{CompareParams, TruthReference, Viewpoint};
pub use volumetric_iou::{IouParams, volumetric_iou};
