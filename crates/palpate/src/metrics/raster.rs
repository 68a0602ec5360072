//! Where a bundle of parallel lines crosses a mesh.

use super::inside::InsideRule;
use crate::geometry::{Aabb, Point, TriangleMesh};
use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Lines along one coordinate axis, one at a random place in each cell of a grid over a box.
pub(super) struct LineBundle {
    /// The two axes across the lines and the axis along them, in cyclic order.
    axes: [usize; 3],
    origin: Point,
    cell: f64,
    shape: [usize; 2],
    /// Where each line meets the grid, relative to `origin`, cells in rows of `shape[0]`.
    places: Vec<[f64; 2]>,
}

/// One crossing: position along the line, and +1 on the way into the mesh, −1 on the way out.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    at: f64,
    step: i32,
}

/// The crossings of every line with one mesh, sorted along each line.
pub(super) struct Crossings {
    starts: Vec<usize>,
    all: Vec<Crossing>,
}

impl LineBundle {
    /// About `lines` lines along `axis` through a box; the places depend on the seed.
    ///
    /// Multi-jittered: one line a cell, and within each column (row) of cells the lines are spread evenly across (along) it too.
    /// No mesh edge can run along the lattice, and a wall parallel to an axis, however thin, meets its share of the lines.
    ///
    /// Chiu, Shirley & Wang, *Multi-jittered sampling*, Graphics Gems IV, 1994.
    pub(super) fn new(bounds: &Aabb, axis: usize, lines: usize, seed: u64) -> Self {
        let axes = [(axis + 1) % 3, (axis + 2) % 3, axis];
        // A flat box still has lines through it: no side counts as thinner than a thousandth of the diagonal.
        let floor = (1e-3 * bounds.diagonal()).max(1e-9);
        let side = [axes[0], axes[1]].map(|i| bounds.size()[i].max(floor));
        let cell = (side[0] * side[1] / lines.max(1) as f64).sqrt();
        let shape = side.map(|s| ((s / cell).ceil() as usize).max(1));
        let mut rng = Pcg64Mcg::seed_from_u64(seed.wrapping_mul(3).wrapping_add(axis as u64));
        let mut places = vec![[0.0; 2]; shape[0] * shape[1]];
        let mut order: Vec<usize> = (0..shape[1]).collect();
        for col in 0..shape[0] {
            order.shuffle(&mut rng);
            for (row, &rank) in order.iter().enumerate() {
                let within = (rank as f64 + rng.random::<f64>()) / shape[1] as f64;
                places[row * shape[0] + col][0] = (col as f64 + within) * cell;
            }
        }
        order = (0..shape[0]).collect();
        for row in 0..shape[1] {
            order.shuffle(&mut rng);
            for (col, &rank) in order.iter().enumerate() {
                let within = (rank as f64 + rng.random::<f64>()) / shape[0] as f64;
                places[row * shape[0] + col][1] = (row as f64 + within) * cell;
            }
        }
        Self { axes, origin: bounds.min, cell, shape, places }
    }

    /// Area that each line stands for, m².
    pub(super) fn cell_area(&self) -> f64 {
        self.cell * self.cell
    }

    /// Number of lines.
    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    /// Finds the crossings of all lines with a mesh.
    pub(super) fn crossings(&self, mesh: &TriangleMesh) -> Crossings {
        let corners: Vec<[f64; 3]> = mesh
            .vertices
            .iter()
            .map(|p| {
                let p = p - self.origin;
                self.axes.map(|i| p[i])
            })
            .collect();
        let mut found: Vec<(u32, Crossing)> = Vec::new();
        for face in &mesh.faces {
            self.cross(face.map(|i| corners[i as usize]), &mut found);
        }
        Crossings::sorted(self.len(), &found)
    }

    fn cross(&self, triangle: [[f64; 3]; 3], found: &mut Vec<(u32, Crossing)>) {
        let range = |i: usize| {
            let [a, b, c] = triangle.map(|p| p[i] / self.cell);
            let first = a.min(b).min(c).floor().max(0.0) as usize;
            (first, (a.max(b).max(c).floor() + 1.0).clamp(0.0, self.shape[i] as f64) as usize)
        };
        let ((col0, col1), (row0, row1)) = (range(0), range(1));
        for row in row0..row1 {
            for col in col0..col1 {
                let line = row * self.shape[0] + col;
                if let Some(crossing) = cross_line(&triangle, self.places[line]) {
                    found.push((line as u32, crossing));
                }
            }
        }
    }
}

