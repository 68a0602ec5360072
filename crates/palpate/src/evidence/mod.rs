//! What is known of space: oriented samples of the surface with their uncertainty, and the space that is proven free.

mod samples;

pub use samples::{Provenance, Sample};
