//! The mesh of sorted cells that the surface enters: vertices are numbered without a table of edges, cell by cell in parallel.
//!
//! A lattice edge that the surface crosses belongs to the first of the four cells round it, where it is the last of the four along its axis; so a cell
//! makes the vertices of three of its edges at most, and a running count of those numbers them all.

use super::isosurface::{CASES, Loop, edge_start, edge_vertex};
use crate::geometry::{Point, TriangleMesh};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::LazyLock;

/// A cell and its sign pattern.
pub(super) type Crossed = ([i32; 3], u8);

/// No such cell.
const NONE: u32 = u32::MAX;

/// Rows of cells that a thread takes on at a time.
const ROWS: usize = 32;

/// For each edge of a cell: where its owner is (bits x, y, z: one cell back) and its axis.
static OWNERS: LazyLock<[(usize, usize); 12]> = LazyLock::new(|| {
    std::array::from_fn(|edge| {
        let (start, axis) = edge_start(edge as u8);
        (usize::from(!start & 7) & !(1 << axis), axis)
    })
});

/// For each sign pattern: how many vertices the cell makes, and which of them lies on its last edge along each axis.
static MADE: LazyLock<Vec<(u32, [u32; 3])>> = LazyLock::new(|| {
    let made = |loops: &Vec<Loop>| {
        let (mut count, mut rank) = (0, [NONE; 3]);
        for &edge in loops.iter().flat_map(|l| &l.edges) {
            let (owner, axis) = OWNERS[edge as usize];
            if owner == 0 {
                rank[axis] = count;
                count += 1;
            }
        }
        (count, rank)
    };
    CASES.iter().map(made).collect()
});

/// The mesh of [`super::extract_isosurface`], vertex by vertex; `None` if a cell that the surface enters is missing.
///
/// * `crossed` – distinct, by z, y and x
///
/// O(cells), in parallel.
pub(super) fn complete_mesh(
    crossed: &[Crossed],
    value: &(impl Fn([i32; 3]) -> f64 + Sync),
    position: &(impl Fn([i32; 3]) -> Point + Sync),
) -> Option<TriangleMesh> {
    let rows = Rows::new(crossed);
    let mut count = 0;
    let first: Vec<u32> = crossed
        .iter()
        .map(|&(_, case)| {
            count += MADE[case as usize].0;
            count - MADE[case as usize].0
        })
        .collect();
    let vertices_of = |&(cell, case): &Crossed| {
        let edges = CASES[case as usize].iter().flat_map(|l| &l.edges).filter(|&&edge| OWNERS[edge as usize].0 == 0);
        edges.map(move |&edge| edge_vertex(cell, edge, value, position))
    };
    let vertices: Vec<Point> = crossed.par_iter().with_min_len(1024).flat_map_iter(vertices_of).collect();
    let faces_of = |part: Range<usize>| -> Option<Vec<[u32; 3]>> {
        let mut faces = Vec::new();
        for row in part {
            rows.walk(crossed, row, |cell, owners| {
                for face_loop in &CASES[crossed[cell].1 as usize] {
                    let mut ids = [0_u32; 12];
                    for (id, &edge) in ids.iter_mut().zip(&face_loop.edges) {
                        let (back, axis) = OWNERS[edge as usize];
                        let owner = Some(owners[back] as usize).filter(|&o| o != NONE as usize)?;
                        *id = first[owner] + MADE[crossed[owner].1 as usize].1[axis];
                    }
                    face_loop.push_triangles(&ids, &vertices, &mut faces);
                }
                Some(())
            })?;
        }
        Some(faces)
    };
    let parts: Vec<Range<usize>> =
        (0..rows.len()).step_by(ROWS).map(|start| start..(start + ROWS).min(rows.len())).collect();
    let faces: Option<Vec<Vec<[u32; 3]>>> = parts.into_par_iter().map(faces_of).collect();
    Some(TriangleMesh { vertices, faces: faces?.concat(), colors: None })
}

/// Where rows of cells along x begin, and one more at the end.
struct Rows {
    starts: Vec<usize>,
    /// (z, y) of each.
    places: Vec<(i32, i32)>,
}

impl Rows {
    fn new(crossed: &[Crossed]) -> Self {
        let place = |i: usize| (crossed[i].0[2], crossed[i].0[1]);
        let begins = |&i: &usize| i == 0 || place(i) != place(i - 1);
        let mut starts: Vec<usize> = (0..crossed.len()).into_par_iter().with_min_len(4096).filter(begins).collect();
        let places = starts.iter().map(|&i| place(i)).collect();
        starts.push(crossed.len());
        Self { starts, places }
    }

    fn len(&self) -> usize {
        self.places.len()
    }

    /// The cells of the row at a place; none if there is no such row.
    fn at(&self, place: (i32, i32)) -> Range<usize> {
        self.places.binary_search(&place).map_or(0..0, |row| self.starts[row]..self.starts[row + 1])
    }

    /// Calls `visit(cell, cells one back by the bits x, y, z, itself first)` for the cells of a row, until it returns `None`.
    fn walk(
        &self,
        crossed: &[Crossed],
        row: usize,
        mut visit: impl FnMut(usize, &[u32; 8]) -> Option<()>,
    ) -> Option<()> {
        let (z, y) = self.places[row];
        let own = self.starts[row]..self.starts[row + 1];
        let mut rows = [own.clone(), self.at((z, y - 1)), self.at((z - 1, y)), self.at((z - 1, y - 1))];
        for cell in own {
            let x = crossed[cell].0[0];
            let mut owners = [NONE; 8];
            for (k, row) in rows.iter_mut().enumerate() {
                while row.start < row.end && crossed[row.start].0[0] < x - 1 {
                    row.start += 1;
                }
                for i in row.clone().take(2) {
                    match x - crossed[i].0[0] {
                        0 => owners[2 * k] = i as u32,
                        1 => owners[2 * k + 1] = i as u32,
                        _ => {}
                    }
                }
            }
            visit(cell, &owners)?;
        }
        Some(())
    }
}
