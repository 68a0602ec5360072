use super::SmoothParams;
use crate::geometry::Raster;
use nalgebra::{Matrix6, Vector6};

/// Largest window radius; it bounds the stack buffers.
pub(super) const MAX_RADIUS: usize = 8;
const MAX_WINDOW: usize = (2 * MAX_RADIUS + 1) * (2 * MAX_RADIUS + 1);

/// Fewest neighbours of a quadratic fit: four per unknown.
const MIN_QUADRATIC: usize = 24;
/// Reweighted solves of the quadratic.
const QUADRATIC_SOLVES: usize = 3;

/// A plane through the neighbourhood of a pixel: depth there and its slopes, metres and metres per pixel.
#[derive(Clone, Copy)]
pub(super) struct LocalPlane {
    pub(super) z: f64,
    pub(super) z_u: f64,
    pub(super) z_v: f64,
}

impl LocalPlane {
    /// From q = z₀ (1 − z₀/z) and its slopes: 1/z = (1 − q/z₀)/z₀, hence z = z₀²/(z₀ − q) and ∂z = (z/z₀)² ∂q.
    fn of_q(q: f64, [q_u, q_v]: [f64; 2], z0: f64) -> Self {
        let z = z0 * z0 / (z0 - q);
        let stretch = (z / z0).powi(2);
        Self { z, z_u: stretch * q_u, z_v: stretch * q_v }
    }
}

/// What was fitted in one window.
#[derive(Clone, Copy)]
pub(super) struct WindowFit {
    /// At the centre; `None` if the depth there is too far from the reading.
    pub(super) plane: Option<LocalPlane>,
    /// Readings.
    pub(super) count: usize,
    /// The quadratic and the sum of its squared residuals in σ²; `None` if there are too few readings.
    quadratic: Option<([f32; 6], f32)>,
}

impl WindowFit {
    pub(super) fn is_curved(&self) -> bool {
        self.quadratic.is_some()
    }

    fn freedom(&self) -> f64 {
        self.count as f64 - 6.0
    }

    /// Variance of the residuals over that of the noise.
    pub(super) fn variance_ratio(&self) -> Option<f32> {
        self.quadratic.map(|(_, chi_squared)| chi_squared / self.freedom() as f32)
    }

    /// By how many σ of the sum of squares the residuals exceed noise of `excess` times the stated variance; none do without a quadratic.
    ///
    /// A window that noise alone explains is as large as it may be: smaller ones have more noise, larger ones bias (the choice of a bandwidth
    /// by Lepski's principle, here by a χ² test).
    pub(super) fn misfit(&self, excess: f64) -> f64 {
        let misfit = |(_, chi_squared): ([f32; 6], f32)| {
            (f64::from(chi_squared) / excess - self.freedom()) / (2.0 * self.freedom()).sqrt()
        };
        self.quadratic.map_or(f64::NEG_INFINITY, misfit)
    }

    /// The surface at a pixel beside the centre, whose reading is `z0`: the tangent plane of the quadratic there.
    pub(super) fn surface_at(&self, du: f64, dv: f64, z0: f64) -> Option<LocalPlane> {
        let [c, a, b, aa, ab, bb] = self.quadratic?.0.map(f64::from);
        let unit = f64::from(QUADRATIC_UNIT);
        let (x, y) = (unit * du, unit * dv);
        let q = c + a * x + b * y + aa * x * x + ab * x * y + bb * y * y;
        let slopes = [unit * (a + 2.0 * aa * x + ab * y), unit * (b + ab * x + 2.0 * bb * y)];
        Some(LocalPlane::of_q(q, slopes, z0))
    }
}

/// The fit in one window, half of it `radius` pixels; `None` if there are too few neighbours for a plane.
pub(super) fn fit_window(
    depth: &Raster<f32>,
    object: &Raster<bool>,
    (row, col): (usize, usize),
    radius: usize,
    sigma: f64,
    params: &SmoothParams,
) -> Option<WindowFit> {
    let (rows, cols) = depth.shape();
    let z0 = depth[(row, col)];
    let (mut du, mut dv, mut q) = ([0.0f32; MAX_WINDOW], [0.0f32; MAX_WINDOW], [0.0f32; MAX_WINDOW]);
    let mut count = 0;
    let max_step = params.max_step as f32;
    for r in row.saturating_sub(radius)..(row + radius + 1).min(rows) {
        for c in col.saturating_sub(radius)..(col + radius + 1).min(cols) {
            let z = depth[(r, c)];
            if object[(r, c)] && (z - z0).abs() < max_step {
                du[count] = c as f32 - col as f32;
                dv[count] = r as f32 - row as f32;
                q[count] = z0 * (z - z0) / z;
                count += 1;
            }
        }
    }
    if count < params.min_neighbours {
        return None;
    }
    let (du, dv, q) = (&du[..count], &dv[..count], &q[..count]);
    let mut fit = [0.0f32; 3];
    for iteration in 0..params.iterations {
        let scale = if iteration == 0 { 0.0 } else { (1.0 / (3.0 * sigma)) as f32 };
        fit = solve_weighted(du, dv, q, fit, scale)?;
    }
    let scale = (1.0 / (3.0 * sigma)) as f32;
    let quadratic = quadratic(du, dv, q, fit, scale);
    // A one-sided window may extrapolate wildly: no farther from the plane than three σ.
    let trusted = quadratic.filter(|quadratic| (quadratic[0] - fit[2]).abs() < 1.0 / scale);
    let offset = f64::from(trusted.map_or(fit[2], |quadratic| quadratic[0]));
    let slopes = [fit[0].into(), fit[1].into()];
    let near = offset.abs() <= params.max_residual_sigmas * sigma;
    Some(WindowFit {
        plane: near.then(|| LocalPlane::of_q(offset, slopes, z0.into())),
        count,
        quadratic: quadratic.map(|quadratic| (quadratic, chi_squared(du, dv, q, &quadratic, sigma as f32))),
    })
}

