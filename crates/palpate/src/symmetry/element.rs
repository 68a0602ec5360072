use crate::geometry::{Plane, Point, Vector};
use nalgebra::{Matrix3, Rotation3, Unit};

/// What may map an object onto itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SymmetryElement {
    /// Mirror symmetry.
    Reflection(Plane),
    /// Rotation about an axis.
    Axis {
        /// A point of the axis, metres.
        point: Point,
        /// Its direction; the sign has no meaning.
        direction: Unit<Vector>,
        /// Number of rotations that map the object onto itself; `None` = all of them, a body of revolution.
        order: Option<u32>,
    },
    /// Every rotation about a point.
    Sphere {
        /// The point, metres.
        center: Point,
    },
}

impl SymmetryElement {
    /// "reflection", "axis" or "sphere".
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Reflection(_) => "reflection",
            Self::Axis { .. } => "axis",
            Self::Sphere { .. } => "sphere",
        }
    }

    /// The motions of this element but for the identity: one reflection; the n − 1 rotations of an axis of order n, or `steps` − 1
    /// evenly spaced ones of a continuous axis; for a sphere the rotations about three perpendicular axes, `steps` − 1 each.
    pub fn motions(&self, steps: u32) -> Vec<Motion> {
        let turns = |point: &Point, direction: &Unit<Vector>, n: u32| {
            (1..n)
                .map(|k| Motion::rotation(point, direction, std::f64::consts::TAU * f64::from(k) / f64::from(n)))
                .collect()
        };
        match self {
            Self::Reflection(plane) => vec![Motion::reflection(plane)],
            Self::Axis { point, direction, order } => turns(point, direction, order.unwrap_or(steps)),
            Self::Sphere { center } => {
                let axes = [Vector::z_axis(), Vector::x_axis(), Vector::y_axis()];
                axes.iter().flat_map(|a| -> Vec<Motion> { turns(center, a, steps) }).collect()
            }
        }
    }
}

/// A distance-preserving map x ↦ linear · x + translation, proper (rotation) or not (reflection).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Orthogonal matrix.
    pub linear: Matrix3<f64>,
    /// Metres.
    pub translation: Vector,
}

impl Motion {
    /// Nothing moves.
    pub fn identity() -> Self {
        Self { linear: Matrix3::identity(), translation: Vector::zeros() }
    }

    /// The reflection at a plane.
    pub fn reflection(plane: &Plane) -> Self {
        let n = plane.normal.into_inner();
        Self { linear: Matrix3::identity() - n * n.transpose() * 2.0, translation: n * (2.0 * plane.offset) }
    }

    /// The rotation about an axis, radians, right-handed.
    pub fn rotation(point: &Point, direction: &Unit<Vector>, angle: f64) -> Self {
        let linear = Rotation3::from_axis_angle(direction, angle).into_inner();
        Self { linear, translation: point.coords - linear * point.coords }
    }

    /// Where a point goes.
    #[inline]
    pub fn point(&self, p: &Point) -> Point {
        Point::from(self.linear * p.coords + self.translation)
    }

    /// Where a direction or normal goes.
    #[inline]
    pub fn vector(&self, v: &Vector) -> Vector {
        self.linear * v
    }

    /// First this motion, then `next`.
    pub fn then(&self, next: &Self) -> Self {
        Self { linear: next.linear * self.linear, translation: next.linear * self.translation + next.translation }
    }

    /// The motion that undoes this one.
    pub fn inverse(&self) -> Self {
        let linear = self.linear.transpose();
        Self { linear, translation: -(linear * self.translation) }
    }

    /// Whether it turns right hands into left ones, and so the winding of triangles.
    pub fn is_improper(&self) -> bool {
        self.linear.determinant() < 0.0
    }
}

/// Two unit vectors that complete `n` to a right-handed basis (u, v, n); a fixed choice, so that covariances have a meaning.
pub(crate) fn tangents(n: &Vector) -> (Vector, Vector) {
    let smallest = n.iamin();
    let u = n.cross(&Vector::ith(smallest, 1.0)).normalize();
    (u, n.cross(&u))
}

/// `n` turned by the small angles `a` about u and `b` about v.
pub(crate) fn tilted(n: &Unit<Vector>, a: f64, b: f64) -> Unit<Vector> {
    let (u, v) = tangents(n);
    Unit::new_normalize(n.into_inner() + u * b - v * a)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_do_what_they_say() {
        let plane = Plane::new(Vector::new(1.0, 2.0, 2.0), &Point::new(0.1, 0.0, 0.0)).expect("it has a direction");
        let mirror = Motion::reflection(&plane);
        let p = Point::new(0.3, -0.2, 0.5);
        assert!((mirror.point(&p) - plane.reflect_point(&p)).norm() < 1e-15);
        assert!((mirror.then(&mirror).point(&p) - p).norm() < 1e-15, "mirror twice = identity");
        assert!(mirror.is_improper());
        let quarter = Motion::rotation(&Point::new(1.0, 0.0, 0.0), &Vector::z_axis(), std::f64::consts::FRAC_PI_2);
        assert!((quarter.point(&Point::new(2.0, 0.0, 3.0)) - Point::new(1.0, 1.0, 3.0)).norm() < 1e-15);
        assert!((quarter.then(&quarter.inverse()).point(&p) - p).norm() < 1e-15);
        assert!(!quarter.is_improper());
    }

    #[test]
    fn an_element_of_order_four_has_three_rotations() {
        let order = |order| SymmetryElement::Axis { point: Point::origin(), direction: Vector::z_axis(), order };
        assert_eq!(order(Some(4)).motions(99).len(), 3);
        assert_eq!(order(None).motions(12).len(), 11);
        let tilt = tilted(&Vector::z_axis(), 0.01, -0.02);
        let (u, v) = tangents(&Vector::z());
        assert!((u.cross(&v) - Vector::z()).norm() < 1e-15);
        let turned = Rotation3::new(u * 0.01 - v * 0.02) * Vector::z();
        assert!((tilt.into_inner() - turned).norm() < 1e-5, "a turn about u by a and v by b");
    }
}
