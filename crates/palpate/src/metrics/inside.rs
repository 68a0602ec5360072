use crate::geometry::TriangleMesh;
use std::collections::HashMap;

/// The rule by which a line's crossings decide what is inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum InsideRule {
    /// Each directed edge has its opposite: the winding number is defined, inside is where it is not zero.
    Winding,
    /// Each edge has an even number of faces, not all consistently oriented: inside after an odd number of crossings.
    Parity,
    /// There are boundary edges: no inside.
    Open,
}

impl InsideRule {
    /// The rule of a mesh, and whether every edge has exactly two faces: corners joined by index or, failing that, by position
    /// (joining by position alone would pinch objects whose seams touch themselves).
    pub(super) fn of(mesh: &TriangleMesh) -> (Self, bool) {
        let by_index = EdgeCounts::of(&mesh.faces);
        if by_index.balanced && by_index.two {
            return (Self::Winding, true);
        }
        let by_position = EdgeCounts::of(&welded(mesh));
        let rule = if by_index.balanced || by_position.balanced {
            Self::Winding
        } else if by_index.even || by_position.even {
            Self::Parity
        } else {
            Self::Open
        };
        (rule, by_index.two || by_position.two)
    }
}

struct EdgeCounts {
    /// Every edge has exactly two faces.
    two: bool,
    /// Every edge has an even number of faces.
    even: bool,
    /// Every edge is run through as often one way as the other.
    balanced: bool,
}

impl EdgeCounts {
    fn of(faces: &[[u32; 3]]) -> Self {
        // (smaller, larger, forwards): sorting brings the faces of an edge together.
        let mut edges: Vec<(u32, u32, bool)> = Vec::with_capacity(3 * faces.len());
        for &[a, b, c] in faces.iter().filter(|[a, b, c]| a != b && b != c && c != a) {
            edges.extend([(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q), p < q)));
        }
        edges.sort_unstable();
        let mut counts = Self { two: !edges.is_empty(), even: !edges.is_empty(), balanced: !edges.is_empty() };
        for edge in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let forwards = edge.iter().filter(|e| e.2).count();
            counts.two &= edge.len() == 2;
            counts.even &= edge.len() % 2 == 0;
            counts.balanced &= 2 * forwards == edge.len();
        }
        counts
    }
}

/// The faces with corners of equal position made equal.
fn welded(mesh: &TriangleMesh) -> Vec<[u32; 3]> {
    let mut first: HashMap<[u64; 3], u32> = HashMap::with_capacity(mesh.vertices.len());
    let same: Vec<u32> = (0u32..)
        .zip(&mesh.vertices)
        // Adding zero turns −0 into 0: they are the same place.
        .map(|(i, p)| *first.entry([p.x, p.y, p.z].map(|c| (c + 0.0).to_bits())).or_insert(i))
        .collect();
    mesh.faces.iter().map(|f| f.map(|i| same[i as usize])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    fn tetrahedron(faces: Vec<[u32; 3]>) -> TriangleMesh {
        let vertices = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [0., 0., 0.]];
        TriangleMesh::new(vertices.map(Point::from).to_vec(), faces).expect("indices are valid")
    }

    #[test]
    fn closed_tetrahedron() {
        let mesh = tetrahedron(vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
        assert_eq!(InsideRule::of(&mesh), (InsideRule::Winding, true));
    }

    #[test]
    fn seam_of_coincident_vertices_is_closed() {
        let mesh = tetrahedron(vec![[4, 2, 1], [0, 1, 3], [1, 2, 3], [2, 4, 3]]);
        assert_eq!(InsideRule::of(&mesh), (InsideRule::Winding, true));
    }

    #[test]
    fn missing_face_is_open_and_a_flipped_one_leaves_parity() {
        let open = tetrahedron(vec![[0, 2, 1], [0, 1, 3], [1, 2, 3]]);
        assert_eq!(InsideRule::of(&open), (InsideRule::Open, false));
        let flipped = tetrahedron(vec![[0, 1, 2], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
        assert_eq!(InsideRule::of(&flipped), (InsideRule::Parity, true));
    }

    #[test]
    fn faces_that_repeat_a_corner_change_nothing() {
        let mesh = tetrahedron(vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 1, 2]]);
        assert_eq!(InsideRule::of(&mesh), (InsideRule::Winding, true));
    }
}
