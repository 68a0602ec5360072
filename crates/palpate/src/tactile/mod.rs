//! The fingertip: sensor geometry, what a press records, and the oriented patch it proves.

mod ball;
pub mod compact;
mod contact;
mod decode;
mod gaussian;
mod integrate;
mod lift;
mod lookup_table;
mod markers;
mod no_contact;
pub mod optics;
mod patch;
mod press;
mod regressor;
pub mod resample;
mod sensor;
mod sine;
mod threshold;

pub use ball::{BallPress, refine_ball};
pub use contact::{Contact, ContactError, Touch};
pub use decode::{DecodeError, TactileDecoder};
pub use integrate::Integrator;
pub use lift::{LiftError, LiftParams, lift};
pub use lookup_table::{Border, CalibrationSample, LookupDecoder, LookupTable, LookupTableError};
pub use markers::{fill_markers, markers};
pub use no_contact::NoContact;
pub use patch::Patch;
pub use press::{PressError, PressParams, Pressed, press, press_surface};
pub use regressor::{RegressorDecoder, RegressorError, SlopeRegressor, SlopeSample};
pub use sensor::{RelaxedGel, SensorError, TactileSensor};
pub use threshold::{CONTACT_FLOOR, CONTACT_SHARE, ThresholdDecoder, mask_from_height};
