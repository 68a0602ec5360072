use crate::geometry::{Aabb, Point, Vector};
use rayon::prelude::*;

/// One resolution of the field: a dense regular grid of values in **cells**, with the nodes that may change listed as runs along x.
///
/// Dense storage with runs keeps every stencil neighbour at a fixed offset, so the inner loops vectorise, while the work follows
/// the active nodes and not the box.
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub(super) origin: Point,
    pub(super) spacing: f64,
    pub(super) dims: [usize; 3],
    /// Signed distance in cells, negative inside; x fastest.
    pub(super) values: Vec<f32>,
    /// For each plane k: runs (first index in `values`, length) of active nodes.
    pub(super) runs: Vec<Vec<(u32, u32)>>,
}

impl Level {
    /// A grid covering `bounds`, every node active and 1 (outside).
    pub(super) fn covering(bounds: &Aabb, spacing: f64) -> Self {
        let size = bounds.size() / spacing;
        let dims = [size.x, size.y, size.z].map(|s| s.ceil() as usize + 1).map(|n| n.max(5));
        let mut level = Self {
            origin: bounds.min,
            spacing,
            dims,
            values: vec![1.0; dims[0] * dims[1] * dims[2]],
            runs: vec![Vec::new(); dims[2]],
        };
        for k in 0..dims[2] {
            level.runs[k] = (0..dims[1]).map(|j| (level.index(0, j, k) as u32, dims[0] as u32)).collect();
        }
        level
    }

    /// The grid with this many more nodes before and after it on each axis. They hold the value of the nearest old one plus their distance from it.
    pub(super) fn grown(&self, before: [usize; 3], after: [usize; 3]) -> Self {
        let dims = [0, 1, 2].map(|a| self.dims[a] + before[a] + after[a]);
        let shift = Vector::new(before[0] as f64, before[1] as f64, before[2] as f64) * self.spacing;
        let nearest = |i: usize, a: usize| i.saturating_sub(before[a]).min(self.dims[a] - 1);
        let mut values = Vec::with_capacity(dims[0] * dims[1] * dims[2]);
        for (k, j) in (0..dims[2]).flat_map(|k| (0..dims[1]).map(move |j| (k, j))) {
            for i in 0..dims[0] {
                let at = [nearest(i, 0), nearest(j, 1), nearest(k, 2)];
                let off = |n: usize, a: usize| (n as f32 - (at[a] + before[a]) as f32).powi(2);
                let away = (off(i, 0) + off(j, 1) + off(k, 2)).sqrt();
                values.push(self.values[self.index(at[0], at[1], at[2])] + away);
            }
        }
        Self { origin: self.origin - shift, spacing: self.spacing, dims, values, runs: vec![Vec::new(); dims[2]] }
    }

    /// The nodes from `low` to below `high` on each axis as a grid of their own, none of them active.
    pub(super) fn crop(&self, low: [usize; 3], high: [usize; 3]) -> Self {
        let dims = [0, 1, 2].map(|a| high[a] - low[a]);
        let mut values = Vec::with_capacity(dims[0] * dims[1] * dims[2]);
        for k in low[2]..high[2] {
            for j in low[1]..high[1] {
                let row = self.index(low[0], j, k);
                values.extend_from_slice(&self.values[row..row + dims[0]]);
            }
        }
        let origin = self.position(low[0], low[1], low[2]);
        Self { origin, spacing: self.spacing, dims, values, runs: vec![Vec::new(); dims[2]] }
    }

    /// Takes over the values of a [`Self::crop`] from `low`, less `rim` nodes on every side of it.
    pub(super) fn paste(&mut self, part: &Self, low: [usize; 3], rim: usize) {
        let [nx, ny, nz] = part.dims;
        for k in rim..nz.saturating_sub(rim) {
            for j in rim..ny.saturating_sub(rim) {
                let (from, to) = (part.index(rim, j, k), self.index(low[0] + rim, low[1] + j, low[2] + k));
                let length = nx.saturating_sub(2 * rim);
                self.values[to..to + length].copy_from_slice(&part.values[from..from + length]);
            }
        }
    }

    /// Number of nodes a grid over `bounds` would have.
    pub(super) fn node_count(bounds: &Aabb, spacing: f64) -> f64 {
        let size = bounds.size() / spacing;
        (size.x.ceil() + 1.0).max(5.0) * (size.y.ceil() + 1.0).max(5.0) * (size.z.ceil() + 1.0).max(5.0)
    }

    #[inline]
    pub(super) fn index(&self, i: usize, j: usize, k: usize) -> usize {
        (k * self.dims[1] + j) * self.dims[0] + i
    }

    #[inline]
    pub(super) fn position(&self, i: usize, j: usize, k: usize) -> Point {
        self.origin + Vector::new(i as f64, j as f64, k as f64) * self.spacing
    }

