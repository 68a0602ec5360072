//! The samples in octree order, and the nodes of each depth stored as a sparse lattice.
//!
//! No tree of pointers: a depth is the sorted list of its lattice nodes with a table of where each row (y, z) begins. A node's row neighbours are then
//! contiguous, so 9 indices name its 27 neighbours, and memory follows the surface (rows: 4 bytes · 4^depth, nodes: those near samples).

use super::spans::{Spans, nodes_of};
use crate::geometry::{Aabb, Point, Vector};
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// Least items that a thread takes on at a time where one is done in nanoseconds.
const GRAIN: usize = 4096;

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
    /// Cells of each depth that hold a sample.
    occupied: [usize; CODE_BITS as usize + 1],
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
            position: order.par_iter().map(|&(_, i)| unit(i)).collect(),
            normals: order.par_iter().map(|&(_, i)| normals[i as usize].normalize().cast::<f32>().into()).collect(),
            weight: order.par_iter().map(|&(_, i)| weights.map_or(1.0, |w| w[i as usize] / mean)).collect(),
            code: order.par_iter().map(|&(c, _)| c).collect(),
            occupied: occupied(&order),
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
        self.occupied[depth as usize]
    }

    /// The occupied cells of a depth, in octree order, with the samples in each.
    pub(super) fn cells(&self, depth: u32) -> Vec<(Cell, Range<usize>)> {
        let cell = |i: usize| self.code[i] >> (3 * (CODE_BITS - depth));
        let begins = |i: &usize| *i == 0 || cell(*i) != cell(i - 1);
        let starts: Vec<usize> = (0..self.len()).into_par_iter().with_min_len(GRAIN).filter(begins).collect();
        let one = |k: usize| (decode(cell(starts[k])), starts[k]..starts.get(k + 1).copied().unwrap_or(self.len()));
        (0..starts.len()).into_par_iter().with_min_len(GRAIN).map(one).collect()
    }
}

/// Cells of each depth that hold one of the sorted codes.
fn occupied(sorted: &[(u64, u32)]) -> [usize; CODE_BITS as usize + 1] {
    // Two neighbours lie in different cells from the depth on where their codes differ first.
    let mut parted = [0; CODE_BITS as usize + 1];
    for pair in sorted.windows(2) {
        let differs = pair[0].0 ^ pair[1].0;
        if differs != 0 {
            parted[(CODE_BITS - differs.ilog2() / 3) as usize] += 1;
        }
    }
    let mut count = usize::from(!sorted.is_empty());
    parted.map(|p| {
        count += p;
        count
    })
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
    [gather(code) as i16, gather(code >> 1) as i16, gather(code >> 2) as i16]
}

/// Every third of the low 63 bits: undoes [`spread`].
fn gather(x: u64) -> u64 {
    let x = x & 0x1249_2492_4924_9249;
    let x = (x | x >> 2) & 0x10C3_0C30_C30C_30C3;
    let x = (x | x >> 4) & 0x100F_00F0_0F00_F00F;
    let x = (x | x >> 8) & 0x001F_0000_FF00_00FF;
    let x = (x | x >> 16) & 0x001F_0000_0000_FFFF;
    (x | x >> 32) & 0x001F_FFFF
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
    /// The lattice of a set of nodes.
    pub(super) fn new(depth: u32, set: &Spans) -> Self {
        let cells = 1_i16 << depth;
        let all = -1..=cells + 1;
        let mut rows = Vec::with_capacity(Self::side_of(cells).pow(2) + 1);
        rows.push(0);
        let mut count = 0;
        for (z, y) in all.clone().flat_map(|z| all.clone().map(move |y| (z, y))) {
            count += set.row(y, z).iter().map(|&s| nodes_of(s).len() as u32).sum::<u32>();
            rows.push(count);
        }
        let mut lattice = Self { cells, nodes: Vec::new(), rows };
        let mut nodes = vec![[0; 3]; count as usize];
        lattice.slabs_mut(&mut nodes).into_par_iter().for_each(|(z, slab)| {
            let along = |y: i16| set.row(y, z).iter().copied().flat_map(nodes_of).map(move |x| [x, y, z]);
            slab.iter_mut().zip(all.clone().flat_map(along)).for_each(|(slot, node)| *slot = node);
        });
        lattice.nodes = nodes;
        lattice
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

/// Adds to values at the nodes what cells leave there: in parallel over the slabs, but at each node in the order of the cells.
///
/// * `steps` – from a cell to the slabs that it adds to
/// * `add(values of a slab, its first node, step, number of the cell)`
pub(super) fn add_by_slabs<T: Send>(
    lattice: &Lattice,
    cells: &[(Cell, Range<usize>)],
    steps: &RangeInclusive<i16>,
    values: &mut [T],
    add: impl Fn(&mut [T], usize, i16, usize) + Sync,
) {
    let mut by_slab: Vec<(i16, u32)> = cells.iter().enumerate().map(|(i, (cell, _))| (cell[2], i as u32)).collect();
    by_slab.par_sort_unstable();
    let of_slab = |z: i16| &by_slab[by_slab.partition_point(|c| c.0 < z)..by_slab.partition_point(|c| c.0 <= z)];
    lattice.slabs_mut(values).into_par_iter().for_each(|(z, slab)| {
        let reaching = |step: i16| of_slab(z - step).iter().map(move |&(_, i)| (i, step));
        let mut order: Vec<(u32, i16)> = steps.clone().flat_map(reaching).collect();
        order.sort_unstable();
        let start = lattice.slab(z).start;
        for (i, step) in order {
            add(slab, start, step, i as usize);
        }
    });
}

/// Index of the corner with bits x, y, z among the rows of [`Lattice::corner_rows`].
#[inline]
pub(super) fn corner(rows: &[u32; 4], corner: usize) -> usize {
    rows[corner >> 1] as usize + (corner & 1)
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
    fn a_lattice_finds_exactly_its_nodes() {
        let lattice = Lattice::new(3, &Spans::of(8, [[2, 3, 4]].into_iter()).grown(&(-1..=1), &(0..=8)));
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
