use super::{Augment, DataError, PressSample, Samples};
use palpate::geometry::Raster;
use palpate::tactile::resample::resize;
use rand_pcg::Pcg64;

/// A sample of a network's input size, planar.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// `[3, rows, cols]`: grey levels of 255, red green blue; or their differences to the background.
    pub image: Vec<f32>,
    /// z of the gel, metres.
    pub height: Vec<f32>,
    /// 1 where the object touches, else 0.
    pub mask: Vec<f32>,
}

impl Prepared {
    /// Loads a press and brings it to `(rows, cols)`.
    ///
    /// Everything is resampled alike: areas are averaged. The mask is then cut at one half.
    ///
    /// * `background` – what is taken off, as [`small_image`] makes it
    /// * `augment` – with its random numbers; none in validation
    ///
    /// # Errors
    /// [`DataError::Io`], [`DataError::Sizes`].
    pub fn load(
        samples: &dyn Samples,
        index: usize,
        (rows, cols): (usize, usize),
        background: Option<&[f32]>,
        augment: Option<(&Augment, &mut Pcg64)>,
    ) -> Result<Self, DataError> {
        let PressSample { image, height_map, mask } = samples.load(index)?;
        let sizes = [image.shape(), height_map.shape(), mask.shape()];
        if sizes[1] != sizes[0] || sizes[2] != sizes[0] {
            return Err(DataError::Sizes { index, object: samples.object(index).to_owned(), sizes });
        }
        let mut image = small_image(&image, (rows, cols));
        // The lamp changes, then the background is subtracted that was recorded before.
        if let Some((augment, rng)) = augment {
            augment.apply(&mut image, rng);
        }
        if let Some(background) = background {
            image.iter_mut().zip(background).for_each(|(v, b)| *v -= b);
        }
        let mask = resize(&mask.map(|&m| f32::from(u8::from(m))), rows, cols);
        Ok(Self {
            image,
            height: resize(&height_map, rows, cols).as_slice().to_vec(),
            mask: mask.as_slice().iter().map(|&m| f32::from(u8::from(m >= 0.5))).collect(),
        })
    }
}

/// An image at `(rows, cols)`, `[3, rows, cols]`: grey levels of 255, red green blue.
pub fn small_image(image: &Raster<[u8; 3]>, (rows, cols): (usize, usize)) -> Vec<f32> {
    let small = resize(&image.map(|rgb| rgb.map(f32::from)), rows, cols);
    (0..3).flat_map(|channel| small.as_slice().iter().map(move |rgb| rgb[channel])).collect()
}
