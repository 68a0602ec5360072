//! One object, several clusters: a bowl's near wall hides the rim that joins it to the inside.

use super::raster_filter::NO_CLUSTER;
use super::support::Support;
use crate::geometry::{KdTree, Point, Raster, Vector};

/// Clusters smaller than this are noise, pixels.
pub(super) const MIN_FRAGMENT: usize = 20;
/// Two clusters share ground if this share of one's points lies over the other's footprint.
const SHARED_GROUND: f64 = 0.02;

/// Joins to a cluster those that belong to the same object and returns the pixels of all.
///
/// Things that stand on one plane do not share ground. A cluster joins if it comes within `gap` metres and the convex hulls of
/// the footprints (points dropped onto the support plane) overlap noticeably.
pub(super) fn with_fragments(
    points: &Raster<Point>,
    labels: &Raster<u32>,
    clusters: usize,
    chosen: u32,
    support: &Support,
    gap: f64,
) -> Raster<bool> {
    let mut members: Vec<Vec<Point>> = vec![Vec::new(); clusters];
    for (&label, p) in labels.as_slice().iter().zip(points.as_slice()).filter(|(l, _)| **l != NO_CLUSTER) {
        members[label as usize].push(*p);
    }
    let mut joined = vec![false; clusters];
    joined[chosen as usize] = true;
    // Each newcomer may bring others near.
    loop {
        let object: Vec<Point> =
            (0..clusters).filter(|&c| joined[c]).flat_map(|c| members[c].iter().copied()).collect();
        let ground = footprint(&object, support);
        let hull = convex_hull(ground.clone());
        let mut tree = None;
        let before = joined.iter().filter(|j| **j).count();
        for c in (0..clusters).filter(|&c| members[c].len() >= MIN_FRAGMENT) {
            if joined[c] {
                continue;
            }
            let other = footprint(&members[c], support);
            let other_hull = convex_hull(other.clone());
            if share_inside(&other, &hull).max(share_inside(&ground, &other_hull)) < SHARED_GROUND {
                continue;
            }
            let tree = tree.get_or_insert_with(|| KdTree::new(&object));
            joined[c] = members[c].iter().any(|p| tree.nearest(p).is_some_and(|found| found.1 < gap));
        }
        if joined.iter().filter(|j| **j).count() == before {
            return labels.map(|&l| l != NO_CLUSTER && joined[l as usize]);
        }
    }
}

/// Points dropped onto the plane, in two coordinates of it.
pub(super) fn footprint(points: &[Point], support: &Support) -> Vec<[f64; 2]> {
    let up = support.plane.normal.into_inner();
    let across = if up.x.abs() < 0.7 { Vector::x() } else { Vector::y() };
    let e1 = up.cross(&across).normalize();
    let e2 = up.cross(&e1);
    points.iter().map(|p| [e1.dot(&p.coords), e2.dot(&p.coords)]).collect()
}

fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Andrew's monotone chain, counter-clockwise.
pub(super) fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut hull: Vec<[f64; 2]> = Vec::new();
    let mut half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let start = hull.len();
        for p in points {
            while hull.len() >= start + 2 && turn(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0.0 {
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
    };
    half(&mut points.iter().copied());
    half(&mut points.iter().rev().copied());
    hull
}

pub(super) fn share_inside(points: &[[f64; 2]], hull: &[[f64; 2]]) -> f64 {
    if hull.len() < 3 {
        return 0.0;
    }
    let inside = |p: &&[f64; 2]| (0..hull.len()).all(|i| turn(hull[i], hull[(i + 1) % hull.len()], **p) >= 0.0);
    points.iter().filter(inside).count() as f64 / points.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Plane;

    #[test]
    fn hull_of_a_grid_is_its_square() {
        let grid: Vec<[f64; 2]> = (0..25).map(|i| [f64::from(i % 5), f64::from(i / 5)]).collect();
        let hull = convex_hull(grid.clone());
        assert_eq!(hull, [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]);
        assert_eq!(share_inside(&grid, &hull), 1.0);
        assert_eq!(share_inside(&[[5.0, 1.0], [1.0, 1.0]], &hull), 0.5);
        assert_eq!(share_inside(&grid, &[[0.0, 0.0]]), 0.0);
    }

    /// Three strips of 10×10 pixels, 1 mm apart within a strip: 0 and 1 above each other, 2 beside them.
    #[test]
    fn shared_ground_joins_and_neighbours_do_not() {
        let points = Raster::from_fn(10, 30, |row, col| match col / 10 {
            0 => Point::new(col as f64 * 1e-3, row as f64 * 1e-3, 0.50),
            1 => Point::new((col - 10) as f64 * 1e-3, row as f64 * 1e-3, 0.52),
            _ => Point::new((col - 2) as f64 * 1e-3, row as f64 * 1e-3, 0.50),
        });
        let labels = Raster::from_fn(10, 30, |_, col| (col / 10) as u32);
        let plane = Plane::new(-Vector::z(), &Point::new(0.0, 0.0, 0.6)).expect("a direction");
        let support = Support { plane, margin: 0.002 };
        let joined = |gap| {
            let mask = with_fragments(&points, &labels, 3, 0, &support, gap);
            [0, 10, 20].map(|col| mask[(5, col)])
        };
        assert_eq!(joined(0.025), [true, true, false]);
        assert_eq!(joined(0.015), [true, false, false]);
    }
}
