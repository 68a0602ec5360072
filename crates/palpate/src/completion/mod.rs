//! From what is known to the whole: measured samples moved by the accepted symmetries (`fused`), and the removal of guesses that
//! a touch contradicts (`paper`).

mod copies;
mod correction;
mod eliminate;
mod far_sides;
mod follow;
mod follow_pose;
mod guess_sigma;
mod inscribed;
mod known_sides;
mod kriging;
mod motion;
mod orbit;
mod thickness;
mod touch_check;
mod touch_pose;

pub use eliminate::{EliminationParams, contradicted};
pub use follow::MovedChange;
pub use follow_pose::refine_touch;
pub use guess_sigma::GuessSigma;
pub use motion::{Copying, best_plane, copyings};
pub use orbit::{MovedEvidence, OrbitParams, copying_radius, move_evidence};
pub use touch_check::{Objection, TouchCheckParams, objections};
pub use touch_pose::{RefinedTouch, TouchPoseParams, refine_touches};