    /// The box of all nodes.
    pub(super) fn bounds(&self) -> Aabb {
        let [nx, ny, nz] = self.dims;
        Aabb { min: self.origin, max: self.position(nx - 1, ny - 1, nz - 1) }
    }

    /// Nodes in one plane of constant k.
    pub(super) fn plane_len(&self) -> usize {
        self.dims[0] * self.dims[1]
    }

    /// Base node and fractions of the cell that holds `p`; `None` outside the grid.
    #[inline]
    pub(super) fn locate(&self, p: &Point) -> Option<([usize; 3], [f32; 3])> {
        let c = (p - self.origin) / self.spacing;
        let mut base = [0; 3];
        let mut frac = [0.0; 3];
        for a in 0..3 {
            if !(c[a] >= 0.0 && c[a] <= (self.dims[a] - 1) as f64) {
                return None;
            }
            base[a] = (c[a] as usize).min(self.dims[a] - 2);
            frac[a] = (c[a] - base[a] as f64) as f32;
        }
        Some((base, frac))
    }

    /// Trilinear value in cells at `p`, clamped to the grid.
    #[inline]
    pub(super) fn sample(&self, p: &Point) -> f32 {
        let c = (p - self.origin) / self.spacing;
        let mut base = [0; 3];
        let mut t = [0.0f32; 3];
        for a in 0..3 {
            let x = c[a].clamp(0.0, (self.dims[a] - 1) as f64);
            base[a] = (x as usize).min(self.dims[a] - 2);
            t[a] = (x - base[a] as f64) as f32;
        }
        let n = self.index(base[0], base[1], base[2]);
        let (dy, dz) = (self.dims[0], self.plane_len());
        let v = &self.values;
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let row = |n: usize| lerp(v[n], v[n + 1], t[0]);
        lerp(lerp(row(n), row(n + dy), t[1]), lerp(row(n + dz), row(n + dz + dy), t[1]), t[2])
    }

    /// Fills this level from a coarser one, rescaling cells.
    pub(super) fn upsample_from(&mut self, coarse: &Self) {
        let scale = (coarse.spacing / self.spacing) as f32;
        let (dims, origin, spacing) = (self.dims, self.origin, self.spacing);
        let plane = self.plane_len();
        self.values.par_chunks_mut(plane).enumerate().for_each(|(k, values)| {
            for j in 0..dims[1] {
                for i in 0..dims[0] {
                    let p = origin + Vector::new(i as f64, j as f64, k as f64) * spacing;
                    values[j * dims[0] + i] = scale * coarse.sample(&p);
                }
            }
        });
    }

    /// The box of the nodes below `reach` cells, with room for the stencils of a finer level; the whole grid if there are none.
    pub(super) fn surface_box(&self, reach: f32) -> Aabb {
        let [nx, ny, nz] = self.dims;
        let far = self.position(nx - 1, ny - 1, nz - 1);
        let (mut min, mut max) = (far, self.origin);
        for (row, values) in self.values.chunks(nx).enumerate() {
            let Some(first) = values.iter().position(|&v| v < reach) else { continue };
            let last = values.iter().rposition(|&v| v < reach).unwrap_or(first);
            min = min.inf(&self.position(first, row % ny, row / ny));
            max = max.sup(&self.position(last, row % ny, row / ny));
        }
        if min.x > max.x {
            return Aabb { min: self.origin, max: far };
        }
        let grown = Aabb { min, max }.inflated(3.0 * self.spacing);
        Aabb { min: grown.min.sup(&self.origin), max: grown.max.inf(&far) }
    }

    /// Makes the border outside, so that the zero surface is closed.
    pub(super) fn close_border(&mut self) {
        let [nx, ny, nz] = self.dims;
        for k in 0..nz {
            for j in 0..ny {
                let row = self.index(0, j, k);
                let values = &mut self.values[row..row + nx];
                if k == 0 || j == 0 || k + 1 == nz || j + 1 == ny {
                    for v in &mut *values {
                        *v = v.max(0.1);
                    }
                }
                values[0] = values[0].max(0.1);
                values[nx - 1] = values[nx - 1].max(0.1);
            }
        }
    }

    /// Makes exactly the marked nodes active, never those within two nodes of the border (the stencil must stay inside).
    pub(super) fn activate(&mut self, mask: &[bool]) {
        let [nx, ny, nz] = self.dims;
        for k in 0..nz {
            self.runs[k].clear();
            if k < 2 || k + 2 >= nz {
                continue;
            }
            for j in 2..ny.saturating_sub(2) {
                let row = self.index(0, j, k);
                let mut i = 2;
                while i + 2 < nx {
                    if !mask[row + i] {
                        i += 1;
                        continue;
                    }
                    let start = i;
                    while i + 2 < nx && mask[row + i] {
                        i += 1;
                    }
                    self.runs[k].push(((row + start) as u32, (i - start) as u32));
                }
            }
        }
    }
}
