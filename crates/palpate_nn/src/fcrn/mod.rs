//! The fully convolutional residual network of the thesis: a ResNet-50 encoder and four up-projections.
//!
//! # References
//! Laina et al., *Deeper Depth Prediction with Fully Convolutional Residual Networks*, 3DV 2016 (decoder, fast
//! up-projection); He et al., *Deep Residual Learning for Image Recognition*, CVPR 2016 (encoder); Suresh et al.,
//! *ShapeMap 3-D*, ICRA 2022 and *MidasTouch*, CoRL 2022 (use on tactile images).
//!
//! # Departures
//! * Weights start at random: N(0, √(2 / (kh·kw·`C_out`))), biases 0. No ImageNet weights are loaded.
//! * The running variance of batch normalisation averages the *biased* batch variance (burn), PyTorch's the unbiased one.
//! * Sizes that 32 does not divide are padded by repeating the edge, and the output is cropped.

mod decoder;
mod encoder;
mod network;

pub use network::{Fcrn, FcrnConfig, FcrnError, Head};
