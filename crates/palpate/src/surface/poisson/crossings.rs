//! The cells of the finest lattice that the surface enters, of the components that pass near a sample.
//!
//! Most are in the band of cells whose eight corners are nodes: those are listed row by row in parallel, and joined into components. Only where the surface
//! leaves the band is it followed cell by cell.

use super::octree::{Cell, Lattice};
use crate::geometry::UnionFind;
use crate::surface::isosurface::{FACE_MASKS, KeyHasher, cell_case, pack};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// The surface does not enter the cell.
const NONE: u32 = u32::MAX;

/// A cell of the band that the surface enters.
struct Entered {
    cell: Cell,
    case: u8,
    /// Its first node, and those one on along y and z.
    nodes: [u32; 3],
}

/// Where a cell is.
enum Place {
    /// In the band: which of its cells that the surface enters.
    Band(u32),
    /// Beyond the band.
    Beyond([i32; 3]),
    /// Outside the domain.
    Off,
}

/// The cells with 0 ≤ x, y, z < size that the zero surface of `value` enters, by z, y and x, with their sign patterns: the components that touch a seed, found
/// through cell faces that the surface crosses.
///
/// * `inside` – whether each node of the lattice is: `value` is negative there
///
/// O(nodes) in parallel, then O(cells).
pub(super) fn entered_cells(
    lattice: &Lattice,
    inside: &[bool],
    seeds: &[[i32; 3]],
    value: impl Fn([i32; 3]) -> f64,
) -> Vec<([i32; 3], u8)> {
    let size = i32::from(lattice.cells);
    let band: Vec<Entered> =
        (0..lattice.cells).into_par_iter().flat_map_iter(|z| entered_slab(lattice, inside, z)).collect();
    let mut at_node = vec![NONE; lattice.len()];
    for (i, entered) in band.iter().enumerate() {
        at_node[entered.nodes[0] as usize] = i as u32;
    }
    let (component, exits) = components(&band, &at_node, size);
    let place = |&cell: &[i32; 3]| {
        let within = cell.iter().all(|c| (0..size).contains(c));
        let rows = within.then(|| lattice.corner_rows(cell.map(|c| c as i16)));
        rows.map_or(Place::Off, |rows| rows.map_or(Place::Beyond(cell), |rows| Place::Band(at_node[rows[0] as usize])))
    };
    let mut live = vec![false; band.len()];
    let mut beyond: HashMap<u64, (), BuildHasherDefault<KeyHasher>> = HashMap::default();
    let mut queue: Vec<Place> = seeds.par_iter().with_min_len(1024).map(place).collect();
    let mut found = Vec::new();
    while let Some(at) = queue.pop() {
        match at {
            Place::Off | Place::Band(NONE) => {}
            Place::Band(i) => {
                let own = component[i as usize];
                if !std::mem::replace(&mut live[own as usize], true) {
                    let first = exits.partition_point(|e| e.0 < own);
                    queue.extend(exits[first..].iter().take_while(|e| e.0 == own).map(|e| place(&e.1)));
                }
            }
            Place::Beyond(cell) => {
                if beyond.insert(pack(cell), ()).is_none() {
                    let case = cell_case(cell, &value);
                    if case != 0 && case != 255 {
                        found.push((cell, case));
                        queue.extend(crossed_faces(case).map(|(axis, side)| place(&beside(cell, axis, side))));
                    }
                }
            }
        }
    }
    let in_band = band.iter().zip(&component).filter(|(_, c)| live[**c as usize]);
    let mut cells: Vec<([i32; 3], u8)> = in_band.map(|(e, _)| (e.cell.map(i32::from), e.case)).collect();
    if !found.is_empty() {
        cells.extend(found);
        cells.par_sort_unstable_by_key(|&([x, y, z], _)| (z, y, x));
    }
    cells
}

