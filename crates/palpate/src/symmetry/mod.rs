//! Symmetry as a hypothesis that evidence can reject.
//!
//! A hypothesis moves every measured sample, seen and felt, and looks it up: landing in proven free space speaks against it, landing on a
//! measured surface with an agreeing normal speaks for it, landing where nothing is known says nothing. Accepting none is an answer.

mod accept;
mod axes;
mod course;
mod element;
mod estimate;
mod params;
mod planes;
mod refine;
mod resting;
mod score;
mod verdict;
mod watch;

pub use element::{Motion, SymmetryElement};
pub(crate) use element::{tangents, tilted};
pub use estimate::{EvidenceSearch, Hypothesis, Rejection, Symmetry, SymmetryEstimator};
pub use params::{SymmetryError, SymmetryParams};
pub use score::Score;
pub use verdict::{Verdict, verdict_cloud, verdicts};
pub use watch::contradicted;
