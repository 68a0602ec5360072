//! Tactile presses without a scene: the training data of decoders.

mod light;
mod primitives;
mod sampler;

pub use light::LightParams;
pub use primitives::Primitive;
pub use sampler::{PressRecord, PressSample, PressSampler, PressSetParams};
