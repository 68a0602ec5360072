//! The plane that the object stands on, found among the readings of a frame.

use super::SegmentParams;
use crate::geometry::{Plane, PlaneRansac, Point, Raster, Vector};

/// What is known of the direction away from the ground.
#[derive(Debug, Clone, Copy)]
pub(super) enum Up {
    /// It is this one, camera frame; a support plane is within 30° of it.
    Known(Vector),
    /// Images are taken the right way up: of a table and a wall the table faces more towards −y. Planes face the camera.
    Image,
    /// Nothing. Planes face the sensor.
    Unknown,
}

impl Up {
    fn allows(&self, plane: &Plane) -> bool {
        match self {
            Self::Known(up) => plane.normal.dot(up).abs() > 30.0_f64.to_radians().cos(),
            Self::Image | Self::Unknown => true,
        }
    }

    fn oriented(&self, plane: Plane) -> Plane {
        let faces_up = match self {
            Self::Known(up) => plane.normal.dot(up) > 0.0,
            Self::Image | Self::Unknown => plane.offset < 0.0,
        };
        if faces_up { plane } else { plane.flipped() }
    }

    /// How much likelier than a plane seen head-on an oriented plane carries things.
    fn preference(&self, plane: &Plane) -> f64 {
        match self {
            Self::Image => (-2.0 * plane.normal.y).exp(),
            Self::Known(_) | Self::Unknown => 1.0,
        }
    }
}

/// More readings than this are thinned to every second row and column before planes are searched.
const DENSE: usize = 100_000;
/// At most this many planes are considered: table, wall or floor, and the object's own largest face.
const MAX_PLANES: usize = 3;

/// A support plane in the **camera** frame, normal up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Support {
    pub(super) plane: Plane,
    /// Readings less than this above the plane may be the plane itself, metres.
    pub(super) margin: f64,
}

impl Support {
    /// A known plane; its margin is measured on the readings near it.
    pub(super) fn known(plane: Plane, readings: &[Point], params: &SegmentParams) -> Self {
        let mut near: Vec<f64> =
            readings.iter().map(|p| plane.signed_distance(p).abs()).filter(|d| *d < params.plane_tolerance).collect();
        let middle = near.len() / 2;
        let sigma =
            if near.len() < 100 { 0.0 } else { 1.4826 * *near.select_nth_unstable_by(middle, f64::total_cmp).1 };
        Self { plane, margin: margin(sigma, params) }
    }
}

fn margin(sigma: f64, params: &SegmentParams) -> f64 {
    (params.margin_sigmas * sigma).clamp(params.min_margin, params.max_margin)
}

/// All usable readings, thinned where they are dense, with their pixels.
pub(super) fn readings(points: &Raster<Point>, usable: &Raster<bool>) -> (Vec<Point>, Vec<(f64, f64)>) {
    let count = usable.as_slice().iter().filter(|u| **u).count();
    let stride = if count > DENSE { 2 } else { 1 };
    points
        .pixels()
        .filter(|(row, col, _)| usable[(*row, *col)] && row % stride == 0 && col % stride == 0)
        .map(|(row, col, p)| (*p, (col as f64, row as f64)))
        .unzip()
}

