//! Candidates for corners, by the crate `chess-corners`.

use crate::geometry::Raster;
use chess_corners::{Detector, DetectorConfig};

/// A place where four squares may meet.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    pub(super) at: [f64; 2],
    /// Directions of the two lines through it, radians; between the first and the second, turning from x to y, it is dark.
    pub(super) axes: [f64; 2],
    pub(super) response: f64,
}

/// A way of preparing the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Attempt {
    /// Pixels averaged into one, along each side.
    pub(super) shrink: usize,
    /// Standard deviation of the smoothing, pixels of the shrunk image.
    pub(super) sigma: f64,
    /// Whether uneven light is evened out.
    pub(super) even: bool,
}

/// From the sharpest to the bluntest.
pub(super) const ATTEMPTS: [Attempt; 8] = [
    Attempt { shrink: 1, sigma: 0.0, even: false },
    Attempt { shrink: 1, sigma: 1.0, even: false },
    Attempt { shrink: 1, sigma: 1.0, even: true },
    Attempt { shrink: 2, sigma: 0.0, even: true },
    Attempt { shrink: 1, sigma: 2.0, even: true },
    Attempt { shrink: 2, sigma: 1.0, even: false },
    Attempt { shrink: 3, sigma: 1.0, even: true },
    Attempt { shrink: 4, sigma: 1.0, even: true },
];

/// Grey values that a hundredth of the pixels lie below and above.
pub(super) fn range(image: &Raster<f32>) -> (f32, f32) {
    let mut sorted: Vec<f32> = image.as_slice().iter().copied().filter(|v| v.is_finite()).collect();
    if sorted.is_empty() {
        return (0.0, 0.0);
    }
    sorted.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
    (at(0.01), at(0.99))
}

/// The image stretched to 0 to 255, shrunk and smoothed.
pub(super) fn prepare(image: &Raster<f32>, (low, high): (f32, f32), attempt: Attempt) -> Raster<f32> {
    let gain = 255.0 / (high - low);
    let stretched = image.map(|&v| if v.is_finite() { ((v - low) * gain).clamp(0.0, 255.0) } else { 0.0 });
    let small = shrink(&stretched, attempt.shrink);
    let smooth = blur(&small, attempt.sigma);
    if attempt.even { evened(&smooth) } else { smooth }
}

/// Corners of a picture of 0 to 255.
pub(super) fn detect(picture: &Raster<f32>, shrink: usize) -> Vec<Corner> {
    let (rows, cols) = picture.shape();
    if rows < 24 || cols < 24 {
        return Vec::new();
    }
    let bytes: Vec<u8> = picture.as_slice().iter().map(|v| v.round() as u8).collect();
    let config = if shrink > 1 { DetectorConfig::chess() } else { DetectorConfig::chess_multiscale() };
    let Ok(mut detector) = Detector::new(config) else { return Vec::new() };
    let found = detector.detect_u8(&bytes, cols as u32, rows as u32).unwrap_or_default();
    let corner = |c: &chess_corners::CornerDescriptor| {
        let axes = c.axes?.map(|axis| f64::from(axis.angle));
        let at = [f64::from(c.x), f64::from(c.y)];
        at.iter().chain(&axes).all(|v| v.is_finite()).then_some(Corner { at, axes, response: f64::from(c.response) })
    };
    let mut corners: Vec<Corner> = found.iter().filter_map(corner).collect();
    // A picture full of texture holds thousands; no board does.
    corners.sort_by(|a, b| b.response.total_cmp(&a.response).then(a.at[1].total_cmp(&b.at[1])));
    corners.truncate(6000);
    corners
}

fn shrink(image: &Raster<f32>, n: usize) -> Raster<f32> {
    if n == 1 {
        return image.clone();
    }
    Raster::from_fn(image.rows() / n, image.cols() / n, |row, col| {
        let mut sum = 0.0;
        for r in 0..n {
            for c in 0..n {
                sum += image[(row * n + r, col * n + c)];
            }
        }
        sum / (n * n) as f32
    })
}

/// Gaussian, borders repeated.
pub(super) fn blur(image: &Raster<f32>, sigma: f64) -> Raster<f32> {
    if sigma <= 0.0 {
        return image.clone();
    }
    let reach = (3.0 * sigma).ceil() as isize;
    let weights: Vec<f32> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp() as f32).collect();
    let total: f32 = weights.iter().sum();
    let (rows, cols) = image.shape();
    let near = |i: usize, k: usize, n: usize| (i as isize + k as isize - reach).clamp(0, n as isize - 1) as usize;
    let pass = |source: &Raster<f32>, along_rows: bool| {
        Raster::par_from_fn(rows, cols, |row, col| {
            let at = |k: usize| if along_rows { (near(row, k, rows), col) } else { (row, near(col, k, cols)) };
            weights.iter().enumerate().map(|(k, w)| w * source[at(k)]).sum::<f32>() / total
        })
    };
    pass(&pass(image, false), true)
}

/// Local mean 128 and local standard deviation 48: squares in a bright and in a dim part become alike.
fn evened(image: &Raster<f32>) -> Raster<f32> {
    let reach = 0.04 * image.rows().max(image.cols()) as f64;
    let mean = blur(image, reach);
    let mut off = image.clone();
    off.as_mut_slice().iter_mut().zip(mean.as_slice()).for_each(|(v, m)| *v -= m);
    let spread = blur(&off.map(|v| v * v), reach);
    off.as_mut_slice().iter_mut().zip(spread.as_slice()).for_each(|(v, s)| {
        *v = (128.0 + *v * 48.0 / s.sqrt().max(6.0)).clamp(0.0, 255.0);
    });
    off
}
