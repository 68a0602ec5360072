use super::gaussian::{Border as Beyond, blur_channels};
use super::lookup_table::level_by_border;
use super::{BallPress, Contact, DecodeError, Integrator, NoContact, TactileDecoder, TactileSensor};
use crate::geometry::Raster;
use nalgebra::{DMatrix, DVector};

/// Colours of a pixel and their squares and products.
const COLORS: usize = 9;
/// 1, x, y, x², x y, y².
const PLACES: usize = 6;
const TERMS: usize = COLORS * PLACES;

/// Colour and place to slope, in closed form: a quadratic in the change of colour, each coefficient a quadratic in the place.
///
/// The change is taken relative to the light that falls there, so that a dim corner reads as the bright middle does. A look-up
/// table needs each colour to have been seen; this needs five to ten presses of a ball.
///
/// The quadratic gives the normal's tilt t = g / √(1 + |g|²), not the slope g: matt gel is as bright as its normal is turned to the
/// lights (Lambert), so colours are nearly linear in t, and across a ball t is linear in the place where g runs off to infinity.
///
/// # References
/// Johnson & Adelson, *Retrographic sensing for the measurement of surface texture and shape*, CVPR 2009 (normals from colours by
/// pressing a ball).
#[derive(Debug, Clone, PartialEq)]
pub struct SlopeRegressor {
    weights: Vec<[f32; 2]>,
}

/// A pixel whose colour, place and slope are known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlopeSample {
    /// Change of colour relative to the no-contact image, R, G, B: see [`SlopeRegressor::relative_difference`].
    pub relative: [f32; 3],
    /// Place in the image, −1 to 1 along columns and rows.
    pub place: [f32; 2],
    /// Slope of the indentation along columns and rows.
    pub slope: [f32; 2],
}

/// Why there is no regressor.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RegressorError {
    /// Too few pixels to learn from.
    #[error("{found} calibration pixels with finite colours and slopes; at least {needed} are required")]
    TooFewSamples {
        /// Usable samples.
        found: usize,
        /// Samples needed.
        needed: usize,
    },
    /// The ridge is not positive.
    #[error("ridge is {found}; it must be positive and finite")]
    Ridge {
        /// Value found.
        found: f64,
    },
}

impl SlopeRegressor {
    /// Pixels from which it can be made.
    const MIN_SAMPLES: usize = 1000;
    /// Added to the no-contact image before dividing, grey levels: black pixels are all noise.
    const DARK: f32 = 10.0;
    /// Largest tilt that is believed: 72° from the relaxed gel.
    const MOST_TILT: f32 = 0.95;

    /// Solves for the coefficients by least squares.
    ///
    /// * `ridge` – added to the normal equations' diagonal; features are about 1 in size, so it counts as so many pixels that
    ///   say "flat". Larger: gentler between and beyond the presses, slopes too small.
    ///
    /// # Errors
    /// [`RegressorError`].
    pub fn fit(samples: impl IntoIterator<Item = SlopeSample>, ridge: f64) -> Result<Self, RegressorError> {
        // Written so that NaN fails too.
        if !(ridge > 0.0 && ridge.is_finite()) {
            return Err(RegressorError::Ridge { found: ridge });
        }
        let mut normal = DMatrix::<f64>::zeros(TERMS, TERMS);
        let mut right = [DVector::<f64>::zeros(TERMS), DVector::zeros(TERMS)];
        let mut found = 0;
        for sample in samples {
            let features = features(sample.relative, sample.place);
            if !features.iter().chain(&sample.slope).all(|v| v.is_finite()) {
                continue;
            }
            let features = DVector::from_iterator(TERMS, features.iter().map(|&f| f64::from(f)));
            normal.syger(1.0, &features, &features, 1.0);
            let tilt = tilt(sample.slope);
            (0..2).for_each(|k| right[k].axpy(f64::from(tilt[k]), &features, 1.0));
            found += 1;
        }
        if found < Self::MIN_SAMPLES {
            return Err(RegressorError::TooFewSamples { found, needed: Self::MIN_SAMPLES });
        }
        (0..TERMS).for_each(|i| normal[(i, i)] += ridge);
        let factor = normal.cholesky().expect("a Gram matrix plus a positive diagonal is positive definite");
        let [x, y] = right.map(|right| factor.solve(&right));
        Ok(Self { weights: x.iter().zip(y.iter()).map(|(&x, &y)| [x as f32, y as f32]).collect() })
    }

