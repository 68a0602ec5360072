//! What clings to the object's edge and is not the object: waves of the table at its foot, and depth smeared from its
//! silhouette down to the table.

use super::support::Support;
use crate::geometry::{Point, Raster, Vector};

/// The fringe rises at most this many plane margins …
const LOW_MARGINS: f64 = 3.0;
/// … and this share of the object's height: a thin object is low and flat altogether.
const LOW_SHARE: f64 = 0.1;
/// A surface within 35° of the plane is flat.
const FLAT_COSINE: f64 = 0.82;
/// A surface seen at more than 72° from its normal, and joined to the table without a step, is smeared depth.
const GRAZING_COSINE: f64 = 0.3;

/// Pixels of the object to drop: those reached from the table, over steps of less than `max_step`(z), through pixels that are
/// low and flat, or grazing.
///
/// A bowl's inside is low and flat as well, but its wall parts it from the table; a sphere's silhouette is grazing as well, but
/// a step parts it from the table.
///
/// * `table` – true on readings of the support plane
/// * `normals` – of the object, camera frame, zero where unknown
pub(super) fn fringe(
    points: &Raster<Point>,
    normals: &Raster<[f32; 3]>,
    table: &Raster<bool>,
    support: &Support,
    max_step: impl Fn(f64) -> f64,
) -> Raster<bool> {
    let heights = points.pixels().filter(|(r, c, _)| normals[(*r, *c)] != [0.0; 3]);
    let mut heights: Vec<f64> = heights.map(|(_, _, p)| support.plane.signed_distance(p)).collect();
    if heights.is_empty() {
        return table.map(|_| false);
    }
    let nearly_top = heights.len() - 1 - heights.len() / 50;
    let top = *heights.select_nth_unstable_by(nearly_top, f64::total_cmp).1;
    let low_below = (LOW_MARGINS * support.margin).min(LOW_SHARE * top);
    let suspicious = |row: usize, col: usize| {
        let [x, y, z] = normals[(row, col)].map(f64::from);
        let n = Vector::new(x, y, z);
        if n == Vector::zeros() {
            return false;
        }
        let p = points[(row, col)];
        let low = support.plane.signed_distance(&p) < low_below;
        low && n.dot(&support.plane.normal) > FLAT_COSINE || -n.dot(&p.coords.normalize()) < GRAZING_COSINE
    };
    let mut dropped = table.map(|_| false);
    let mut queue: Vec<(usize, usize)> = table.pixels().filter(|(_, _, t)| **t).map(|(r, c, _)| (r, c)).collect();
    while let Some((row, col)) = queue.pop() {
        let z = points[(row, col)].z;
        for (dr, dc) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            let (r, c) = (row as isize + dr, col as isize + dc);
            if dropped.at(r, c) != Some(&false) {
                continue;
            }
            let next = (r as usize, c as usize);
            let joined = (points[next].z - z).abs() < max_step(z);
            if joined && !table[next] && suspicious(next.0, next.1) {
                dropped[next] = true;
                queue.push(next);
            }
        }
    }
    dropped
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Plane;

    /// Seen from above: table at 0.8 m; columns 10..20 an object 150 mm high; what lies in columns 8..10 varies.
    fn drop_at(column_depths: [f64; 2], normal: [f32; 3]) -> [bool; 4] {
        let points = Raster::from_fn(10, 30, |row, col| {
            let z = match col {
                8 => column_depths[0],
                9 => column_depths[1],
                10..20 => 0.65,
                _ => 0.8,
            };
            Point::new((col as f64 - 15.0) * 1e-3, (row as f64 - 5.0) * 1e-3, z)
        });
        let table = Raster::from_fn(10, 30, |_, col| !(8..20).contains(&col));
        let normals = Raster::from_fn(10, 30, |_, col| match col {
            8 | 9 => normal,
            10..20 => [0.0, 0.0, -1.0],
            _ => [0.0; 3],
        });
        let plane = Plane::new(-Vector::z(), &Point::new(0.0, 0.0, 0.8)).expect("a direction");
        let dropped = fringe(&points, &normals, &table, &Support { plane, margin: 0.002 }, |_| 0.02);
        [8, 9, 10, 15].map(|col| dropped[(5, col)])
    }

    #[test]
    fn waves_and_smeared_depth_are_dropped_steps_are_not() {
        let (flat, steep) = ([0.0, 0.0, -1.0], [-0.98, 0.0, -0.2]);
        assert_eq!(drop_at([0.797, 0.796], flat), [true, true, false, false], "a wave of the table");
        assert_eq!(drop_at([0.785, 0.768], steep), [true, true, false, false], "depth smeared down to the table");
        assert_eq!(drop_at([0.65, 0.65], steep), [false; 4], "a silhouette behind a step");
        assert_eq!(drop_at([0.785, 0.768], [-0.8, 0.0, -0.6]), [false; 4], "a slope seen well");
    }
}
