//! How far a decoded contact is from the true one.

use crate::geometry::Raster;
use crate::tactile::resample::resize;
use crate::tactile::{Contact, ContactError, TactileSensor};

/// Half width of the central differences of the normals, metres: one pixel of a 320-wide map of an 18.9 mm pad.
const NORMAL_HALF_WIDTH: f64 = 0.059e-3;

/// Errors of one decoded contact. Heights are indentations: relaxed gel minus gel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct TactileErrors {
    /// Root mean square height error over the whole pad, mm.
    pub rmse_mm: f64,
    /// The same inside the true contact; none if there is none.
    pub contact_rmse_mm: Option<f64>,
    /// Mean height error inside the true contact (decoded minus true indentation), mm: the bias of the depth.
    pub contact_bias_mm: Option<f64>,
    /// Mean angle between decoded and true normals inside the true contact, degrees.
    pub normal_error_deg: Option<f64>,
    /// Intersection over union of the masks; 1 if both are empty.
    pub mask_iou: f64,
    /// F1 of the mask's pixels (the Dice coefficient); 1 if both are empty.
    pub mask_f1: f64,
    /// Share of the pad that is truly in contact.
    pub truth_share: f64,
    /// Share of the pad that the decoder says is in contact.
    pub decoded_share: f64,
}

/// Why two contacts cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TactileMetricsError {
    /// One of the two is no possible contact of the sensor.
    #[error(transparent)]
    Contact(#[from] ContactError),
    /// The sizes are no whole multiples of each other.
    #[error(
        "the decoded map is {}×{}, the true one {}×{} (rows × cols): one must be a whole multiple of the other",
        decoded.0, decoded.1, truth.0, truth.1
    )]
    Size {
        /// Rows and columns of the decoded map.
        decoded: (usize, usize),
        /// Rows and columns of the true map.
        truth: (usize, usize),
    },
}

