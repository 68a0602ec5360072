//! Tactile presses without a scene: the training data of decoders.

mod calibration;
mod disturbance;
mod light;
mod primitives;
mod sampler;

pub use calibration::simulated_lookup_table;
pub use disturbance::Disturbance;
pub use light::LightParams;
pub use primitives::Primitive;
pub use sampler::{PressRecord, PressSample, PressSampler, PressSetParams};
