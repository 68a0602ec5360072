use super::{Contact, TactileSensor};
use crate::geometry::Raster;

/// Why a tactile image could not be decoded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The touch has neither a recorded height map nor an image that this decoder reads.
    #[error("the touch has no recorded height map and contact mask; decoder '{decoder}' needs them")]
    NothingRecorded {
        /// Name of the decoder.
        decoder: &'static str,
    },
}

/// Turns a tactile image into a height map and a contact mask.
pub trait TactileDecoder: Sync {
    /// Decodes one image (sRGB, the sensor's size) taken by `sensor`.
    ///
    /// # Errors
    /// [`DecodeError`] if the image does not fit the decoder.
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError>;
}
