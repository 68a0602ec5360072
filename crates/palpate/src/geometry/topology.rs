use super::half_edges::{HalfEdge, sorted_half_edges};
use super::{TriangleMesh, UnionFind};
use serde::Serialize;

/// How the faces of a mesh hang together. Combinatorial: only [`Topology::degenerate_faces`] looks at positions.
///
/// Faces that name a vertex twice take no part in anything but that count. A *fan* is a maximal set of faces round a
/// vertex joined by edges; a vertex with several fans is where pieces touch in a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Topology {
    /// Faces.
    pub faces: usize,
    /// Vertices, used or not.
    pub vertices: usize,
    /// Vertices of no face.
    pub unused_vertices: usize,
    /// Undirected edges.
    pub edges: usize,
    /// Edges of exactly one face.
    pub boundary_edges: usize,
    /// Holes: closed chains of boundary edges, once pieces that touch in a point are taken apart.
    pub boundary_loops: usize,
    /// Edges of three faces or more.
    pub non_manifold_edges: usize,
    /// Vertices with several fans, or on an edge of three faces or more.
    pub non_manifold_vertices: usize,
    /// Edges that two faces run through in the same direction.
    pub inconsistent_edges: usize,
    /// Faces that name a vertex twice or have no area (height below 1e-12 of the longest edge).
    pub degenerate_faces: usize,
    /// Pieces, joined by edges.
    pub components: usize,
    /// Fans − edges + faces: the Euler characteristic once touching pieces are taken apart.
    pub euler_characteristic: i64,
}

impl Topology {
    /// Reads the connectivity of a mesh, O(n log n).
    pub fn of(mesh: &TriangleMesh) -> Self {
        let proper = |f: &[u32; 3]| f[0] != f[1] && f[1] != f[2] && f[2] != f[0];
        let faces: Vec<[u32; 3]> = mesh.faces.iter().copied().filter(proper).collect();
        let half_edges = sorted_half_edges(&faces);
        let groups: Vec<&[HalfEdge]> = half_edges.chunk_by(|a, b| a.edge() == b.edge()).collect();

        // Corner 3 f + k is vertex k of face f; corners of one fan are united across the edges at their vertex.
        let mut fans = UnionFind::new(3 * faces.len());
        let mut pieces = UnionFind::new(faces.len());
        let mut bad_vertex = vec![false; mesh.vertices.len()];
        let (mut boundary, mut non_manifold, mut inconsistent) = (Vec::new(), 0, 0);
        for group in &groups {
            let first = &group[0];
            for h in &group[1..] {
                pieces.union(first.face(), h.face());
                fans.union(first.corner_at(first.low), h.corner_at(first.low));
                fans.union(first.corner_at(first.high), h.corner_at(first.high));
            }
            match group {
                [h] => boundary.push(*h),
                [a, b] => inconsistent += usize::from(a.forward == b.forward),
                _ => {
                    non_manifold += 1;
                    bad_vertex[first.low as usize] = true;
                    bad_vertex[first.high as usize] = true;
                }
            }
        }
        let mut loops = UnionFind::new(3 * faces.len());
        for h in &boundary {
            loops.union(fans.find(h.corner_at(h.low)), fans.find(h.corner_at(h.high)));
        }
        let mut loop_roots: Vec<u32> = boundary.iter().map(|h| loops.find(fans.find(h.corner_at(h.low)))).collect();
        loop_roots.sort_unstable();
        loop_roots.dedup();

        let mut fans_of_vertex = vec![0_usize; mesh.vertices.len()];
        for corner in 0..3 * faces.len() as u32 {
            if fans.find(corner) == corner {
                fans_of_vertex[faces[corner as usize / 3][corner as usize % 3] as usize] += 1;
            }
        }
        let fan_count: usize = fans_of_vertex.iter().sum();
        Self {
            faces: mesh.faces.len(),
            vertices: mesh.vertices.len(),
            unused_vertices: fans_of_vertex.iter().filter(|&&n| n == 0).count(),
            edges: groups.len(),
            boundary_edges: boundary.len(),
            boundary_loops: loop_roots.len(),
            non_manifold_edges: non_manifold,
            non_manifold_vertices: fans_of_vertex.iter().zip(&bad_vertex).filter(|&(&n, &bad)| n > 1 || bad).count(),
            inconsistent_edges: inconsistent,
            degenerate_faces: (0..mesh.faces.len()).filter(|&f| is_degenerate(mesh, f)).count(),
            components: (0..faces.len() as u32).filter(|&f| pieces.find(f) == f).count(),
            euler_characteristic: fan_count as i64 - groups.len() as i64 + faces.len() as i64,
        }
    }

    /// Whether every edge has at least two faces and there is a face at all.
    pub fn is_closed(&self) -> bool {
        self.edges > 0 && self.boundary_edges == 0
    }

    /// Whether no edge has three faces or more.
    pub fn is_edge_manifold(&self) -> bool {
        self.non_manifold_edges == 0
    }

    /// Whether the faces round every vertex form one fan.
    pub fn is_vertex_manifold(&self) -> bool {
        self.non_manifold_vertices == 0
    }

