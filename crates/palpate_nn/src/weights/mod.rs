//! Parameters as named tensors, and the files that hold them.
//!
//! A weight file is a safetensors file: readable by every framework, nothing in it is executed, sizes are checked before
//! anything is allocated. Tensors are named by their place in the network, such as `encoder.layer1.0.middle.conv.weight`.

mod error;
mod format;
mod initial;
mod tensors;
mod weight_file;

pub use error::WeightsError;
pub use format::{Precision, TensorFile};
pub use initial::initialize;
pub use tensors::{NamedTensor, NamedTensors, load_tensors, named_tensors, trainable_count};
pub(crate) use tensors::{TensorPath, follow_path, host_values};
pub use weight_file::{Architecture, Provenance, WeightFile};
