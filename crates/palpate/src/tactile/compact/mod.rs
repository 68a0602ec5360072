//! The compact decoder: a small network, run without any deep-learning framework.
//!
//! Trained by `palpate_nn`, which mirrors it layer by layer; a test there holds the two equal.

mod convolution;
mod decoder;
mod model;
mod planes;
mod weights;

pub use convolution::Convolution;
pub use decoder::CompactDecoder;
pub use model::{
    CompactModel, GRADIENT_LAYERS, GradientMap, Indentation, LEVEL_BLOCKS, LEVEL_INPUTS, LEVEL_SCALE, LEVEL_WIDTHS,
    LEVELS, LevelNetwork, MASK_LAYERS, MaskMap, STEP_SCALE, WORKING_SIZE, gradient_input, indentation, join,
    level_input, mask_input,
};
pub use planes::Planes;
pub use weights::{ARCHITECTURE, VERSION, Weights, WeightsError};
