//! Light: what the camera behind the gel sees of a press.

mod markers;
mod nnls;
mod point_response;
mod shadow;

pub use markers::{MarkerError, MarkerField, MarkerParams, draw_markers};
pub use shadow::{PressedGel, ShadowError, ShadowTable, cast_shadows, soften};
