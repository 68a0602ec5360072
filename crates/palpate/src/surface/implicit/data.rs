use super::{WeightedSample, level::Level};
use rayon::prelude::*;

/// The data and orientation terms Σ wᵢ f(pᵢ)² + Σ wᵢ |∇f(pᵢ) − nᵢ|² on one level, matrix-free.
///
/// Samples are sorted by cell, so each plane of the grid gathers from the samples of two layers of cells: parallel over planes
/// without conflicts and the same sums for any number of threads.
pub(super) struct DataTerm {
    samples: Vec<Placed>,
    /// Samples of cell layer k are `samples[layers[k]..layers[k + 1]]`.
    layers: Vec<usize>,
}

struct Placed {
    /// Index of the cell's lowest node.
    base: u32,
    frac: [f32; 3],
    weight: f32,
    orientation: f32,
    normal: [f32; 3],
}

/// Value and gradient at a sample, weighted.
pub(super) type Row = [f32; 4];

impl DataTerm {
    pub(super) fn new(level: &Level, samples: &[WeightedSample]) -> Self {
        let mut placed: Vec<Placed> = samples
            .iter()
            .filter_map(|s| {
                let (base, frac) = level.locate(&s.position)?;
                let normal = [s.normal.x as f32, s.normal.y as f32, s.normal.z as f32];
                let base = level.index(base[0], base[1], base[2]) as u32;
                Some(Placed { base, frac, weight: s.weight as f32, orientation: s.orientation as f32, normal })
            })
            .collect();
        placed.sort_by_key(|s| s.base);
        let plane = level.plane_len() as u32;
        let layers = (0..=level.dims[2]).map(|k| placed.partition_point(|s| s.base < k as u32 * plane)).collect();
        Self { samples: placed, layers }
    }

    /// Weighted value and gradient of `x` at every sample: the first half of the operator.
    pub(super) fn rows(&self, level: &Level, x: &[f32]) -> Vec<Row> {
        self.samples.par_iter().with_min_len(512).map(|s| s.weighted(s.evaluate(level, x))).collect()
    }

    /// Weighted misfit at every sample: (0 − f(p), n − ∇f(p)).
    pub(super) fn misfits(&self, level: &Level, x: &[f32]) -> Vec<Row> {
        let misfit = |s: &Placed| {
            let v = s.evaluate(level, x);
            s.weighted([-v[0], s.normal[0] - v[1], s.normal[1] - v[2], s.normal[2] - v[3]])
        };
        self.samples.par_iter().with_min_len(512).map(misfit).collect()
    }

    /// Adds the transpose applied to `rows` to plane `k`, given as `out`: the second half of the operator.
    pub(super) fn scatter_plane(&self, level: &Level, rows: &[Row], k: usize, out: &mut [f32]) {
        self.for_each_corner(level, k, out, |s, i, c| {
            let (r, v) = (s.coefficients(c), rows[i]);
            r[0] * v[0] + r[1] * v[1] + r[2] * v[2] + r[3] * v[3]
        });
    }

    /// Adds the diagonal of the operator to plane `k`, given as `out`.
    pub(super) fn diagonal_plane(&self, level: &Level, k: usize, out: &mut [f32]) {
        self.for_each_corner(level, k, out, |s, _, c| {
            let r = s.coefficients(c);
            s.weight * r[0] * r[0] + s.orientation * (r[1] * r[1] + r[2] * r[2] + r[3] * r[3])
        });
    }

    /// Adds `value(sample, its index, corner)` to the corner nodes that lie in plane `k`.
    #[inline]
    fn for_each_corner(
        &self,
        level: &Level,
        k: usize,
        out: &mut [f32],
        value: impl Fn(&Placed, usize, [usize; 3]) -> f32,
    ) {
        let (nx, plane) = (level.dims[0], level.plane_len());
        for dz in 0..2usize {
            let Some(layer) = k.checked_sub(dz) else { continue };
            for i in self.layers[layer]..self.layers[layer + 1] {
                let s = &self.samples[i];
                let n = s.base as usize - layer * plane;
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    out[n + dx + dy * nx] += value(s, i, [dx, dy, dz]);
                }
            }
        }
    }
}

impl Placed {
    fn weighted(&self, row: Row) -> Row {
        let [value, x, y, z] = row;
        [value * self.weight, x * self.orientation, y * self.orientation, z * self.orientation]
    }

    /// Trilinear value and gradient at the sample.
    #[inline]
    fn evaluate(&self, level: &Level, x: &[f32]) -> Row {
        let n = self.base as usize;
        let (dy, dz) = (level.dims[0], level.plane_len());
        let [tx, ty, tz] = self.frac;
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let (a00, a10) = (x[n], x[n + 1]);
        let (a01, a11) = (x[n + dy], x[n + dy + 1]);
        let (b00, b10) = (x[n + dz], x[n + dz + 1]);
        let (b01, b11) = (x[n + dz + dy], x[n + dz + dy + 1]);
        let (y0, y1) = (lerp(a00, a10, tx), lerp(a01, a11, tx));
        let (w0, w1) = (lerp(b00, b10, tx), lerp(b01, b11, tx));
        let (z0, z1) = (lerp(y0, y1, ty), lerp(w0, w1, ty));
        let gx = lerp(lerp(a10 - a00, a11 - a01, ty), lerp(b10 - b00, b11 - b01, ty), tz);
        [lerp(z0, z1, tz), gx, lerp(y1 - y0, w1 - w0, tz), z1 - z0]
    }

    /// Derivatives of (value, gradient) with respect to the corner's node.
    #[inline]
    fn coefficients(&self, corner: [usize; 3]) -> Row {
        let mut w = [0.0; 3];
        let mut s = [0.0; 3];
        for a in 0..3 {
            (w[a], s[a]) = if corner[a] == 1 { (self.frac[a], 1.0) } else { (1.0 - self.frac[a], -1.0) };
        }
        [w[0] * w[1] * w[2], s[0] * w[1] * w[2], w[0] * s[1] * w[2], w[0] * w[1] * s[2]]
    }
}
