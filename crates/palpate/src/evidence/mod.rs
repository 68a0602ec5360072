//! What is known of space: oriented samples of the surface with their uncertainty, and the space that is proven free.
//!
//! [`Evidence::gather`] joins the camera's view and the touches into one structure that the symmetry search, the filters of
//! the completion and the fusion all read. Nothing in it is a guess.

mod contour;
mod follow;
mod free_space;
mod gather;
mod grid;
mod index;
mod pad;
mod params;
mod pose;
mod rays;
mod samples;
#[cfg(test)]
pub(crate) mod testing;
mod thin;

pub use contour::ContourPoint;
pub use free_space::FreeSpace;
pub use gather::Evidence;
pub use index::{Match, SampleIndex};
pub use params::{EvidenceError, EvidenceParams};
pub use pose::{pose_row, pose_sigma_at};
pub use samples::{Provenance, Sample};
pub(crate) use samples::{cell_and_side, firsts, thinned};
pub use thin::average_in_voxels;
