use super::ransac::scatter;
use super::{KdTree, Point, Vector};
use nalgebra::SymmetricEigen;
use rayon::prelude::*;

/// Unit normals from the principal axes of each point's `neighbours` nearest, turned towards the viewpoint.
///
/// A point whose neighbours lie on one line, and any point of a set smaller than three, gets the direction to the
/// viewpoint. Points must be finite.
///
/// # References
/// Hoppe et al., *Surface reconstruction from unorganized points*, SIGGRAPH 1992, §3.1; the orientation is ours: what a
/// sensor saw faces the sensor.
pub fn estimate_normals(points: &[Point], neighbours: usize, viewpoint: &Point) -> Vec<Vector> {
    let tree = KdTree::new(points);
    points
        .par_iter()
        .map(|p| {
            let near = tree.nearest_n(p, neighbours.max(3));
            let to_viewpoint = (viewpoint - p).try_normalize(1e-12).unwrap_or_else(Vector::z);
            principal_normal(near.iter().map(|(i, _)| points[*i]))
                .map_or(to_viewpoint, |n| if n.dot(&to_viewpoint) < 0.0 { -n } else { n })
        })
        .collect()
}

fn principal_normal(points: impl Iterator<Item = Point> + Clone) -> Option<Vector> {
    let eigen = SymmetricEigen::new(scatter(points)?.1);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    let planar = eigen.eigenvalues[order[1]] > 1e-9 * eigen.eigenvalues[order[2]];
    planar.then(|| eigen.eigenvectors.column(order[0]).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sphere_normals_point_outwards_towards_the_viewer() {
        // The half of a Fibonacci sphere that faces a viewer on +z.
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        let points: Vec<Point> = (0..2000)
            .map(|i| {
                let z = 1.0 - f64::from(i) / 2000.0;
                let (s, c) = (golden * f64::from(i)).sin_cos();
                Point::new(c * (1.0 - z * z).sqrt(), s * (1.0 - z * z).sqrt(), z) * 0.04
            })
            .collect();
        let normals = estimate_normals(&points, 12, &Point::new(0.0, 0.0, 5.0));
        for (p, n) in points.iter().zip(&normals).filter(|(p, _)| p.z > 0.006) {
            let angle = n.dot(&(p.coords / 0.04)).min(1.0).acos();
            assert!(angle < 0.06, "normal off by {angle} rad at {p}");
        }
    }

    #[test]
    fn a_line_and_a_single_point_look_at_the_viewer() {
        let line: Vec<Point> = (0..20).map(|i| Point::new(f64::from(i), 0.0, 0.0)).collect();
        for n in estimate_normals(&line, 5, &Point::new(0.0, 0.0, 1e9)) {
            assert!((n - Vector::z()).norm() < 1e-6);
        }
        assert_eq!(estimate_normals(&[Point::origin()], 5, &Point::new(2.0, 0.0, 0.0)), [Vector::x()]);
    }
}
