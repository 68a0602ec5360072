//! The samples in octree order, and the nodes of each depth stored as a sparse lattice.
//!
//! No tree of pointers: a depth is the sorted list of its lattice nodes with a table of where each row (y, z) begins. A node's row neighbours are then
//! contiguous, so 9 indices name its 27 neighbours, and memory follows the surface (rows: 4 bytes · 4^depth, nodes: those near samples).

use crate::geometry::{Aabb, Point, Vector};
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// Bits of an octree code along each axis.
const CODE_BITS: u32 = 21;

/// The samples in the order of their octree (Morton) codes, in a unit cube.
pub(super) struct Samples {
    /// Positions in the unit cube.
    pub(super) position: Vec<[f64; 3]>,
    /// Unit outward normals.
    normals: Vec<[f32; 3]>,
    /// Relative trust, mean 1.
    pub(super) weight: Vec<f64>,
    code: Vec<u64>,
}

impl Samples {
    /// Sorts the points `chosen` with their normals into the octree of the cube at `origin` with the given edge.
    pub(super) fn new(
        points: &[Point],
        normals: &[Vector],
        weights: Option<&[f64]>,
        chosen: &[u32],
        origin: Point,
        edge: f64,
    ) -> Self {
        let unit = |i: u32| -> [f64; 3] { ((points[i as usize] - origin) / edge).into() };
        let mut order: Vec<(u64, u32)> = chosen.par_iter().map(|&i| (code(unit(i)), i)).collect();
        order.par_sort_unstable();
        let total: f64 = weights.map_or(chosen.len() as f64, |w| order.iter().map(|&(_, i)| w[i as usize]).sum());
        let mean = total / chosen.len().max(1) as f64;
        Self {
            position: order.iter().map(|&(_, i)| unit(i)).collect(),
            normals: order.iter().map(|&(_, i)| normals[i as usize].normalize().cast::<f32>().into()).collect(),
            weight: order.iter().map(|&(_, i)| weights.map_or(1.0, |w| w[i as usize] / mean)).collect(),
            code: order.iter().map(|&(c, _)| c).collect(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.code.len()
    }

    /// Unit outward normal.
    #[inline]
    pub(super) fn normal(&self, sample: usize) -> [f32; 3] {
        self.normals[sample]
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

/// Indices of points in the order of an octree over their box: neighbours in space are mostly neighbours in the order.
pub(in crate::surface) fn octree_order(points: &[Point]) -> Vec<u32> {
    let bounds = Aabb::of(points).unwrap_or(Aabb { min: Point::origin(), max: Point::origin() });
    let edge = bounds.size().max().max(f64::MIN_POSITIVE);
    let mut order: Vec<(u64, u32)> =
        points.par_iter().enumerate().map(|(i, p)| (code(((p - bounds.min) / edge).into()), i as u32)).collect();
    order.par_sort_unstable();
    order.into_iter().map(|o| o.1).collect()
}

/// Coordinates of a lattice node or of the cell above it; nodes just outside the domain have −1.
pub(super) type Cell = [i16; 3];

/// The cell of a depth that holds a place of the unit cube, and where in the cell it is (0 to 1 along each axis).
#[inline]
pub(super) fn locate(place: [f64; 3], depth: u32) -> (Cell, [f64; 3]) {
    let n = (1_u32 << depth) as f64;
    let scaled = place.map(|c| c * n);
    // Truncation is the floor of what is not negative, and what is ends in cell 0 either way.
    let cell = scaled.map(|c| (c as i32).clamp(0, n as i32 - 1));
    (cell.map(|c| c as i16), std::array::from_fn(|k| scaled[k] - f64::from(cell[k])))
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
    [gather(code) as i16, gather(code >> 1) as i16, gather(code >> 2) as i16]
}

/// A set of nodes of a cubic lattice, sorted by (z, y, x).
pub(super) struct Lattice {
    /// Cells along an axis: nodes run from 0 to this, or from −1 to one more.
    pub(super) cells: i16,
    /// The nodes.
    pub(super) nodes: Vec<Cell>,
    /// Start of each row in `nodes`, y faster than z, both from −1; and the end.
    rows: Vec<u32>,
}

impl Lattice {
    /// The lattice of the sorted, distinct keys.
    pub(super) fn new(depth: u32, keys: &[u64]) -> Self {
        let cells = 1_i16 << depth;
        let side = Self::side_of(cells);
        let nodes: Vec<Cell> = keys.par_iter().map(|&k| unpack(k)).collect();
        let mut rows = vec![0_u32; side * side + 1];
        for n in &nodes {
            rows[(n[2] + 1) as usize * side + (n[1] + 1) as usize + 1] += 1;
        }
        for r in 0..side * side {
            rows[r + 1] += rows[r];
        }
        Self { cells, nodes, rows }
    }

    /// Rows along an axis, those just outside included.
    fn side_of(cells: i16) -> usize {
        cells as usize + 3
    }

    pub(super) fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Where the nodes of row (y, z) are; both from −1 to one more than the cells.
    #[inline]
    pub(super) fn row(&self, y: i16, z: i16) -> Range<usize> {
        let row = (z + 1) as usize * Self::side_of(self.cells) + (y + 1) as usize;
        self.rows[row] as usize..self.rows[row + 1] as usize
    }

    /// Where the nodes of slab z are.
    pub(super) fn slab(&self, z: i16) -> Range<usize> {
        let side = Self::side_of(self.cells);
        let row = (z + 1) as usize * side;
        self.rows[row] as usize..self.rows[row + side] as usize
    }

    /// Index of a node.
    #[inline]
    pub(super) fn find(&self, [x, y, z]: Cell) -> Option<usize> {
        let row = self.row(y, z);
        let at = row.start + self.nodes[row.clone()].partition_point(|n| n[0] < x);
        (at < row.end && self.nodes[at][0] == x).then_some(at)
    }

    /// Indices of the first of the two corners in each of a cell's four rows (bits y, z), if all eight are in the set.
    #[inline]
    pub(super) fn corner_rows(&self, [x, y, z]: Cell) -> Option<[u32; 4]> {
        let mut corners = [0; 4];
        for (row, (dy, dz)) in [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().enumerate() {
            let first = self.find([x, y + dy, z + dz])?;
            // The next node along x, if present, is the next in memory.
            let next = self.nodes.get(first + 1)?;
            if *next != [x + 1, y + dy, z + dz] {
                return None;
            }
            corners[row] = first as u32;
        }
        Some(corners)
    }

    /// Node indices and coordinates, cut into the slabs of equal z, for work on disjoint parts of `values`.
    pub(super) fn slabs_mut<'a, T>(&self, mut values: &'a mut [T]) -> Vec<(i16, &'a mut [T])> {
        let mut slabs = Vec::with_capacity(Self::side_of(self.cells));
        for z in -1..=self.cells + 1 {
            let (slab, rest) = values.split_at_mut(self.slab(z).len());
            slabs.push((z, slab));
            values = rest;
        }
        slabs
    }
}

/// Index of the corner with bits x, y, z among the rows of [`Lattice::corner_rows`].
#[inline]
pub(super) fn corner(rows: &[u32; 4], corner: usize) -> usize {
    rows[corner >> 1] as usize + (corner & 1)
}

const FIELD: u32 = 20;
const MASK: u64 = (1 << FIELD) - 1;
/// Added to coordinates in keys, which are unsigned.
const BIAS: i16 = 1;

#[inline]
fn pack(node: Cell) -> u64 {
    let [x, y, z] = node.map(|c| (c + BIAS) as u64);
    z << (2 * FIELD) | y << FIELD | x
}

#[inline]
fn unpack(key: u64) -> Cell {
    [0, 1, 2].map(|axis| ((key >> (axis * FIELD)) & MASK) as i16 - BIAS)
}

/// Sorted keys of all nodes with coordinates in the range.
pub(super) fn all_keys(range: RangeInclusive<i16>) -> Vec<u64> {
    let (low, high) = (*range.start(), *range.end());
    (low..=high).flat_map(|z| (low..=high).flat_map(move |y| (low..=high).map(move |x| pack([x, y, z])))).collect()
}

/// Sorted keys of the cells themselves.
pub(super) fn cell_keys(cells: impl Iterator<Item = Cell>) -> Vec<u64> {
    let mut keys: Vec<u64> = cells.map(pack).collect();
    keys.par_sort_unstable();
    keys.dedup();
    keys
}

/// Sorted keys of the corners of the cells.
pub(super) fn corner_keys(mut keys: Vec<u64>) -> Vec<u64> {
    for axis in 0..3 {
        keys = merged(&keys, axis, &[0, 1], &(i16::MIN..=i16::MAX));
    }
    keys
}

/// The set grown by one node in every direction (diagonals included), kept within the range of coordinates.
pub(super) fn grown(mut keys: Vec<u64>, range: RangeInclusive<i16>) -> Vec<u64> {
    for axis in 0..3 {
        keys = merged(&keys, axis, &[-1, 0, 1], &range);
    }
    keys
}

/// Keys with every coordinate within the range.
pub(super) fn within(keys: &[u64], range: &RangeInclusive<i16>) -> Vec<u64> {
    keys.iter().copied().filter(|&k| unpack(k).iter().all(|c| range.contains(c))).collect()
}

/// The union of copies of the set moved by each of the steps along an axis, where the moved coordinate stays within the range.
fn merged(keys: &[u64], axis: u32, steps: &[i64], range: &RangeInclusive<i16>) -> Vec<u64> {
    let at = |k: u64| ((k >> (axis * FIELD)) & MASK) as i64 - i64::from(BIAS);
    let (low, high) = (i64::from(*range.start()), i64::from(*range.end()));
    let moved = |k: u64, step: i64| k.wrapping_add_signed(step << (axis * FIELD));
    // A moved copy is sorted as the set is: merge by the smallest head.
    let mut heads = vec![0; steps.len()];
    let mut out: Vec<u64> = Vec::with_capacity(keys.len() * 3 / 2);
    loop {
        let mut least = u64::MAX;
        for (head, &step) in heads.iter_mut().zip(steps) {
            while *head < keys.len() && !(low..=high).contains(&(at(keys[*head]) + step)) {
                *head += 1;
            }
            if let Some(&k) = keys.get(*head) {
                least = least.min(moved(k, step));
            }
        }
        if least == u64::MAX {
            return out;
        }
        for (head, &step) in heads.iter_mut().zip(steps) {
            *head += usize::from(keys.get(*head).is_some_and(|&k| moved(k, step) == least));
        }
        out.push(least);
    }
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
        let keys = grown(vec![pack([5, 5, 5])], 0..=8);
        assert_eq!(keys, all_keys(4..=6));
        assert_eq!(grown(vec![pack([0, 0, 0])], 0..=8), all_keys(0..=1));
        assert_eq!(grown(vec![pack([0, 0, 0])], -1..=8), all_keys(-1..=1));
        assert_eq!(corner_keys(vec![pack([3, 3, 3])]), all_keys(3..=4));
        assert_eq!(within(&all_keys(0..=8), &(1..=7)), all_keys(1..=7));
    }

    #[test]
    fn a_lattice_finds_exactly_its_nodes() {
        let lattice = Lattice::new(3, &grown(vec![pack([2, 3, 4])], 0..=8));
        assert_eq!(lattice.len(), 27);
        assert_eq!(lattice.find([1, 2, 3]), Some(0));
        assert_eq!(lattice.find([4, 3, 4]), None);
        assert!(lattice.corner_rows([1, 2, 3]).is_some_and(|c| lattice.nodes[corner(&c, 7)] == [2, 3, 4]));
        assert!(lattice.corner_rows([3, 3, 4]).is_none());
        assert_eq!((lattice.row(3, 4), lattice.slab(4)), (12..15, 9..18));
        let mut values: Vec<usize> = (0..27).collect();
        let slabs = lattice.slabs_mut(&mut values);
        assert_eq!(slabs.iter().map(|(_, s)| s.len()).sum::<usize>(), 27);
        assert!(slabs.iter().any(|(z, s)| *z == 5 && s[0] == 18));
    }

    #[test]
    fn cells_group_every_sample_once() {
        let points: Vec<Point> =
            (0..200).map(|i| Point::new((i * 37 % 200) as f64, (i * 91 % 200) as f64, (i % 17) as f64)).collect();
        let normals = vec![Vector::z(); 200];
        let chosen: Vec<u32> = (0..200).collect();
        let samples = Samples::new(&points, &normals, None, &chosen, Point::new(-1.0, -1.0, -1.0), 210.0);
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
