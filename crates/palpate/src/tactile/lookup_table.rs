use super::{Contact, DecodeError, Integrator, NoContact, TactileDecoder, TactileSensor};
use crate::geometry::{KdTree, Point, Raster};

/// Colour to slope: what a calibrated gel looks like when it is tilted so far that way.
///
/// 50³ cells over the scaled colour differences of blue, green and red; each holds the slope of the indentation, `[along columns,
/// along rows]`, pixels per pixel, positive where the gel is pressed in more towards larger column or row.
#[derive(Clone, PartialEq)]
pub struct LookupTable {
    slopes: Vec<[f32; 2]>,
}

/// A pixel whose colour and slope are both known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationSample {
    /// Difference to the no-contact image, R, G, B, scaled by [`LookupDecoder::gains`].
    pub scaled_difference: [f32; 3],
    /// Slope of the indentation along columns and rows.
    pub slope: [f32; 2],
}

/// Why there is no table.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LookupTableError {
    /// An array is not 50 × 50 × 50.
    #[error("the table '{name}' has the shape {found:?}; [50, 50, 50] is needed")]
    Shape {
        /// `grad_mag` or `grad_dir`.
        name: &'static str,
        /// Shape found.
        found: Vec<usize>,
    },
    /// A magnitude is no slope angle, or a direction is not finite.
    #[error("cell {cell} of the table '{name}' is {found}; it must be {needed}")]
    Value {
        /// `grad_mag` or `grad_dir`.
        name: &'static str,
        /// Which cell, row-major.
        cell: usize,
        /// Value found, radians.
        found: f64,
        /// Values allowed.
        needed: &'static str,
    },
    /// Too few pixels to learn from.
    #[error("{found} calibration pixels with finite slopes; at least {needed} are required")]
    TooFewSamples {
        /// Usable samples.
        found: usize,
        /// Samples needed.
        needed: usize,
    },
}

impl std::fmt::Debug for LookupTable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LookupTable").field("cells", &self.slopes.len()).finish()
    }
}

impl LookupTable {
    /// Cells along each colour.
    pub const BINS: usize = 50;
    /// Scaled difference at the low end of the cells, and their range, grey levels.
    const LOW: f32 = -70.0;
    const RANGE: f32 = 120.0;
    /// Steepest slope angle that a table may hold, radians: tan = 57.
    const STEEPEST: f64 = 1.553;
    /// Pixels from which a table can be made.
    const MIN_SAMPLES: usize = 1000;

    /// The table of the YCB-Sight release: slope angle and direction, radians, by blue, green and red cell, row-major.
    ///
    /// Slopes are tan(magnitude) · (cos, sin)(direction); a direction may lie outside ±π.
    ///
    /// # Errors
    /// [`LookupTableError::Shape`] or [`LookupTableError::Value`].
    ///
    /// # References
    /// Suresh et al., *ShapeMap 3-D*, ICRA 2022; Yuan, Dong & Adelson, *GelSight*, Sensors 2017 (the method).
    pub fn from_arrays(magnitude: (&[usize], &[f64]), direction: (&[usize], &[f64])) -> Result<Self, LookupTableError> {
        for (name, (shape, values)) in [("grad_mag", magnitude), ("grad_dir", direction)] {
            if shape != [Self::BINS; 3] || values.len() != Self::BINS.pow(3) {
                return Err(LookupTableError::Shape { name, found: shape.to_vec() });
            }
        }
        let bad = |values: &[f64], ok: &dyn Fn(f64) -> bool| values.iter().position(|&v| !ok(v));
        if let Some(cell) = bad(magnitude.1, &|m| (0.0..=Self::STEEPEST).contains(&m)) {
            let found = magnitude.1[cell];
            return Err(LookupTableError::Value { name: "grad_mag", cell, found, needed: "in [0, 1.553]" });
        }
        if let Some(cell) = bad(direction.1, &f64::is_finite) {
            let found = direction.1[cell];
            return Err(LookupTableError::Value { name: "grad_dir", cell, found, needed: "finite" });
        }
        let slope = |(m, d): (&f64, &f64)| [(m.tan() * d.cos()) as f32, (m.tan() * d.sin()) as f32];
        Ok(Self { slopes: magnitude.1.iter().zip(direction.1).map(slope).collect() })
    }

