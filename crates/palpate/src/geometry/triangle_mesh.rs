use super::{Aabb, Isometry, Point, Vector};

/// A triangle mesh: shared vertices, faces counter-clockwise seen from outside.
///
/// Invariant (kept by [`TriangleMesh::new`]): every index is below the number of vertices.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriangleMesh {
    /// Positions, metres.
    pub vertices: Vec<Point>,
    /// Corner indices of each face.
    pub faces: Vec<[u32; 3]>,
    /// sRGB colour of each vertex.
    pub colors: Option<Vec<[u8; 3]>>,
}

impl TriangleMesh {
    /// Checks the indices; `None` if one points past the vertices.
    pub fn new(vertices: Vec<Point>, faces: Vec<[u32; 3]>) -> Option<Self> {
        let valid = faces.iter().flatten().all(|&i| (i as usize) < vertices.len());
        valid.then_some(Self { vertices, faces, colors: None })
    }

    /// Whether there is no face.
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// The corners of a face.
    #[inline]
    pub fn triangle(&self, face: usize) -> [Point; 3] {
        self.faces[face].map(|i| self.vertices[i as usize])
    }

    /// Twice the face's area vector: outward, length 2 · area.
    #[inline]
    pub fn area_vector(&self, face: usize) -> Vector {
        let [a, b, c] = self.triangle(face);
        (b - a).cross(&(c - a))
    }

    /// Outward unit normal of a face; zero for a degenerate one.
    #[inline]
    pub fn face_normal(&self, face: usize) -> Vector {
        self.area_vector(face).try_normalize(0.0).unwrap_or_else(Vector::zeros)
    }

    /// Area-weighted outward unit normals of the vertices.
    pub fn vertex_normals(&self) -> Vec<Vector> {
        let mut normals = vec![Vector::zeros(); self.vertices.len()];
        for face in 0..self.faces.len() {
            let n = self.area_vector(face);
            for &i in &self.faces[face] {
                normals[i as usize] += n;
            }
        }
        for n in &mut normals {
            *n = n.try_normalize(0.0).unwrap_or_else(Vector::zeros);
        }
        normals
    }

    /// Surface area, m².
    pub fn area(&self) -> f64 {
        (0..self.faces.len()).map(|f| 0.5 * self.area_vector(f).norm()).sum()
    }

    /// Signed enclosed volume, m³ (divergence theorem); meaningful for closed meshes only.
    pub fn volume(&self) -> f64 {
        let origin = self.vertices.first().copied().unwrap_or_else(Point::origin);
        (0..self.faces.len())
            .map(|f| {
                let [a, b, c] = self.triangle(f).map(|p| p - origin);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum()
    }

    /// The smallest box round the vertices.
    pub fn bounds(&self) -> Option<Aabb> {
        Aabb::of(&self.vertices)
    }

    /// The mesh in frame `a`, given `a_from_b` and the mesh in `b`.
    pub fn transformed(&self, a_from_b: &Isometry) -> Self {
        let mut mesh = self.clone();
        for v in &mut mesh.vertices {
            *v = a_from_b * *v;
        }
        mesh
    }
}
