//! Tactile optics: from a deformed gel to the image that the fingertip's camera takes (Taxim).
//!
//! Colour change by a photometric table, plus shadows where asked for, plus the background; marker dots are drawn last. Images are
//! RGB everywhere; Taxim's tables are B, G, R, which is undone where they are used.

mod error;
mod markers;
mod nnls;
mod photometry;
mod point_response;
mod presets;
mod renderer;
mod shadow;

pub use error::OpticsError;
pub use markers::{MarkerError, MarkerField, MarkerParams, draw_markers};
pub use photometry::PhotometricTable;
pub use renderer::TactileOptics;
pub use shadow::{PressedGel, ShadowError, ShadowTable, cast_shadows, soften};
