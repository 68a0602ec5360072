use super::{Point, TriangleMesh, Vector};
use parry3d_f64::math::Vector as Glam;
use parry3d_f64::query::{PointQueryWithLocation, Ray, RayCast};
use parry3d_f64::shape::{FeatureId, TriMesh};

/// Ray casting and closest-point queries on a triangle mesh. The only file that names the collision crate.
pub struct Bvh {
    mesh: Option<TriMesh>,
    faces: usize,
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
        Self { mesh: TriMesh::new(vertices, mesh.faces.clone()).ok(), faces: mesh.faces.len() }
    }

    /// First hit of the ray `origin + t · direction`, 0 ≤ t ≤ `max_distance`.
    pub fn cast_ray(&self, origin: &Point, direction: &Vector, max_distance: f64) -> Option<RayHit> {
        let ray = Ray::new(to_glam(&origin.coords), to_glam(direction));
        let hit = self.mesh.as_ref()?.cast_local_ray_and_get_normal(&ray, max_distance, false)?;
        let face = match hit.feature {
            FeatureId::Face(f) => f as usize,
            _ => return None,
        };
        // Back faces are numbered after the front ones.
        Some(RayHit { distance: hit.time_of_impact, face: face % self.faces })
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