    /// The table as [`Self::from_arrays`] takes it: slope angle and direction, radians.
    pub fn to_arrays(&self) -> (Vec<f64>, Vec<f64>) {
        let angle = |s: &[f32; 2]| f64::from(s[0].hypot(s[1])).atan().min(Self::STEEPEST);
        let direction = |s: &[f32; 2]| f64::from(s[1]).atan2(f64::from(s[0]));
        (self.slopes.iter().map(angle).collect(), self.slopes.iter().map(direction).collect())
    }

    /// Fills a table from pixels whose slope is known, as presses of a ball give them: each cell the mean of its samples, an
    /// empty one that of the nearest filled cell.
    ///
    /// # Errors
    /// [`LookupTableError::TooFewSamples`].
    pub fn calibrate(samples: impl IntoIterator<Item = CalibrationSample>) -> Result<Self, LookupTableError> {
        let mut sums = vec![[0.0f64; 3]; Self::BINS.pow(3)];
        let mut found = 0;
        for sample in samples {
            let [x, y] = sample.slope.map(f64::from);
            if (x + y).is_finite() && sample.scaled_difference.iter().all(|d| d.is_finite()) {
                let sum = &mut sums[Self::cell(sample.scaled_difference)];
                *sum = [sum[0] + x, sum[1] + y, sum[2] + 1.0];
                found += 1;
            }
        }
        if found < Self::MIN_SAMPLES {
            return Err(LookupTableError::TooFewSamples { found, needed: Self::MIN_SAMPLES });
        }
        let place = |cell: usize| {
            let (n, cell) = (Self::BINS, cell);
            Point::new((cell / (n * n)) as f64, (cell / n % n) as f64, (cell % n) as f64)
        };
        let filled: Vec<usize> = (0..sums.len()).filter(|&cell| sums[cell][2] > 0.0).collect();
        let tree = KdTree::new(&filled.iter().map(|&cell| place(cell)).collect::<Vec<_>>());
        let mean = |cell: usize| {
            let [x, y, n] = sums[cell];
            [(x / n) as f32, (y / n) as f32]
        };
        let slopes = (0..sums.len())
            .map(|cell| {
                if sums[cell][2] > 0.0 {
                    return mean(cell);
                }
                tree.nearest(&place(cell)).map_or([0.0; 2], |(nearest, _)| mean(filled[nearest]))
            })
            .collect();
        Ok(Self { slopes })
    }

    /// The slope that goes with a scaled difference, R, G, B.
    #[inline]
    pub fn slope(&self, scaled_difference: [f32; 3]) -> [f32; 2] {
        self.slopes[Self::cell(scaled_difference)]
    }

    /// The cell of a scaled difference, R, G, B; the table runs blue, green, red.
    #[inline]
    fn cell([r, g, b]: [f32; 3]) -> usize {
        let last = (Self::BINS - 1) as f32;
        let bin = |d: f32| (((d - Self::LOW) / Self::RANGE).clamp(0.0, 1.0) * last) as usize;
        (bin(b) * Self::BINS + bin(g)) * Self::BINS + bin(r)
    }
}

/// What is assumed of the gel at the border of the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Border {
    /// Relaxed: the published method. Wrong where a contact runs out of the image.
    #[default]
    Relaxed,
    /// Free; the median of the border ring is taken as relaxed. Errors of the slopes add up over the image.
    Free,
}

/// Look-up table and fast Poisson: colour → slope → height, the classic decoder.
#[derive(Debug)]
pub struct LookupDecoder {
    table: LookupTable,
    no_contact: NoContact,
    gains: Raster<[f32; 3]>,
    integrator: Integrator,
    border: Border,
}

impl LookupDecoder {
    /// Decodes with this table and the sensor's no-contact image, at that image's size.
    ///
    /// The table must have been made against such an image: that of YCB-Sight against a photograph of the relaxed gel.
    pub fn new(table: LookupTable, no_contact: NoContact, border: Border) -> Self {
        let (rows, cols) = no_contact.shape();
        Self { table, gains: Self::gains(&no_contact), no_contact, integrator: Integrator::new(rows, cols), border }
    }

