//! The fingertip: sensor geometry, what a press records, and the oriented patch it proves.

mod contact;
mod decode;
mod patch;
mod sensor;

pub use contact::{Contact, Touch};
pub use decode::{DecodeError, TactileDecoder};
pub use patch::Patch;
pub use sensor::{RelaxedGel, TactileSensor};
