use super::IoError;
use super::error::read_bytes;
use crate::tactile::compact::Weights;
use std::path::Path;

/// Reads the weights of a compact decoder.
///
/// # Errors
/// [`IoError::Read`], or [`IoError::Content`] for a file that is damaged or of another kind.
pub fn read_compact_weights(path: impl AsRef<Path>) -> Result<Weights, IoError> {
    let path = path.as_ref();
    Weights::parse(&read_bytes(path)?).map_err(|error| IoError::content(path, error.to_string()))
}
