//! Light: what the camera behind the gel sees of a press.

mod shadow;

pub use shadow::{PressedGel, ShadowError, ShadowTable, cast_shadows, soften};
