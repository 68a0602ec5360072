use super::{TriangleMesh, split_fans, without_unused_vertices};
use std::collections::{HashMap, HashSet};

/// What [`repaired`] removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Repair {
    /// Vertices merged into another at the same position.
    pub merged_vertices: usize,
    /// Faces that named a vertex twice once vertices were merged, or lay on a line.
    pub degenerate_faces: usize,
    /// Faces with the same three corners as an earlier one, whichever way round.
    pub duplicate_faces: usize,
    /// Vertices that no face used.
    pub unused_vertices: usize,
}

/// The mesh with vertices at exactly the same position merged, without degenerate and duplicate faces and without unused vertices; vertices at which
/// several sheets touch are doubled again.
///
/// Removing a face can open a mesh: [`Topology`](super::Topology) of the result says so, `surface::fill_holes` closes it. Faces that name a vertex
/// twice leave no hole, faces with three corners on a line (height below 1e-12 of the longest side) are dropped only if they are such.
pub fn repaired(mesh: &TriangleMesh) -> (TriangleMesh, Repair) {
    let mut repair = Repair::default();
    let mut first_at: HashMap<[u64; 3], u32> = HashMap::new();
    let mut merged = Vec::with_capacity(mesh.vertices.len());
    for (i, p) in mesh.vertices.iter().enumerate() {
        // Adding zero turns −0 into 0.
        let key = [p.x, p.y, p.z].map(|c| (c + 0.0).to_bits());
        let first = *first_at.entry(key).or_insert(i as u32);
        repair.merged_vertices += usize::from(first != i as u32);
        merged.push(first);
    }
    let mut seen: HashSet<[u32; 3]> = HashSet::new();
    let mut faces = Vec::with_capacity(mesh.faces.len());
    for face in &mesh.faces {
        let face = face.map(|v| merged[v as usize]);
        let [a, b, c] = face;
        if a == b || b == c || c == a || is_on_a_line(mesh, face) {
            repair.degenerate_faces += 1;
            continue;
        }
        let mut key = face;
        key.sort_unstable();
        if seen.insert(key) { faces.push(face) } else { repair.duplicate_faces += 1 }
    }
    let (clean, kept) = without_unused_vertices(&TriangleMesh { faces, ..mesh.clone() });
    repair.unused_vertices = mesh.vertices.len() - repair.merged_vertices - kept.len();
    (split_fans(&clean), repair)
}

fn is_on_a_line(mesh: &TriangleMesh, face: [u32; 3]) -> bool {
    let [a, b, c] = face.map(|v| mesh.vertices[v as usize]);
    let longest = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
    (b - a).cross(&(c - a)).norm() <= 1e-12 * longest
}

/// Longest side over the height on it, times √3/2: 1 for an equilateral face, infinite for one on a line.
///
/// The worst of the mesh; 0 without faces.
pub fn worst_aspect_ratio(mesh: &TriangleMesh) -> f64 {
    let ratio = |face: usize| {
        let [a, b, c] = mesh.triangle(face);
        let longest = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
        let twice_area = mesh.area_vector(face).norm();
        if twice_area > 0.0 { 0.75_f64.sqrt() * longest / twice_area } else { f64::INFINITY }
    };
    (0..mesh.faces.len()).map(ratio).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Topology};

    #[test]
    fn a_soup_becomes_a_tetrahedron() {
        let corner = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Point::from);
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3], [3, 2, 1], [1, 1, 2]];
        let vertices: Vec<Point> =
            faces.iter().flatten().map(|&v: &usize| corner[v]).chain([Point::origin()]).collect();
        let soup = TriangleMesh::new(vertices, (0..6).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect()).expect("valid");
        assert_eq!(Topology::of(&soup).components, 6);
        let (mesh, repair) = repaired(&soup);
        let topology = Topology::of(&mesh);
        assert!(topology.is_watertight() && topology.is_vertex_manifold());
        let expected = Repair { merged_vertices: 15, degenerate_faces: 1, duplicate_faces: 1, unused_vertices: 0 };
        assert_eq!((mesh.vertices.len(), mesh.faces.len(), repair), (4, 4, expected));
        assert_eq!(repaired(&mesh), (mesh.clone(), Repair::default()));
    }

    #[test]
    fn the_aspect_ratio_is_one_for_equal_sides() {
        let mut mesh = TriangleMesh::new(
            vec![Point::origin(), Point::new(2.0, 0.0, 0.0), Point::new(1.0, 3.0_f64.sqrt(), 0.0)],
            vec![[0, 1, 2]],
        )
        .expect("valid");
        assert!((worst_aspect_ratio(&mesh) - 1.0).abs() < 1e-12);
        mesh.vertices[2].y = 0.0;
        assert_eq!(worst_aspect_ratio(&mesh), f64::INFINITY);
        assert_eq!(worst_aspect_ratio(&TriangleMesh::default()), 0.0);
    }
}
