use super::OpticsError;
use crate::geometry::Raster;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Colour change of a gel by the direction of its surface, as a polynomial of the pixel's place: Taxim's table.
///
/// Cell (i, j) holds surfaces whose slope angle atan|∇H| lies in the i-th of `bins` − 1 equal parts of [0, π/2] and whose
/// direction atan2(∂H/∂row, ∂H/∂col) lies in the j-th of `bins` − 1 equal parts of [−π, π]; H grows **into** the gel. For each
/// channel it holds c · (x², y², xy, x, y, 1), x = column and y = row.
///
/// # References
/// Si & Yuan, *Taxim*, RA-L 2022, §IV-B. Conventions confirmed on its published images: the tests turn each one over.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotometricTable {
    bins: usize,
    /// Width of the frame it was calibrated on, pixels.
    width: usize,
    /// \[magnitude\]\[direction\]\[R G B\]\[term\]; x and y are in units of `width`.
    cells: Vec<[[f32; TERMS]; 3]>,
}

/// Slope under which a place is flat: far under the 0.0127 rad of a table's first cell.
const FLAT_SLOPE: f32 = 1e-5;
/// Terms of the polynomial: x² y² xy x y 1.
const TERMS: usize = 6;

impl PhotometricTable {
    /// Wraps coefficients.
    ///
    /// * `bins` – along slope angle and along direction; the last of each is for the closed end of the range
    /// * `width` – of the calibration frame, pixels; its pixels may be finer or coarser than those of the images to render
    /// * `coefficients` – \[magnitude\]\[direction\]\[R G B\]\[x² y² xy x y 1\], x and y in units of `width`, grey levels
    ///
    /// # Errors
    /// [`OpticsError::TableSize`] or [`OpticsError::NotFinite`].
    pub fn new(bins: usize, width: usize, coefficients: &[f32]) -> Result<Self, OpticsError> {
        let needed = bins * bins * 3 * TERMS;
        if coefficients.len() != needed || bins < 2 || width == 0 {
            return Err(OpticsError::TableSize { found: coefficients.len(), bins, needed });
        }
        if let Some((index, &found)) = coefficients.iter().enumerate().find(|(_, c)| !c.is_finite()) {
            return Err(OpticsError::NotFinite { index, found });
        }
        let cells = coefficients
            .chunks_exact(3 * TERMS)
            .map(|cell| std::array::from_fn(|channel| std::array::from_fn(|term| cell[channel * TERMS + term])))
            .collect();
        Ok(Self { bins, width, cells })
    }

    /// Colour change (R, G, B; grey levels) of every pixel of a surface.
    ///
    /// * `height` – H, row and col over the whole pad, in units of a pixel, growing into the gel, **the relaxed shape included**
    ///
    /// O(pixels).
    pub fn colour_change(&self, height: &Raster<f32>) -> Raster<[f32; 3]> {
        let scale = 1.0 / height.cols() as f32;
        let directions = surface_directions(height);
        let (rows, cols) = height.shape();
        let mut change = Raster::filled(rows, cols, [0.0f32; 3]);
        let lines = change.as_mut_slice().chunks_exact_mut(cols).zip(directions.as_slice().chunks_exact(cols));
        for (row, (line, directions)) in lines.enumerate() {
            // Centres of pixels of this image, in units of the calibration frame's width, whose pixel 0 is at 0.
            let place = |i: usize| (i as f32 + 0.5) * scale - 0.5 / self.width as f32;
            let y = place(row);
            for (col, (pixel, &(magnitude, direction))) in line.iter_mut().zip(directions).enumerate() {
                let x = place(col);
                let terms = [x * x, y * y, x * y, x, y, 1.0];
                let cell = self.cell(magnitude, direction);
                for (value, c) in pixel.iter_mut().zip(cell) {
                    *value = terms.iter().zip(c).map(|(t, c)| t * c).sum();
                }
            }
        }
        change
    }

