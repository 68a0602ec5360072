//! Corners to a fraction of a pixel: where all gradients around are square to the line from it.

use crate::geometry::Raster;

/// Steps of the search.
const STEPS: usize = 40;
/// Step at which it ends, pixels.
const SMALL: f64 = 1e-3;

/// Half the side of the default window, as a share of the way to the next corner. Boards drawn with a known camera (docs/bench-guide.md)
/// set it: 0.3 is noisier where squares are small, 0.45 reaches over the edge of a board whose outer squares are cut.
const WINDOW_SHARE: f64 = 0.35;
/// Its bounds, pixels.
const WINDOW: [f64; 2] = [2.0, 10.0];

/// Refines the corners of a board, row by row.
///
/// At the corner q the image's gradient g at every point p near it is square to p − q, whether p lies on an edge (the gradient is
/// square to the edge, which runs through q) or in a square (it is 0): least squares of g·(p − q), weighted towards the middle.
///
/// # References
/// Förstner & Gülch, *A fast operator for detection and precise location of distinct points, corners and centres of circular
/// features*, ISPRS 1987.
pub(super) fn refine(
    image: &Raster<f32>,
    corners: &mut [[f64; 2]],
    (cols, rows): (usize, usize),
    window: Option<usize>,
) {
    let rough = corners.to_vec();
    let nearest = |i: usize| {
        let (x, y) = (i % cols, i / cols);
        let mut least = f64::INFINITY;
        let near = [(x > 0, 1), (y > 0, cols)].into_iter().filter(|n| n.0).map(|n| i - n.1);
        let more = [(x + 1 < cols, 1), (y + 1 < rows, cols)].into_iter().filter(|n| n.0).map(|n| i + n.1);
        for j in near.chain(more) {
            least = least.min((rough[i][0] - rough[j][0]).hypot(rough[i][1] - rough[j][1]));
        }
        least
    };
    for (i, corner) in corners.iter_mut().enumerate() {
        let spacing = nearest(i);
        // The window must not reach the next corner.
        let half = window.map_or((WINDOW_SHARE * spacing).clamp(WINDOW[0], WINDOW[1]) as i32, |w| w as i32);
        let near = |p: &[f64; 2]| (p[0] - rough[i][0]).hypot(p[1] - rough[i][1]) < (0.3 * spacing).max(1.5);
        if let Some(place) = step_to_corner(image, rough[i], half).filter(near) {
            *corner = place;
        }
    }
}

/// A corner that the detector missed, if there is one near the guess.
pub(super) fn find_missing(image: &Raster<f32>, guess: [f64; 2], spacing: f64) -> Option<[f64; 2]> {
    let half = (WINDOW_SHARE * spacing).clamp(WINDOW[0], WINDOW[1]) as i32;
    let place = step_to_corner(image, guess, half)?;
    let moved = (place[0] - guess[0]).hypot(place[1] - guess[1]);
    // Two bright and two dark quarters, opposite ones alike.
    let mut best = 0.0f64;
    for turn in 0..8 {
        let (sin, cos) = (f64::from(turn) * std::f64::consts::PI / 16.0).sin_cos();
        let r = 0.35 * spacing;
        let at = |x: f64, y: f64| sample(image, place[0] + r * x, place[1] + r * y);
        let (a, b, c, d) = (at(cos, sin)?, at(-sin, cos)?, at(-cos, -sin)?, at(sin, -cos)?);
        best = best.max(((a + c - b - d).abs() - (a - c).abs() - (b - d).abs()) / 2.0);
    }
    (moved < 0.25 * spacing && best > 8.0).then_some(place)
}

fn step_to_corner(image: &Raster<f32>, start: [f64; 2], half: i32) -> Option<[f64; 2]> {
    let mut at = start;
    for _ in 0..STEPS {
        let (mut a, mut b, mut c, mut x, mut y) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for dy in -half..=half {
            for dx in -half..=half {
                let (fx, fy) = (f64::from(dx), f64::from(dy));
                let at = |ox: f64, oy: f64| sample(image, at[0] + fx + ox, at[1] + fy + oy);
                let gx = 0.5 * (at(1.0, 0.0)? - at(-1.0, 0.0)?);
                let gy = 0.5 * (at(0.0, 1.0)? - at(0.0, -1.0)?);
                let r2 = (fx * fx + fy * fy) / f64::from(half * half);
                let weight = (-r2).exp();
                let (xx, xy, yy) = (weight * gx * gx, weight * gx * gy, weight * gy * gy);
                (a, b, c) = (a + xx, b + xy, c + yy);
                (x, y) = (x + xx * fx + xy * fy, y + xy * fx + yy * fy);
            }
        }
        let det = a * c - b * b;
        // Written so that NaN fails too.
        if !(det > 1e-6 * (a + c).powi(2)) {
            return None;
        }
        let step = [(c * x - b * y) / det, (a * y - b * x) / det];
        at = [at[0] + step[0], at[1] + step[1]];
        if step[0].hypot(step[1]) < SMALL {
            break;
        }
    }
    Some(at)
}

/// Bilinear value, or `None` outside the image.
pub(super) fn sample(image: &Raster<f32>, x: f64, y: f64) -> Option<f64> {
    let (cols, rows) = (image.cols() as f64, image.rows() as f64);
    if !(x >= 0.0 && y >= 0.0 && x <= cols - 1.0 && y <= rows - 1.0) {
        return None;
    }
    let (c, r) = ((x as usize).min(image.cols() - 2), (y as usize).min(image.rows() - 2));
    let (fx, fy) = (x - c as f64, y - r as f64);
    let at = |r, c| f64::from(image[(r, c)]);
    Some(
        (at(r, c) * (1.0 - fx) + at(r, c + 1) * fx) * (1.0 - fy)
            + (at(r + 1, c) * (1.0 - fx) + at(r + 1, c + 1) * fx) * fy,
    )
}
