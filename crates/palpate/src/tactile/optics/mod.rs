//! Tactile optics: from a deformed gel to the image that the fingertip's camera takes (Taxim).
//!
//! Colour change by a photometric table, plus the background. Images are RGB everywhere; Taxim's files are B, G, R, which is
//! undone where the table is made.

mod error;
mod photometry;
mod presets;
mod renderer;

pub use error::OpticsError;
pub use photometry::PhotometricTable;
pub use renderer::TactileOptics;