    fn cell(&self, magnitude: f32, direction: f32) -> &[[f32; TERMS]; 3] {
        let last = self.bins - 1;
        let i = ((magnitude * (last as f32 / FRAC_PI_2)) as usize).min(last);
        let j = (((direction + PI) * (last as f32 / TAU)) as usize).min(last);
        &self.cells[i * self.bins + j]
    }
}

/// Slope angle and direction of every pixel, radians: central differences, the outer ring as its inner neighbour.
pub(crate) fn surface_directions(height: &Raster<f32>) -> Raster<(f32, f32)> {
    let (rows, cols) = height.shape();
    let values = height.as_slice();
    let mut out = Raster::filled(rows, cols, (0.0, 0.0));
    if rows < 3 || cols < 3 {
        return out;
    }
    for row in 1..rows - 1 {
        let line = &mut out.as_mut_slice()[row * cols..(row + 1) * cols];
        for col in 1..cols - 1 {
            let at = row * cols + col;
            let by_row = 0.5 * (values[at + cols] - values[at - cols]);
            let by_col = 0.5 * (values[at + 1] - values[at - 1]);
            // A flat place has direction 0; rounding must not give it another, whose colour may differ by tens of levels.
            let slope = by_row.hypot(by_col);
            if slope > FLAT_SLOPE {
                line[col] = (slope.atan(), by_row.atan2(by_col));
            }
        }
        line[0] = line[1];
        line[cols - 1] = line[cols - 2];
    }
    let inner = &mut out.as_mut_slice()[..];
    inner.copy_within(cols..2 * cols, 0);
    inner.copy_within((rows - 2) * cols..(rows - 1) * cols, (rows - 1) * cols);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Direction → colour: the cell's centre angle in R and direction in G, x in B.
    fn readable(bins: usize) -> PhotometricTable {
        let last = (bins - 1) as f32;
        let mut c = Vec::new();
        for i in 0..bins {
            for j in 0..bins {
                c.extend([0.0, 0.0, 0.0, 0.0, 0.0, (i as f32 + 0.5) * FRAC_PI_2 / last]);
                c.extend([0.0, 0.0, 0.0, 0.0, 0.0, (j as f32 + 0.5) * TAU / last - PI]);
                c.extend([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
            }
        }
        PhotometricTable::new(bins, 64, &c).expect("right size")
    }

    #[test]
    fn a_plane_has_one_colour_and_it_is_that_of_its_slope() {
        let table = readable(91);
        // Slope 0.5 along rows (downwards), 0.2 along columns.
        let plane = Raster::from_fn(48, 64, |r, c| 0.5 * r as f32 + 0.2 * c as f32);
        let change = table.colour_change(&plane);
        let (angle, direction) = (0.5f32.hypot(0.2).atan(), 0.5f32.atan2(0.2));
        for (_, col, pixel) in change.pixels() {
            assert!((pixel[0] - angle).abs() <= 0.5 * FRAC_PI_2 / 90.0 + 1e-5);
            assert!((pixel[1] - direction).abs() <= 0.5 * TAU / 90.0 + 1e-5);
            assert!((pixel[2] - col as f32 / 64.0).abs() < 1e-5);
        }
    }

    #[test]
    fn images_of_half_the_size_see_the_same_places() {
        let table = readable(11);
        let flat = |rows, cols| table.colour_change(&Raster::filled(rows, cols, 3.0));
        let (full, half) = (flat(48, 64), flat(24, 32));
        for (row, col, pixel) in half.pixels() {
            let mean = 0.5 * (full[(2 * row, 2 * col)][2] + full[(2 * row, 2 * col + 1)][2]);
            assert!((pixel[2] - mean).abs() < 1e-5, "{row} {col}");
        }
    }

    #[test]
    fn wrong_tables_are_refused() {
        assert!(matches!(PhotometricTable::new(3, 64, &[0.0; 10]), Err(OpticsError::TableSize { needed: 162, .. })));
        let mut c = vec![0.0; 162];
        c[7] = f32::NAN;
        assert!(matches!(PhotometricTable::new(3, 64, &c), Err(OpticsError::NotFinite { index: 7, .. })));
    }
}
