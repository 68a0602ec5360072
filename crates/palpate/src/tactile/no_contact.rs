//! The image of the untouched gel, which every decoder subtracts; the one place that judges images and knows channel orders.
//!
//! Images are R, G, B everywhere in palpate. Tables of the Taxim family are B, G, R; their readers turn them.

use super::resample::resize;
use super::{DecodeError, TactileSensor};
use crate::geometry::Raster;

/// Side of the cells over which light is compared: the imprint's edges and the noise average out.
const CELLS: usize = 16;
/// Channels that differ by less, on average, are grey: a colour JPEG of a grey picture stays under 1.
const GREY_SPREAD: f32 = 2.0;
/// The no-contact image must be this much more colourful before an image is called grey.
const COLOR_SPREAD: f32 = 6.0;
/// Share of saturated pixels from which an image is refused.
const SATURATED_LIMIT: f32 = 0.25;
/// Median local difference from which the light is another, grey levels. A gain of 10 % makes 14, a photograph in place of the
/// simulated no-contact image 8; two units of one sensor model differ by 20.
const LIGHT_LIMIT: f32 = 18.0;
/// Median local difference from which a change of the whole light is tried, grey levels. A contact's colours differ from channel
/// to channel, so that no change of the whole explains half of them, or as much as this.
const LIGHT_DOUBT: f32 = 4.0;
/// Largest even offset that is undone, grey levels.
const OFFSET_LIMIT: f32 = 25.0;
/// Gains that a lamp or a camera's exposure may have.
const GAINS: std::ops::RangeInclusive<f32> = 0.75..=1.34;
/// Reversed channels must fit this many times better before they are called swapped: images as they should be fit 2 to 100 times
/// **worse** reversed.
const SWAP_FACTOR: f32 = 1.6;
/// Largest deviation of a cell from the overall drift that is still no contact, grey levels: JPEG noise stays under 1 in a cell.
const CONTACT_LEVELS: f32 = 4.0;

/// The image of a sensor that touches nothing, in the light in which it will be used.
#[derive(Debug, Clone, PartialEq)]
pub struct NoContact {
    image: Raster<[u8; 3]>,
    spread: f32,
    cells: Raster<[f32; 3]>,
}

/// A change of the light as a whole.
#[derive(Debug, Clone, Copy)]
struct Light {
    gain: f32,
    offset: f32,
}

impl Light {
    /// The value before the change.
    fn undo(self, value: f32) -> f32 {
        (value - self.offset) / self.gain
    }
}

