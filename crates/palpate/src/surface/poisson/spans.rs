//! Sets of lattice nodes as spans along x: a surface's band is a few spans a row, so that growing and joining sets costs little a node.

use super::octree::Cell;
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// A set of nodes with coordinates from −1 to one more than the domain's cells.
pub(super) struct Spans {
    /// Cells along an axis of the domain.
    cells: i16,
    /// Start of each row in `spans`, y faster than z; and the end.
    starts: Vec<u32>,
    /// First node of each span and the one behind its last; neither touching nor overlapping in a row.
    spans: Vec<(i16, i16)>,
}

impl Spans {
    /// All nodes with coordinates in the range.
    pub(super) fn full(cells: i16, range: &RangeInclusive<i16>) -> Self {
        Self::by_rows(cells, |y, z, row| {
            if range.contains(&y) && range.contains(&z) {
                row.push((*range.start(), range.end() + 1));
            }
        })
    }

    /// The cells themselves, or the first node of each. O(n log n).
    pub(super) fn of(cells: i16, members: impl Iterator<Item = Cell>) -> Self {
        let mut sorted: Vec<u64> = members.map(|[x, y, z]| (z as u64) << 32 | (y as u64) << 16 | x as u64).collect();
        sorted.par_sort_unstable();
        let x = |key: u64| key as i16;
        let row_starts = |z: i16| sorted.partition_point(|k| (k >> 32) < z.max(0) as u64);
        Self::by_slabs(cells, |z, slab| {
            let mut rest = &sorted[row_starts(z)..if z < 0 { 0 } else { row_starts(z + 1) }];
            for y in -1..=cells + 1 {
                let len = if y < 0 { 0 } else { rest.partition_point(|k| (k >> 16) as u16 <= y as u16) };
                let (row, after) = rest.split_at(len);
                slab.row(row.iter().map(|&k| (x(k), x(k) + 1)));
                rest = after;
            }
        })
    }

    /// Every node moved by each of the steps along each axis, as far as its coordinates stay within the range.
    pub(super) fn grown(&self, steps: &RangeInclusive<i16>, range: &RangeInclusive<i16>) -> Self {
        let (low, high) = (*steps.start(), *steps.end());
        let within = |(start, end): (i16, i16)| ((start + low).max(*range.start()), (end + high).min(range.end() + 1));
        let back = |c: i16| (c - high).max(-1)..=(c - low).min(self.cells + 1);
        let in_plane = Self::by_rows(self.cells, |y, z, row| {
            if range.contains(&y) {
                back(y).for_each(|from| row.extend(self.row(from, z).iter().map(|&s| within(s)).filter(|s| s.0 < s.1)));
            }
        });
        Self::by_rows(self.cells, |y, z, row| {
            if range.contains(&z) {
                back(z).for_each(|from| row.extend(in_plane.row(y, from)));
            }
        })
    }

    /// The nodes with every coordinate within the range.
    pub(super) fn within(&self, range: &RangeInclusive<i16>) -> Self {
        self.grown(&(0..=0), range)
    }

    /// The spans of row (y, z).
    pub(super) fn row(&self, y: i16, z: i16) -> &[(i16, i16)] {
        let row = (z + 1) as usize * (self.cells as usize + 3) + (y + 1) as usize;
        &self.spans[self.starts[row] as usize..self.starts[row + 1] as usize]
    }

    /// First node and length of every span, by z, y and x.
    pub(super) fn list(&self) -> Vec<(Cell, u32)> {
        let span = |y: i16, z: i16, &(start, end): &(i16, i16)| ([start, y, z], (end - start) as u32);
        let rows = |z| (-1..=self.cells + 1).flat_map(move |y| self.row(y, z).iter().map(move |s| span(y, z, s)));
        (-1..=self.cells + 1).into_par_iter().flat_map_iter(rows).collect()
    }

    /// The rows made by `fill(y, z, spans)`, which may overlap and be out of order.
    fn by_rows(cells: i16, fill: impl Fn(i16, i16, &mut Vec<(i16, i16)>) + Sync) -> Self {
        Self::by_slabs(cells, |z, slab| {
            let mut row = Vec::new();
            for y in -1..=cells + 1 {
                row.clear();
                fill(y, z, &mut row);
                row.sort_unstable();
                slab.row(row.iter().copied());
            }
        })
    }