/// Planes that may carry the object, the likeliest first.
///
/// RANSAC finds the planes with the most readings one after the other. They are ordered by the readings on them less those
/// below them, each weighted by nearness to `focus` (the picked pixel or the image centre): a table surrounds the object and
/// little lies below it; a wall is elsewhere, and below the object's own face lies the rest of the scene.
///
/// * `up` – what is known of it, in the readings' frame, whose origin is the sensor
pub(super) fn support_candidates(
    readings: &[Point],
    pixels: &[(f64, f64)],
    up: Up,
    focus: (f64, f64),
    params: &SegmentParams,
) -> Vec<Support> {
    let ransac = PlaneRansac { tolerance: params.plane_tolerance, seed: params.seed, ..PlaneRansac::default() };
    let mut remaining = readings.to_vec();
    let mut found: Vec<(f64, Support)> = Vec::new();
    for _ in 0..MAX_PLANES {
        let Some(fit) = ransac.fit(&remaining, |plane| up.allows(plane)) else { break };
        if (fit.inliers as f64) < params.min_plane_share * readings.len() as f64 {
            break;
        }
        remaining.retain(|p| fit.plane.signed_distance(p).abs() > 2.0 * params.plane_tolerance);
        let plane = up.oriented(fit.plane);
        let score = support_score(&plane, readings, pixels, focus, params.plane_tolerance) * up.preference(&plane);
        if score > 0.0 {
            found.push((score, Support { plane, margin: margin(fit.sigma, params) }));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|f| f.1).collect()
}

fn support_score(plane: &Plane, readings: &[Point], pixels: &[(f64, f64)], focus: (f64, f64), tolerance: f64) -> f64 {
    /// Readings this far from the focus count half, pixels.
    const REACH: f64 = 150.0;
    let mut score = 0.0;
    for (p, (u, v)) in readings.iter().zip(pixels) {
        let weight = 1.0 / (1.0 + ((u - focus.0).powi(2) + (v - focus.1).powi(2)) / (REACH * REACH));
        let height = plane.signed_distance(p);
        if height.abs() < tolerance {
            score += weight;
        } else if height < -2.0 * tolerance {
            score -= weight;
        }
    }
    score
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A table below, a wall behind it that fills more of the image, and a box face in front.
    fn scene() -> (Vec<Point>, Vec<(f64, f64)>) {
        let (mut points, mut pixels) = (Vec::new(), Vec::new());
        for row in 0..96 {
            for col in 0..128 {
                let (x, y) = ((f64::from(col) - 63.5) / 120.0, (f64::from(row) - 47.5) / 120.0);
                // Table y = 0.2 (y points down), wall z = 1.2, face z = 0.7 for |x z| < 0.08 above the table.
                let table = if y > 0.0 { 0.2 / y } else { f64::INFINITY };
                let mut z = table.min(1.2);
                if (0.7 * x).abs() < 0.08 && (-0.02..0.2).contains(&(0.7 * y)) {
                    z = z.min(0.7);
                }
                points.push(Point::new(x, y, 1.0) * z);
                pixels.push((f64::from(col) * 5.0, f64::from(row) * 5.0));
            }
        }
        (points, pixels)
    }

    #[test]
    fn the_table_wins_over_wall_and_face() {
        let (points, pixels) = scene();
        let params = SegmentParams::default();
        for up in [Up::Image, Up::Known(-Vector::y())] {
            let found = support_candidates(&points, &pixels, up, (320.0, 330.0), &params);
            let plane = found.first().expect("a plane").plane;
            assert!(
                (plane.normal.into_inner() + Vector::y()).norm() < 1e-6,
                "{up:?}: normal {}",
                plane.normal.into_inner()
            );
            assert!((plane.offset + 0.2).abs() < 1e-6);
        }
    }

    #[test]
    fn a_known_up_excludes_walls() {
        let (points, pixels) = scene();
        let wall_up =
            support_candidates(&points, &pixels, Up::Known(-Vector::z()), (320.0, 100.0), &SegmentParams::default());
        assert!(wall_up.iter().all(|s| s.plane.normal.z < -0.86));
    }

    #[test]
    fn the_margin_follows_the_noise_of_the_plane() {
        let params = SegmentParams::default();
        let plane = Plane::new(-Vector::z(), &Point::new(0.0, 0.0, 0.7)).expect("a direction");
        let wavy: Vec<Point> = (0..1000).map(|i| Point::new(0.0, 0.0, 0.7 + 0.003 * (f64::from(i)).sin())).collect();
        let support = Support::known(plane, &wavy, &params);
        // The median of |3 mm · sin| is 3 mm · sin 45°.
        assert!(
            (support.margin - params.margin_sigmas * 1.4826 * 0.003 * std::f64::consts::FRAC_1_SQRT_2).abs() < 2e-4,
            "{}",
            support.margin
        );
        assert_eq!(Support::known(plane, &[], &params).margin, params.min_margin);
    }
}