    /// Factors that even out the light before the table is asked: 1 + 2 (m / (v + 1) − 1) for a no-contact value v, m its mean
    /// over all pixels and channels.
    pub fn gains(no_contact: &NoContact) -> Raster<[f32; 3]> {
        let values = no_contact.image().as_slice().as_flattened();
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64;
        no_contact.image().map(|pixel| pixel.map(|v| 1.0 + 2.0 * (mean as f32 / (f32::from(v) + 1.0) - 1.0)))
    }

    /// Slopes of the indentation from a difference to the no-contact image.
    fn slopes(&self, difference: &Raster<[f32; 3]>) -> Raster<[f32; 2]> {
        let pairs = difference.as_slice().iter().zip(self.gains.as_slice());
        let slope = |(d, f): (&[f32; 3], &[f32; 3])| self.table.slope([d[0] * f[0], d[1] * f[1], d[2] * f[2]]);
        let slopes = pairs.map(slope).collect();
        Raster::from_vec(difference.rows(), difference.cols(), slopes).expect("one slope a pixel")
    }
}

impl TactileDecoder for LookupDecoder {
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        let difference = self.no_contact.difference(image)?;
        if NoContact::is_untouched(&difference) {
            return Contact::from_indentation(&difference.map(|_| 0.0), sensor);
        }
        let slopes = self.slopes(&difference);
        let mut indentation = match self.border {
            Border::Relaxed => self.integrator.poisson_dirichlet(&slopes),
            Border::Free => level_by_border(self.integrator.poisson_neumann(&slopes)),
        };
        let pitch = sensor.map_pitch(indentation.cols()) as f32;
        indentation.as_mut_slice().iter_mut().for_each(|d| *d *= pitch);
        Contact::from_indentation(&indentation, sensor)
    }
}

