use palpate::io::IoError;
use std::path::PathBuf;

/// Why weights could not be read, written or put into a network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// The file cannot be read or written.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The bytes are no safetensors file, or it is cut short.
    #[error("{}: not a readable weight file: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A metadata entry that every weight file of palpate has is not there.
    #[error("{}: metadata entry '{key}' is missing or unreadable; was the file written by palpate?", path.display())]
    Metadata {
        /// The file.
        path: PathBuf,
        /// Name of the entry.
        key: &'static str,
    },
    /// The file holds another network.
    #[error("{}: holds weights of {found}, but {needed} is needed", path.display())]
    Architecture {
        /// The file.
        path: PathBuf,
        /// Network in the file.
        found: String,
        /// Network asked for.
        needed: String,
    },
    /// A tensor of the network is not in the file.
    #[error("{}: tensor '{tensor}' of shape {needed:?} is missing", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Its shape in the network.
        needed: Vec<usize>,
    },
    /// The file holds a tensor that the network does not have.
    #[error("{}: tensor '{tensor}' of shape {found:?} belongs to no layer of the network", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Its shape in the file.
        found: Vec<usize>,
    },
    /// A tensor has another shape than the network needs.
    #[error("{}: tensor '{tensor}' has shape {found:?}; {needed:?} is needed", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Shape in the file.
        found: Vec<usize>,
        /// Shape in the network.
        needed: Vec<usize>,
    },
    /// A tensor holds numbers of a kind that is not read.
    #[error("{}: tensor '{tensor}' holds {found}; F32 or F16 is needed", path.display())]
    Kind {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Kind of number found.
        found: String,
    },
    /// A value is NaN or infinite, or would become so in half precision.
    #[error("{}: tensor '{tensor}' holds {found}; every weight must be finite (and below 65504 in half precision)", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Value found.
        found: f32,
    },
}
