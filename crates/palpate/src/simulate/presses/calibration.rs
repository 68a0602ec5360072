use super::Primitive;
use crate::geometry::{Isometry, Raster};
use crate::simulate::SimulateError;
use crate::tactile::optics::TactileOptics;
use crate::tactile::{
    CalibrationSample, LookupDecoder, LookupTable, NoContact, PressParams, TactileSensor, press_surface,
};

/// Radii of the balls, metres: slopes of all steepnesses, and flat contact.
const RADII: [f64; 3] = [2e-3, 5e-3, 15e-3];
/// Places of each ball as shares of the pad's half width and height.
const PLACES: [f64; 3] = [-0.5, 0.0, 0.5];

/// Calibrates a colour table as in a laboratory, with balls on a 3 × 3 grid, but simulated: a look-up decoder for simulated images
/// that needs no measured table. Of a real sensor of the same model it knows the colours only as well as the simulator does.
///
/// # Errors
/// [`SimulateError`] if no optics of this sensor are known.
pub fn simulated_lookup_table(sensor: &TactileSensor) -> Result<LookupTable, SimulateError> {
    let optics = TactileOptics::preset(sensor)?;
    let no_contact = NoContact::new(optics.no_contact(), sensor).expect("our own image has the sensor's shape");
    let gains = LookupDecoder::gains(&no_contact);
    let params = PressParams { min_contact: 0.0, ..PressParams::default() };
    let (width, height) = sensor.pad_size();
    let mut samples = Vec::new();
    for radius in RADII {
        for (fx, fy) in PLACES.iter().flat_map(|y| PLACES.map(|x| (x, *y))) {
            let ball = Primitive::ball(radius, (0.5 * fx * width, 0.5 * fy * height));
            let mut surface = ball.surface(sensor, sensor.height, sensor.width);
            let top = surface.as_slice().iter().copied().fold(f32::INFINITY, f32::min);
            surface.as_mut_slice().iter_mut().for_each(|z| *z -= top);
            // A ball that the pad's rim keeps away is left out.
            let Ok(pressed) = press_surface(&surface, &Isometry::identity(), sensor, &params) else { continue };
            let image = optics.render(&pressed.contact.height_map)?;
            let difference = no_contact.difference(&image).expect("rendered in the same light");
            let slopes = slopes(&pressed.contact.indentation(sensor), 1.0 / sensor.pixel_pitch as f32);
            samples.extend(slopes.pixels().map(|(row, col, slope)| CalibrationSample {
                scaled_difference: [0, 1, 2].map(|k| difference[(row, col)][k] * gains[(row, col)][k]),
                slope: *slope,
            }));
        }
    }
    Ok(LookupTable::calibrate(samples).expect("each press gives a whole image of pixels"))
}

/// Central differences, one-sided at the border, times `scale`.
fn slopes(map: &Raster<f32>, scale: f32) -> Raster<[f32; 2]> {
    let (rows, cols) = map.shape();
    let ends = |i: usize, n: usize| (i.saturating_sub(1), (i + 1).min(n - 1));
    Raster::from_fn(rows, cols, |row, col| {
        let ((left, right), (up, down)) = (ends(col, cols), ends(row, rows));
        [
            scale * (map[(row, right)] - map[(row, left)]) / (right - left) as f32,
            scale * (map[(down, col)] - map[(up, col)]) / (down - up) as f32,
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::compare_contacts;
    use crate::tactile::{Border, Contact, TactileDecoder as _};

    #[test]
    fn a_table_from_simulated_balls_decodes_a_ball_that_it_has_not_seen() {
        let sensor = TactileSensor::preset("gelsight-mini").expect("listed");
        let optics = TactileOptics::preset(&sensor).expect("known");
        let table = simulated_lookup_table(&sensor).expect("known");
        let no_contact = NoContact::new(optics.no_contact(), &sensor).expect("sound");
        let decoder = LookupDecoder::new(table, no_contact, Border::Relaxed);
        let surface = Primitive::ball(8e-3, (0.7e-3, -1e-3)).surface(&sensor, 240, 320);
        let pressed =
            press_surface(&surface, &Isometry::identity(), &sensor, &PressParams::default()).expect("contact");
        let image = optics.render(&pressed.contact.height_map).expect("the sensor's size");
        let found = decoder.decode(&image, &sensor).expect("the same light");
        let errors = compare_contacts(&found, &pressed.contact, &sensor).expect("the same size");
        let flat = Contact::from_indentation(&Raster::filled(240, 320, 0.0), &sensor).expect("sound");
        let nothing = compare_contacts(&flat, &pressed.contact, &sensor).expect("the same size");
        assert!(errors.rmse_mm < 0.4 * nothing.rmse_mm, "{errors:?} {nothing:?}");
        assert!(errors.mask_iou > 0.6, "{errors:?}");
    }
}