    /// The samples that a ball's press gives.
    ///
    /// * `ball_radius` – pixels
    pub fn samples(relative: &Raster<[f32; 3]>, press: &BallPress, ball_radius: f64) -> Vec<SlopeSample> {
        let (rows, cols) = relative.shape();
        let labels = press.labels(rows, cols, ball_radius).into_iter();
        labels
            .map(|(row, col, slope)| SlopeSample {
                relative: relative[(row, col)],
                place: place(row, col, rows, cols),
                slope,
            })
            .collect()
    }

    /// Difference to the no-contact image as a share of that image, smoothed over 3 × 3 pixels: half the light gained is 1.
    pub fn relative_difference(no_contact: &NoContact, difference: &Raster<[f32; 3]>) -> Raster<[f32; 3]> {
        let mut relative = difference.clone();
        blur_channels(&mut relative, &[1.0 / 3.0; 3], Beyond::Repeat);
        let mut light = no_contact.image().map(|pixel| pixel.map(f32::from));
        blur_channels(&mut light, &[1.0 / 9.0; 9], Beyond::Repeat);
        for (change, light) in relative.as_mut_slice().iter_mut().zip(light.as_slice()) {
            (0..3).for_each(|k| change[k] *= 2.0 / (light[k] + Self::DARK));
        }
        relative
    }

    /// Its coefficients: for each term, its share of the tilt along columns and along rows.
    pub fn weights(&self) -> &[[f32; 2]] {
        &self.weights
    }

    /// A regressor of stored coefficients; `None` unless there are as many as terms and all are finite.
    pub fn from_weights(weights: Vec<[f32; 2]>) -> Option<Self> {
        let sound = weights.len() == TERMS && weights.iter().flatten().all(|w| w.is_finite());
        sound.then_some(Self { weights })
    }

    /// Where a pixel is in an image, −1 to 1 along columns and rows: the place of [`Self::slope`].
    pub fn place(row: usize, col: usize, rows: usize, cols: usize) -> [f32; 2] {
        place(row, col, rows, cols)
    }

    /// The slope that goes with a relative difference at a place.
    #[inline]
    pub fn slope(&self, relative: [f32; 3], place: [f32; 2]) -> [f32; 2] {
        let pairs = features(relative, place).into_iter().zip(&self.weights);
        let [x, y] = pairs.fold([0.0; 2], |[x, y], (f, w)| [x + f * w[0], y + f * w[1]]);
        let (size, most) = (x.hypot(y), Self::MOST_TILT);
        let held = if size > most { most / size } else { 1.0 };
        let scale = held / (1.0 - (held * size).powi(2)).sqrt();
        [scale * x, scale * y]
    }
}

/// A slope as the sine of its angle: g / √(1 + |g|²).
fn tilt([x, y]: [f32; 2]) -> [f32; 2] {
    let length = (1.0 + x * x + y * y).sqrt();
    [x / length, y / length]
}

/// −1 to 1 along columns and rows.
#[inline]
fn place(row: usize, col: usize, rows: usize, cols: usize) -> [f32; 2] {
    let share = |i: usize, n: usize| (2.0 * i as f32 - (n as f32 - 1.0)) / n as f32;
    [share(col, cols), share(row, rows)]
}

#[inline]
fn features([r, g, b]: [f32; 3], [x, y]: [f32; 2]) -> [f32; TERMS] {
    let colors = [b, g, r, b * b, g * g, r * r, b * g, b * r, g * r];
    let places = [1.0, x, y, x * x, x * y, y * y];
    std::array::from_fn(|i| colors[i % COLORS] * places[i / COLORS])
}

