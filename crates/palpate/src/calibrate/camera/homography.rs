use nalgebra::{Matrix3, SMatrix, SymmetricEigen};

/// The homography that takes `from` to `to` with the least algebraic error, both centred and scaled first.
///
/// # References
/// Hartley & Zisserman, *Multiple View Geometry*, 2nd ed., algorithm 4.2.
pub(super) fn homography(from: &[[f64; 2]], to: &[[f64; 2]]) -> Option<Matrix3<f64>> {
    let ((a, from), (b, to)) = (normalised(from)?, normalised(to)?);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (p, q) in from.iter().zip(&to) {
        let rows = [
            [p[0], p[1], 1.0, 0.0, 0.0, 0.0, -q[0] * p[0], -q[0] * p[1], -q[0]],
            [0.0, 0.0, 0.0, p[0], p[1], 1.0, -q[1] * p[0], -q[1] * p[1], -q[1]],
        ];
        for row in rows {
            let row = nalgebra::SVector::<f64, 9>::from(row);
            normal += row * row.transpose();
        }
    }
    let eigen = SymmetricEigen::try_new(normal, 1e-14, 1000)?;
    let least = eigen.eigenvalues.imin();
    let h = Matrix3::from_row_slice(eigen.eigenvectors.column(least).as_slice());
    let h = b.try_inverse()? * h * a;
    (h.iter().all(|v| v.is_finite()) && h[(2, 2)].abs() > 1e-15).then(|| h / h[(2, 2)])
}

/// Centred and with a mean distance of √2, and the transform that did it.
fn normalised(points: &[[f64; 2]]) -> Option<(Matrix3<f64>, Vec<[f64; 2]>)> {
    let n = points.len() as f64;
    let mean = points.iter().fold([0.0; 2], |m, p| [m[0] + p[0] / n, m[1] + p[1] / n]);
    let size = points.iter().map(|p| (p[0] - mean[0]).hypot(p[1] - mean[1])).sum::<f64>() / n;
    // Written so that NaN fails too.
    if points.len() < 4 || !(size > 1e-12) {
        return None;
    }
    let s = std::f64::consts::SQRT_2 / size;
    let t = Matrix3::new(s, 0.0, -s * mean[0], 0.0, s, -s * mean[1], 0.0, 0.0, 1.0);
    Some((t, points.iter().map(|p| [s * (p[0] - mean[0]), s * (p[1] - mean[1])]).collect()))
}
