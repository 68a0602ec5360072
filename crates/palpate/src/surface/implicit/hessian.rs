use super::level::Level;
use rayon::prelude::*;

/// The rows of the operator at the active nodes within two nodes of the border, where only the differences that exist count.
pub(super) struct Border {
    planes: Vec<Rows>,
}

/// Rows of a sparse matrix.
#[derive(Default)]
struct Rows {
    /// Where each row ends in `terms`.
    ends: Vec<u32>,
    /// Node and coefficient.
    terms: Vec<(u32, f32)>,
}

impl Border {
    pub(super) fn new(level: &Level) -> Self {
        let rows = |k: usize| {
            let mut rows = Rows::default();
            for run in &level.runs[k] {
                let (start, first, last, end) = parts(level, k, *run);
                for n in (start..first).chain(last..end) {
                    rows.push(level, n);
                }
            }
            rows
        };
        Self { planes: (0..level.dims[2]).into_par_iter().map(rows).collect() }
    }
}

impl Rows {
    fn push(&mut self, level: &Level, n: usize) {
        let from = self.terms.len();
        for_each_difference(level, n, |own, terms| {
            for &(m, c) in terms {
                match self.terms[from..].iter_mut().find(|t| t.0 == m as u32) {
                    Some(term) => term.1 += own * c,
                    None => self.terms.push((m as u32, own * c)),
                }
            }
        });
        self.ends.push(self.terms.len() as u32);
    }
}

/// Sets the active nodes of plane `k` to `scale` times the normal operator of Σ |Hess f|² at `x`; `out` is that plane.
///
/// Second differences along the axes and mixed differences on the faces of the cells; in the interior both together are the
/// 25-point stencil 42, −12 at ±1, +2 at (±1, ±1), +1 at ±2. Next to the border only the differences that exist count (natural
/// boundary: linear functions cost nothing).
pub(super) fn apply_plane(level: &Level, border: &Border, x: &[f32], scale: f32, k: usize, out: &mut [f32]) {
    let (nx, plane) = (level.dims[0], level.plane_len());
    let (rows, mut row, mut from) = (&border.planes[k], 0, 0);
    for run in &level.runs[k] {
        let (start, first, last, end) = parts(level, k, *run);
        for n in (start..first).chain(last..end) {
            let to = rows.ends[row] as usize;
            let sum: f32 = rows.terms[from..to].iter().map(|&(m, c)| c * x[m as usize]).sum();
            out[n - k * plane] = scale * sum;
            (row, from) = (row + 1, to);
        }
        if first < last {
            interior(x, first, last, nx, plane, scale, &mut out[first - k * plane..last - k * plane]);
        }
    }
}

/// Adds `scale` times the diagonal of that operator to the active nodes of plane `k`; `out` is that plane.
pub(super) fn diagonal_plane(level: &Level, border: &Border, scale: f32, k: usize, out: &mut [f32]) {
    let offset = k * level.plane_len();
    let (rows, mut row, mut from) = (&border.planes[k], 0, 0);
    for run in &level.runs[k] {
        let (start, first, last, end) = parts(level, k, *run);
        for n in (start..first).chain(last..end) {
            let to = rows.ends[row] as usize;
            let own: f32 = rows.terms[from..to].iter().filter(|t| t.0 as usize == n).map(|t| t.1).sum();
            out[n - offset] += scale * own;
            (row, from) = (row + 1, to);
        }
        out[first - offset..last - offset].iter_mut().for_each(|d| *d += scale * INNER_DIAGONAL);
    }
}

/// Start and end of a run of plane `k`, and in between those of its part that is at least two nodes from the border.
fn parts(level: &Level, k: usize, (start, len): (u32, u32)) -> (usize, usize, usize, usize) {
    let [nx, ny, nz] = level.dims;
    let (start, end) = (start as usize, (start + len) as usize);
    let in_plane = start - k * level.plane_len();
    let (i, j) = (in_plane % nx, in_plane / nx);
    if k < 2 || k + 2 >= nz || j < 2 || j + 2 >= ny {
        return (start, end, end, end);
    }
    let first = (start + 2usize.saturating_sub(i)).min(end);
    let last = (start + (nx - 2).saturating_sub(i)).clamp(first, end);
    (start, first, last, end)
}

/// Middle of the 25-point stencil.
const INNER_DIAGONAL: f32 = 42.0;

