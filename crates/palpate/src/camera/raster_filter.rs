//! Filters that use the camera's raster as the neighbourhood: far faster than a tree, and they know about edges.

use super::PinholeCamera;
use crate::geometry::{Point, Raster, UnionFind, outlier_limit};

const EIGHT: [(isize, isize); 8] = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)];

/// Label of a pixel that belongs to no cluster.
pub(super) const NO_CLUSTER: u32 = u32::MAX;

/// True for "flying" pixels: readings that mix two surfaces at a depth edge and lie on neither.
///
/// A neighbour is close if its depth differs by less than `max_slope` pixel pitches plus four σ (a surface seen at up to
/// atan(max_slope) from its normal). A pixel flies if fewer than three of its eight neighbours are close, or if two opposite
/// neighbours, not close to each other, have it strictly between them and close to neither.
pub(super) fn flying_pixels(
    depth: &Raster<f32>,
    camera: &PinholeCamera,
    sigma_at: impl Fn(f64) -> f64 + Sync,
    max_slope: f64,
) -> Raster<bool> {
    let pitch = 1.0 / camera.fx.min(camera.fy);
    Raster::par_from_fn(depth.rows(), depth.cols(), |row, col| {
        let z = depth[(row, col)];
        if z.is_nan() {
            return false;
        }
        let step = (max_slope * pitch * f64::from(z) + 4.0 * sigma_at(f64::from(z))) as f32;
        let at = |(dr, dc): (isize, isize), sign: isize| {
            depth.at(row as isize + sign * dr, col as isize + sign * dc).copied().unwrap_or(f32::NAN)
        };
        let close = EIGHT.iter().filter(|&&d| (at(d, 1) - z).abs() < step).count();
        // Each pair of opposite neighbours once. Comparisons with NaN are false.
        let between = EIGHT[..4].iter().any(|&d| {
            let (a, b) = (at(d, 1), at(d, -1));
            (a - z) * (z - b) > 0.0 && (a - z).abs() >= step && (z - b).abs() >= step
        });
        close < 3 || between
    })
}

/// Clusters of the chosen pixels: neighbours within `reach` pixels of each other and `link` metres join.
///
/// Returns a label per pixel, counting from 0 in row-major order of the first pixel, or [`NO_CLUSTER`], and their number.
pub(super) fn raster_clusters(
    points: &Raster<Point>,
    chosen: &Raster<bool>,
    reach: usize,
    link: impl Fn(f64) -> f64,
) -> (Raster<u32>, usize) {
    let (rows, cols) = points.shape();
    let mut sets = UnionFind::new(rows * cols);
    let reach = reach as isize;
    for (row, col, _) in chosen.pixels().filter(|(_, _, c)| **c) {
        let p = points[(row, col)];
        let limit = link(p.z).powi(2);
        for dr in 0..=reach {
            for dc in if dr == 0 { 1..=reach } else { -reach..=reach } {
                let (r, c) = (row as isize + dr, col as isize + dc);
                if chosen.at(r, c) == Some(&true) && (points[(r as usize, c as usize)] - p).norm_squared() < limit {
                    sets.union((row * cols + col) as u32, (r as usize * cols + c as usize) as u32);
                }
            }
        }
    }
    let mut labels = Raster::filled(rows, cols, NO_CLUSTER);
    let mut count = 0;
    for i in 0..rows * cols {
        let (row, col) = (i / cols, i % cols);
        if !chosen[(row, col)] {
            continue;
        }
        // The representative is the smallest member, so it has been labelled before.
        let root = sets.find(i as u32) as usize;
        labels[(row, col)] = if root == i {
            count += 1;
            count - 1
        } else {
            labels[(root / cols, root % cols)]
        };
    }
    (labels, count as usize)
}

/// True for chosen pixels whose mean distance to their eight nearest in the 5×5 window, in units of the pixel pitch at their
/// depth, lies more than `ratio` standard deviations above the average.
pub(super) fn raster_outliers(
    points: &Raster<Point>,
    chosen: &Raster<bool>,
    camera: &PinholeCamera,
    ratio: f64,
) -> Raster<bool> {
    let focal = camera.fx.min(camera.fy);
    let spread = Raster::par_from_fn(points.rows(), points.cols(), |row, col| {
        if !chosen[(row, col)] {
            return f64::NAN;
        }
        let p = points[(row, col)];
        let mut near = [f64::INFINITY; 24];
        let mut count = 0;
        for dr in -2..=2 {
            for dc in -2..=2 {
                let (r, c) = (row as isize + dr, col as isize + dc);
                if (dr, dc) != (0, 0) && chosen.at(r, c) == Some(&true) {
                    near[count] = (points[(r as usize, c as usize)] - p).norm();
                    count += 1;
                }
            }
        }
        if count < 8 {
            // Too sparse to judge by distance: the flying-pixel and plane-fit tests decide.
            return f64::NAN;
        }
        near[..count].select_nth_unstable_by(7, f64::total_cmp);
        near[..8].iter().sum::<f64>() / 8.0 * focal / p.z
    });
    let known: Vec<f64> = spread.as_slice().iter().copied().filter(|s| s.is_finite()).collect();
    let limit = outlier_limit(&known, ratio);
    spread.map(|s| *s > limit)
}

