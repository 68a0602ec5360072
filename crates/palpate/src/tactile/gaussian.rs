use crate::geometry::Raster;

/// Odd-length Gaussian kernel of a `size`-pixel OpenCV kernel, for a map `scale` times as wide as the one `size` was meant for.
///
/// OpenCV derives σ = 0.3·((size − 1)/2 − 1) + 0.8 from the size; both shrink with the map.
pub(super) fn kernel(size: usize, scale: f64) -> Vec<f32> {
    let half = (size - 1) as f64 / 2.0;
    let sigma = (0.3 * (half - 1.0) + 0.8) * scale;
    let radius = (half * scale).ceil() as i64;
    sampled(sigma, radius)
}

/// Odd-length Gaussian kernel of standard deviation `sigma` pixels, cut off at four of them (SciPy's default).
pub(super) fn kernel_of_sigma(sigma: f64) -> Vec<f32> {
    let radius = (4.0 * sigma + 0.5) as i64;
    sampled(sigma, radius)
}

/// The Gaussian at the integers `-radius..=radius`, scaled to sum to one.
fn sampled(sigma: f64, radius: i64) -> Vec<f32> {
    let weights: Vec<f64> = (-radius..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|w| (w / sum) as f32).collect()
}

/// What a blur reads beyond the border.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Border {
    /// `c b | a b c`: reflected without repeating the edge (OpenCV's default).
    Reflect,
    /// `b a | a b c`: reflected with the edge repeated (SciPy's default).
    Repeat,
}

impl Border {
    /// The pixel of `0..n` that stands for pixel `i`.
    fn index(self, i: isize, n: usize) -> usize {
        let n = n as isize;
        if n == 1 {
            return 0;
        }
        let (period, last) = match self {
            Self::Reflect => (2 * (n - 1), 0),
            Self::Repeat => (2 * n, 1),
        };
        let i = i.rem_euclid(period);
        (if i < n { i } else { period - last - i }) as usize
    }
}

/// Separable blur of the whole raster with the same odd kernel along rows and columns.
pub(super) fn blur(image: &mut Raster<f32>, kernel: &[f32]) {
    let cols = image.cols();
    blur_rows(image.as_mut_slice(), cols, 1, kernel, Border::Reflect);
}

/// [`blur`] of each channel of an interleaved image.
pub(super) fn blur_channels(image: &mut Raster<[f32; 3]>, kernel: &[f32], border: Border) {
    let cols = image.cols();
    blur_rows(image.as_mut_slice().as_flattened_mut(), cols, 3, kernel, border);
}

/// Blurs `values`, rows of `cols` pixels of `channels` values each.
fn blur_rows(values: &mut [f32], cols: usize, channels: usize, kernel: &[f32], border: Border) {
    let width = cols * channels;
    if values.is_empty() {
        return;
    }
    let rows = values.len() / width;
    let radius = kernel.len() / 2;
    let mut padded = vec![0.0f32; width + 2 * radius * channels];
    let mut horizontal = vec![0.0f32; values.len()];
    for (source, target) in values.chunks_exact(width).zip(horizontal.chunks_exact_mut(width)) {
        let (left, rest) = padded.split_at_mut(radius * channels);
        let (middle, right) = rest.split_at_mut(width);
        middle.copy_from_slice(source);
        for i in 0..radius {
            let before = border.index(i as isize - radius as isize, cols) * channels;
            let after = border.index((cols + i) as isize, cols) * channels;
            left[i * channels..][..channels].copy_from_slice(&source[before..][..channels]);
            right[i * channels..][..channels].copy_from_slice(&source[after..][..channels]);
        }
        weighted_sum(target, kernel, |tap| &padded[tap * channels..]);
    }
    for (row, target) in values.chunks_exact_mut(width).enumerate() {
        let source = |tap: usize| border.index(row as isize + tap as isize - radius as isize, rows) * width;
        weighted_sum(target, kernel, |tap| &horizontal[source(tap)..][..width]);
    }
}

