use crate::geometry::{Raster, distance_to_true};

/// Side of the neighbourhood whose brightest pixel is the gel without its markers, pixels.
const REACH: usize = 7;
/// Share of that brightness under which a pixel belongs to a marker.
const DARK: f32 = 0.86;
/// Pixels round a marker that its blur darkens.
const FRINGE: f64 = 2.0;
/// Sweeps of the fill; the holes are a few pixels wide.
const SWEEPS: usize = 200;

/// Whether a pixel of a gel with printed dots shows a dot or its blur.
///
/// Dots are dark and small: darker than the brightest of their neighbourhood after that has been shrunk back (a morphological
/// closing of the mean of the channels). Dots in a shadow, and steep shadows as narrow as a dot, are confused.
pub fn markers(image: &Raster<[u8; 3]>) -> Raster<bool> {
    let gray = image.map(|p| p.iter().map(|&v| f32::from(v)).sum::<f32>() / 3.0);
    let closed = extreme(&extreme(&gray, f32::max), f32::min);
    let dark = Raster::from_fn(gray.rows(), gray.cols(), |r, c| gray[(r, c)] < DARK * closed[(r, c)]);
    distance_to_true(&dark).map(|&d| f64::from(d) <= FRINGE)
}

/// The image with the masked pixels filled smoothly from those around them (Laplace's equation).
///
/// For colours only: the slope under a marker is not known, it is guessed.
pub fn fill_markers(image: &Raster<[u8; 3]>, mask: &Raster<bool>) -> Raster<[u8; 3]> {
    let (rows, cols) = image.shape();
    let mut filled = image.map(|p| p.map(f32::from));
    let holes: Vec<(usize, usize)> = mask.pixels().filter(|(.., m)| **m).map(|(r, c, _)| (r, c)).collect();
    let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
    for (pixel, _) in filled.as_slice().iter().zip(mask.as_slice()).filter(|(_, m)| !**m) {
        (0..3).for_each(|k| sum[k] += pixel[k]);
        count += 1.0;
    }
    for &hole in &holes {
        filled[hole] = sum.map(|s| s / count.max(1.0));
    }
    for _ in 0..SWEEPS {
        for &(row, col) in &holes {
            let near = [
                (row.saturating_sub(1), col),
                ((row + 1).min(rows - 1), col),
                (row, col.saturating_sub(1)),
                (row, (col + 1).min(cols - 1)),
            ];
            filled[(row, col)] = std::array::from_fn(|k| near.iter().map(|&n| filled[n][k]).sum::<f32>() / 4.0);
        }
    }
    filled.map(|p| p.map(|v| v.round() as u8))
}

/// The extreme value of each square neighbourhood.
fn extreme(image: &Raster<f32>, pick: fn(f32, f32) -> f32) -> Raster<f32> {
    let (rows, cols) = image.shape();
    let near = |i: usize, n: usize| i.saturating_sub(REACH)..(i + REACH + 1).min(n);
    let fold = |values: &mut dyn Iterator<Item = f32>| values.reduce(pick).unwrap_or(0.0);
    let across = Raster::from_fn(rows, cols, |r, c| fold(&mut near(c, cols).map(|c| image[(r, c)])));
    Raster::from_fn(rows, cols, |r, c| fold(&mut near(r, rows).map(|r| across[(r, c)])))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gel(row: usize, col: usize) -> [u8; 3] {
        [90 + (col / 2) as u8, 130 - (row / 3) as u8, 100 + (row / 4) as u8]
    }

    #[test]
    fn dots_are_found_and_filled_and_the_rest_is_untouched() {
        let dot = |row: usize, col: usize| row % 20 >= 8 && row % 20 < 12 && col % 25 >= 9 && col % 25 < 16;
        let clean = Raster::from_fn(100, 125, gel);
        let image = Raster::from_fn(100, 125, |r, c| if dot(r, c) { [40, 42, 41] } else { gel(r, c) });
        let mask = markers(&image);
        assert!(mask.pixels().all(|(r, c, m)| *m || !dot(r, c)));
        let share = mask.as_slice().iter().filter(|m| **m).count() as f64 / mask.as_slice().len() as f64;
        assert!(share < 0.2, "{share}");
        for ((r, c, found), clean) in fill_markers(&image, &mask).pixels().zip(clean.as_slice()) {
            assert!((0..3).all(|k| found[k].abs_diff(clean[k]) <= 2), "{r} {c} {found:?} {clean:?}");
        }
    }

    #[test]
    fn a_gel_without_dots_has_none() {
        let mask = markers(&Raster::from_fn(100, 125, gel));
        assert!(mask.as_slice().iter().all(|m| !m));
    }
}
