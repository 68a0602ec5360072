//! From what is known to the whole: measured samples moved by the accepted symmetries (`fused`), and the removal of guesses that
//! a touch contradicts (`paper`).

mod eliminate;
mod motion;
mod orbit;

pub use eliminate::{EliminationParams, contradicted};
pub use motion::{Copying, best_plane, copyings};
pub use orbit::{MovedEvidence, OrbitParams, move_evidence};