/// The band's cells of a slab that the surface enters.
fn entered_slab(lattice: &Lattice, inside: &[bool], z: i16) -> Vec<Entered> {
    let mut found = Vec::new();
    for y in 0..lattice.cells {
        let mut rows = [lattice.row(y, z), lattice.row(y + 1, z), lattice.row(y, z + 1), lattice.row(y + 1, z + 1)];
        // Signs of the four nodes of equal x, at the place of those of the cell above them.
        let mut last: Option<(i16, u8, [u32; 3])> = None;
        for node in rows[0].clone() {
            let x = lattice.nodes[node][0];
            let mut signs = 0;
            let mut complete = true;
            for (k, row) in rows.iter_mut().enumerate() {
                while row.start < row.end && lattice.nodes[row.start][0] < x {
                    row.start += 1;
                }
                complete &= row.start < row.end && lattice.nodes[row.start][0] == x;
                signs |= u8::from(complete && inside[row.start]) << (2 * k);
            }
            if !complete {
                last = None;
                continue;
            }
            if let Some((before, low, nodes)) = last
                && before + 1 == x
                && (0..lattice.cells).contains(&before)
            {
                let case = low | signs << 1;
                if case != 0 && case != 255 {
                    found.push(Entered { cell: [before, y, z], case, nodes });
                }
            }
            last = Some((x, signs, [0, 1, 2].map(|k| rows[k].start as u32)));
        }
    }
    found
}

/// The component of each of the band's cells, and where the surface leaves the band: component and the cell beyond, by component.
fn components(band: &[Entered], at_node: &[u32], size: i32) -> (Vec<u32>, Vec<(u32, [i32; 3])>) {
    let mut sets = UnionFind::new(band.len());
    // Faces through which another cell of the band has been reached: bits 2 · axis + side.
    let mut joined = vec![0_u8; band.len()];
    for (i, entered) in band.iter().enumerate() {
        let next = [entered.nodes[0] + 1, entered.nodes[1], entered.nodes[2]];
        for (axis, side) in crossed_faces(entered.case).filter(|f| f.1 == 1) {
            let other = at_node[next[axis] as usize];
            if other != NONE {
                sets.union(i as u32, other);
                joined[i] |= 1 << (2 * axis + side);
                joined[other as usize] |= 1 << (2 * axis);
            }
        }
    }
    let component: Vec<u32> = (0..band.len() as u32).map(|i| sets.find(i)).collect();
    let mut exits = Vec::new();
    for ((entered, joined), own) in band.iter().zip(&joined).zip(&component) {
        for (axis, side) in crossed_faces(entered.case).filter(|(axis, side)| joined >> (2 * axis + side) & 1 == 0) {
            let beyond = beside(entered.cell.map(i32::from), axis, side);
            if (0..size).contains(&beyond[axis]) {
                exits.push((*own, beyond));
            }
        }
    }
    exits.sort_unstable();
    (component, exits)
}

/// Axis and side of the faces that the surface crosses.
fn crossed_faces(case: u8) -> impl Iterator<Item = (usize, usize)> {
    let crosses = move |&(axis, side): &(usize, usize)| {
        let on_face = case & FACE_MASKS[axis][side];
        on_face != 0 && on_face != FACE_MASKS[axis][side]
    };
    [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)].into_iter().filter(crosses)
}

fn beside(mut cell: [i32; 3], axis: usize, side: usize) -> [i32; 3] {
    cell[axis] += 2 * side as i32 - 1;
    cell
}

#[cfg(test)]
mod tests {
    use super::super::spans::Spans;
    use super::*;
    use crate::surface::crossing_cells;
    use crate::surface::isosurface::cell_case;

    #[test]
    fn the_cells_are_those_that_following_the_surface_finds_in_and_out_of_the_band() {
        // Two spheres, one of which leaves the band: a block of nodes in the middle of 16³ cells.
        let distance =
            |c: [i32; 3], centre: [f64; 3]| (0..3).map(|k| (f64::from(c[k]) - centre[k]).powi(2)).sum::<f64>().sqrt();
        let value = |c: [i32; 3]| {
            if c.iter().any(|i| *i <= 0 || *i >= 16) {
                return 1.0;
            }
            (distance(c, [5.2, 8.1, 7.9]) - 3.4).min(distance(c, [11.5, 8.0, 8.0]) - 1.7)
        };
        let lattice = Lattice::new(4, &Spans::full(16, &(4..=12)));
        let inside: Vec<bool> = lattice.nodes.iter().map(|n| value(n.map(i32::from)) < 0.0).collect();
        for seeds in
            [vec![[8, 8, 8]], vec![[1, 8, 8]], vec![[12, 8, 8]], vec![[8, 8, 8], [13, 8, 8], [99, 0, 0]], vec![]]
        {
            let mut expected: Vec<([i32; 3], u8)> =
                crossing_cells(&seeds, 16, value).into_iter().map(|c| (c, cell_case(c, &value))).collect();
            expected.sort_unstable_by_key(|&([x, y, z], _)| (z, y, x));
            assert_eq!(entered_cells(&lattice, &inside, &seeds, value), expected, "{seeds:?}");
        }
    }
}
