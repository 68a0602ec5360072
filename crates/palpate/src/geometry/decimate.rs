use super::{Point, TriangleMesh, Vector, without_unused_vertices};
use nalgebra::{Matrix3, SymmetricEigen};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Weight of the planes that hold a boundary in place, over that of a face of the same size.
const BOUNDARY_WEIGHT: f64 = 100.0;

/// A face may not turn by more than this cosine when a corner moves.
const LEAST_TURN: f64 = 0.2;

/// Eigenvalues below this share of the largest leave the vertex where it is along them: the quadric does not say where.
const FLAT: f64 = 1e-3;

/// The mesh with at most `target` faces, by collapsing the edges whose removal moves the surface least.
///
/// The topology stays: a collapse that would make an edge of three faces, pinch a vertex or turn a face over is not done, so that a closed manifold
/// stays one and the target may not be reached (a tetrahedron stays). Colours are those of the vertex that stays, mixed by halves.
///
/// # References
/// Garland & Heckbert, *Surface simplification using quadric error metrics*, SIGGRAPH 1997; the link condition: Dey et al., *Topology preserving edge
/// contraction*, Publ. Inst. Math. 66, 1999. The best place in the directions that the quadric fixes: Lindstrom, *Out-of-core simplification of large
/// polygonal models*, SIGGRAPH 2000, §3.
pub fn decimated(mesh: &TriangleMesh, target: usize) -> TriangleMesh {
    let mut work = Decimation::new(mesh);
    while work.alive > target {
        let Some(Reverse(candidate)) = work.queue.pop() else { break };
        let [a, b] = candidate.edge.map(|v| v as usize);
        if work.version[a] != candidate.versions[0] || work.version[b] != candidate.versions[1] {
            continue;
        }
        work.collapse(a, b);
    }
    let dead = |f: &[u32; 3]| f[0] == u32::MAX;
    let faces = work.mesh.faces.iter().filter(|f| !dead(f)).copied().collect();
    without_unused_vertices(&TriangleMesh { faces, ..work.mesh }).0
}

/// Σ w (n·x + d)²: A = Σ w n nᵀ, b = Σ w d n, c = Σ w d².
#[derive(Clone, Copy)]
struct Quadric {
    a: Matrix3<f64>,
    b: Vector,
    c: f64,
}

impl Quadric {
    const ZERO: Self =
        Self { a: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), b: Vector::new(0.0, 0.0, 0.0), c: 0.0 };

    fn add_plane(&mut self, normal: &Vector, through: &Point, weight: f64) {
        let d = -normal.dot(&through.coords);
        self.a += normal * normal.transpose() * weight;
        self.b += normal * (weight * d);
        self.c += weight * d * d;
    }

    fn plus(&self, other: &Self) -> Self {
        Self { a: self.a + other.a, b: self.b + other.b, c: self.c + other.c }
    }

    fn at(&self, p: &Point) -> f64 {
        (p.coords.dot(&(self.a * p.coords)) + 2.0 * self.b.dot(&p.coords) + self.c).max(0.0)
    }

    /// The best place near `start`.
    fn best(&self, start: &Point) -> Point {
        let eigen = SymmetricEigen::new(self.a);
        let largest = eigen.eigenvalues.amax();
        let downhill = -(self.b + self.a * start.coords);
        let mut best = *start;
        for (value, axis) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value > FLAT * largest {
                best += axis * (axis.dot(&downhill) / value);
            }
        }
        best
    }
}

#[derive(PartialEq)]
struct Candidate {
    cost: f64,
    edge: [u32; 2],
    versions: [u32; 2],
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.cost.total_cmp(&other.cost).then(self.edge.cmp(&other.edge)).then(self.versions.cmp(&other.versions))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

struct Decimation {
    mesh: TriangleMesh,
    alive: usize,
    quadric: Vec<Quadric>,
    /// Faces at each vertex.
    faces_of: Vec<Vec<u32>>,
    /// Raised when a vertex changes: older candidates no longer hold.
    version: Vec<u32>,
    queue: BinaryHeap<Reverse<Candidate>>,
}

impl Decimation {
    fn new(mesh: &TriangleMesh) -> Self {
        let mut faces_of = vec![Vec::new(); mesh.vertices.len()];
        let mut quadric = vec![Quadric::ZERO; mesh.vertices.len()];
        for (f, face) in mesh.faces.iter().enumerate() {
            let twice_area = mesh.area_vector(f);
            let normal = twice_area.try_normalize(0.0).unwrap_or_else(Vector::zeros);
            for &v in face {
                faces_of[v as usize].push(f as u32);
                quadric[v as usize].add_plane(&normal, &mesh.vertices[v as usize], twice_area.norm());
            }
        }
        let mut work = Self {
            mesh: mesh.clone(),
            alive: mesh.faces.len(),
            quadric,
            faces_of,
            version: vec![0; mesh.vertices.len()],
            queue: BinaryHeap::new(),
        };
        work.hold_boundaries();
        for v in 0..mesh.vertices.len() {
            for n in work.neighbours(v) {
                if v < n {
                    work.propose(v, n);
                }
            }
        }
        work
    }

