use super::ransac::scatter;
use super::{KdTree, Point, Vector};
use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;
use std::f64::consts::TAU;

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
            principal_normal(near.iter().map(|&(i, _)| points[i]))
                .map_or(to_viewpoint, |n| if n.dot(&to_viewpoint) < 0.0 { -n } else { n })
        })
        .collect()
}

fn principal_normal(points: impl Iterator<Item = Point> + Clone) -> Option<Vector> {
    let scatter = scatter(points)?.1;
    if let Some(normal) = clear_normal(&scatter) {
        return Some(normal);
    }
    let eigen = SymmetricEigen::new(scatter);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    let planar = eigen.eigenvalues[order[1]] > 1e-9 * eigen.eigenvalues[order[2]];
    planar.then(|| eigen.eigenvectors.column(order[0]).into_owned())
}

/// Axis of the smallest eigenvalue in closed form, where it is well apart from the middle one: as good as by iteration there, and several times faster.
///
/// Smith, *Eigenvalues of a symmetric 3 × 3 matrix*, Comm. ACM 4(4), 1961.
fn clear_normal(m: &Matrix3<f64>) -> Option<Vector> {
    const APART: f64 = 1e-4;
    let mean = m.trace() / 3.0;
    let centred = m - Matrix3::from_diagonal_element(mean);
    let spread = (centred.norm_squared() / 6.0).sqrt();
    let angle = (centred.determinant() / (2.0 * spread.powi(3))).clamp(-1.0, 1.0).acos() / 3.0;
    let largest = mean + 2.0 * spread * angle.cos();
    let smallest = mean + 2.0 * spread * (angle + TAU / 3.0).cos();
    let middle = 3.0 * mean - largest - smallest;
    // NaN where there is no spread.
    if !(middle - smallest > APART * largest) {
        return None;
    }
    let shifted = m - Matrix3::from_diagonal_element(smallest);
    let [a, b, c] = [0, 1, 2].map(|k| shifted.column(k).into_owned());
    // The columns span the plane across the axis.
    let crossed = [a.cross(&b), b.cross(&c), c.cross(&a)];
    crossed.into_iter().max_by(|p, q| p.norm_squared().total_cmp(&q.norm_squared()))?.try_normalize(0.0)
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
    fn the_closed_form_is_the_iteration_s_axis() {
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5
        };
        let mut clear = 0;
        for k in 0..2000 {
            let thin = 10.0_f64.powi(-(k % 7));
            let turn = nalgebra::Rotation3::new(Vector::new(uniform(), uniform(), uniform()) * 9.0);
            let points: Vec<Point> =
                (0..20).map(|_| turn * Point::new(uniform(), 0.3 * uniform(), thin * uniform())).collect();
            let matrix = scatter(points.iter().copied()).expect("points").1;
            let eigen = SymmetricEigen::new(matrix);
            if let Some(n) = clear_normal(&matrix) {
                let expected = eigen.eigenvectors.column(eigen.eigenvalues.imin());
                assert!(n.cross(&expected).norm() < 1e-9, "{n} {expected}");
                clear += 1;
            }
        }
        assert!(clear > 1900);
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