/// One weighted least-squares solve of q = a du + b dv + c; `scale` = 1/(3σ), 0 for equal weights.
fn solve_weighted(du: &[f32], dv: &[f32], q: &[f32], [a, b, c]: [f32; 3], scale: f32) -> Option<[f32; 3]> {
    let mut sums = [0.0f32; 9];
    for ((&x, &y), &z) in du.iter().zip(dv).zip(q) {
        let r = (a * x + b * y + c - z) * scale;
        let root = 1.0 / (1.0 + r * r);
        let w = root * root;
        let (wx, wy) = (w * x, w * y);
        for (sum, term) in sums.iter_mut().zip([wx * x, wx * y, wx, wy * y, wy, w, wx * z, wy * z, w * z]) {
            *sum += term;
        }
    }
    let [xx, xy, x, yy, y, n, xz, yz, z] = sums.map(f64::from);
    // Eliminate c first: what is left is the 2×2 covariance, whose determinant tells a line from a patch.
    let (mx, my, mz) = (x / n, y / n, z / n);
    let (cxx, cxy, cyy) = (xx - x * mx, xy - x * my, yy - y * my);
    let (cxz, cyz) = (xz - x * mz, yz - y * mz);
    let det = cxx * cyy - cxy * cxy;
    if !(det > 1e-3 * n * n) {
        return None;
    }
    let (a, b) = ((cyy * cxz - cxy * cyz) / det, (cxx * cyz - cxy * cxz) / det);
    Some([a as f32, b as f32, (mz - a * mx - b * my) as f32])
}

/// A quadratic (see [`basis`]), fitted from the plane on by reweighted solves; `None` if ill-conditioned.
///
/// The weights must be those of the quadratic's own residuals: weighted by the plane's, a curved surface is pulled to the plane by 0.4 of
/// the distance between them, since noise that leads there weighs more. Each solve leaves 0.4 of that.
fn quadratic(du: &[f32], dv: &[f32], q: &[f32], [a, b, c]: [f32; 3], scale: f32) -> Option<[f32; 6]> {
    if du.len() < MIN_QUADRATIC {
        return None;
    }
    let mut fit = [c, a / QUADRATIC_UNIT, b / QUADRATIC_UNIT, 0.0, 0.0, 0.0];
    for _ in 0..QUADRATIC_SOLVES {
        fit = solve_quadratic(du, dv, q, &fit, scale)?;
    }
    Some(fit)
}

/// Columns of the quadratic are of order one over the window: x and y in units of four pixels.
const QUADRATIC_UNIT: f32 = 0.25;

/// 1, x, y, x², xy, y².
#[inline]
fn basis(du: f32, dv: f32) -> [f32; 6] {
    let (x, y) = (QUADRATIC_UNIT * du, QUADRATIC_UNIT * dv);
    [1.0, x, y, x * x, x * y, y * y]
}

#[inline]
fn dot(basis: &[f32; 6], fit: &[f32; 6]) -> f32 {
    basis.iter().zip(fit).map(|(b, f)| b * f).sum()
}

/// Sum of the squared residuals in σ²; each counts as three σ at most.
fn chi_squared(du: &[f32], dv: &[f32], q: &[f32], fit: &[f32; 6], sigma: f32) -> f32 {
    let square = |((&x, &y), &z): ((&f32, &f32), &f32)| ((z - dot(&basis(x, y), fit)) / sigma).abs().min(3.0).powi(2);
    du.iter().zip(dv).zip(q).map(square).sum()
}

/// One solve for [`basis`] with the weights of the residuals of `fit`. (What is solved for is the difference, which is small: single
/// precision suffices for a window at the object's edge.)
fn solve_quadratic(du: &[f32], dv: &[f32], q: &[f32], fit: &[f32; 6], scale: f32) -> Option<[f32; 6]> {
    let mut normal = [[0.0f32; 6]; 6];
    let mut rhs = [0.0f32; 6];
    for ((&x, &y), &z) in du.iter().zip(dv).zip(q) {
        let basis = basis(x, y);
        let residual = z - dot(&basis, fit);
        let r = residual * scale;
        let root = 1.0 / (1.0 + r * r);
        let w = root * root;
        for i in 0..6 {
            let wi = w * basis[i];
            rhs[i] += wi * residual;
            for j in i..6 {
                normal[i][j] += wi * basis[j];
            }
        }
    }
    let matrix = Matrix6::from_fn(|i, j| f64::from(normal[i.min(j)][i.max(j)]));
    let step = matrix.cholesky()?.solve(&Vector6::from_fn(|i, _| f64::from(rhs[i])));
    Some(std::array::from_fn(|i| fit[i] + step[i] as f32))
}