/// Regressed slopes, integrated with free borders: colour and place → slope → height.
#[derive(Debug)]
pub struct RegressorDecoder {
    regressor: SlopeRegressor,
    no_contact: NoContact,
    integrator: Integrator,
    view: f32,
}

impl RegressorDecoder {
    /// Decodes with this regressor and the sensor's no-contact image, at that image's size.
    pub fn new(regressor: SlopeRegressor, no_contact: NoContact) -> Self {
        let (rows, cols) = no_contact.shape();
        Self { regressor, no_contact, integrator: Integrator::new(rows, cols), view: 1.0 }
    }

    /// For images that show only the middle of the field that was calibrated: their width as a share of its width.
    pub fn with_view(mut self, share: f32) -> Self {
        self.view = share;
        self
    }

    fn slopes(&self, difference: &Raster<[f32; 3]>) -> Raster<[f32; 2]> {
        let relative = SlopeRegressor::relative_difference(&self.no_contact, difference);
        let (rows, cols) = relative.shape();
        Raster::from_fn(rows, cols, |row, col| {
            let place = place(row, col, rows, cols).map(|p| self.view * p);
            self.regressor.slope(relative[(row, col)], place)
        })
    }
}

impl TactileDecoder for RegressorDecoder {
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        let difference = self.no_contact.difference(image)?;
        if NoContact::is_untouched(&difference) {
            return Contact::from_indentation(&difference.map(|_| 0.0), sensor);
        }
        let pitch = sensor.map_pitch(difference.cols()) as f32;
        let indentation = level_by_border(self.integrator.poisson_neumann(&self.slopes(&difference)));
        Contact::from_indentation(&indentation.map(|d| d * pitch), sensor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Sphere};
    use crate::tactile::refine_ball;

    const BALL: f64 = 25.0;
    const CONTACT: f64 = 17.0;

    fn sensor() -> TactileSensor {
        TactileSensor::preset("gelsight-mini").expect("listed")
    }

    /// Lit unevenly, brighter to the right and below.
    fn light(row: usize, col: usize) -> [f64; 3] {
        [70.0 + 0.2 * col as f64, 90.0 + 0.3 * row as f64, 120.0 - 0.1 * col as f64]
    }

    fn press([x, y]: [f64; 2]) -> Raster<[u8; 3]> {
        Raster::from_fn(120, 160, |row, col| {
            let (dx, dy) = (col as f64 - x, row as f64 - y);
            let r = dx.hypot(dy).max(1e-9);
            let steepest = CONTACT / (BALL * BALL - CONTACT * CONTACT).sqrt();
            let slope = if r < CONTACT {
                r / (BALL * BALL - r * r).sqrt()
            } else {
                steepest * ((28.0 - r) / (28.0 - CONTACT)).clamp(0.0, 1.0)
            };
            // Matt: as bright as its normal is turned.
            let tilt = slope / (1.0 + slope * slope).sqrt();
            let (gx, gy) = (-tilt * dx / r, -tilt * dy / r);
            let light = light(row, col);
            let gain = [0.6 * gx + 0.2 * gy + 0.1 * gx * gx, 0.5 * gy, 0.3 * gy - 0.5 * gx];
            std::array::from_fn(|k| (light[k] * (1.0 + gain[k])).round() as u8)
        })
    }

    fn no_contact() -> NoContact {
        let image = Raster::from_fn(120, 160, |row, col| light(row, col).map(|v| v.round() as u8));
        NoContact::new(image, &sensor()).expect("sound")
    }