/// Shifts a map so that the median of its border ring is 0.
pub(super) fn level_by_border(mut map: Raster<f32>) -> Raster<f32> {
    let (rows, cols) = map.shape();
    let on_ring = |&(r, c, _): &(usize, usize, &f32)| r == 0 || c == 0 || r + 1 == rows || c + 1 == cols;
    let mut ring: Vec<f32> = map.pixels().filter(on_ring).map(|(.., &h)| h).collect();
    let middle = ring.len() / 2;
    let level = *ring.select_nth_unstable_by(middle, f32::total_cmp).1;
    map.as_mut_slice().iter_mut().for_each(|h| *h -= level);
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor() -> TactileSensor {
        TactileSensor::preset("gelsight-mini").expect("listed")
    }

    /// A gel whose colour tells its slope: red rises with the slope along columns, blue along rows.
    fn colour(light: [u8; 3], [x, y]: [f32; 2]) -> [u8; 3] {
        let shift = |v: u8, d: f32| (f32::from(v) + d).round().clamp(0.0, 255.0) as u8;
        [shift(light[0], 60.0 * x), shift(light[1], 20.0 * (x + y)), shift(light[2], 60.0 * y)]
    }

    const LIGHT: [u8; 3] = [110, 120, 130];

    /// Indentation (px) and slopes of a smooth bump of depth `depth`, in the middle of 120 × 160.
    fn bump(depth: f32) -> (Raster<f32>, Raster<[f32; 2]>) {
        let at = |r: usize, c: usize| ((r as f32 - 60.0) / 22.0, (c as f32 - 80.0) / 22.0);
        let height = |y: f32, x: f32| depth * (-0.5 * (x * x + y * y)).exp();
        let slopes = |r, c| {
            let (y, x) = at(r, c);
            let h = height(y, x);
            [-x / 22.0 * h, -y / 22.0 * h]
        };
        let heights = Raster::from_fn(120, 160, |r, c| {
            let (y, x) = at(r, c);
            height(y, x)
        });
        (heights, Raster::from_fn(120, 160, slopes))
    }

    fn back() -> NoContact {
        // Not evenly lit, so that the gains matter.
        let light = |_: usize, c: usize| [LIGHT[0] + (c / 16) as u8, LIGHT[1], LIGHT[2]];
        NoContact::new(Raster::from_fn(120, 160, light), &sensor()).expect("sound")
    }

    fn picture(slopes: &Raster<[f32; 2]>) -> Raster<[u8; 3]> {
        let back = back();
        let gains = LookupDecoder::gains(&back);
        Raster::from_fn(120, 160, |r, c| {
            let full = colour([100; 3], slopes[(r, c)]).map(|v| f32::from(v) - 100.0);
            let (light, gain) = (back.image()[(r, c)], gains[(r, c)]);
            [0, 1, 2].map(|k| (f32::from(light[k]) + full[k] / gain[k]).round() as u8)
        })
    }

    fn calibrated() -> LookupTable {
        let (_, slopes) = bump(14.0);
        let image = picture(&slopes);
        let (back, gains) = (back(), LookupDecoder::gains(&back()));
        let difference = back.difference(&image).expect("fits");
        let samples = difference.pixels().map(|(r, c, d)| CalibrationSample {
            scaled_difference: [0, 1, 2].map(|k| d[k] * gains[(r, c)][k]),
            slope: slopes[(r, c)],
        });
        LookupTable::calibrate(samples).expect("enough pixels")
    }

    #[test]
    fn a_table_made_from_one_bump_decodes_another() {
        let (heights, slopes) = bump(9.0);
        let pitch = sensor().map_pitch(160) as f32;
        for (border, limit) in [(Border::Relaxed, 0.5), (Border::Free, 0.8)] {
            let decoder = LookupDecoder::new(calibrated(), back(), border);
            let contact = decoder.decode(&picture(&slopes), &sensor()).expect("sound");
            let found = contact.indentation(&sensor());
            let worst = found.as_slice().iter().zip(heights.as_slice()).map(|(f, h)| (f / pitch - h).abs());
            let worst = worst.fold(0.0, f32::max);
            assert!(worst < limit, "{border:?}: {worst} px");
            assert!(contact.mask[(60, 80)] && !contact.mask[(5, 5)]);
        }
    }

    #[test]
    fn the_arrays_of_the_release_are_blue_green_red_and_turned_to_slopes() {
        let n = LookupTable::BINS;
        let (mut magnitude, mut direction) = (vec![0.0; n * n * n], vec![0.0; n * n * n]);
        // ΔB = +10, ΔG = −70, ΔR = +50 (both ends of the range): cells 32, 0, 49.
        let cell = (32 * n) * n + 49;
        magnitude[cell] = 0.5f64.atan();
        direction[cell] = std::f64::consts::FRAC_PI_6 + std::f64::consts::TAU;
        let shape = [n; 3];
        let table = LookupTable::from_arrays((&shape, &magnitude), (&shape, &direction)).expect("sound");
        let [x, y] = table.slope([50.0, -70.0, 10.0]);
        assert!((x - 0.5 * 0.75f32.sqrt()).abs() < 1e-6 && (y - 0.25).abs() < 1e-6, "{x} {y}");
        assert_eq!(table.slope([10.0, -70.0, 50.0]), [0.0, 0.0]);
        assert_eq!(table.slope([500.0, -700.0, 10.0]), [x, y]);
    }

    #[test]
    fn bad_tables_are_refused() {
        let n = LookupTable::BINS;
        let (zeros, shape) = (vec![0.0; n * n * n], [n; 3]);
        let flat = LookupTable::from_arrays((&[n, n * n], &zeros), (&shape, &zeros)).expect_err("two axes");
        assert!(flat.to_string().contains("'grad_mag' has the shape [50, 2500]"), "{flat}");
        let mut steep = zeros.clone();
        steep[7] = 1.6;
        let steep = LookupTable::from_arrays((&shape, &steep), (&shape, &zeros));
        assert!(matches!(steep, Err(LookupTableError::Value { name: "grad_mag", cell: 7, .. })));
        let mut nan = zeros.clone();
        nan[9] = f64::NAN;
        let nan = LookupTable::from_arrays((&shape, &zeros), (&shape, &nan));
        assert!(matches!(nan, Err(LookupTableError::Value { name: "grad_dir", cell: 9, .. })));
        let few = vec![CalibrationSample { scaled_difference: [0.0; 3], slope: [f32::NAN, 0.0] }; 2000];
        assert!(matches!(LookupTable::calibrate(few), Err(LookupTableError::TooFewSamples { found: 0, .. })));
    }

    #[test]
    fn no_contact_decodes_to_the_relaxed_gel() {
        let decoder = LookupDecoder::new(calibrated(), back(), Border::Relaxed);
        let contact = decoder.decode(back().image(), &sensor()).expect("no error");
        assert_eq!(contact.contact_share(), 0.0);
        assert_eq!(contact.height_map, sensor().relaxed(120, 160));
    }
}
