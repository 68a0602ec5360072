use super::half_edges::sorted_half_edges;
use super::{TriangleMesh, UnionFind};

/// For each face the number of its piece, counted from 0 in the order of first faces; a piece is joined by edges.
pub fn pieces(mesh: &TriangleMesh) -> Vec<usize> {
    let mut sets = UnionFind::new(mesh.faces.len());
    for edge in sorted_half_edges(&mesh.faces).chunk_by(|a, b| a.edge() == b.edge()) {
        for h in &edge[1..] {
            sets.union(edge[0].face(), h.face());
        }
    }
    let mut number = vec![usize::MAX; mesh.faces.len()];
    let mut count = 0;
    let mut label = |root: usize| {
        if number[root] == usize::MAX {
            number[root] = count;
            count += 1;
        }
        number[root]
    };
    (0..mesh.faces.len() as u32).map(|f| label(sets.find(f) as usize)).collect()
}

/// For each face whether it belongs to the piece with the largest area (the first of equal ones).
pub(crate) fn in_largest_piece(mesh: &TriangleMesh) -> Vec<bool> {
    let piece = pieces(mesh);
    let area = piece_areas(mesh, &piece);
    let largest = (0..area.len()).max_by(|&a, &b| area[a].total_cmp(&area[b]).then(b.cmp(&a)));
    piece.iter().map(|&p| Some(p) == largest).collect()
}

/// The mesh's piece with the largest area alone, without unused vertices.
pub fn largest_piece(mesh: &TriangleMesh) -> TriangleMesh {
    let kept = in_largest_piece(mesh);
    let faces = mesh.faces.iter().zip(kept).filter(|(_, kept)| *kept).map(|(f, _)| *f).collect();
    without_unused_vertices(&TriangleMesh { faces, ..mesh.clone() }).0
}

/// The mesh with the vertices that faces use, in their order, and the old index of each.
pub fn without_unused_vertices(mesh: &TriangleMesh) -> (TriangleMesh, Vec<u32>) {
    let mut new_index = vec![u32::MAX; mesh.vertices.len()];
    for &v in mesh.faces.iter().flatten() {
        new_index[v as usize] = 0;
    }
    let kept: Vec<u32> = (0..mesh.vertices.len() as u32).filter(|&v| new_index[v as usize] == 0).collect();
    for (new, &old) in kept.iter().enumerate() {
        new_index[old as usize] = new as u32;
    }
    let clean = TriangleMesh {
        vertices: kept.iter().map(|&v| mesh.vertices[v as usize]).collect(),
        faces: mesh.faces.iter().map(|f| f.map(|v| new_index[v as usize])).collect(),
        colors: mesh.colors.as_ref().map(|c| kept.iter().map(|&v| c[v as usize]).collect()),
    };
    (clean, kept)
}

fn piece_areas(mesh: &TriangleMesh, piece: &[usize]) -> Vec<f64> {
    let mut area = vec![0.0; piece.iter().max().map_or(0, |m| m + 1)];
    for (face, &piece) in piece.iter().enumerate() {
        area[piece] += 0.5 * mesh.area_vector(face).norm();
    }
    area
}

/// The mesh without the pieces that have less than `share` of its whole area, and without unused vertices.
pub fn drop_small_pieces(mesh: &TriangleMesh, share: f64) -> TriangleMesh {
    let piece = pieces(mesh);
    let area = piece_areas(mesh, &piece);
    let least = share * area.iter().sum::<f64>();
    let mut corners = Vec::new();
    let kept = (0..mesh.faces.len()).filter(|&f| area[piece[f]] >= least);
    corners.extend(kept.flat_map(|f| mesh.faces[f].map(|v| v as usize)));
    rebuilt(mesh, &corners, mesh.vertices.len(), |_, v| v)
}