    /// Adds planes at right angles to the faces through boundary edges.
    fn hold_boundaries(&mut self) {
        for f in 0..self.mesh.faces.len() {
            for k in 0..3 {
                let (a, b) = (self.mesh.faces[f][k] as usize, self.mesh.faces[f][(k + 1) % 3] as usize);
                if self.shared_faces(a, b).count() == 1 {
                    let along = self.mesh.vertices[b] - self.mesh.vertices[a];
                    if let Some(normal) = along.cross(&self.mesh.area_vector(f)).try_normalize(0.0) {
                        let weight = BOUNDARY_WEIGHT * along.norm_squared();
                        for v in [a, b] {
                            self.quadric[v].add_plane(&normal, &self.mesh.vertices[a], weight);
                        }
                    }
                }
            }
        }
    }

    fn shared_faces(&self, a: usize, b: usize) -> impl Iterator<Item = u32> {
        self.faces_of[a].iter().copied().filter(move |&f| self.mesh.faces[f as usize].contains(&(b as u32)))
    }

    /// Vertices that share an edge with it, ascending.
    fn neighbours(&self, v: usize) -> Vec<usize> {
        let corners = self.faces_of[v].iter().flat_map(|&f| self.mesh.faces[f as usize]);
        let mut near: Vec<usize> = corners.map(|c| c as usize).filter(|&c| c != v).collect();
        near.sort_unstable();
        near.dedup();
        near
    }

    fn is_boundary(&self, v: usize, near: &[usize]) -> bool {
        near.iter().any(|&n| self.shared_faces(v, n).count() != 2)
    }

    fn place(&self, a: usize, b: usize) -> (Point, f64) {
        let both = self.quadric[a].plus(&self.quadric[b]);
        let (p, q) = (self.mesh.vertices[a], self.mesh.vertices[b]);
        let middle = nalgebra::center(&p, &q);
        let best = both.best(&middle);
        // Nearly flat quadrics send the vertex far: keep it near the edge.
        let best = if (best - middle).norm() > 2.0 * (p - q).norm() { middle } else { best };
        (best, both.at(&best))
    }

    fn propose(&mut self, a: usize, b: usize) {
        let (a, b) = (a.min(b), a.max(b));
        let cost = self.place(a, b).1;
        if cost.is_finite() {
            let versions = [self.version[a], self.version[b]];
            self.queue.push(Reverse(Candidate { cost, edge: [a as u32, b as u32], versions }));
        }
    }

    /// Merges b into a, if the mesh stays a manifold and no face turns over.
    fn collapse(&mut self, a: usize, b: usize) {
        let (near_a, near_b) = (self.neighbours(a), self.neighbours(b));
        let shared: Vec<u32> = self.shared_faces(a, b).collect();
        if shared.is_empty() || shared.len() > 2 {
            return;
        }
        // Link condition: the common neighbours are the corners opposite the edge, and an inner edge does not join two boundary vertices.
        let common = near_a.iter().filter(|n| near_b.binary_search(n).is_ok()).count();
        let both_boundary = self.is_boundary(a, &near_a) && self.is_boundary(b, &near_b);
        if common != shared.len()
            || (shared.len() == 2 && both_boundary)
            || near_a.len().min(near_b.len()) < 3 && shared.len() == 2
        {
            return;
        }
        // What is left must be more than two faces back to back.
        if shared.len() == 2 && near_a.len() + near_b.len() - 4 < 3 {
            return;
        }
        let (place, _) = self.place(a, b);
        if self.turns_over(a, &shared, &place) || self.turns_over(b, &shared, &place) {
            return;
        }
        for &f in &shared {
            for v in self.mesh.faces[f as usize] {
                self.faces_of[v as usize].retain(|&g| g != f);
            }
            self.mesh.faces[f as usize] = [u32::MAX; 3];
            self.alive -= 1;
        }
        for f in std::mem::take(&mut self.faces_of[b]) {
            self.mesh.faces[f as usize] =
                self.mesh.faces[f as usize].map(|v| if v as usize == b { a as u32 } else { v });
            self.faces_of[a].push(f);
        }
        self.mesh.vertices[a] = place;
        if let Some(colors) = &mut self.mesh.colors {
            let (ca, cb) = (colors[a], colors[b]);
            colors[a] = [0, 1, 2].map(|k| u8::midpoint(ca[k], cb[k]));
        }
        self.quadric[a] = self.quadric[a].plus(&self.quadric[b]);
        self.version[a] += 1;
        self.version[b] += 1;
        for n in self.neighbours(a) {
            self.propose(a, n);
        }
    }

