use super::{Point, TriangleMesh, Vector};
use parry3d_f64::math::Vector as Glam;
use parry3d_f64::query::{PointQueryWithLocation, Ray};
use parry3d_f64::shape::{CompositeShapeRef, TriMesh};

/// Ray casting and closest-point queries on a triangle mesh. The only file that names the collision crate.
pub struct Bvh {
    mesh: Option<TriMesh>,
}

/// Where a ray first meets a mesh.
#[derive(Debug, Clone, Copy)]
pub struct RayHit {
    /// Distance along the ray in units of the direction's length.
    pub distance: f64,
    /// The face that was hit.
    pub face: usize,
}

/// The point of a mesh nearest to a query.
#[derive(Debug, Clone, Copy)]
pub struct SurfacePoint {
    /// The nearest point.
    pub point: Point,
    /// Its distance from the query, metres.
    pub distance: f64,
    /// The face it lies on.
    pub face: usize,
}

fn to_glam(p: &Vector) -> Glam {
    Glam::new(p.x, p.y, p.z)
}

impl Bvh {
    /// Builds the hierarchy, O(n log n); an empty mesh is allowed and is never hit.
    pub fn new(mesh: &TriangleMesh) -> Self {
        let vertices = mesh.vertices.iter().map(|p| to_glam(&p.coords)).collect();
        Self { mesh: TriMesh::new(vertices, mesh.faces.clone()).ok() }
    }

    /// First hit of the ray `origin + t · direction`, 0 ≤ t ≤ `max_distance`.
    pub fn cast_ray(&self, origin: &Point, direction: &Vector, max_distance: f64) -> Option<RayHit> {
        let ray = Ray::new(to_glam(&origin.coords), to_glam(direction));
        let (face, distance) = CompositeShapeRef(self.mesh.as_ref()?).cast_local_ray(&ray, max_distance, false)?;
        Some(RayHit { distance, face: face as usize })
    }

    /// The surface point nearest to `p`; `None` only for an empty mesh.
    pub fn closest_point(&self, p: &Point) -> Option<SurfacePoint> {
        let (projection, (face, _)) =
            self.mesh.as_ref()?.project_local_point_and_get_location(to_glam(&p.coords), false);
        let q = projection.point;
        let point = Point::new(q.x, q.y, q.z);
        Some(SurfacePoint { point, distance: (point - p).norm(), face: face as usize })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_names_the_face_it_hits_first_from_either_side() {
        // Two parallel squares of two triangles each, one metre apart.
        let p = |x: f64, y: f64, z: f64| Point::new(x, y, z);
        let square = |z| [p(0.0, 0.0, z), p(1.0, 0.0, z), p(1.0, 1.0, z), p(0.0, 1.0, z)];
        let vertices = [square(0.0), square(1.0)].concat();
        let faces = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let bvh = Bvh::new(&TriangleMesh::new(vertices, faces).expect("indices"));
        let cast = |x: f64, y: f64, z: f64, dz: f64| bvh.cast_ray(&p(x, y, z), &Vector::new(0.0, 0.0, dz), 10.0);
        for (x, y, face) in [(0.7, 0.2, 0), (0.2, 0.7, 1)] {
            let up = cast(x, y, -1.0, 2.0).expect("hit");
            assert_eq!((up.face, up.distance), (face, 0.5));
            let down = cast(x, y, 3.0, -1.0).expect("hit");
            assert_eq!((down.face, down.distance), (face + 2, 2.0));
        }
        assert!(cast(1.5, 0.5, -1.0, 1.0).is_none());
        assert!(cast(0.5, 0.2, -11.0, 1.0).is_none());
    }
}
