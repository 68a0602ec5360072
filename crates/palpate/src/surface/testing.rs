//! What the tests of surfaces share.

use crate::geometry::Vector;

/// Unit vectors spread evenly over the sphere: Fibonacci's spiral.
pub(super) fn directions(count: usize) -> Vec<Vector> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let direction = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        Vector::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + Vector::z() * z
    };
    (0..count).map(direction).collect()
}
