use super::{Point, Vector};
use nalgebra::{Matrix4, Vector4};

/// A sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Its centre, metres.
    pub center: Point,
    /// Its radius, metres.
    pub radius: f64,
}

impl Sphere {
    /// The sphere whose surface is nearest to the points: least squares of the distances, by Gauss–Newton from the algebraic fit.
    ///
    /// `None` for fewer than four points, or points in a plane.
    ///
    /// # References
    /// Coope, *Circle fitting by linear and nonlinear least squares*, JOTA 1993 (the algebraic start).
    pub fn fit(points: &[Point]) -> Option<Self> {
        const STEPS: usize = 30;
        if points.len() < 4 {
            return None;
        }
        // Centred and scaled to one, so that the normal equations keep their digits.
        let mean = points.iter().fold(Vector::zeros(), |sum, p| sum + p.coords) / points.len() as f64;
        let size = points.iter().map(|p| (p.coords - mean).norm()).fold(0.0, f64::max);
        let local: Vec<Vector> = points.iter().map(|p| (p.coords - mean) / size).collect();
        let mut sphere = algebraic(&local)?;
        for _ in 0..STEPS {
            let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
            for p in &local {
                let arm = sphere.xyz() - p;
                let distance = arm.norm().max(f64::MIN_POSITIVE);
                let row = (arm / distance).push(-1.0);
                normal += row * row.transpose();
                right -= row * (distance - sphere.w);
            }
            let step = normal.cholesky()?.solve(&right);
            sphere += step;
            if step.norm() < 1e-12 * sphere.w.abs() {
                break;
            }
        }
        let finite = sphere.iter().all(|v| v.is_finite()) && sphere.w > 0.0;
        finite.then(|| Self { center: Point::from(mean + size * sphere.xyz()), radius: size * sphere.w })
    }
}

/// |p|² = 2 c·p + (r² − |c|²), linear in c and the bracket.
fn algebraic(points: &[Vector]) -> Option<Vector4<f64>> {
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for p in points {
        let row = (2.0 * p).push(1.0);
        normal += row * row.transpose();
        right += row * p.norm_squared();
    }
    // Points in a plane leave one pivot to rounding.
    let factor = normal.cholesky().filter(|c| c.l().diagonal().min() > 1e-7 * c.l().diagonal().max())?;
    let x = factor.solve(&right);
    Some(x.xyz().push((x.w + x.xyz().norm_squared()).max(0.0).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cap(noise: f64) -> Vec<Point> {
        let hash = |i: usize| ((i * 2_654_435_761) % 1000) as f64 / 1000.0 - 0.5;
        let at = |i: usize| (1.2e-3 * hash(3 * i + 1), 1.2e-3 * hash(7 * i + 2));
        (0..2000)
            .map(|i| {
                let (x, y) = at(i);
                Point::new(5.0 + x, y - 2.0, (4e-6 - x * x - y * y).sqrt() + noise * hash(11 * i + 5))
            })
            .collect()
    }

    #[test]
    fn the_radius_of_a_cap_is_found_far_from_the_origin() {
        let sphere = Sphere::fit(&cap(0.0)).expect("curved");
        assert!((sphere.radius - 2e-3).abs() < 1e-9, "{sphere:?}");
        assert!((sphere.center - Point::new(5.0, -2.0, 0.0)).norm() < 1e-8, "{sphere:?}");
        let noisy = Sphere::fit(&cap(20e-6)).expect("curved");
        assert!((noisy.radius - 2e-3).abs() < 0.1e-3, "{noisy:?}");
    }

    #[test]
    fn a_plane_and_three_points_have_no_sphere() {
        let flat: Vec<Point> = cap(0.0).iter().map(|p| Point::new(p.x, p.y, 0.3)).collect();
        assert_eq!(Sphere::fit(&flat), None);
        assert_eq!(Sphere::fit(&cap(0.0)[..3]), None);
    }
}