/// Writes Σ weight · source to `target`, taps in order; `source(tap)` is at least as long as `target`.
///
/// Blocks keep their sums in registers: one load per tap, and none or one store in all.
fn weighted_sum<'a>(target: &mut [f32], kernel: &[f32], source: impl Fn(usize) -> &'a [f32]) {
    const BLOCK: usize = 32;
    let sources: Vec<&[f32]> = (0..kernel.len()).map(source).collect();
    let mut blocks = target.chunks_exact_mut(BLOCK);
    let mut at = 0;
    for block in &mut blocks {
        let mut sums = [0.0f32; BLOCK];
        for (weight, source) in kernel.iter().zip(&sources) {
            for (sum, value) in sums.iter_mut().zip(&source[at..at + BLOCK]) {
                *sum += weight * value;
            }
        }
        block.copy_from_slice(&sums);
        at += BLOCK;
    }
    for (i, t) in blocks.into_remainder().iter_mut().enumerate() {
        *t = kernel.iter().zip(&sources).fold(0.0, |sum, (weight, source)| sum + weight * source[at + i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernel_matches_opencv_sigma_and_sums_to_one() {
        let k = kernel(11, 1.0);
        assert_eq!(k.len(), 11);
        assert!((k.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        // σ = 2.0: neighbouring weights at the centre have ratio exp(-1/8).
        assert!((k[6] / k[5] - (-0.125f32).exp()).abs() < 1e-6);
        assert_eq!(kernel(51, 0.5).len(), 27);
    }

    #[test]
    fn blur_keeps_constants_and_straight_ramps_inside_and_spreads_a_point_by_the_kernel() {
        let k = kernel(5, 1.0);
        let mut ramp = Raster::from_fn(20, 30, |r, c| 3.0 * c as f32 - r as f32);
        let before = ramp.clone();
        blur(&mut ramp, &k);
        assert!((ramp[(10, 15)] - before[(10, 15)]).abs() < 1e-4);
        let mut point = Raster::filled(9, 9, 0.0f32);
        point[(4, 4)] = 1.0;
        blur(&mut point, &k);
        assert!((point[(4, 3)] - k[2] * k[1]).abs() < 1e-7);
        assert!((point[(2, 6)] - k[0] * k[0]).abs() < 1e-7);
    }

    #[test]
    fn kernel_of_sigma_reaches_four_of_them() {
        let k = kernel_of_sigma(2.0);
        assert_eq!(k.len(), 17);
        assert!((k[9] / k[8] - (-0.125f32).exp()).abs() < 1e-6);
    }

    #[test]
    fn border_reflects_with_and_without_repeating_the_edge() {
        let at = [-2isize, -1, 0, 3, 4, 5, 9];
        assert_eq!(at.map(|i| Border::Reflect.index(i, 4)), [2, 1, 0, 3, 2, 1, 3]);
        assert_eq!(at.map(|i| Border::Repeat.index(i, 4)), [1, 0, 0, 3, 3, 2, 1]);
        assert_eq!(Border::Repeat.index(-40, 1), 0);
    }

    #[test]
    fn channels_are_blurred_as_if_each_were_alone_also_where_blocks_end() {
        let value = |c: usize| move |row: usize, col: usize| ((row * 7 + col * (3 + c)) % 11) as f32;
        let mut image = Raster::from_fn(9, 37, |r, c| [0, 1, 2].map(|k| value(k)(r, c)));
        blur_channels(&mut image, &kernel(11, 1.0), Border::Reflect);
        for c in 0..3 {
            let mut alone = Raster::from_fn(9, 37, value(c));
            blur(&mut alone, &kernel(11, 1.0));
            assert_eq!(image.map(|v| v[c]), alone);
        }
    }

    #[test]
    fn an_image_smaller_than_the_kernel_is_blurred_too() {
        let mut image = Raster::filled(2, 1, [1.0f32, 2.0, 3.0]);
        blur_channels(&mut image, &kernel_of_sigma(2.0), Border::Repeat);
        assert!((image[(1, 0)][2] - 3.0).abs() < 1e-5);
        blur_channels(&mut Raster::filled(0, 0, [0.0; 3]), &[1.0], Border::Reflect);
    }
}
