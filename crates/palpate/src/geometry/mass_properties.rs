use super::{Point, TriangleMesh, Vector};
use nalgebra::Matrix3;

/// What a closed mesh weighs and how it turns, for a density of 1 kg/m³: multiply volume and inertia by the real one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MassProperties {
    /// Enclosed volume, m³; negative if the faces are turned inside out.
    pub volume: f64,
    /// Surface area, m².
    pub area: f64,
    /// Centre of mass; the mean of the vertices if there is no volume.
    pub centroid: Point,
    /// Inertia tensor about the centroid, kg m² at unit density, axes of the mesh's frame.
    pub inertia: Matrix3<f64>,
}

impl MassProperties {
    /// Sums signed tetrahedra from a point near the mesh to its faces (exact; meaningful for closed, oriented meshes).
    ///
    /// For a tetrahedron (0, a, b, c) with d = a·(b×c): ∫ 1 = d/6, ∫ x = d/24 s, ∫ x xᵀ = d/120 (a aᵀ + b bᵀ + c cᵀ + s sᵀ),
    /// s = a + b + c.
    pub fn of(mesh: &TriangleMesh) -> Self {
        let count = mesh.vertices.len().max(1) as f64;
        let origin = Point::from(mesh.vertices.iter().map(|p| p.coords).sum::<Vector>() / count);
        let (mut volume, mut first, mut second) = (0.0, Vector::zeros(), Matrix3::zeros());
        for face in 0..mesh.faces.len() {
            let [a, b, c] = mesh.triangle(face).map(|p| p - origin);
            let d = a.dot(&b.cross(&c));
            let s = a + b + c;
            volume += d / 6.0;
            first += s * (d / 24.0);
            second += (a * a.transpose() + b * b.transpose() + c * c.transpose() + s * s.transpose()) * (d / 120.0);
        }
        let offset = if volume == 0.0 { Vector::zeros() } else { first / volume };
        let covariance = second - offset * offset.transpose() * volume;
        let inertia = Matrix3::identity() * covariance.trace() - covariance;
        Self { volume, area: mesh.area(), centroid: origin + offset, inertia }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box with edges along the axes, min corner at `corner`.
    fn cuboid(corner: Point, size: Vector) -> TriangleMesh {
        let vertices = (0..8)
            .map(|i| corner + Vector::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64).component_mul(&size))
            .collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        TriangleMesh::new(vertices, faces).expect("indices are in range")
    }

    #[test]
    fn box_far_from_the_origin() {
        let size = Vector::new(0.1, 0.2, 0.3);
        let m = MassProperties::of(&cuboid(Point::new(3.0, -2.0, 5.0), size));
        let volume = 0.006;
        assert!((m.volume - volume).abs() < 1e-12);
        assert!((m.area - 0.22).abs() < 1e-12);
        assert!((m.centroid - Point::new(3.05, -1.9, 5.15)).norm() < 1e-12);
        let squares = size.component_mul(&size);
        for i in 0..3 {
            let expected = volume / 12.0 * (squares.sum() - squares[i]);
            assert!((m.inertia[(i, i)] - expected).abs() < 1e-15, "{} {expected}", m.inertia);
            assert!(m.inertia[(i, (i + 1) % 3)].abs() < 1e-15);
        }
    }

    #[test]
    fn inside_out_is_negative_and_no_faces_are_nothing() {
        let mut mesh = cuboid(Point::origin(), Vector::repeat(1.0));
        for f in &mut mesh.faces {
            f.swap(0, 1);
        }
        assert!((MassProperties::of(&mesh).volume + 1.0).abs() < 1e-12);
        let nothing = MassProperties::of(&TriangleMesh::default());
        assert_eq!((nothing.volume, nothing.area), (0.0, 0.0));
    }
}
