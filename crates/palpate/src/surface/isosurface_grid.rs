//! The zero surface of a dense grid: the mesh of [`super::extract_isosurface`], vertex by vertex, without sorting and hashing.

use super::isosurface::{CASES, edge_start, edge_vertex};
use crate::geometry::{Point, TriangleMesh};
use rayon::prelude::*;

/// No vertex was made on this lattice edge.
const NONE: u32 = u32::MAX;

/// Extracts the surface where `values` (x fastest) change sign; negative inside, zero and NaN outside.
///
/// * `position` – of a lattice corner
///
/// Closed if the border is outside. O(nodes) comparisons, then O(surface).
pub(super) fn extract_grid(
    values: &[f32],
    dims: [usize; 3],
    position: impl Fn([i32; 3]) -> Point + Sync,
) -> TriangleMesh {
    let [nx, ny, nz] = dims;
    let crossed: Vec<Vec<([i32; 3], u8)>> =
        (0..nz.saturating_sub(1)).into_par_iter().map(|k| crossed_cells(values, dims, k)).collect();
    let count = crossed.iter().map(Vec::len).sum::<usize>();
    let (mut vertices, mut faces) = (Vec::with_capacity(count * 5 / 4), Vec::with_capacity(count * 5 / 2));
    let value = |c: [i32; 3]| f64::from(values[(c[2] as usize * ny + c[1] as usize) * nx + c[0] as usize]);
    let mut made = EdgeVertices::new(nx, ny);
    for layer in &crossed {
        for &(cell, case) in layer {
            for face_loop in &CASES[case as usize] {
                let mut ids = [0_u32; 12];
                for (id, &edge) in ids.iter_mut().zip(&face_loop.edges) {
                    let slot = made.slot(cell, edge);
                    if *slot == NONE {
                        *slot = vertices.len() as u32;
                        vertices.push(edge_vertex(cell, edge, &value, &position));
                    }
                    *id = *slot;
                }
                face_loop.push_triangles(&ids, &vertices, &mut faces);
            }
        }
        made.next_layer();
    }
    TriangleMesh { vertices, faces, colors: None }
}

/// The cells of layer `k` that the surface enters, with their sign patterns, in order.
fn crossed_cells(values: &[f32], [nx, ny, _]: [usize; 3], k: usize) -> Vec<([i32; 3], u8)> {
    let mut found = Vec::new();
    let mut signs = vec![0_u8; nx];
    for j in 0..ny - 1 {
        let row = |dj: usize, dk: usize| &values[((k + dk) * ny + j + dj) * nx..][..nx];
        let rows = [row(0, 0), row(1, 0), row(0, 1), row(1, 1)];
        for (i, s) in signs.iter_mut().enumerate() {
            // Corner bits are x, y, z; each of the four rows holds the corners of x = 0, and the next node those of x = 1.
            *s = u8::from(rows[0][i] < 0.0)
                | u8::from(rows[1][i] < 0.0) << 2
                | u8::from(rows[2][i] < 0.0) << 4
                | u8::from(rows[3][i] < 0.0) << 6;
        }
        for (i, s) in signs.windows(2).enumerate() {
            let case = s[0] | s[1] << 1;
            if case != 0 && case != 255 {
                found.push(([i as i32, j as i32, k as i32], case));
            }
        }
    }
    found
}

/// The vertices made on the lattice edges of one layer of cells: x- and y-edges of its two planes, z-edges between them.
struct EdgeVertices {
    nx: usize,
    /// x- and y-edges of the lower plane, of the upper one, then z-edges.
    tables: [Vec<u32>; 5],
    /// Entries in use of each table: only they are cleared.
    used: [Vec<u32>; 5],
}

impl EdgeVertices {
    fn new(nx: usize, ny: usize) -> Self {
        Self { nx, tables: [(); 5].map(|()| vec![NONE; nx * ny]), used: Default::default() }
    }

    fn slot(&mut self, [x, y, _]: [i32; 3], edge: u8) -> &mut u32 {
        let (start, axis) = edge_start(edge);
        let at = (y as usize + usize::from(start >> 1 & 1)) * self.nx + x as usize + usize::from(start & 1);
        let table = if axis == 2 { 4 } else { 2 * usize::from(start >> 2 & 1) + axis };
        let slot = &mut self.tables[table][at];
        if *slot == NONE {
            self.used[table].push(at as u32);
        }
        slot
    }

    /// The upper plane becomes the lower one.
    fn next_layer(&mut self) {
        for table in [0, 1, 4] {
            for at in self.used[table].drain(..) {
                self.tables[table][at as usize] = NONE;
            }
        }
        for axis in 0..2 {
            self.tables.swap(axis, 2 + axis);
            self.used.swap(axis, 2 + axis);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::extract_isosurface;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn the_mesh_is_that_of_the_sparse_method() {
        // Noise holds every sign pattern next to every other.
        let (nx, ny, nz) = (11, 9, 13);
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let border = |n: usize| {
            let (i, j, k) = (n % nx, n / nx % ny, n / (nx * ny));
            i == 0 || j == 0 || k == 0 || i + 1 == nx || j + 1 == ny || k + 1 == nz
        };
        let values: Vec<f32> =
            (0..nx * ny * nz).map(|n| if border(n) { 1.0 } else { rng.random_range(-1.0..1.0) }).collect();
        let at = |c: [i32; 3]| Point::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2]));
        let value = |c: [i32; 3]| f64::from(values[(c[2] as usize * ny + c[1] as usize) * nx + c[0] as usize]);
        let cells: Vec<[i32; 3]> = (0..(nx - 1) * (ny - 1) * (nz - 1))
            .map(|n| [n % (nx - 1), n / (nx - 1) % (ny - 1), n / ((nx - 1) * (ny - 1))].map(|i| i as i32))
            .collect();
        let sparse = extract_isosurface(&cells, value, at);
        assert!(sparse.faces.len() > 1000);
        assert_eq!(extract_grid(&values, [nx, ny, nz], at), sparse);
    }
}