    fn calibrated() -> SlopeRegressor {
        let no_contact = no_contact();
        let samples = [[40.0, 40.0], [120.0, 40.0], [80.0, 60.0], [40.0, 82.0], [118.0, 80.0]].map(|center| {
            let difference = no_contact.difference(&press(center)).expect("fits");
            let found = refine_ball(&difference, center, 28.0).expect("a ball");
            SlopeRegressor::samples(&SlopeRegressor::relative_difference(&no_contact, &difference), &found, BALL)
        });
        SlopeRegressor::fit(samples.into_iter().flatten(), 1.0).expect("enough pixels")
    }

    #[test]
    fn five_presses_decode_a_ball_elsewhere_to_its_radius() {
        let (sensor, center) = (sensor(), [97.0, 55.0]);
        let decoder = RegressorDecoder::new(calibrated(), no_contact());
        let contact = decoder.decode(&press(center), &sensor).expect("the same light");
        let pitch = sensor.map_pitch(160);
        let on_ball = |&(row, col, _): &(usize, usize, &f32)| {
            (col as f64 - center[0]).hypot(row as f64 - center[1]) < CONTACT - 1.0
        };
        let points: Vec<Point> = (contact.height_map.pixels().filter(on_ball))
            .map(|(row, col, &z)| Point::new(pitch * col as f64, pitch * row as f64, f64::from(z)))
            .collect();
        let sphere = Sphere::fit(&points).expect("curved");
        assert!((sphere.radius / (BALL * pitch) - 1.0).abs() < 0.05, "{} {}", sphere.radius, BALL * pitch);
    }

    /// A matt ball's colours are linear in its normals: learnt from gentle slopes, the map holds for steep ones, and stays finite.
    #[test]
    fn slopes_beyond_those_learnt_follow_the_normals() {
        let colors = |[x, y]: [f32; 2]| [0.5 * x + 0.1 * y, 0.4 * y - 0.2 * x, 0.3 * x - 0.4 * y];
        let sample = |i: usize| {
            let (angle, tilt) = (0.1 * i as f32, 0.6 * (i % 40) as f32 / 40.0);
            let (sin, cos) = angle.sin_cos();
            let normal = [tilt * cos, tilt * sin];
            let place = [(i % 7) as f32 / 7.0 - 0.5, (i % 11) as f32 / 11.0 - 0.5];
            let slope = normal.map(|t| t / (1.0 - tilt * tilt).sqrt());
            SlopeSample { relative: colors(normal), place, slope }
        };
        let map = SlopeRegressor::fit((0..4000).map(sample), 1e-3).expect("enough");
        // A tilt of 0.8 is a slope of 4/3; 0.6 was the most that was seen.
        let [x, y] = map.slope(colors([0.8, 0.0]), [0.1, 0.1]);
        assert!((x - 4.0 / 3.0).abs() < 0.05 && y.abs() < 0.02, "{x} {y}");
        let [x, y] = map.slope(colors([3.0, 0.0]), [0.1, 0.1]);
        assert!(x.is_finite() && x < 3.1 && y.is_finite(), "{x} {y}");
    }

    #[test]
    fn the_untouched_gel_is_flat() {
        let decoder = RegressorDecoder::new(calibrated(), no_contact());
        let contact = decoder.decode(no_contact().image(), &sensor()).expect("the same light");
        assert!(contact.height_map.as_slice().iter().all(|&z| z == 0.0) && contact.contact_share() == 0.0);
    }

    #[test]
    fn too_few_pixels_and_a_ridge_of_zero_are_errors() {
        let sample = SlopeSample { relative: [0.1, 0.0, -0.1], place: [0.0; 2], slope: [0.2, 0.0] };
        let few = SlopeRegressor::fit(vec![sample; 10], 1.0).expect_err("few").to_string();
        assert_eq!(few, "10 calibration pixels with finite colours and slopes; at least 1000 are required");
        let none = SlopeRegressor::fit(vec![SlopeSample { slope: [f32::NAN; 2], ..sample }; 2000], 1.0);
        assert!(matches!(none, Err(RegressorError::TooFewSamples { found: 0, .. })));
        assert!(matches!(SlopeRegressor::fit([sample], 0.0), Err(RegressorError::Ridge { .. })));
    }
}