    /// Whether a face at v, other than the shared ones, would turn over or vanish with v at the place.
    fn turns_over(&self, v: usize, shared: &[u32], place: &Point) -> bool {
        self.faces_of[v].iter().filter(|f| !shared.contains(f)).any(|&f| {
            let corners = self.mesh.faces[f as usize];
            let before = self.mesh.area_vector(f as usize);
            let [p, q, s] = corners.map(|c| if c as usize == v { *place } else { self.mesh.vertices[c as usize] });
            let after = (q - p).cross(&(s - p));
            !(before.dot(&after) > LEAST_TURN * before.norm() * after.norm())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Topology;

    /// A sphere of radius 1 of rings and segments.
    fn sphere(n: u32) -> TriangleMesh {
        let mut vertices = vec![Point::new(0.0, 0.0, 1.0)];
        for i in 1..n {
            for j in 0..2 * n {
                let (polar, round) = (
                    std::f64::consts::PI * f64::from(i) / f64::from(n),
                    std::f64::consts::PI * f64::from(j) / f64::from(n),
                );
                vertices.push(Point::new(polar.sin() * round.cos(), polar.sin() * round.sin(), polar.cos()));
            }
        }
        vertices.push(Point::new(0.0, 0.0, -1.0));
        let last = vertices.len() as u32 - 1;
        let at = |i: u32, j: u32| match i {
            0 => 0,
            i if i == n => last,
            i => 1 + (i - 1) * 2 * n + j % (2 * n),
        };
        let square = |k: u32| {
            let (i, j) = (k / (2 * n), k % (2 * n));
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        };
        let faces = (0..2 * n * n).flat_map(square).filter(|f| f[0] != f[1] && f[1] != f[2] && f[2] != f[0]).collect();
        TriangleMesh::new(vertices, faces).expect("valid")
    }

    #[test]
    fn a_sphere_keeps_its_shape_and_topology_down_to_a_tetrahedron() {
        let fine = sphere(24);
        for target in [1000, 200, 20, 0] {
            let coarse = decimated(&fine, target);
            let topology = Topology::of(&coarse);
            assert!(topology.is_watertight() && topology.is_vertex_manifold(), "{target}: {topology:?}");
            assert_eq!((topology.euler_characteristic, topology.unused_vertices), (2, 0));
            assert!(coarse.faces.len() <= target.max(20), "{} of {target}", coarse.faces.len());
            if target >= 200 {
                assert!(coarse.faces.len() >= target - 2);
                assert!((coarse.volume() / fine.volume() - 1.0).abs() < 0.03, "{target}: {}", coarse.volume());
            }
        }
        assert_eq!(decimated(&fine, usize::MAX), fine);
    }

    #[test]
    fn a_flat_sheet_keeps_its_outline() {
        let n = 20_u32;
        let vertices = (0..n * n).map(|k| Point::new(f64::from(k % n), f64::from(k / n), 0.0)).collect();
        let square = |k: u32| {
            let at = k / (n - 1) * n + k % (n - 1);
            [[at, at + 1, at + n + 1], [at, at + n + 1, at + n]]
        };
        let sheet = TriangleMesh::new(vertices, (0..(n - 1) * (n - 1)).flat_map(square).collect()).expect("valid");
        let coarse = decimated(&sheet, 40);
        assert!(coarse.faces.len() <= 40);
        assert!((coarse.area() - 361.0).abs() < 1e-6, "{}", coarse.area());
        assert_eq!(Topology::of(&coarse).boundary_loops, 1);
    }
}
