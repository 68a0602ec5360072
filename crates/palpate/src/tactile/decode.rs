use super::{Contact, ContactError, TactileSensor};
use crate::geometry::Raster;

/// Why a tactile image could not be decoded.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The touch has neither a recorded height map nor an image that this decoder reads.
    #[error("the touch has no recorded height map and contact mask; decoder '{decoder}' needs them")]
    NothingRecorded {
        /// Name of the decoder.
        decoder: &'static str,
    },
    /// The image is neither of the no-contact image's size nor a whole multiple of it.
    #[error(
        "the image is {}×{} px; the no-contact image is {}×{} (width × height): the same size or a whole multiple is needed",
        found.0, found.1, needed.0, needed.1
    )]
    Size {
        /// Width and height of the image.
        found: (usize, usize),
        /// Width and height of the no-contact image.
        needed: (usize, usize),
    },
    /// The no-contact image does not have the pad's shape.
    #[error(
        "the no-contact image is {}×{} px (width × height); one {} wide of sensor '{model}' is {needed_height} high",
        found.0, found.1, found.0
    )]
    Aspect {
        /// Width and height found.
        found: (usize, usize),
        /// Height that fits the sensor.
        needed_height: usize,
        /// The sensor.
        model: String,
    },
    /// The decoder works on one size, which the images cannot be averaged down to.
    #[error(
        "the images are {}×{} px; this decoder works on {}×{} (width × height) or a whole multiple",
        found.0, found.1, needed.0, needed.1
    )]
    WorkingSize {
        /// Width and height of the no-contact image.
        found: (usize, usize),
        /// Width and height that the decoder works on.
        needed: (usize, usize),
    },
    /// The image is grey, the no-contact image is not.
    #[error(
        "the image is grey (its channels differ by {found:.1} levels on average, those of the no-contact image by {reference:.1}): \
         a tactile image needs its colours"
    )]
    Grey {
        /// Mean spread between the channels of the image, grey levels.
        found: f32,
        /// The same of the no-contact image.
        reference: f32,
    },
    /// Red and blue are exchanged.
    #[error(
        "the image fits the no-contact image far better with red and blue exchanged ({reversed:.1} levels off, {found:.1} as it is): \
         one of the two is in BGR order, RGB is needed"
    )]
    ChannelsSwapped {
        /// Typical difference of the image as it is, grey levels.
        found: f32,
        /// The same with its channels reversed.
        reversed: f32,
    },
    /// Too many pixels carry no colour any more.
    #[error("{:.0} % of the image is over- or underexposed; at most {:.0} % can be decoded", 100.0 * found, 100.0 * limit)]
    Saturated {
        /// Share of the pixels with a channel at 255 or all at 0.
        found: f32,
        /// Share allowed.
        limit: f32,
    },
    /// The light is not that of the no-contact image.
    #[error(
        "the image is typically {found:.0} levels off the no-contact image, {limit:.0} are allowed: is that image of this sensor \
         and this light?"
    )]
    OtherLight {
        /// Median over the image of the local mean difference, grey levels.
        found: f32,
        /// Difference allowed.
        limit: f32,
    },
    /// The network was trained for another sensor.
    #[error(
        "the image is of sensor '{found}', the weights are for '{needed}': train some for this sensor (`palpate train compact`)"
    )]
    OtherSensor {
        /// Model of the image's sensor.
        found: String,
        /// Model that the weights are for.
        needed: String,
    },
    /// The decoder's answer is no possible gel surface.
    #[error(transparent)]
    Contact(#[from] ContactError),
}

/// Turns a tactile image into a height map and a contact mask.
pub trait TactileDecoder: Sync {
    /// Decodes one image (sRGB, the sensor's size or a whole multiple) taken by `sensor`.
    ///
    /// An image without contact is no error: the gel is relaxed and the mask empty.
    ///
    /// # Errors
    /// [`DecodeError`] if the image does not fit the decoder.
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError>;
}
