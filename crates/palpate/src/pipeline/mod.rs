//! The methods, top to bottom: one frame and some touches in, a closed mesh out.

mod paper;

pub use paper::{PaperError, PaperParams, PaperResult, PaperSurface, reconstruct_paper};