/// Whether the line at `place` passes the triangle, where, and which way.
///
/// The three edge tests use the same arithmetic in both triangles that share an edge (corners in lexicographic order), so a
/// line at an edge is given to exactly one of them, even between coincident vertices or slivers of no area.
fn cross_line(triangle: &[[f64; 3]; 3], place: [f64; 2]) -> Option<Crossing> {
    let [a, b, c] = triangle;
    let (ab, left_ab) = edge(a, b, place);
    let (bc, left_bc) = edge(b, c, place);
    if left_ab != left_bc {
        return None;
    }
    let (ca, left_ca) = edge(c, a, place);
    if left_ca != left_ab {
        return None;
    }
    let sum = ab + bc + ca;
    let at = if sum == 0.0 { (a[2] + b[2] + c[2]) / 3.0 } else { (bc * a[2] + ca * b[2] + ab * c[2]) / sum };
    // Counter-clockwise seen against the line: the outward normal points along it, so it leaves the mesh here.
    Some(Crossing { at, step: if left_ab { -1 } else { 1 } })
}

/// Twice the signed area of (p, q, place), and whether the place is to the left of p → q.
fn edge(p: &[f64; 3], q: &[f64; 3], place: [f64; 2]) -> (f64, bool) {
    let area = |p: &[f64; 3], q: &[f64; 3]| (q[0] - p[0]) * (place[1] - p[1]) - (q[1] - p[1]) * (place[0] - p[0]);
    if (p[0], p[1]) <= (q[0], q[1]) {
        let e = area(p, q);
        (e, e >= 0.0)
    } else {
        let e = area(q, p);
        (-e, e < 0.0)
    }
}

impl Crossings {
    fn sorted(lines: usize, found: &[(u32, Crossing)]) -> Self {
        // Counting sort by line; lines have few crossings each.
        let mut starts = vec![0; lines + 1];
        for (line, _) in found {
            starts[*line as usize + 1] += 1;
        }
        for line in 0..lines {
            starts[line + 1] += starts[line];
        }
        let mut next = starts.clone();
        let mut all = vec![Crossing { at: 0.0, step: 0 }; found.len()];
        for (line, crossing) in found {
            let slot = &mut next[*line as usize];
            all[*slot] = *crossing;
            *slot += 1;
        }
        for line in 0..lines {
            all[starts[line]..starts[line + 1]].sort_by(|a, b| a.at.total_cmp(&b.at));
        }
        Self { starts, all }
    }

    /// Writes the stretches of a line that are inside, in order and disjoint.
    pub(super) fn inside(&self, line: usize, rule: InsideRule, stretches: &mut Vec<(f64, f64)>) {
        stretches.clear();
        let (mut depth, mut entered) = (0, 0.0);
        for crossing in &self.all[self.starts[line]..self.starts[line + 1]] {
            let before = depth;
            depth = match rule {
                InsideRule::Winding => depth + crossing.step,
                InsideRule::Parity => 1 - depth,
                InsideRule::Open => 0,
            };
            if before == 0 && depth != 0 {
                entered = crossing.at;
            } else if before != 0 && depth == 0 {
                stretches.push((entered, crossing.at));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shared_edge_is_crossed_once_whatever_the_line() {
        // Two triangles of a square; the line runs exactly through the diagonal, a corner and a border.
        let square = [[0., 0., 1.], [1., 0., 1.], [1., 1., 1.], [0., 1., 1.]];
        for place in [[0.5, 0.5], [0.25, 0.25], [0.75, 0.75]] {
            let hits = [[0, 1, 2], [0, 2, 3]].map(|f| cross_line(&f.map(|i: usize| square[i]), place));
            assert_eq!(hits.iter().flatten().count(), 1, "{place:?}");
            assert!(hits.iter().flatten().all(|h| h.at == 1.0 && h.step == -1));
        }
    }

    #[test]
    fn nested_shells_are_inside_once() {
        let steps = [(1.0, 1), (2.0, 1), (3.0, -1), (4.0, -1), (6.0, -1), (7.0, 1)];
        let found: Vec<_> = steps.iter().rev().map(|&(at, step)| (0, Crossing { at, step })).collect();
        let crossings = Crossings::sorted(1, &found);
        let mut stretches = Vec::new();
        crossings.inside(0, InsideRule::Winding, &mut stretches);
        assert_eq!(stretches, [(1.0, 4.0), (6.0, 7.0)]);
        crossings.inside(0, InsideRule::Parity, &mut stretches);
        assert_eq!(stretches, [(1.0, 2.0), (3.0, 4.0), (6.0, 7.0)]);
    }
}
