//! The methods, top to bottom: one frame and some touches in, a closed mesh out.
//!
//! [`reconstruct`] is the door; `fused` and `paper` read like the method. Results keep every intermediate, so viewers and tests
//! need no hooks.

mod color;
mod error;
mod fused;
mod paper;
mod params;
mod reconstruct;
mod session;
mod stages;
mod trust;
mod uncertainty;
mod vertices;

pub use color::{ColorBy, provenance_color, sigma_color};
pub use error::ReconstructError;
pub use paper::{PaperError, PaperParams, PaperResult, PaperSurface, reconstruct_paper};
pub use params::{Method, ReconstructParams, Surface, TouchParams, WeightParams};
pub use reconstruct::{Reconstruction, SettledTouch, Stages, Warning, reconstruct};
pub use session::{Followed, Session, Update};
pub use stages::with_contacts;
pub use uncertainty::{SigmaTerms, VertexKnowledge, VertexProvenance};
