//! The samples in octree order, and the nodes of each depth stored as a sparse lattice.
//!
//! No tree of pointers: a depth is the sorted list of its lattice nodes with a table of where each row (y, z) begins. A node's row neighbours are then
//! contiguous, so 9 indices name its 27 neighbours, and memory follows the surface (rows: 4 bytes · 4^depth, nodes: those near samples).

use crate::geometry::{Point, PointCloud, Vector};
use rayon::prelude::*;
use std::ops::Range;

/// Bits of an octree code along each axis.
const CODE_BITS: u32 = 21;

/// The samples in the order of their octree (Morton) codes, in a unit cube.
pub(super) struct Samples {
    /// Positions in the unit cube.
    pub(super) position: Vec<[f64; 3]>,
    /// Unit outward normals.
    pub(super) normal: Vec<Vector>,
    /// Relative trust, mean 1.
    pub(super) weight: Vec<f64>,
    code: Vec<u64>,
}

impl Samples {
    /// Sorts the points `chosen` of a cloud with normals into the octree of the cube at `origin` with the given edge.
    pub(super) fn new(
        cloud: &PointCloud,
        normals: &[Vector],
        weights: Option<&[f64]>,
        chosen: &[u32],
        origin: Point,
        edge: f64,
    ) -> Self {
        let unit = |i: u32| -> [f64; 3] { ((cloud.points[i as usize] - origin) / edge).into() };
        let mut order: Vec<(u64, u32)> = chosen.par_iter().map(|&i| (code(unit(i)), i)).collect();
        order.par_sort_unstable();
        let total: f64 = weights.map_or(chosen.len() as f64, |w| order.iter().map(|&(_, i)| w[i as usize]).sum());
        let mean = total / chosen.len().max(1) as f64;
        Self {
            position: order.iter().map(|&(_, i)| unit(i)).collect(),
            normal: order.iter().map(|&(_, i)| normals[i as usize].normalize()).collect(),
            weight: order.iter().map(|&(_, i)| weights.map_or(1.0, |w| w[i as usize] / mean)).collect(),
            code: order.iter().map(|&(c, _)| c).collect(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.code.len()
    }

    /// Samples in different places (to one part in two million of the domain).
    pub(super) fn distinct(&self) -> usize {
        self.occupied(CODE_BITS)
    }

    /// Octree cells of a depth that hold a sample.
    pub(super) fn occupied(&self, depth: u32) -> usize {
        let cell = |c: u64| c >> (3 * (CODE_BITS - depth));
        self.code.windows(2).filter(|w| cell(w[0]) != cell(w[1])).count() + usize::from(!self.code.is_empty())
    }

    /// The occupied cells of a depth, in octree order, with the samples in each.
    pub(super) fn cells(&self, depth: u32) -> Vec<(Cell, Range<usize>)> {
        let cell = |i: usize| self.code[i] >> (3 * (CODE_BITS - depth));
        let mut cells = Vec::new();
        let mut start = 0;
        for i in 1..=self.len() {
            if i == self.len() || cell(i) != cell(start) {
                cells.push((decode(cell(start)), start..i));
                start = i;
            }
        }
        cells
    }
}

/// Coordinates of a lattice node or of the cell above it.
pub(super) type Cell = [u16; 3];

/// The cell of a depth that holds a place of the unit cube, and where in the cell it is (0 to 1 along each axis).
#[inline]
pub(super) fn locate(place: [f64; 3], depth: u32) -> (Cell, [f64; 3]) {
    let n = (1_u32 << depth) as f64;
    let scaled = place.map(|c| c * n);
    let cell = scaled.map(|c| c.floor().clamp(0.0, n - 1.0));
    (cell.map(|c| c as u16), [scaled[0] - cell[0], scaled[1] - cell[1], scaled[2] - cell[2]])
}

fn code(place: [f64; 3]) -> u64 {
    let n = (1_u64 << CODE_BITS) as f64;
    let [x, y, z] = place.map(|c| spread((c * n).floor().clamp(0.0, n - 1.0) as u64));
    x | y << 1 | z << 2
}

/// Puts two zero bits before each of the low 21 bits.
fn spread(x: u64) -> u64 {
    let x = (x | x << 32) & 0x001F_0000_0000_FFFF;
    let x = (x | x << 16) & 0x001F_0000_FF00_00FF;
    let x = (x | x << 8) & 0x100F_00F0_0F00_F00F;
    let x = (x | x << 4) & 0x10C3_0C30_C30C_30C3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

fn decode(code: u64) -> Cell {
    let gather = |x: u64| (0..CODE_BITS).fold(0, |sum, bit| sum | ((x >> (3 * bit)) & 1) << bit);
    [gather(code) as u16, gather(code >> 1) as u16, gather(code >> 2) as u16]
}

/// A set of nodes of an n × n × n lattice, sorted by (z, y, x).
pub(super) struct Lattice {
    /// Nodes along an axis.
    pub(super) size: usize,
    /// The nodes.
    pub(super) nodes: Vec<Cell>,
    /// Start of each row z · size + y in `nodes`, and the end.
    rows: Vec<u32>,
}

impl Lattice {
    /// The lattice of the sorted, distinct keys.
    pub(super) fn new(size: usize, keys: &[u64]) -> Self {
        let nodes: Vec<Cell> = keys.iter().map(|&k| unpack(k)).collect();
        let mut rows = vec![0_u32; size * size + 1];
        for n in &nodes {
            rows[n[2] as usize * size + n[1] as usize + 1] += 1;
        }
        for r in 0..size * size {
            rows[r + 1] += rows[r];
        }
        Self { size, nodes, rows }
    }

    pub(super) fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Index of a node.
    #[inline]
    pub(super) fn find(&self, [x, y, z]: Cell) -> Option<usize> {
        let row = z as usize * self.size + y as usize;
        let (start, end) = (self.rows[row] as usize, self.rows[row + 1] as usize);
        let at = start + self.nodes[start..end].partition_point(|n| n[0] < x);
        (at < end && self.nodes[at][0] == x).then_some(at)
    }

    /// Indices of the eight corners (bits x, y, z) of a cell, if all are in the set.
    #[inline]
    pub(super) fn corners(&self, [x, y, z]: Cell) -> Option<[usize; 8]> {
        let mut corners = [0; 8];
        for (row, (dy, dz)) in [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().enumerate() {
            let first = self.find([x, y + dy, z + dz])?;
            // The next node along x, if present, is the next in memory.
            let next = self.nodes.get(first + 1)?;
            if *next != [x + 1, y + dy, z + dz] {
                return None;
            }
            corners[2 * row] = first;
            corners[2 * row + 1] = first + 1;
        }
        Some(corners)
    }

    /// For nodes whose 26 neighbours are all in the set: the index of the first node of each of their nine rows, y fastest.
    pub(super) fn neighbour_rows(&self, of: &[u32]) -> Vec<[u32; 9]> {
        of.par_iter()
            .map(|&i| {
                let [x, y, z] = self.nodes[i as usize];
                std::array::from_fn(|r| {
                    let node = [x - 1, y + r as u16 % 3 - 1, z + r as u16 / 3 - 1];
                    self.find(node).expect("active nodes have all their neighbours") as u32
                })
            })
            .collect()
    }
}

const FIELD: u32 = 20;
const MASK: u64 = (1 << FIELD) - 1;

#[inline]
fn pack([x, y, z]: [u64; 3]) -> u64 {
    z << (2 * FIELD) | y << FIELD | x
}

#[inline]
fn unpack(key: u64) -> Cell {
    [0, 1, 2].map(|axis| ((key >> (axis * FIELD)) & MASK) as u16)
}

/// Sorted keys of all nodes with coordinates from `low` to `high`.
pub(super) fn all_keys(low: u64, high: u64) -> Vec<u64> {
    let range = low..=high;
    range.clone().flat_map(|z| range.clone().flat_map(move |y| (low..=high).map(move |x| pack([x, y, z])))).collect()
}

/// Sorted keys of the cells themselves.
pub(super) fn cell_keys(cells: impl Iterator<Item = Cell>) -> Vec<u64> {
    let mut keys: Vec<u64> = cells.map(|c| pack(c.map(u64::from))).collect();
    keys.sort_unstable();
    keys.dedup();
    keys
}

/// Sorted keys of the corners of the cells.
pub(super) fn corner_keys(mut keys: Vec<u64>) -> Vec<u64> {
    for axis in 0..3 {
        let shifted: Vec<u64> = keys.iter().map(|k| k + (1 << (axis * FIELD))).collect();
        keys = union([&keys, &shifted]);
    }
    keys
}

/// The set grown by one node in every direction (diagonals included), kept within coordinates `low..=high`.
pub(super) fn grown(mut keys: Vec<u64>, low: u64, high: u64) -> Vec<u64> {
    for axis in 0..3 {
        let at = |k: u64| (k >> (axis * FIELD)) & MASK;
        let step = 1 << (axis * FIELD);
        let below: Vec<u64> = keys.iter().filter(|&&k| at(k) > low).map(|k| k - step).collect();
        let above: Vec<u64> = keys.iter().filter(|&&k| at(k) < high).map(|k| k + step).collect();
        keys = union([&below, &union([&keys, &above])]);
    }
    keys
}

/// Keys with every coordinate within `low..=high`.
pub(super) fn within(keys: &[u64], low: u64, high: u64) -> Vec<u64> {
    let inside = |k: u64| (0..3).all(|axis| (low..=high).contains(&((k >> (axis * FIELD)) & MASK)));
    keys.iter().copied().filter(|&k| inside(k)).collect()
}

fn union([a, b]: [&[u64]; 2]) -> Vec<u64> {
    let mut merged = Vec::with_capacity(a.len() + b.len());
    let (mut i, mut j) = (0, 0);
    while i < a.len() && j < b.len() {
        merged.push(a[i].min(b[j]));
        let (step_a, step_b) = (a[i] <= b[j], b[j] <= a[i]);
        i += usize::from(step_a);
        j += usize::from(step_b);
    }
    merged.extend_from_slice(&a[i..]);
    merged.extend_from_slice(&b[j..]);
    merged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_round_trip_and_locate_agrees() {
        let place = [0.3, 0.71, 0.999];
        for depth in [1, 5, 9] {
            assert_eq!(decode(code(place) >> (3 * (CODE_BITS - depth))), locate(place, depth).0);
        }
        let (cell, inside) = locate([0.5, 0.26, 1.0], 2);
        assert_eq!(cell, [2, 1, 3]);
        assert!((inside[1] - 0.04).abs() < 1e-12 && inside[2] == 1.0);
    }

    #[test]
    fn growing_a_node_gives_its_27_neighbours_and_stops_at_the_border() {
        let keys = grown(vec![pack([5, 5, 5])], 0, 8);
        assert_eq!(keys, all_keys(4, 6));
        assert_eq!(grown(vec![pack([0, 0, 0])], 0, 8), all_keys(0, 1));
        assert_eq!(corner_keys(vec![pack([3, 3, 3])]), all_keys(3, 4));
        assert_eq!(within(&all_keys(0, 8), 1, 7), all_keys(1, 7));
    }

    #[test]
    fn a_lattice_finds_exactly_its_nodes() {
        let lattice = Lattice::new(9, &grown(vec![pack([2, 3, 4])], 0, 8));
        assert_eq!(lattice.len(), 27);
        assert_eq!(lattice.find([1, 2, 3]), Some(0));
        assert_eq!(lattice.find([4, 3, 4]), None);
        assert!(lattice.corners([1, 2, 3]).is_some_and(|c| lattice.nodes[c[7]] == [2, 3, 4]));
        assert!(lattice.corners([3, 3, 4]).is_none());
        let centre = lattice.find([2, 3, 4]).map(|i| i as u32);
        let rows = lattice.neighbour_rows(&[centre.unwrap_or_default()]);
        assert_eq!(rows[0], [0, 3, 6, 9, 12, 15, 18, 21, 24]);
    }

    #[test]
    fn cells_group_every_sample_once() {
        let points: Vec<Point> =
            (0..200).map(|i| Point::new((i * 37 % 200) as f64, (i * 91 % 200) as f64, (i % 17) as f64)).collect();
        let normals = vec![Vector::z(); 200];
        let cloud = PointCloud { points, ..PointCloud::default() };
        let chosen: Vec<u32> = (0..200).collect();
        let samples = Samples::new(&cloud, &normals, None, &chosen, Point::new(-1.0, -1.0, -1.0), 210.0);
        for depth in [1, 3, 6] {
            let cells = samples.cells(depth);
            assert_eq!(cells.len(), samples.occupied(depth));
            assert_eq!(cells.iter().map(|(_, r)| r.len()).sum::<usize>(), 200);
            for (cell, range) in cells {
                assert!(range.clone().all(|i| locate(samples.position[i], depth).0 == cell));
            }
        }
    }
}