    /// The slabs of equal z made by `fill`, in parallel.
    fn by_slabs(cells: i16, fill: impl Fn(i16, &mut Slab) + Sync) -> Self {
        let slab = |z| {
            let mut slab = Slab::default();
            fill(z, &mut slab);
            slab
        };
        let slabs: Vec<Slab> = (-1..=cells + 1).into_par_iter().map(slab).collect();
        let mut starts = vec![0];
        let mut before = 0;
        for slab in &slabs {
            starts.extend(slab.ends.iter().map(|end| before + end));
            before += slab.spans.len() as u32;
        }
        Self { cells, starts, spans: slabs.into_iter().flat_map(|s| s.spans).collect() }
    }
}

/// Rows of equal z.
#[derive(Default)]
struct Slab {
    ends: Vec<u32>,
    spans: Vec<(i16, i16)>,
}

impl Slab {
    /// Adds the next row, of spans by their start.
    fn row(&mut self, spans: impl Iterator<Item = (i16, i16)>) {
        let first = self.spans.len();
        for (start, end) in spans {
            match self.spans[first..].last_mut() {
                Some(last) if start <= last.1 => last.1 = last.1.max(end),
                _ => self.spans.push((start, end)),
            }
        }
        self.ends.push(self.spans.len() as u32);
    }
}

/// The nodes of a span.
pub(super) fn nodes_of((start, end): (i16, i16)) -> Range<i16> {
    start..end
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nodes(spans: &Spans) -> Vec<Cell> {
        let along = |([x, y, z], len): (Cell, u32)| (x..x + len as i16).map(move |x| [x, y, z]);
        spans.list().into_iter().flat_map(along).collect()
    }

    fn block(range: RangeInclusive<i16>) -> Vec<Cell> {
        let n = range;
        n.clone()
            .flat_map(|z| {
                n.clone().flat_map({
                    let n = n.clone();
                    move |y| n.clone().map(move |x| [x, y, z])
                })
            })
            .collect()
    }

    #[test]
    fn growing_a_node_gives_its_27_neighbours_and_stops_at_the_border() {
        let grown = |node: Cell, range| nodes(&Spans::of(8, [node].into_iter()).grown(&(-1..=1), &range));
        assert_eq!(grown([5, 5, 5], 0..=8), block(4..=6));
        assert_eq!(grown([0, 0, 0], 0..=8), block(0..=1));
        assert_eq!(grown([0, 0, 0], -1..=8), block(-1..=1));
        assert_eq!(grown([8, 8, 8], -1..=9), block(7..=9));
        assert_eq!(nodes(&Spans::of(8, [[3, 3, 3]].into_iter()).grown(&(0..=1), &(0..=8))), block(3..=4));
        assert_eq!(nodes(&Spans::full(8, &(0..=8)).within(&(1..=7))), block(1..=7));
        assert!(nodes(&Spans::of(8, std::iter::empty())).is_empty());
    }

    #[test]
    fn spans_of_scattered_nodes_are_those_nodes() {
        let mut scattered: Vec<Cell> =
            (0..300_i32).map(|i| [i * 37 % 17, i * 91 % 16, i % 17].map(|c| c as i16)).collect();
        let spans = Spans::of(16, scattered.iter().copied());
        scattered.sort_unstable_by_key(|&[x, y, z]| (z, y, x));
        scattered.dedup();
        assert_eq!(nodes(&spans), scattered);
        let mut grown: Vec<Cell> = block(-1..=17)
            .into_iter()
            .filter(|n| scattered.iter().any(|s| (0..3).all(|k| (-1..=2).contains(&(n[k] - s[k])))))
            .filter(|n| n.iter().all(|c| (0..=15).contains(c)))
            .collect();
        grown.sort_unstable_by_key(|&[x, y, z]| (z, y, x));
        assert_eq!(nodes(&spans.grown(&(-1..=2), &(0..=15))), grown);
    }
}
