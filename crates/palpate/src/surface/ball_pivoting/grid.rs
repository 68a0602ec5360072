use crate::geometry::Point;
use rayon::prelude::*;

/// Points in cubic cells, found again through a hash of the cell: memory does not depend on the extent.
pub(super) struct Grid {
    cell_size: f64,
    /// First entry of each bucket; one more at the end.
    starts: Vec<u32>,
    /// Sorted by bucket, then by index.
    entries: Vec<Entry>,
}

#[derive(Clone, Copy)]
struct Entry {
    cell: [i32; 3],
    index: u32,
    point: Point,
}

impl Grid {
    /// Sorts the points into cells, O(n).
    pub(super) fn new(points: &[Point], cell_size: f64) -> Self {
        let buckets = points.len().next_power_of_two().max(BLOCK);
        let cells: Vec<[i32; 3]> = points.iter().map(|p| cell_of(p, cell_size)).collect();
        let mut starts = vec![0_u32; buckets + 1];
        for &cell in &cells {
            starts[bucket(cell, buckets) + 1] += 1;
        }
        for b in 0..buckets {
            starts[b + 1] += starts[b];
        }
        let mut next = starts.clone();
        let mut entries = vec![Entry { cell: [0; 3], index: 0, point: Point::origin() }; points.len()];
        for (index, (&cell, &point)) in cells.iter().zip(points).enumerate() {
            let slot = &mut next[bucket(cell, buckets)];
            entries[*slot as usize] = Entry { cell, index: index as u32, point };
            *slot += 1;
        }
        Self { cell_size, starts, entries }
    }

    /// Calls `visit(index, point, squared distance)` for every point nearer than `radius`, until it returns `false`.
    pub(super) fn within(&self, center: &Point, radius: f64, mut visit: impl FnMut(u32, &Point, f64) -> bool) {
        let margin = nalgebra::Vector3::repeat(radius);
        let (low, high) = (cell_of(&(center - margin), self.cell_size), cell_of(&(center + margin), self.cell_size));
        let buckets = self.starts.len() - 1;
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let cell = [x, y, z];
                    let b = bucket(cell, buckets);
                    for e in &self.entries[self.starts[b] as usize..self.starts[b + 1] as usize] {
                        let distance = (e.point - center).norm_squared();
                        if e.cell == cell && distance < radius * radius && !visit(e.index, &e.point, distance) {
                            return;
                        }
                    }
                }
            }
        }
    }
}

impl Grid {
    /// What `f` makes of each point (its index and place) and what `with` holds for all points of another grid, of equal cells, in its cell and the 26 cells
    /// round it; in the order of the points. Points of a cell share the search.
    pub(super) fn map_near<W: Copy + Sync, T: Copy + Send>(
        &self,
        others: &Self,
        with: &[W],
        f: impl Fn(usize, &Point, &[W]) -> T + Sync,
    ) -> Vec<T> {
        let visit = |part: &[Entry]| {
            let (mut near, mut near_to) = (Vec::new(), None);
            let mut made = Vec::with_capacity(part.len());
            for e in part {
                if near_to != Some(e.cell) {
                    near.clear();
                    others.each_around(e.cell, |n| near.push(with[n.index as usize]));
                    near_to = Some(e.cell);
                }
                made.push((e.index, f(e.index as usize, &e.point, &near)));
            }
            made
        };
        let mut made: Vec<(u32, T)> = self.entries.par_chunks(1024).flat_map_iter(visit).collect();
        made.par_sort_unstable_by_key(|m| m.0);
        made.into_iter().map(|m| m.1).collect()
    }

    fn each_around(&self, cell: [i32; 3], mut visit: impl FnMut(&Entry)) {
        let buckets = self.starts.len() - 1;
        for step in 0..27 {
            let at: [i32; 3] = std::array::from_fn(|k| cell[k].saturating_add(step / 3_i32.pow(k as u32) % 3 - 1));
            let b = bucket(at, buckets);
            let members = &self.entries[self.starts[b] as usize..self.starts[b + 1] as usize];
            members.iter().filter(|e| e.cell == at).for_each(&mut visit);
        }
    }
}

/// Saturates far out: such points share a cell, which is slow but right.
fn cell_of(p: &Point, cell_size: f64) -> [i32; 3] {
    [0, 1, 2].map(|i| (p[i] / cell_size).floor() as i32)
}

/// Cells of a block of 4 × 4 × 4, which are neighbours in memory too.
const BLOCK: usize = 64;

fn bucket(cell: [i32; 3], buckets: usize) -> usize {
    let mix = |h: u64, c: i32| (h ^ (c >> 2) as u32 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
    let block = (cell.into_iter().fold(0x2545_F491_4F6C_DD1D, mix) >> 20) as usize * BLOCK;
    let [x, y, z] = cell.map(|c| (c & 3) as usize);
    (block | z << 4 | y << 2 | x) & (buckets - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_what_a_scan_finds() {
        let points: Vec<Point> = (0..500)
            .map(|i| i as f64)
            .map(|i| Point::new((i * 12.9898).sin(), (i * 78.233).sin(), (i * 37.719).sin()) * 2.0)
            .collect();
        for cell in [0.05, 0.4, 9.0, 1e-12] {
            let grid = Grid::new(&points, cell);
            for radius in [0.02, 0.3, 0.7] {
                if radius / cell > 100.0 {
                    continue;
                }
                let center = points[17];
                let mut found = Vec::new();
                grid.within(&center, radius, |i, _, _| {
                    found.push(i as usize);
                    true
                });
                found.sort_unstable();
                let expected: Vec<usize> = (0..500).filter(|&i| (points[i] - center).norm() < radius).collect();
                assert_eq!(found, expected);
            }
        }
    }
}