/// Share of the outline of `mask` that lies on the image border.
pub(super) fn border_share(mask: &Raster<bool>) -> f64 {
    let (mut outline, mut border) = (0usize, 0usize);
    for (row, col, _) in mask.pixels().filter(|(_, _, m)| **m) {
        let sides = [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(dr, dc)| mask.at(row as isize + dr, col as isize + dc));
        outline += usize::from(sides.iter().any(|s| *s != Some(&true)));
        border += usize::from(sides.iter().any(Option::is_none));
    }
    border as f64 / outline.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> PinholeCamera {
        PinholeCamera { width: 40, height: 30, fx: 100.0, fy: 100.0, cx: 19.5, cy: 14.5, distortion: [0.0; 5] }
    }

    fn lift(depth: &Raster<f32>) -> Raster<Point> {
        Raster::from_fn(depth.rows(), depth.cols(), |r, c| {
            Point::from(camera().ray(c as f64, r as f64) * f64::from(depth[(r, c)]))
        })
    }

    #[test]
    fn the_ramp_between_two_surfaces_flies() {
        // Object at 0.5 m left, table at 0.8 m right, one mixed column between.
        let depth = Raster::from_fn(30, 40, |_, col| match col {
            0..20 => 0.5,
            20 => 0.62,
            _ => 0.8,
        });
        let flying = flying_pixels(&depth, &camera(), |_| 1e-3, 6.0);
        for (row, col, &flies) in flying.pixels() {
            assert_eq!(flies, col == 20, "({row}, {col})");
        }
    }

    #[test]
    fn slopes_edges_and_holes_do_not_fly_but_lone_readings_do() {
        let mut depth = Raster::from_fn(30, 40, |_, col| 0.5 + 0.004 * col as f32);
        for row in 10..13 {
            depth[(row, 7)] = f32::NAN;
        }
        assert!(!flying_pixels(&depth, &camera(), |_| 1e-3, 6.0).as_slice().contains(&true));
        depth[(20, 20)] = 0.3;
        let flying = flying_pixels(&depth, &camera(), |_| 1e-3, 6.0);
        assert_eq!(flying.pixels().filter(|(_, _, f)| **f).map(|(r, c, _)| (r, c)).collect::<Vec<_>>(), [(20, 20)]);
    }

    #[test]
    fn clusters_need_nearness_in_image_and_in_depth() {
        let depth = Raster::from_fn(30, 40, |_, col| if col < 20 { 0.5 } else { 0.6 });
        let mut chosen = Raster::from_fn(30, 40, |row, col| row < 28 && col > 1);
        // A gap of two columns is bridged, one of four is not.
        for row in 0..30 {
            for col in [5, 6, 30, 31, 32, 33] {
                chosen[(row, col)] = false;
            }
        }
        let (labels, count) = raster_clusters(&lift(&depth), &chosen, 3, |_| 0.03);
        assert_eq!(count, 3);
        assert_eq!([2, 4, 7, 19, 20, 29, 34].map(|c| labels[(3, c)]), [0, 0, 0, 0, 1, 1, 2]);
        assert_eq!(labels[(3, 5)], NO_CLUSTER);
        assert_eq!(labels[(29, 10)], NO_CLUSTER);
    }

    #[test]
    fn border_share_counts_the_cut_part_of_the_outline() {
        let whole = Raster::from_fn(30, 40, |r, c| (5..10).contains(&r) && (5..10).contains(&c));
        assert_eq!(border_share(&whole), 0.0);
        // A 5×5 square in the corner: 16 outline pixels, 9 of them on the border.
        let corner = Raster::from_fn(30, 40, |r, c| r < 5 && c < 5);
        assert!((border_share(&corner) - 9.0 / 16.0).abs() < 1e-12);
        assert_eq!(border_share(&Raster::filled(3, 3, false)), 0.0);
    }

    #[test]
    fn a_spike_is_an_outlier() {
        let mut depth = Raster::filled(30, 40, 0.5);
        depth[(15, 20)] = 0.45;
        let outliers = raster_outliers(&lift(&depth), &depth.map(|_| true), &camera(), 4.0);
        assert!(outliers[(15, 20)] && !outliers[(5, 5)]);
    }
}
