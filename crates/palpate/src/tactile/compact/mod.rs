//! The compact decoder: a small network, run without any deep-learning framework.
//!
//! Trained by `palpate_nn`, which mirrors [`CompactModel`] layer by layer; a test there holds the two equal.

mod convolution;
mod model;
mod planes;
mod weights;

pub use convolution::Convolution;
pub use model::{
    CompactModel, GRADIENT_WIDTH, Indentation, LEVEL_BLOCKS, LEVEL_SCALE, LEVEL_WIDTHS, LEVELS, MASK_WIDTH,
    STEP_SCALE, WORKING_SIZE, gradient_input, join, level_input, mask_input,
};
pub use planes::Planes;
pub use weights::{ARCHITECTURE, VERSION, WeightsError};
