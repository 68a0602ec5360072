use super::{Isometry, Point, Vector};
use nalgebra::Unit;

/// The plane `normal · x = offset`, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Unit normal; for a support plane it points up, towards the object.
    pub normal: Unit<Vector>,
    /// Signed distance of the plane from the origin along the normal, metres.
    pub offset: f64,
}

impl Plane {
    /// The plane through a point; `None` if the normal has no direction or anything is not finite.
    pub fn new(normal: Vector, point: &Point) -> Option<Self> {
        let normal = Unit::try_new(normal, 1e-12).filter(|n| n.iter().all(|c| c.is_finite()))?;
        let offset = normal.dot(&point.coords);
        offset.is_finite().then_some(Self { normal, offset })
    }

    /// Signed distance of a point, positive on the side the normal points to.
    #[inline]
    pub fn signed_distance(&self, p: &Point) -> f64 {
        self.normal.dot(&p.coords) - self.offset
    }

    /// The mirror image of a point.
    #[inline]
    pub fn reflect_point(&self, p: &Point) -> Point {
        p - self.normal.into_inner() * (2.0 * self.signed_distance(p))
    }

    /// The mirror image of a direction.
    #[inline]
    pub fn reflect_vector(&self, v: &Vector) -> Vector {
        v - self.normal.into_inner() * (2.0 * self.normal.dot(v))
    }

    /// The same plane seen from frame `a`, given `a_from_b` and the plane in `b`.
    pub fn transformed(&self, a_from_b: &Isometry) -> Self {
        let normal = Unit::new_normalize(a_from_b * self.normal.into_inner());
        let point = a_from_b * Point::from(self.normal.into_inner() * self.offset);
        Self { normal, offset: normal.dot(&point.coords) }
    }

    /// The same plane with its normal turned round.
    pub fn flipped(&self) -> Self {
        Self { normal: -self.normal, offset: -self.offset }
    }
}
