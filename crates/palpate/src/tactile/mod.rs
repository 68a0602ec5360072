//! The fingertip: sensor geometry, what a press records, and the oriented patch it proves.

mod contact;
mod decode;
mod gaussian;
mod lift;
pub mod optics;
mod patch;
mod press;
mod sensor;

pub use contact::{Contact, ContactError, Touch};
pub use decode::{DecodeError, TactileDecoder};
pub use lift::{LiftError, LiftParams, lift};
pub use patch::Patch;
pub use press::{PressError, PressParams, Pressed, press};
pub use sensor::{RelaxedGel, SensorError, TactileSensor};
