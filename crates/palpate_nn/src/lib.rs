//! Networks of palpate: from a tactile image to a height map and a contact mask; their training and weight files.
//!
//! * [`compact`] – training of the small decoder that `palpate` ships and runs by itself
//! * [`fcrn`] – the encoder-decoder network of the thesis that palpate follows, in any width
//! * [`weights`] – parameters as named tensors in safetensors files
//! * [`train`] – one training loop for every network: a network is a [`train::Task`]
//! * [`data`] – samples from press data sets, object-wise splits, augmentation
//! * [`config`] – the parameter file of a training run and its presets
//!
//! Everything is generic over burn's `Backend`; [`Cpu`] is the one that tests and plain builds use.

pub mod compact;
pub mod config;
pub mod data;
mod decoder;
pub mod fcrn;
pub mod loss;
pub mod tactile;
pub mod train;
pub mod weights;

mod layers;
mod random;

/// The CPU back end: vectorised and threaded, pure Rust.
pub type Cpu = burn::backend::Flex;

/// The one device of [`Cpu`].
pub use burn_flex::FlexDevice as CpuDevice;
pub use decoder::{FcrnDecoder, FcrnDecoderError};

/// [`Cpu`] with reverse-mode differentiation.
pub type CpuAutodiff = burn::backend::Autodiff<Cpu>;

/// The CUDA back end with reverse-mode differentiation.
#[cfg(feature = "cuda")]
pub type CudaAutodiff = burn::backend::Autodiff<burn::backend::Cuda>;

/// What networks are generic over, for callers that do not name burn.
pub use burn::tensor::backend::AutodiffBackend;
