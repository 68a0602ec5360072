use super::grid::Grid;
use crate::geometry::{KdTree, Point, PointCloud, Vector};
use crate::surface::SurfaceError;
use rayon::prelude::*;

/// Unit normals of a cloud that can be meshed.
pub(super) fn checked_normals(cloud: &PointCloud) -> Result<Vec<Vector>, SurfaceError> {
    let normals = cloud.normals.as_ref().filter(|n| n.len() == cloud.len()).ok_or(SurfaceError::NoNormals)?;
    let mut unit = Vec::with_capacity(normals.len());
    for (index, (p, n)) in cloud.points.iter().zip(normals).enumerate() {
        if !p.iter().chain(n.iter()).all(|c| c.is_finite()) {
            return Err(SurfaceError::NotFinite { index });
        }
        let length = n.norm();
        unit.push(n.try_normalize(1e-9).ok_or(SurfaceError::ZeroNormal { index, length })?);
    }
    Ok(unit)
}

/// Indices, in order, of the points that differ from every earlier one.
pub(super) fn distinct(points: &[Point]) -> Vec<usize> {
    // Adding zero turns −0 into 0, which are one place.
    let key = |i: usize| points[i].coords.add_scalar(0.0);
    let order = |a: &usize, b: &usize| {
        let (p, q) = (key(*a), key(*b));
        p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)).then(a.cmp(b))
    };
    let mut kept: Vec<usize> = (0..points.len()).collect();
    kept.sort_unstable_by(order);
    kept.dedup_by(|b, a| key(*a) == key(*b));
    kept.sort_unstable();
    kept
}

/// Indices, in order, of a subset in which no two points are nearer than `distance`: each point yields to an earlier one.
pub(super) fn thinned(points: &[Point], distance: f64) -> Vec<usize> {
    if distance <= 0.0 {
        return (0..points.len()).collect();
    }
    let grid = Grid::new(points, distance);
    let mut dropped = vec![false; points.len()];
    for i in 0..points.len() {
        if !dropped[i] {
            grid.within(&points[i], distance, |j, _, _| {
                dropped[j as usize] |= j as usize > i;
                true
            });
        }
    }
    (0..points.len()).filter(|&i| !dropped[i]).collect()
}

/// The median over the points of the mean distance to the six nearest others: the side of the triangles to expect.
pub(super) fn median_spacing(points: &[Point]) -> f64 {
    const NEIGHBORS: usize = 6;
    let tree = KdTree::new(points);
    let mut spacing: Vec<f64> = points
        .par_iter()
        .map(|p| {
            let near = tree.nearest_n(p, NEIGHBORS + 1);
            near.iter().map(|n| n.1).sum::<f64>() / near.len().saturating_sub(1).max(1) as f64
        })
        .collect();
    spacing.sort_unstable_by(f64::total_cmp);
    spacing.get(spacing.len() / 2).copied().unwrap_or(0.0)
}

/// The points moved by up to 1e-5 `scale` each, the same way every time.
///
/// On a regular grid several points touch one ball at once, and fronts that meet could triangulate them differently. Moved
/// ever so little, the points are in general position and the faces that admit an empty ball are unique.
pub(super) fn jittered(points: &[Point], scale: f64) -> Vec<Point> {
    let noise = |k: usize| {
        // SplitMix64 finaliser.
        let mut h = (k as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        h = (h ^ (h >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        h = (h ^ (h >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((h ^ (h >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    };
    let step = 1e-5 * scale;
    let moved = |(i, p): (usize, &Point)| p + Vector::new(noise(3 * i), noise(3 * i + 1), noise(3 * i + 2)) * step;
    points.iter().enumerate().map(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_equal_points_stays() {
        let p = |x: f64| Point::new(x, 0.0, 1.0);
        assert_eq!(distinct(&[p(2.0), p(0.0), p(2.0), p(-0.0), p(1.0)]), [0, 1, 4]);
    }

    #[test]
    fn thinning_keeps_the_distance_and_covers() {
        let points: Vec<Point> =
            (0..1000).map(|i| Point::new((f64::from(i) * 0.37).sin(), f64::from(i) * 1e-3, 0.0)).collect();
        let kept = thinned(&points, 0.1);
        let near = |i: usize| kept.iter().any(|&k| k <= i && (points[k] - points[i]).norm() < 0.1);
        assert!((0..1000).all(near));
        for (n, &a) in kept.iter().enumerate() {
            assert!(kept[..n].iter().all(|&b| (points[a] - points[b]).norm() >= 0.1));
        }
    }

    #[test]
    fn spacing_of_a_hexagonal_sheet() {
        let row = |j: i32| {
            (0..30).map(move |i| Point::new(f64::from(i) + 0.5 * f64::from(j % 2), 0.75_f64.sqrt() * f64::from(j), 2.0))
        };
        let points: Vec<Point> = (0..30).flat_map(row).collect();
        assert!((median_spacing(&points) - 1.0).abs() < 1e-9);
    }
}