    /// Whether neighbouring faces agree on which side is out.
    pub fn is_consistently_oriented(&self) -> bool {
        self.is_edge_manifold() && self.inconsistent_edges == 0
    }

    /// Whether the mesh bounds a volume: closed, edge-manifold and consistently oriented.
    pub fn is_watertight(&self) -> bool {
        self.is_closed() && self.is_consistently_oriented()
    }

    /// Handles, summed over the pieces; `None` where a surface of that kind has no genus (not oriented, edges of three faces).
    pub fn genus(&self) -> Option<usize> {
        let twice = 2 * self.components as i64 - self.boundary_loops as i64 - self.euler_characteristic;
        (self.is_consistently_oriented() && twice >= 0 && twice % 2 == 0).then_some((twice / 2) as usize)
    }
}

fn is_degenerate(mesh: &TriangleMesh, face: usize) -> bool {
    let [a, b, c] = mesh.triangle(face);
    let longest = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
    // Twice the area is base times height: relative to the longest edge, so that the unit of length does not matter.
    mesh.area_vector(face).norm() <= 1e-12 * longest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    fn mesh(vertices: usize, faces: &[[u32; 3]]) -> TriangleMesh {
        let position = |i: usize| Point::new(i as f64, (i * i) as f64, (i * i * i % 17) as f64);
        TriangleMesh::new((0..vertices).map(position).collect(), faces.to_vec()).expect("indices are in range")
    }

    /// An n × m torus grid.
    fn torus(n: u32, m: u32) -> Vec<[u32; 3]> {
        let at = |i: u32, j: u32| (i % n) * m + j % m;
        (0..n * m)
            .flat_map(|k| {
                let (i, j) = (k / m, k % m);
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect()
    }

    #[test]
    fn tetrahedron_is_a_sphere() {
        let t = Topology::of(&mesh(5, &TETRAHEDRON));
        assert!(t.is_watertight() && t.is_vertex_manifold());
        assert_eq!((t.edges, t.components, t.euler_characteristic, t.genus()), (6, 1, 2, Some(0)));
        assert_eq!((t.boundary_edges, t.boundary_loops, t.unused_vertices), (0, 0, 1));
    }

    #[test]
    fn torus_has_one_handle() {
        let t = Topology::of(&mesh(20, &torus(4, 5)));
        assert!(t.is_watertight() && t.is_vertex_manifold());
        assert_eq!((t.euler_characteristic, t.genus()), (0, Some(1)));
    }

    #[test]
    fn every_missing_face_is_a_hole() {
        let faces: Vec<_> =
            torus(6, 6).into_iter().enumerate().filter(|(i, _)| *i != 0 && *i != 40).map(|f| f.1).collect();
        let t = Topology::of(&mesh(36, &faces));
        assert!(!t.is_closed() && t.is_consistently_oriented());
        assert_eq!((t.boundary_edges, t.boundary_loops, t.genus()), (6, 2, Some(1)));
    }

    #[test]
    fn a_flipped_face_is_inconsistent() {
        let mut faces = TETRAHEDRON;
        faces[2].swap(0, 1);
        let t = Topology::of(&mesh(4, &faces));
        assert_eq!((t.inconsistent_edges, t.is_closed(), t.genus()), (3, true, None));
    }

    #[test]
    fn three_faces_on_an_edge() {
        let t = Topology::of(&mesh(5, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]));
        assert_eq!((t.non_manifold_edges, t.non_manifold_vertices), (1, 2));
        assert_eq!(t.components, 1);
    }

    #[test]
    fn two_tetrahedra_touching_in_a_point() {
        let mut faces = TETRAHEDRON.to_vec();
        faces.extend(TETRAHEDRON.map(|f| f.map(|i| if i == 0 { 0 } else { i + 3 })));
        let t = Topology::of(&mesh(7, &faces));
        assert!(t.is_watertight() && !t.is_vertex_manifold());
        assert_eq!((t.non_manifold_vertices, t.components, t.euler_characteristic, t.genus()), (1, 2, 4, Some(0)));
    }

    #[test]
    fn a_hole_touching_the_border_in_a_point_opens_into_it() {
        let at = |i: u32, j: u32| i * 4 + j;
        let mut faces = Vec::new();
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            if (i, j) != (0, 0) && (i, j) != (1, 1) {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                faces.extend([[a, b, c], [a, c, d]]);
            }
        }
        let t = Topology::of(&mesh(16, &faces));
        assert_eq!((t.boundary_loops, t.non_manifold_vertices, t.genus()), (1, 1, Some(0)));
    }

    #[test]
    fn degenerate_faces_are_counted_and_empty_is_not_closed() {
        let mut flat = mesh(4, &[[0, 1, 1], [0, 1, 2], [1, 2, 3]]);
        flat.vertices[2] = nalgebra::center(&flat.vertices[0], &flat.vertices[1]);
        assert_eq!(Topology::of(&flat).degenerate_faces, 2);
        assert!(!Topology::of(&TriangleMesh::default()).is_closed());
    }
}
