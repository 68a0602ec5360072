use crate::geometry::{Point, TriangleMesh, split_fans};
use std::collections::HashSet;

/// Up to this many corners a hole is filled optimally; larger ones are first clipped down to it. The optimum costs O(n³).
const MAX_OPTIMAL: usize = 256;

/// Closes every hole of an edge-manifold, consistently oriented mesh; pieces that touch in a point are taken apart first.
///
/// Each chain of boundary edges becomes the triangulation of least area (G. Barequet, M. Sharir: "Filling gaps in the boundary of a
/// polyhedron", CAGD 12, 1995), large ones after their flattest ears are clipped; no diagonal doubles an edge that exists. Where
/// none fits, a fan round the hole's centroid does. The result is watertight; holes are spanned, not guessed smoothly.
pub fn fill_holes(mesh: &TriangleMesh) -> TriangleMesh {
    let mut mesh = split_fans(mesh);
    let mut edges: HashSet<(u32, u32)> = HashSet::new();
    for f in &mesh.faces {
        edges.extend([(f[0], f[1]), (f[1], f[2]), (f[2], f[0])]);
    }
    for hole in boundary_loops(&mesh, &edges) {
        let mut filler = Filler { vertices: &mesh.vertices, edges: &mut edges, faces: Vec::new() };
        let rest = filler.clip_ears(hole);
        let solved = filler.fill_optimally(&rest);
        let mut faces = filler.faces;
        if !solved {
            let center = rest.iter().map(|&v| mesh.vertices[v as usize].coords).sum::<nalgebra::Vector3<f64>>();
            let apex = mesh.vertices.len() as u32;
            mesh.vertices.push(Point::from(center / rest.len() as f64));
            if let Some(colors) = &mut mesh.colors {
                let sum =
                    rest.iter().fold([0_usize; 3], |s, &v| [0, 1, 2].map(|i| s[i] + colors[v as usize][i] as usize));
                colors.push(sum.map(|s| (s / rest.len()) as u8));
            }
            faces.extend((0..rest.len()).map(|i| [rest[i], rest[(i + 1) % rest.len()], apex]));
        }
        mesh.faces.extend(faces);
    }
    mesh
}

/// The holes, each as the vertices round it in the direction that faces filling it must run.
fn boundary_loops(mesh: &TriangleMesh, edges: &HashSet<(u32, u32)>) -> Vec<Vec<u32>> {
    // In a vertex-manifold mesh at most one boundary edge ends at each vertex; a hole runs against the faces' direction.
    let mut next = vec![u32::MAX; mesh.vertices.len()];
    for f in &mesh.faces {
        for (a, b) in [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])] {
            if !edges.contains(&(b, a)) {
                next[b as usize] = a;
            }
        }
    }
    let mut loops = Vec::new();
    for start in 0..next.len() {
        let mut hole = Vec::new();
        let mut v = start;
        while next[v] != u32::MAX {
            hole.push(v as u32);
            v = std::mem::replace(&mut next[v], u32::MAX) as usize;
        }
        if hole.len() >= 3 && v == start {
            loops.push(hole);
        }
    }
    loops
}

struct Filler<'a> {
    vertices: &'a [Point],
    /// Half-edges of the mesh and of what has been filled.
    edges: &'a mut HashSet<(u32, u32)>,
    faces: Vec<[u32; 3]>,
}

