use super::{Aabb, Point, TriangleMesh, Vector};
use rayon::prelude::*;

/// Pairs of faces, smaller index first, that cross without sharing a vertex.
///
/// Strict crossings only: faces that touch, coplanar overlaps and folds between neighbours are not found. Sorts the faces along
/// the longest side of the mesh and compares those that overlap there: about O(n^1.5) on evenly meshed surfaces.
pub fn self_intersections(mesh: &TriangleMesh) -> Vec<(u32, u32)> {
    let Some(bounds) = mesh.bounds() else { return Vec::new() };
    let axis = bounds.size().imax();
    let mut boxes: Vec<(Aabb, u32)> =
        (0..mesh.faces.len()).filter_map(|f| Some((Aabb::of(&mesh.triangle(f))?, f as u32))).collect();
    boxes.sort_unstable_by(|a, b| a.0.min[axis].total_cmp(&b.0.min[axis]).then(a.1.cmp(&b.1)));
    let mut pairs: Vec<(u32, u32)> = (0..boxes.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let (box_a, a) = boxes[i];
            boxes[i + 1..]
                .iter()
                .take_while(move |(b, _)| b.min[axis] <= box_a.max[axis])
                .filter(move |(b, _)| overlap(&box_a, b))
                .filter(move |&&(_, b)| cross(mesh, a as usize, b as usize))
                .map(move |&(_, b)| (a.min(b), a.max(b)))
        })
        .collect();
    pairs.sort_unstable();
    pairs
}

fn overlap(a: &Aabb, b: &Aabb) -> bool {
    (0..3).all(|i| a.min[i] <= b.max[i] && b.min[i] <= a.max[i])
}

fn cross(mesh: &TriangleMesh, a: usize, b: usize) -> bool {
    if mesh.faces[a].iter().any(|v| mesh.faces[b].contains(v)) {
        return false;
    }
    let (s, t) = (mesh.triangle(a), mesh.triangle(b));
    (0..3).any(|k| pierces(&s[k], &s[(k + 1) % 3], &t) || pierces(&t[k], &t[(k + 1) % 3], &s))
}

/// Whether the open segment goes through the inside of the triangle.
fn pierces(p: &Point, q: &Point, [a, b, c]: &[Point; 3]) -> bool {
    let along = q - p;
    // Twice the signed volumes under the three sides as the segment sees them: all of one sign if it passes between.
    let (pa, pb, pc): (Vector, Vector, Vector) = (a - p, b - p, c - p);
    let sides = [along.dot(&pa.cross(&pb)), along.dot(&pb.cross(&pc)), along.dot(&pc.cross(&pa))];
    let between = sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0);
    let normal = (b - a).cross(&(c - a));
    between && normal.dot(&pa) * normal.dot(&(a - q)) < 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(points: &[[f64; 3]], faces: &[[u32; 3]]) -> TriangleMesh {
        TriangleMesh::new(points.iter().map(|p| Point::from(*p)).collect(), faces.to_vec())
            .expect("indices are in range")
    }

    const FLAT: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];

    fn with(other: [[f64; 3]; 3]) -> Vec<(u32, u32)> {
        self_intersections(&mesh(&[FLAT, other].concat(), &[[3, 4, 5], [0, 1, 2]]))
    }

    #[test]
    fn crossing_faces_are_found() {
        assert_eq!(with([[1.0, 1.0, -1.0], [1.0, 1.2, 1.0], [9.0, 9.0, 9.0]]), [(0, 1)]);
        // The other way round: the flat one's side goes through a large upright face.
        assert_eq!(with([[1.0, -9.0, -9.0], [1.0, 9.0, -9.0], [1.0, 0.0, 9.0]]), [(0, 1)]);
    }

    #[test]
    fn apart_touching_and_neighbouring_faces_are_not() {
        assert!(with([[3.0, 3.0, -1.0], [3.0, 3.0, 1.0], [9.0, 9.0, 9.0]]).is_empty());
        assert!(with([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]]).is_empty());
        let shared = mesh(&[FLAT.as_slice(), &[[1.0, 1.0, 1.0]]].concat(), &[[0, 1, 2], [0, 1, 3]]);
        assert!(self_intersections(&shared).is_empty());
        assert!(self_intersections(&TriangleMesh::default()).is_empty());
    }
}
