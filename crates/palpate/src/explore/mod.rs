//! Where to touch next: reachable poses of the fingertip, ranked by how much the mesh is expected to gain, and the loop that shows it.
//!
//! [`next_touches`] is the door; [`explore`] plays the loop on a known mesh with one of the [`Policy`]s. The equations stand in
//! docs/next-touch.md.

mod belief;
mod candidates;
mod error;
mod gap;
mod hypotheses;
mod next_touch;
mod params;
mod policy;
mod reach;
mod trial;
mod uncertainty;

pub use belief::{Belief, Gain};
pub use candidates::{Candidate, Planner};
pub use error::ExploreError;
pub use gap::{ObjectErrors, gap_closed};
pub use next_touch::{NextTouch, next_touches, rank};
pub use params::{BeliefParams, ExploreParams, NextTouchParams};
pub use policy::Policy;
pub use reach::{ApproachCone, HalfSpace, Reach, Workspace};
pub use trial::{Step, Trial, explore};
pub use uncertainty::{EvidenceDistance, SurfaceUncertainty};
