use super::{Contact, DecodeError, NoContact, TactileDecoder, TactileSensor};
use crate::geometry::Raster;

/// Share of the imprint's depth from which gel counts as contact: the definition of the YCB-Sight masks.
pub const CONTACT_SHARE: f32 = 0.4;
/// Indentation under which nothing counts as contact, metres: decoders see up to 0.05 mm in the noise of an untouched gel.
pub const CONTACT_FLOOR: f32 = 0.06e-3;

/// Contact from the change of brightness alone: mask only, the height map is the relaxed gel.
///
/// D = Σ over channels of |image − no-contact image|; D under 20 counts as none; the mask is D > 0.4 · (90th percentile of D).
/// A yardstick, not a decoder to reconstruct with: light changes most on slopes and least on flat contact.
#[derive(Debug, Clone)]
pub struct ThresholdDecoder {
    no_contact: NoContact,
}

impl ThresholdDecoder {
    /// Sum of differences that counts as none, grey levels.
    const NOISE: f32 = 20.0;
    /// Share of the 90th percentile from which a pixel is contact.
    const SHARE: f32 = 0.4;

    /// Subtracts this no-contact image.
    pub fn new(no_contact: NoContact) -> Self {
        Self { no_contact }
    }

    /// The mask alone.
    ///
    /// # Errors
    /// As [`NoContact::difference`].
    pub fn mask(&self, image: &Raster<[u8; 3]>) -> Result<Raster<bool>, DecodeError> {
        let change = self.no_contact.difference(image)?.map(|d| {
            let sum: f32 = d.iter().map(|v| v.abs()).sum();
            if sum < Self::NOISE { 0.0 } else { sum }
        });
        let limit = Self::SHARE * percentile(change.as_slice(), 0.9);
        Ok(change.map(|&d| d > limit))
    }
}

impl TactileDecoder for ThresholdDecoder {
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        let mask = self.mask(image)?;
        let height_map = sensor.relaxed(mask.rows(), mask.cols());
        Ok(Contact::new(height_map, mask, sensor)?)
    }
}

/// Where an indentation counts as contact: over `share` of its 99.5th percentile, and never under [`CONTACT_FLOOR`].
///
/// * `indentation` – relaxed gel minus gel, metres, larger = pressed further in
pub fn mask_from_height(indentation: &Raster<f32>, share: f32) -> Raster<bool> {
    let limit = (share * percentile(indentation.as_slice(), 0.995)).max(CONTACT_FLOOR);
    indentation.map(|&d| d > limit)
}

impl Contact {
    /// The contact of a gel that is pressed in so far, masked by [`mask_from_height`].
    ///
    /// A gel outside what is possible (out of its relaxed shape by more than the bulge allowed, or deeper than any gel) is cut
    /// off there: a decoder errs, it does not lie about units.
    ///
    /// * `indentation` – relaxed gel minus gel, metres; any resolution with the pad's aspect
    ///
    /// # Errors
    /// [`DecodeError::Contact`] if a value is NaN or the shape is not the pad's.
    pub fn from_indentation(indentation: &Raster<f32>, sensor: &TactileSensor) -> Result<Self, DecodeError> {
        let mask = mask_from_height(indentation, CONTACT_SHARE);
        let mut height_map = sensor.relaxed(indentation.rows(), indentation.cols());
        let (deepest, bulge) = (-Self::MAX_HEIGHT as f32, Self::BULGE_TOLERANCE as f32);
        for (z, d) in height_map.as_mut_slice().iter_mut().zip(indentation.as_slice()) {
            // Just inside the bounds, for the sum is rounded; `max` would swallow NaN.
            let d = if *d < -0.99 * bulge { -0.99 * bulge } else { *d };
            *z = if *z - d < deepest { deepest } else { *z - d };
        }
        Ok(Self::new(height_map, mask, sensor)?)
    }

    /// Relaxed gel minus gel, metres: 0 where nothing presses.
    pub fn indentation(&self, sensor: &TactileSensor) -> Raster<f32> {
        let (rows, cols) = self.height_map.shape();
        let mut indentation = sensor.relaxed(rows, cols);
        indentation.as_mut_slice().iter_mut().zip(self.height_map.as_slice()).for_each(|(d, z)| *d -= z);
        indentation
    }
}

/// The value that a share `q` of all values does not exceed; 0 of nothing. NaN counts as large.
fn percentile(values: &[f32], q: f64) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let place = (q * (values.len() - 1) as f64).round() as usize;
    *values.to_vec().select_nth_unstable_by(place, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dome() -> TactileSensor {
        TactileSensor::preset("ycb-sight").expect("listed")
    }

    #[test]
    fn the_mask_is_where_the_light_changes() {
        let light = |_, c: usize| [120u8, 100 + c as u8, 160 - c as u8];
        let back = NoContact::new(Raster::from_fn(48, 64, light), &dome()).expect("sound");
        let decoder = ThresholdDecoder::new(back.clone());
        let inside = |r: usize, c: usize| r.abs_diff(24) < 12 && c.abs_diff(30) < 12;
        let faint = |r: usize, c: usize| r == 3 && c == 3;
        let image = Raster::from_fn(48, 64, |r, c| {
            let step = if inside(r, c) { 20 } else { u8::from(faint(r, c)) * 8 };
            light(r, c).map(|v| v + step)
        });
        let contact = decoder.decode(&image, &dome()).expect("sound");
        assert!(contact.mask.pixels().all(|(r, c, &m)| m == inside(r, c)));
        assert_eq!(contact.height_map, dome().relaxed(48, 64));
        let untouched = decoder.decode(back.image(), &dome()).expect("no error");
        assert!(!untouched.mask.as_slice().contains(&true));
    }

    #[test]
    fn a_cap_is_masked_at_its_share_and_noise_is_not() {
        let cap = Raster::from_fn(48, 64, |r, c| {
            let r2 = ((r as f32 - 24.0).powi(2) + (c as f32 - 32.0).powi(2)) / 400.0;
            1e-3 * (1.0 - r2).max(0.0)
        });
        let contact = Contact::from_indentation(&cap, &dome()).expect("sound");
        let limit = 0.4 * percentile(cap.as_slice(), 0.995);
        assert!(limit > 0.38e-3);
        assert!(contact.mask.as_slice().iter().zip(cap.as_slice()).all(|(&m, &d)| m == (d > limit)));
        let back = contact.indentation(&dome());
        assert!(back.as_slice().iter().zip(cap.as_slice()).all(|(a, b)| (a - b).abs() < 1e-9));
        let noise = cap.map(|d| 0.05 * d);
        assert!(!mask_from_height(&noise, CONTACT_SHARE).as_slice().contains(&true));
    }

    #[test]
    fn impossible_gels_are_cut_off_and_nan_is_an_error() {
        let wild = Raster::from_fn(48, 64, |r, _| if r < 24 { 0.5 } else { -0.5 });
        let contact = Contact::from_indentation(&wild, &dome()).expect("cut off");
        assert!(contact.validate(&dome()).is_ok());
        let nan = Raster::filled(48, 64, f32::NAN);
        assert!(matches!(Contact::from_indentation(&nan, &dome()), Err(DecodeError::Contact(_))));
    }
}
