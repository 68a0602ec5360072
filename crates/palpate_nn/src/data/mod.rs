//! Samples, splits of the objects, and what is done to a sample before a network sees it.

mod augment;
mod error;
mod prepare;
mod press_folder;
mod samples;
mod split;

pub use augment::Augment;
pub use error::DataError;
pub use prepare::{Prepared, small_image};
pub use press_folder::PressFolder;
pub use samples::{MemorySamples, PressSample, Samples};
pub use split::Parts;