impl NoContact {
    /// Takes the no-contact image: sRGB, in the sensor's shape. A mean of some twenty frames is best.
    ///
    /// # Errors
    /// [`DecodeError::Aspect`] or [`DecodeError::Saturated`].
    pub fn new(image: Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Self, DecodeError> {
        let (rows, cols) = image.shape();
        let needed_height = sensor.map_rows(cols);
        if rows < 2 || cols < 2 || rows.abs_diff(needed_height) > 1 {
            return Err(DecodeError::Aspect { found: (cols, rows), needed_height, model: sensor.model.clone() });
        }
        check_saturation(&image)?;
        let (spread, cells) = (spread(&image), cell_means(&image));
        Ok(Self { image, spread, cells })
    }

    /// The image, sRGB.
    pub fn image(&self) -> &Raster<[u8; 3]> {
        &self.image
    }

    /// `(rows, cols)` of the image and of every difference.
    pub fn shape(&self) -> (usize, usize) {
        self.image.shape()
    }

    /// Image minus no-contact image, R, G, B grey levels, after checking that the two belong together.
    ///
    /// An image n times as large is averaged down over n × n pixels. One that is brighter or darker as a whole, by a gain of up
    /// to a third or by an even offset, is brought back first.
    ///
    /// # Errors
    /// [`DecodeError`]: size, grey, saturated, red and blue exchanged, or another light.
    pub fn difference(&self, image: &Raster<[u8; 3]>) -> Result<Raster<[f32; 3]>, DecodeError> {
        let factor = self.multiple(image)?;
        let light = self.check_light(image)?;
        let minus =
            |value: [f32; 3], reference: &[u8; 3]| [0, 1, 2].map(|k| light.undo(value[k]) - f32::from(reference[k]));
        if factor == 1 {
            let pairs = image.as_slice().iter().zip(self.image.as_slice());
            let data = pairs.map(|(pixel, reference)| minus(pixel.map(f32::from), reference)).collect();
            return Ok(Raster::from_vec(self.image.rows(), self.image.cols(), data).expect("of the same size"));
        }
        let (rows, cols) = self.shape();
        let mut small = resize(&image.map(|pixel| pixel.map(f32::from)), rows, cols);
        for (value, reference) in small.as_mut_slice().iter_mut().zip(self.image.as_slice()) {
            *value = minus(*value, reference);
        }
        Ok(small)
    }

    /// [`Self::difference`] averaged down to the `rows × cols` on which a decoder works.
    ///
    /// # Errors
    /// As [`Self::difference`], or [`DecodeError::WorkingSize`] if the no-contact image is no whole multiple of that size.
    pub fn difference_at(
        &self,
        image: &Raster<[u8; 3]>,
        rows: usize,
        cols: usize,
    ) -> Result<Raster<[f32; 3]>, DecodeError> {
        let (own_rows, own_cols) = self.shape();
        let Some(factor) = whole_multiple((own_rows, own_cols), (rows, cols)) else {
            return Err(DecodeError::WorkingSize { found: (own_cols, own_rows), needed: (cols, rows) });
        };
        let difference = self.difference(image)?;
        Ok(if factor == 1 { difference } else { resize(&difference, rows, cols) })
    }

    /// Whether a difference holds nothing but noise and an even drift of the light.
    pub fn is_untouched(difference: &Raster<[f32; 3]>) -> bool {
        let cells = cells_of(difference, |pixel| *pixel);
        let drift = [0, 1, 2].map(|k| median(cells.as_slice().iter().map(|cell| cell[k])));
        let deviates = |cell: &[f32; 3]| (0..3).any(|k| (cell[k] - drift[k]).abs() > CONTACT_LEVELS);
        !cells.as_slice().iter().any(deviates)
    }

    /// How many times as large the image is.
    fn multiple(&self, image: &Raster<[u8; 3]>) -> Result<usize, DecodeError> {
        whole_multiple(image.shape(), self.shape()).ok_or(DecodeError::Size {
            found: (image.cols(), image.rows()),
            needed: (self.image.cols(), self.image.rows()),
        })
    }

    /// How the light has changed as a whole, if it clearly has.
    fn check_light(&self, image: &Raster<[u8; 3]>) -> Result<Light, DecodeError> {
        let found = spread(image);
        if found < GREY_SPREAD && self.spread > COLOR_SPREAD {
            return Err(DecodeError::Grey { found, reference: self.spread });
        }
        check_saturation(image)?;
        let cells = cell_means(image);
        // Medians over the image: a contact covers part of it, and changes the light of its edges most.
        let pairs = || cells.as_slice().iter().zip(self.cells.as_slice());
        let off = |a: [f32; 3], b: &[f32; 3]| (0..3).map(|k| (a[k] - b[k]).abs()).sum::<f32>() / 3.0;
        let found = median(pairs().map(|(a, b)| off(*a, b)));
        let reversed = median(pairs().map(|(a, b)| off([a[2], a[1], a[0]], b)));
        if found > 4.0 && found > SWAP_FACTOR * reversed {
            return Err(DecodeError::ChannelsSwapped { found, reversed });
        }
        if found > LIGHT_DOUBT {
            let of_all =
                |f: &dyn Fn(f32, f32) -> f32| median(pairs().flat_map(|(a, b)| [0, 1, 2].map(|k| f(a[k], b[k]))));
            let gain = Light { gain: of_all(&|a, b| a / b.max(1.0)), offset: 0.0 };
            let offset = Light { gain: 1.0, offset: of_all(&|a, b| a - b) };
            let left = |light: &Light| median(pairs().map(|(a, b)| off(a.map(|v| light.undo(v)), b)));
            let possible = |light: &Light| GAINS.contains(&light.gain) && light.offset.abs() < OFFSET_LIMIT;
            let better = [gain, offset].into_iter().filter(possible).min_by(|a, b| left(a).total_cmp(&left(b)));
            let explains = |light: &Light| left(light) < (0.5 * found).max(found - LIGHT_DOUBT);
            if let Some(light) = better.filter(explains) {
                return Ok(light);
            }
        }
        if found > LIGHT_LIMIT {
            return Err(DecodeError::OtherLight { found, limit: LIGHT_LIMIT });
        }
        Ok(Light { gain: 1.0, offset: 0.0 })
    }
}

/// n if `large` is n times `small` along both axes.
fn whole_multiple(large: (usize, usize), small: (usize, usize)) -> Option<usize> {
    let n = large.0.checked_div(small.0)?;
    (n > 0 && (small.0 * n, small.1 * n) == large).then_some(n)
}

/// Mean over the image of the largest minus the smallest channel.
fn spread(image: &Raster<[u8; 3]>) -> f32 {
    let spread = |[r, g, b]: [u8; 3]| u64::from(r.max(g).max(b) - r.min(g).min(b));
    let sum: u64 = image.as_slice().iter().map(|&pixel| spread(pixel)).sum();
    sum as f32 / image.as_slice().len().max(1) as f32
}

fn check_saturation(image: &Raster<[u8; 3]>) -> Result<(), DecodeError> {
    let lost = image.as_slice().iter().filter(|pixel| pixel.contains(&255) || **pixel == [0; 3]).count();
    let found = lost as f32 / image.as_slice().len().max(1) as f32;
    if found > SATURATED_LIMIT { Err(DecodeError::Saturated { found, limit: SATURATED_LIMIT }) } else { Ok(()) }
}

fn cell_means(image: &Raster<[u8; 3]>) -> Raster<[f32; 3]> {
    cells_of(image, |pixel| pixel.map(f32::from))
}

/// Means over a grid of at most [`CELLS`] × [`CELLS`] cells; the same grid for any size of image.
fn cells_of<T>(image: &Raster<T>, value: impl Fn(&T) -> [f32; 3]) -> Raster<[f32; 3]> {
    let (rows, cols) = (image.rows().min(CELLS), image.cols().min(CELLS));
    Raster::from_fn(rows, cols, |row, col| {
        let span = |i: usize, n: usize, all: usize| i * all / n..(i + 1) * all / n;
        let columns = span(col, cols, image.cols());
        let mut sum = [0.0f32; 3];
        let rows = span(row, rows, image.rows());
        let count = rows.len() * columns.len();
        for r in rows {
            for pixel in &image.as_slice()[r * image.cols()..][columns.clone()] {
                let value = value(pixel);
                (0..3).for_each(|k| sum[k] += value[k]);
            }
        }
        sum.map(|s| s / count as f32)
    })
}

/// The middle value; 0 of nothing.
fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor() -> TactileSensor {
        TactileSensor::preset("gelsight-mini").expect("listed")
    }