/// Compares a decoded contact with the true one of the same press, on the coarser of the two rasters.
///
/// # Errors
/// [`TactileMetricsError`].
pub fn compare_contacts(
    decoded: &Contact,
    truth: &Contact,
    sensor: &TactileSensor,
) -> Result<TactileErrors, TactileMetricsError> {
    decoded.validate(sensor)?;
    truth.validate(sensor)?;
    let sizes = (decoded.height_map.shape(), truth.height_map.shape());
    let rows = sizes.0.0.min(sizes.1.0);
    let cols = sizes.0.1.min(sizes.1.1);
    let fits = |(r, c): (usize, usize)| r % rows == 0 && c % cols == 0 && r / rows == c / cols;
    if !fits(sizes.0) || !fits(sizes.1) {
        return Err(TactileMetricsError::Size { decoded: sizes.0, truth: sizes.1 });
    }
    let [decoded, truth] = [decoded, truth].map(|contact| Coarse::of(contact, sensor, cols));
    let pitch = sensor.map_pitch(cols);
    let errors: Vec<f64> =
        decoded.heights.iter().zip(&truth.heights).map(|(d, t)| 1e3 * (f64::from(*d) - f64::from(*t))).collect();
    let inside: Vec<f64> = errors.iter().zip(&truth.mask).filter(|(_, m)| **m).map(|(e, _)| *e).collect();
    let rms = |errors: &[f64]| (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let some = |value: f64| (!inside.is_empty()).then_some(value);
    let count = |f: &dyn Fn(bool, bool) -> bool| {
        decoded.mask.iter().zip(&truth.mask).filter(|(d, t)| f(**d, **t)).count() as f64
    };
    let (both, either) = (count(&|d, t| d && t), count(&|d, t| d || t));
    let (said, area) = (count(&|d, _| d), errors.len() as f64);
    let true_pixels = inside.len() as f64;
    let (mask_iou, mask_f1) =
        if either == 0.0 { (1.0, 1.0) } else { (both / either, 2.0 * both / (said + true_pixels)) };
    Ok(TactileErrors {
        rmse_mm: rms(&errors),
        contact_rmse_mm: some(rms(&inside)),
        contact_bias_mm: some(inside.iter().sum::<f64>() / true_pixels),
        normal_error_deg: normal_error(&decoded, &truth, (rows, cols), pitch, sensor),
        mask_iou,
        mask_f1,
        truth_share: true_pixels / area,
        decoded_share: said / area,
    })
}

/// Indentations (metres) and mask of a contact, averaged down.
struct Coarse {
    heights: Vec<f32>,
    mask: Vec<bool>,
}

impl Coarse {
    fn of(contact: &Contact, sensor: &TactileSensor, cols: usize) -> Self {
        let factor = contact.height_map.cols() / cols;
        let heights = contact.indentation(sensor);
        if factor == 1 {
            return Self { heights: heights.as_slice().to_vec(), mask: contact.mask.as_slice().to_vec() };
        }
        let pairs = heights.as_slice().iter().zip(contact.mask.as_slice());
        let both: Vec<[f32; 2]> = pairs.map(|(h, m)| [*h, f32::from(u8::from(*m))]).collect();
        let both = Raster::from_vec(heights.rows(), heights.cols(), both).expect("one pair a pixel");
        let small = resize(&both, both.rows() / factor, cols);
        let (heights, mask) = small.as_slice().iter().map(|[h, m]| (*h, *m >= 0.5)).unzip();
        Self { heights, mask }
    }
}

/// Mean angle between the surfaces' normals over the true contact, where both neighbours are inside the pad.
fn normal_error(
    decoded: &Coarse,
    truth: &Coarse,
    (rows, cols): (usize, usize),
    pitch: f64,
    sensor: &TactileSensor,
) -> Option<f64> {
    let half = ((NORMAL_HALF_WIDTH / pitch).round() as usize).max(1);
    let relaxed = sensor.relaxed(rows, cols);
    let normal = |heights: &[f32], row: usize, col: usize| {
        let z = |r: usize, c: usize| f64::from(relaxed[(r, c)]) - f64::from(heights[r * cols + c]);
        let width = 2.0 * half as f64 * pitch;
        let dx = (z(row, col + half) - z(row, col - half)) / width;
        let dy = (z(row + half, col) - z(row - half, col)) / width;
        crate::geometry::Vector::new(dx, dy, -1.0).normalize()
    };
    let (mut sum, mut count) = (0.0, 0usize);
    for row in half..rows.saturating_sub(half) {
        for col in half..cols.saturating_sub(half) {
            if truth.mask[row * cols + col] {
                let (a, b) = (normal(&decoded.heights, row, col), normal(&truth.heights, row, col));
                // atan2 keeps small angles, which acos rounds away.
                sum += a.cross(&b).norm().atan2(a.dot(&b));
                count += 1;
            }
        }
    }
    (count > 0).then(|| (sum / count as f64).to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor() -> TactileSensor {
        TactileSensor::preset("ycb-sight").expect("listed")
    }

    fn contact(
        rows: usize,
        cols: usize,
        indentation: impl Fn(f64, f64) -> f64,
        felt: impl Fn(f64, f64) -> bool,
    ) -> Contact {
        let sensor = sensor();
        let at = |r, c| sensor.pixel_position(r, c, rows, cols);
        let height_map = Raster::from_fn(rows, cols, |r, c| {
            let (x, y) = at(r, c);
            (sensor.relaxed_z(r, c, rows, cols) - indentation(x, y)) as f32
        });
        let mask = Raster::from_fn(rows, cols, |r, c| {
            let (x, y) = at(r, c);
            felt(x, y)
        });
        Contact { height_map, mask }
    }

    #[test]
    fn a_contact_has_no_error_against_itself_at_any_resolution() {
        let dent = |x: f64, y: f64| 1e-3 * (1.0 - (x * x + y * y) / 25e-6).max(0.0);
        let felt = |x: f64, y: f64| x.hypot(y) < 4e-3;
        let (fine, coarse) = (contact(480, 640, dent, felt), contact(240, 320, dent, felt));
        let same = compare_contacts(&fine, &fine, &sensor()).expect("comparable");
        assert_eq!((same.rmse_mm, same.mask_iou, same.normal_error_deg), (0.0, 1.0, Some(0.0)));
        let other = compare_contacts(&coarse, &fine, &sensor()).expect("twice as fine");
        assert!(other.rmse_mm < 1e-3 && other.mask_iou > 0.98, "{other:?}");
        assert!(other.normal_error_deg.expect("contact") < 0.1, "{other:?}");
    }

    #[test]
    fn offsets_tilts_and_shares_are_what_they_are() {
        let inside = |x: f64, _: f64| x < 0.0;
        let truth = contact(48, 64, |_, _| 0.3e-3, inside);
        let deeper = contact(48, 64, |x, _| if x < 0.0 { 0.4e-3 } else { 0.3e-3 }, |x, _| x < 4.72e-3);
        let found = compare_contacts(&deeper, &truth, &sensor()).expect("comparable");
        assert!((found.contact_rmse_mm.expect("contact") - 0.1).abs() < 1e-4);
        assert!((found.contact_bias_mm.expect("contact") - 0.1).abs() < 1e-4);
        assert!((found.rmse_mm - 0.1 * 0.5f64.sqrt()).abs() < 1e-4);
        // Half the pad is contact, three quarters are said to be.
        assert!((found.mask_iou - 2.0 / 3.0).abs() < 1e-9 && (found.mask_f1 - 0.8).abs() < 1e-9, "{found:?}");
        // On a flat gel a slope of 5 % is atan 0.05.
        let flat = TactileSensor { relaxed_gel: crate::tactile::RelaxedGel::Flat, ..sensor() };
        let plane = |slope: f64| {
            let height_map =
                Raster::from_fn(48, 64, |r, c| (-0.4e-3 - slope * flat.pixel_position(r, c, 48, 64).0) as f32);
            Contact { height_map, mask: Raster::filled(48, 64, true) }
        };
        let tilted = compare_contacts(&plane(0.03), &plane(0.0), &flat).expect("comparable");
        let angle = tilted.normal_error_deg.expect("contact");
        assert!((angle - 0.03f64.atan().to_degrees()).abs() < 1e-3, "{angle}");
    }

    #[test]
    fn empty_masks_agree_and_odd_sizes_do_not() {
        let none = contact(48, 64, |_, _| 0.0, |_, _| false);
        let found = compare_contacts(&none, &none, &sensor()).expect("comparable");
        assert_eq!((found.mask_iou, found.contact_rmse_mm, found.normal_error_deg), (1.0, None, None));
        let odd = contact(36, 48, |_, _| 0.0, |_, _| false);
        assert_eq!(
            compare_contacts(&odd, &none, &sensor()),
            Err(TactileMetricsError::Size { decoded: (36, 48), truth: (48, 64) })
        );
    }
}
