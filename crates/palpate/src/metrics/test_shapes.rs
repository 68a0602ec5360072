//! Closed meshes with known answers, for tests.

use crate::geometry::{Point, TriangleMesh, Vector};
use std::collections::BTreeMap;

/// A box centred at the origin.
pub(crate) fn cuboid(size: Vector) -> TriangleMesh {
    let corner = |i: usize| {
        let sign = |bit: usize| if i >> bit & 1 == 1 { 0.5 } else { -0.5 };
        Point::new(sign(0) * size.x, sign(1) * size.y, sign(2) * size.z)
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriangleMesh::new((0..8).map(corner).collect(), faces).expect("indices are below 8")
}

/// A sphere at the origin: an octahedron, each face split in four `levels` times.
pub(crate) fn sphere_mesh(radius: f64, levels: usize) -> TriangleMesh {
    let mut directions: Vec<Vector> =
        [Vector::x(), -Vector::x(), Vector::y(), -Vector::y(), Vector::z(), -Vector::z()].to_vec();
    let mut faces: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..levels {
        let mut middles = BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                directions.push((directions[a as usize] + directions[b as usize]).normalize());
                directions.len() as u32 - 1
            })
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
            })
            .collect();
    }
    TriangleMesh::new(directions.iter().map(|d| Point::from(d * radius)).collect(), faces).expect("indices are valid")
}