    /// Three lights from three sides, as in a real sensor.
    fn lit(row: usize, col: usize) -> [u8; 3] {
        let (y, x) = (row as f32 / 24.0, col as f32 / 32.0);
        [(90.0 + 60.0 * x) as u8, (110.0 + 40.0 * y) as u8, (170.0 - 50.0 * x) as u8]
    }

    fn background() -> NoContact {
        NoContact::new(Raster::from_fn(24, 32, lit), &sensor()).expect("sound")
    }

    #[test]
    fn differences_are_signed_and_larger_images_are_averaged() {
        let back = background();
        let mut image = back.image().clone();
        image[(3, 5)] = lit(3, 5).map(|v| v + 12);
        image[(4, 5)] = lit(4, 5).map(|v| v - 12);
        let difference = back.difference(&image).expect("fits");
        assert_eq!((difference[(3, 5)], difference[(4, 5)]), ([12.0; 3], [-12.0; 3]));
        assert!(!NoContact::is_untouched(
            &back
                .difference(&{
                    let touch = |r: usize, c: usize| {
                        if r.abs_diff(12) < 4 && c.abs_diff(16) < 4 { lit(r, c).map(|v| v + 9) } else { lit(r, c) }
                    };
                    Raster::from_fn(24, 32, touch)
                })
                .expect("fits")
        ));
        let double = Raster::from_fn(48, 64, |r, c| lit(r / 2, c / 2).map(|v| v + (r % 2) as u8));
        let halved = back.difference(&double).expect("twice the size");
        assert!(halved.as_slice().iter().all(|d| d.iter().all(|v| (v - 0.5).abs() < 1e-4)));
        assert!(NoContact::is_untouched(&halved));
        let half = back.difference_at(&image, 12, 16).expect("half");
        assert_eq!(half.shape(), (12, 16));
        assert!(matches!(
            back.difference_at(&image, 10, 16),
            Err(DecodeError::WorkingSize { found: (32, 24), needed: (16, 10) })
        ));
    }

