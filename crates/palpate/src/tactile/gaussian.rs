use crate::geometry::Raster;

/// Odd-length Gaussian kernel of a `size`-pixel OpenCV kernel, for a map `scale` times as wide as the one `size` was meant for.
///
/// OpenCV derives σ = 0.3·((size − 1)/2 − 1) + 0.8 from the size; both shrink with the map.
pub(super) fn kernel(size: usize, scale: f64) -> Vec<f32> {
    let half = (size - 1) as f64 / 2.0;
    let sigma = (0.3 * (half - 1.0) + 0.8) * scale;
    let radius = (half * scale).ceil() as i64;
    let weights: Vec<f64> = (-radius..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|w| (w / sum) as f32).collect()
}

/// Index `i` reflected into `0..n` without repeating the edge pixel (OpenCV's default border).
fn reflect(i: isize, n: usize) -> usize {
    let n = n as isize;
    if n == 1 {
        return 0;
    }
    let period = 2 * (n - 1);
    let i = i.rem_euclid(period);
    (if i < n { i } else { period - i }) as usize
}

/// Separable blur of the whole raster with the same odd kernel along rows and columns, border reflected.
pub(super) fn blur(image: &mut Raster<f32>, kernel: &[f32]) {
    let (rows, cols) = image.shape();
    let radius = (kernel.len() / 2) as isize;
    let mut padded = vec![0.0f32; cols + kernel.len() - 1];
    let mut horizontal = vec![0.0f32; rows * cols];
    for (source, target) in image.as_slice().chunks_exact(cols).zip(horizontal.chunks_exact_mut(cols)) {
        for (i, p) in padded.iter_mut().enumerate() {
            *p = source[reflect(i as isize - radius, cols)];
        }
        for (tap, weight) in kernel.iter().enumerate() {
            for (t, p) in target.iter_mut().zip(&padded[tap..]) {
                *t += weight * p;
            }
        }
    }
    for (row, target) in image.as_mut_slice().chunks_exact_mut(cols).enumerate() {
        target.fill(0.0);
        for (tap, weight) in kernel.iter().enumerate() {
            let source = reflect(row as isize + tap as isize - radius, rows) * cols;
            for (t, h) in target.iter_mut().zip(&horizontal[source..source + cols]) {
                *t += weight * h;
            }
        }
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
    fn border_reflects_without_repeating_the_edge() {
        assert_eq!([-2isize, -1, 0, 3, 4, 5, 9].map(|i| reflect(i, 4)), [2, 1, 0, 3, 2, 1, 3]);
    }
}