/// The 25-point stencil on a run whose neighbours all exist.
fn interior(x: &[f32], first: usize, last: usize, dy: usize, dz: usize, scale: f32, out: &mut [f32]) {
    let len = last - first;
    let at = |offset: isize| &x[(first as isize + offset) as usize..][..len];
    let (dy, dz) = (dy as isize, dz as isize);
    let centre = at(0);
    let near = [at(-1), at(1), at(-dy), at(dy), at(-dz), at(dz)];
    let far = [at(-2), at(2), at(-2 * dy), at(2 * dy), at(-2 * dz), at(2 * dz)];
    let xy = [at(-1 - dy), at(1 - dy), at(-1 + dy), at(1 + dy)];
    let xz = [at(-1 - dz), at(1 - dz), at(-1 + dz), at(1 + dz)];
    let yz = [at(-dy - dz), at(dy - dz), at(-dy + dz), at(dy + dz)];
    for n in 0..len {
        let near = near[0][n] + near[1][n] + near[2][n] + near[3][n] + near[4][n] + near[5][n];
        let far = far[0][n] + far[1][n] + far[2][n] + far[3][n] + far[4][n] + far[5][n];
        let mixed = xy[0][n]
            + xy[1][n]
            + xy[2][n]
            + xy[3][n]
            + (xz[0][n] + xz[1][n] + xz[2][n] + xz[3][n])
            + (yz[0][n] + yz[1][n] + yz[2][n] + yz[3][n]);
        out[n] = scale * (INNER_DIAGONAL * centre[n] - 12.0 * near + far + 2.0 * mixed);
    }
}

/// Calls `visit(own coefficient, all (node, coefficient))` for every difference of the energy that involves node `n`.
fn for_each_difference(level: &Level, n: usize, mut visit: impl FnMut(f32, &[(usize, f32)])) {
    let [nx, ny, _] = level.dims;
    let c = [n % nx, n / nx % ny, n / (nx * ny)];
    let step = [1, nx, nx * ny];
    for a in 0..3 {
        for shift in 0..3usize {
            // The difference centred at c[a] + 1 − shift.
            let Some(centre) = (c[a] + 1).checked_sub(shift) else { continue };
            if centre == 0 || centre + 1 >= level.dims[a] {
                continue;
            }
            let m = n + step[a] - shift * step[a];
            let own = if shift == 1 { -2.0 } else { 1.0 };
            visit(own, &[(m - step[a], 1.0), (m, -2.0), (m + step[a], 1.0)]);
        }
    }
    let root2 = std::f32::consts::SQRT_2;
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        for (sa, sb) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            // The cell face whose lowest corner is c − (sa, sb).
            if c[a] < sa || c[b] < sb || c[a] - sa + 1 >= level.dims[a] || c[b] - sb + 1 >= level.dims[b] {
                continue;
            }
            let m = n - sa * step[a] - sb * step[b];
            let own = if sa == sb { root2 } else { -root2 };
            let terms = [(m, root2), (m + step[a], -root2), (m + step[b], -root2), (m + step[a] + step[b], root2)];
            visit(own, &terms);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Point};

    fn apply(level: &Level, x: &[f32], scale: f32, out: &mut [f32]) {
        let border = Border::new(level);
        for (k, out) in out.chunks_mut(level.plane_len()).enumerate() {
            apply_plane(level, &border, x, scale, k, out);
        }
    }

    fn level(n: usize) -> Level {
        let far = (n - 1) as f64;
        Level::covering(&Aabb { min: Point::origin(), max: Point::new(far, far, far) }, 1.0)
    }

    #[test]
    fn linear_functions_cost_nothing_up_to_the_border() {
        let l = level(7);
        let x: Vec<f32> =
            (0..l.values.len()).map(|n| (n % 7) as f32 * 0.5 - (n / 7 % 7) as f32 + 2.0 * (n / 49) as f32).collect();
        let mut out = vec![0.0; x.len()];
        apply(&l, &x, 1.0, &mut out);
        assert!(out.iter().all(|v| v.abs() < 1e-3), "{out:?}");
    }

    #[test]
    fn the_fused_stencil_equals_the_sum_of_differences() {
        let l = level(8);
        let x: Vec<f32> = (0..l.values.len()).map(|n| ((n * 7919) % 101) as f32 / 50.0 - 1.0).collect();
        let mut out = vec![0.0; x.len()];
        apply(&l, &x, 1.0, &mut out);
        for (n, out) in out.iter().enumerate() {
            let mut sum = 0.0;
            for_each_difference(&l, n, |own, terms| {
                sum += own * terms.iter().map(|&(m, c)| c * x[m]).sum::<f32>();
            });
            assert!((out - sum).abs() < 1e-3, "node {n}: {out} against {sum}");
        }
        let border = Border::new(&l);
        for (k, out) in out.chunks_mut(l.plane_len()).enumerate() {
            out.fill(0.0);
            diagonal_plane(&l, &border, 1.0, k, out);
        }
        assert!((out[l.index(4, 4, 4)] - 42.0).abs() < 1e-4);
        for (n, diagonal) in out.iter().enumerate() {
            let mut sum = 0.0;
            for_each_difference(&l, n, |own, _| sum += own * own);
            assert!((diagonal - sum).abs() < 1e-4, "node {n}: {diagonal} against {sum}");
        }
    }
}