impl Filler<'_> {
    fn joined(&self, a: u32, b: u32) -> bool {
        self.edges.contains(&(a, b)) || self.edges.contains(&(b, a))
    }

    fn area(&self, a: u32, b: u32, c: u32) -> f64 {
        let [a, b, c] = [a, b, c].map(|v| self.vertices[v as usize]);
        (b - a).cross(&(c - a)).norm()
    }

    fn add(&mut self, face: [u32; 3]) {
        self.edges.extend([(face[0], face[1]), (face[1], face[2]), (face[2], face[0])]);
        self.faces.push(face);
    }

    /// Cuts off the smallest ears of a large hole; returns what is left.
    fn clip_ears(&mut self, mut hole: Vec<u32>) -> Vec<u32> {
        while hole.len() > MAX_OPTIMAL {
            let n = hole.len();
            let ear = |i: usize| (hole[(i + n - 1) % n], hole[i], hole[(i + 1) % n]);
            let best = (0..n)
                .filter(|&i| !self.joined(ear(i).0, ear(i).2))
                .map(|i| (self.area(ear(i).0, ear(i).1, ear(i).2), i))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let Some((_, i)) = best else { break };
            let (a, b, c) = ear(i);
            self.add([a, b, c]);
            hole.remove(i);
        }
        hole
    }

    /// Adds the triangulation of least area; `false` if every one would double an edge.
    fn fill_optimally(&mut self, hole: &[u32]) -> bool {
        let n = hole.len();
        if n > MAX_OPTIMAL {
            return false;
        }
        // cost[i][k]: least area of the polygon i, i+1, …, k; apex[i][k]: third corner of the triangle on its chord.
        let mut cost = vec![0.0; n * n];
        let mut apex = vec![0; n * n];
        for gap in 2..n {
            for i in 0..n - gap {
                let k = i + gap;
                let mut least = (f64::INFINITY, 0);
                if gap == n - 1 || !self.joined(hole[i], hole[k]) {
                    for j in i + 1..k {
                        let parts = cost[i * n + j] + cost[j * n + k];
                        if parts < least.0 {
                            let total = parts + self.area(hole[i], hole[j], hole[k]);
                            least = if total < least.0 { (total, j) } else { least };
                        }
                    }
                }
                (cost[i * n + k], apex[i * n + k]) = least;
            }
        }
        if cost[n - 1].is_infinite() {
            return false;
        }
        let mut chords = vec![(0, n - 1)];
        while let Some((i, k)) = chords.pop() {
            if k - i >= 2 {
                let j = apex[i * n + k];
                self.add([hole[i], hole[j], hole[k]]);
                chords.extend([(i, j), (j, k)]);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Topology;
    use std::f64::consts::TAU;

    /// The wall of a cylinder of radius and height 1, open at both ends.
    fn tube(n: u32) -> TriangleMesh {
        let ring = |z: f64| {
            (0..n).map(move |i| f64::from(i) * TAU / f64::from(n)).map(move |a| Point::new(a.cos(), a.sin(), z))
        };
        let wall = |i: u32| {
            let (a, b) = (i, (i + 1) % n);
            [[a, b, a + n], [b, b + n, a + n]]
        };
        let vertices = ring(0.0).chain(ring(1.0)).collect();
        TriangleMesh::new(vertices, (0..n).flat_map(wall).collect()).expect("indices are in range")
    }

    fn volume_of_prism(n: u32) -> f64 {
        let n = f64::from(n);
        0.5 * n * (TAU / n).sin()
    }

    #[test]
    fn flat_ends_are_filled_flat() {
        for n in [3, 24, 600] {
            let filled = fill_holes(&tube(n));
            let t = Topology::of(&filled);
            assert!(t.is_watertight() && t.is_vertex_manifold());
            assert_eq!((filled.vertices.len(), t.genus()), (2 * n as usize, Some(0)));
            assert!((filled.volume() - volume_of_prism(n)).abs() < 1e-9, "{n}: {}", filled.volume());
        }
    }

    #[test]
    fn a_closed_mesh_stays_as_it_is() {
        let filled = fill_holes(&tube(12));
        assert_eq!(fill_holes(&filled), filled);
    }

    #[test]
    fn a_diagonal_that_exists_is_not_doubled() {
        // A square hole whose two diagonals are both edges elsewhere: over each, a face pair bulges out.
        let mut mesh = tube(4);
        let apex = mesh.vertices.len() as u32;
        mesh.vertices.extend([Point::new(0.0, 0.0, 3.0), Point::new(0.0, 0.0, 4.0)]);
        mesh.faces.extend([[4, 6, apex], [6, 4, apex], [5, 7, apex + 1], [7, 5, apex + 1]]);
        let t = Topology::of(&mesh);
        assert!(t.is_edge_manifold());
        let filled = Topology::of(&fill_holes(&mesh));
        assert!(filled.is_watertight() && filled.is_vertex_manifold(), "{filled:?}");
    }
}