/// The mesh with one vertex per fan, without unused vertices: where pieces touched in a point, each gets its own.
///
/// Edge-manifold in, vertex-manifold out; positions stay, so neighbouring copies coincide.
pub fn split_fans(mesh: &TriangleMesh) -> TriangleMesh {
    let mut fans = UnionFind::new(3 * mesh.faces.len());
    for edge in sorted_half_edges(&mesh.faces).chunk_by(|a, b| a.edge() == b.edge()) {
        for h in &edge[1..] {
            fans.union(edge[0].corner_at(h.low), h.corner_at(h.low));
            fans.union(edge[0].corner_at(h.high), h.corner_at(h.high));
        }
    }
    let corners: Vec<usize> = mesh.faces.iter().flat_map(|f| f.map(|v| v as usize)).collect();
    rebuilt(mesh, &corners, corners.len(), |corner, _| fans.find(corner as u32) as usize)
}

/// A mesh of the listed corners (vertex indices, three per face); corners with the same `key(position in the list, vertex)` share
/// a vertex. Vertices keep their order, copies in the order of first use.
fn rebuilt(
    mesh: &TriangleMesh,
    corners: &[usize],
    keys: usize,
    mut key: impl FnMut(usize, usize) -> usize,
) -> TriangleMesh {
    let mut first_use = vec![usize::MAX; keys];
    let corner_keys: Vec<usize> = corners.iter().enumerate().map(|(corner, &v)| key(corner, v)).collect();
    let mut used: Vec<(usize, usize, usize)> = Vec::new();
    for (corner, (&v, &k)) in corners.iter().zip(&corner_keys).enumerate() {
        if first_use[k] == usize::MAX {
            first_use[k] = corner;
            used.push((v, corner, k));
        }
    }
    used.sort_unstable();
    let mut new_index = first_use;
    for (i, &(_, _, k)) in used.iter().enumerate() {
        new_index[k] = i;
    }
    let index = |corner: usize| new_index[corner_keys[corner]] as u32;
    TriangleMesh {
        vertices: used.iter().map(|u| mesh.vertices[u.0]).collect(),
        faces: (0..corners.len() / 3).map(|f| [index(3 * f), index(3 * f + 1), index(3 * f + 2)]).collect(),
        colors: mesh.colors.as_ref().map(|c| used.iter().map(|u| c[u.0]).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Topology};

    /// Two tetrahedra that share vertex 0, the second ten times larger, and an unused vertex 7.
    fn touching() -> TriangleMesh {
        let corner = |s: f64| [Point::new(s, 0.0, 0.0), Point::new(0.0, s, 0.0), Point::new(0.0, 0.0, s)];
        let mut vertices = vec![Point::origin()];
        vertices.extend(corner(-0.1));
        vertices.extend(corner(1.0));
        vertices.push(Point::new(9.0, 9.0, 9.0));
        let small = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]];
        let large = small.map(|f: [u32; 3]| [f[0], f[2], f[1]].map(|i| if i == 0 { 0 } else { i + 3 }));
        TriangleMesh::new(vertices, [small, large].concat()).expect("indices are in range")
    }

    #[test]
    fn fans_get_a_vertex_each() {
        let mesh = touching();
        assert_eq!(Topology::of(&mesh).non_manifold_vertices, 1);
        let split = split_fans(&mesh);
        let t = Topology::of(&split);
        assert!(t.is_watertight() && t.is_vertex_manifold());
        assert_eq!((split.vertices.len(), t.components), (8, 2));
        assert!((split.volume() - mesh.volume()).abs() < 1e-15);
    }

    #[test]
    fn small_pieces_go() {
        let mesh = touching();
        assert_eq!(pieces(&mesh), [0, 0, 0, 0, 1, 1, 1, 1]);
        let kept = drop_small_pieces(&mesh, 0.05);
        assert_eq!((kept.faces.len(), kept.vertices.len()), (4, 4));
        assert!((kept.volume() - 1.0 / 6.0).abs() < 1e-12);
        assert_eq!(drop_small_pieces(&mesh, 0.0).faces.len(), 8);
        assert_eq!(largest_piece(&mesh), kept);
        assert_eq!(without_unused_vertices(&mesh).1, [0, 1, 2, 3, 4, 5, 6]);
    }
}
