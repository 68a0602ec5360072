use crate::geometry::{Isometry, Point, Vector};
use nalgebra::{Matrix6, Vector6};

/// Change of a point's height along `normal` (world) with rotation and translation of the sensor in its own frame.
///
/// Order: rotation (radians), translation (metres).
pub fn pose_row(world_from_sensor: &Isometry, point: &Point, normal: &Vector) -> Vector6<f64> {
    let local = world_from_sensor.inverse_transform_point(point).coords;
    let n = world_from_sensor.inverse_transform_vector(normal);
    let turn = local.cross(&n);
    Vector6::new(turn.x, turn.y, turn.z, n.x, n.y, n.z)
}

/// σ along `normal` of a point of a touch by the covariance of the touch's pose (as in [`pose_row`]), metres.
pub fn pose_sigma_at(world_from_sensor: &Isometry, covariance: &Matrix6<f64>, point: &Point, normal: &Vector) -> f64 {
    let row = pose_row(world_from_sensor, point, normal);
    (covariance * row).dot(&row).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_row_is_the_derivative_of_the_height() {
        let pose = Isometry::new(Vector::new(0.1, -0.05, 0.2), Vector::new(0.4, -0.9, 0.3));
        let (p, n) = (Point::new(0.12, -0.03, 0.19), Vector::new(0.6, 0.0, 0.8));
        let row = pose_row(&pose, &p, &n);
        let local = pose.inverse_transform_point(&p);
        for k in 0..6 {
            let mut d = Vector6::zeros();
            d[k] = 1e-6;
            let (turn, shift) = (Vector::new(d[0], d[1], d[2]), Vector::new(d[3], d[4], d[5]));
            let moved = pose * Isometry::new(shift, turn) * local;
            assert!(((moved - p).dot(&n) / 1e-6 - row[k]).abs() < 1e-5, "parameter {k}");
        }
    }

    #[test]
    fn rotation_counts_with_the_distance_from_the_sensor() {
        let covariance = Matrix6::from_diagonal(&Vector6::new(1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6));
        let at = |x: f64| pose_sigma_at(&Isometry::identity(), &covariance, &Point::new(x, 0.0, 0.0), &-Vector::z());
        assert!((at(0.0) - 1e-3).abs() < 1e-12 && (at(0.02) - 1e-3_f64.hypot(2e-4)).abs() < 1e-9);
    }
}