    #[test]
    fn images_that_do_not_belong_are_told_apart() {
        let back = background();
        let with = |change: &dyn Fn([u8; 3]) -> [u8; 3]| back.difference(&back.image().map(|p| change(*p)));
        assert!(matches!(
            back.difference(&Raster::filled(24, 30, [9; 3])),
            Err(DecodeError::Size { found: (30, 24), needed: (32, 24) })
        ));
        assert!(matches!(with(&|[r, ..]| [r, r, r]), Err(DecodeError::Grey { found: 0.0, .. })));
        assert!(matches!(with(&|[r, g, b]| [b, g, r]), Err(DecodeError::ChannelsSwapped { reversed: 0.0, .. })));
        assert!(matches!(with(&|[r, _, b]| [r, 255, b]), Err(DecodeError::Saturated { found: 1.0, .. })));
        assert!(matches!(with(&|p| p.map(|v| v - 40)), Err(DecodeError::OtherLight { .. })));
        // What a robot meets: brighter or darker as a whole, a few levels of drift, a JPEG's noise.
        for gain in [0.8f32, 1.2] {
            let difference =
                with(&|p| p.map(|v| (f32::from(v) * gain).round() as u8)).expect("a gain that is divided out");
            assert!(difference.as_slice().iter().all(|d| d.iter().all(|v| v.abs() < 2.0)), "{gain}");
        }
        assert!(with(&|p| p.map(|v| (f32::from(v) * 1.05) as u8)).is_ok());
        assert!(with(&|[r, g, b]| [r + 8, g - 4, b]).is_ok());
    }

    #[test]
    fn a_no_contact_image_must_have_the_shape_of_the_pad() {
        let square = NoContact::new(Raster::filled(32, 32, [100, 120, 140]), &sensor());
        assert_eq!(
            square.expect_err("square").to_string(),
            "the no-contact image is 32×32 px (width × height); one 32 wide of sensor 'gelsight-mini' is 24 high"
        );
    }

    #[test]
    fn drift_is_no_contact_and_a_small_contact_is_one() {
        let even = Raster::filled(48, 64, [6.0f32, -3.0, 2.0]);
        assert!(NoContact::is_untouched(&even));
        let mut touched = even.clone();
        for row in 20..26 {
            for col in 30..36 {
                touched[(row, col)] = [18.0, -9.0, -6.0];
            }
        }
        assert!(!NoContact::is_untouched(&touched));
    }
}
