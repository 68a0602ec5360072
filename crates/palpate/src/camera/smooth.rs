use super::{DepthNoise, PinholeCamera};
use crate::geometry::{Raster, Vector};
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// Largest window radius; it bounds the stack buffers.
const MAX_RADIUS: usize = 8;
const MAX_WINDOW: usize = (2 * MAX_RADIUS + 1) * (2 * MAX_RADIUS + 1);

/// Fewest neighbours of a quadratic fit: four per unknown.
const MIN_QUADRATIC: usize = 24;
/// Reweighted solves of the quadratic.
const QUADRATIC_SOLVES: usize = 3;

/// How depth is denoised.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SmoothParams {
    /// Half the window, pixels (4 = 9×9). Larger: less noise, rounder edges; 4 brings 1 mm noise to about 2° of normal at 0.7 m.
    pub radius: usize,
    /// Half the smallest window, pixels. Larger: rounder edges; 3: with 2, plates came out worse. From `radius` on, all windows are the same.
    pub min_radius: usize,
    /// A window shrinks while its residuals exceed the noise by this many of their own σ. Larger: rounder edges, less noise; 1.
    pub max_misfit: f64,
    /// Reweighted solves, the first one unweighted. More: steps within the window blend less; 3 suffice.
    pub iterations: usize,
    /// Neighbours farther than this along the ray belong to another surface, metres. Larger: steps blend; 12 mm.
    pub max_step: f64,
    /// A pixel farther than this many σ from its fitted plane is dropped. Larger: keeps more, noisier; 4.
    pub max_residual_sigmas: f64,
    /// Fewest neighbours of a fit, itself included. Larger: thin parts lose pixels; 6.
    pub min_neighbours: usize,
    /// Smallest cosine between normal and ray. Larger: drops more of grazing surfaces, whose depth is worst; 0.12 (83°).
    pub min_incidence_cosine: f64,
}

impl Default for SmoothParams {
    fn default() -> Self {
        Self {
            radius: 4,
            min_radius: 3,
            max_misfit: 1.0,
            iterations: 3,
            max_step: 0.012,
            max_residual_sigmas: 4.0,
            min_neighbours: 6,
            min_incidence_cosine: 0.12,
        }
    }
}

impl SmoothParams {
    /// The first field out of range, its value and the rule.
    pub(crate) fn fault(&self) -> Option<(&'static str, f64, &'static str)> {
        let checks = [
            ((1..=MAX_RADIUS).contains(&self.radius), "smooth.radius", self.radius as f64, "between 1 and 8 pixels"),
            (
                (1..=MAX_RADIUS).contains(&self.min_radius),
                "smooth.min_radius",
                self.min_radius as f64,
                "between 1 and 8 pixels",
            ),
            (!self.max_misfit.is_nan(), "smooth.max_misfit", self.max_misfit, "a number"),
            ((1..=20).contains(&self.iterations), "smooth.iterations", self.iterations as f64, "between 1 and 20"),
            (self.max_step > 0.0, "smooth.max_step", self.max_step, "positive, in metres"),
            (self.max_residual_sigmas > 0.0, "smooth.max_residual_sigmas", self.max_residual_sigmas, "positive"),
            (self.min_neighbours >= 3, "smooth.min_neighbours", self.min_neighbours as f64, "at least 3"),
            (
                (0.0..1.0).contains(&self.min_incidence_cosine),
                "smooth.min_incidence_cosine",
                self.min_incidence_cosine,
                "in [0, 1)",
            ),
        ];
        checks.into_iter().find(|c| !c.0).map(|(_, field, value, rule)| (field, value, rule))
    }
}

/// A plane through the neighbourhood of a pixel: depth there and its slopes, metres and metres per pixel.
#[derive(Clone, Copy)]
pub(super) struct LocalPlane {
    pub(super) z: f64,
    pub(super) z_u: f64,
    pub(super) z_v: f64,
}

/// Denoises depth and takes normals in one pass: around each object pixel a plane is fitted robustly to the object's readings.
///
/// * `depth` – metres, NaN = no reading; only pixels with `object` true are read or written
/// * `noise` – σ of a reading; where nothing is stated a typical one is taken
///
/// Returns the denoised depth (NaN where dropped) and unit normals in the **camera** frame, facing the camera.
///
/// The fit is in q = z₀ (1 − z₀/z) ≈ z − z₀, which is *exactly* linear in (u, v) on a plane without lens distortion; in z a
/// tilted plane is curved. The normal is the plane's; the depth is the centre of a quadratic with the same weights, because a
/// plane lies half a millimetre behind a ball of 40 mm radius, everywhere, while the quadratic's larger noise averages out.
/// Weights after the first solve: 1/(1 + (r/3σ)²)², the Geman–McClure ones.
///
/// The window is the largest, pixel by pixel, whose residuals noise explains: edges keep their shape, smooth parts lose their noise.
pub fn smooth_depth(
    depth: &Raster<f32>,
    object: &Raster<bool>,
    camera: &PinholeCamera,
    noise: DepthNoise,
    params: &SmoothParams,
) -> (Raster<f32>, Raster<[f32; 3]>) {
    let noise = noise.or_typical();
    let (rows, cols) = depth.shape();
    let largest = params.radius.min(MAX_RADIUS);
    let fit_in = |at: (usize, usize), radius: usize| {
        let z = depth[at];
        let sigma = noise.sigma_at(f64::from(z));
        (object[at] && !z.is_nan()).then(|| fit_window(depth, object, at, radius, sigma, params)).flatten()
    };
    let wide = Raster::par_from_fn(rows, cols, |row, col| fit_in((row, col), largest));
    let excess = excess_noise(&wide);
    let fitted = Raster::par_from_fn(rows, cols, |row, col| {
        let mut fit = wide[(row, col)];
        for radius in (params.min_radius..largest).rev() {
            if fit.is_none_or(|f| f.misfit(excess) <= params.max_misfit) {
                break;
            }
            fit = fit_in((row, col), radius);
        }
        fit.and_then(|f| f.plane)
            .and_then(|plane| oriented(&plane, camera, (row, col), params.min_incidence_cosine))
            .unwrap_or((f32::NAN, [0.0; 3]))
    });
    (fitted.map(|f| f.0), fitted.map(|f| f.1))
}

/// The depth and the unit normal of a local plane at a pixel, facing the camera; `None` below the least cosine with the ray.
pub(super) fn oriented(
    plane: &LocalPlane,
    camera: &PinholeCamera,
    (row, col): (usize, usize),
    min_cosine: f64,
) -> Option<(f32, [f32; 3])> {
    let (u, v) = (col as f64, row as f64);
    let ray = camera.ray(u, v);
    let (ray_u, ray_v) = camera.ray_derivatives(u, v);
    let tangent_u: Vector = ray_u * plane.z + ray * plane.z_u;
    let tangent_v: Vector = ray_v * plane.z + ray * plane.z_v;
    // (u, v, forward) is right-handed, so v × u looks back at the camera.
    let normal = tangent_v.cross(&tangent_u).try_normalize(1e-300)?;
    let cosine = -normal.dot(&ray) / ray.norm();
    (cosine >= min_cosine).then(|| (plane.z as f32, [normal.x as f32, normal.y as f32, normal.z as f32]))
}

/// What was fitted in one window.
#[derive(Clone, Copy)]
struct WindowFit {
    /// `None` if the depth at the centre is too far from the reading.
    plane: Option<LocalPlane>,
    /// Sum of the squared residuals of the quadratic, in σ², and degrees of freedom; 0 and 0 without a quadratic.
    chi_squared: f32,
    freedom: f32,
}

impl WindowFit {
    /// By how many σ of the sum of squares the residuals exceed noise of `excess` times the stated variance.
    ///
    /// A window that noise alone explains is as large as it may be: smaller ones have more noise, larger ones bias (the choice of a bandwidth
    /// by Lepski's principle, here by a χ² test).
    fn misfit(&self, excess: f64) -> f64 {
        let freedom = f64::from(self.freedom).max(1.0);
        (f64::from(self.chi_squared) / excess - freedom) / (2.0 * freedom).sqrt()
    }
}

/// How many times the stated variance the noise has, at least 1: where the fits are good, a quarter of the windows, nothing but noise is left. A
/// sensor noisier than is said does not shrink every window.
fn excess_noise(fits: &Raster<Option<WindowFit>>) -> f64 {
    let ratio = |f: &WindowFit| (f.freedom > 0.0).then(|| f.chi_squared / f.freedom);
    let mut ratios: Vec<f32> = fits.as_slice().iter().flatten().filter_map(ratio).collect();
    let quarter = ratios.len() / 4;
    if ratios.is_empty() { 1.0 } else { f64::from(*ratios.select_nth_unstable_by(quarter, f32::total_cmp).1).max(1.0) }
}

/// The fit in one window, half of it `radius` pixels; `None` if there are too few neighbours for a plane.
fn fit_window(
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
    let offset = f64::from(quadratic.map_or(fit[2], |quadratic| quadratic[0]));
    let chi_squared = quadratic.map_or(0.0, |quadratic| chi_squared(du, dv, q, &quadratic, sigma as f32));
    let freedom = quadratic.map_or(0.0, |_| count as f32 - 6.0);
    if offset.abs() > params.max_residual_sigmas * sigma {
        return Some(WindowFit { plane: None, chi_squared, freedom });
    }
    // 1/z = (1 − q/z₀)/z₀, hence z = z₀²/(z₀ − q) and ∂z = (z/z₀)² ∂q.
    let z0 = f64::from(z0);
    let z = z0 * z0 / (z0 - offset);
    let stretch = (z / z0).powi(2);
    let plane = LocalPlane { z, z_u: stretch * f64::from(fit[0]), z_v: stretch * f64::from(fit[1]) };
    Some(WindowFit { plane: Some(plane), chi_squared, freedom })
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
    // A one-sided window may extrapolate wildly: no farther from the plane than three σ.
    Some(fit).filter(|fit| (fit[0] - c).abs() < 1.0 / scale)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Plane, Point};
    use rand::SeedableRng as _;
    use rand_distr::{Distribution as _, Normal};
    use rand_pcg::Pcg64Mcg;

    const QUIET: DepthNoise = DepthNoise { sigma: 1e-3, sigma_quadratic: 0.0 };

    fn camera() -> PinholeCamera {
        PinholeCamera { width: 80, height: 60, fx: 277.0, fy: 280.0, cx: 39.5, cy: 29.5, distortion: [0.0; 5] }
    }

    fn plane_depth(plane: &Plane, camera: &PinholeCamera) -> Raster<f32> {
        Raster::from_fn(camera.height, camera.width, |row, col| {
            (plane.offset / plane.normal.dot(&camera.ray(col as f64, row as f64))) as f32
        })
    }

    #[test]
    fn an_edge_keeps_its_shape_and_a_plane_loses_its_noise() {
        // Two planes that meet in a ridge along the middle column, and noise.
        let camera = camera();
        let ridge = |col: usize| 0.6 + 0.002 * (col as f64 - 40.0).abs();
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let mut noisy = |sigma: f64| {
            let noise = Normal::new(0.0, sigma).expect("finite");
            Raster::from_fn(camera.height, camera.width, |_, col| (ridge(col) + noise.sample(&mut rng)) as f32)
        };
        let (said, twice) = (noisy(1e-3), noisy(2e-3));
        let object = Raster::filled(camera.height, camera.width, true);
        let error = |depth: &Raster<f32>, min_radius: usize, cols: std::ops::Range<usize>| {
            let params = SmoothParams { min_radius, ..SmoothParams::default() };
            let (smooth, _) = smooth_depth(depth, &object, &camera, QUIET, &params);
            let errors = (5..55).flat_map(|row| cols.clone().map(move |col| (row, col)));
            let errors: Vec<f64> =
                errors.map(|at| f64::from(smooth[at]) - ridge(at.1)).filter(|e| e.is_finite()).collect();
            assert!(errors.len() > 100, "{} pixels stay", errors.len());
            (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
        };
        let (rounded, kept) = (error(&said, 4, 39..42), error(&said, 2, 39..42));
        assert!(kept < 0.75 * rounded, "the ridge: {kept} m, with one window for all {rounded} m");
        // Of a sensor that is twice as noisy as is said, too.
        for depth in [said, twice] {
            let (flat, adaptive) = (error(&depth, 4, 10..30), error(&depth, 2, 10..30));
            assert!(adaptive < 1.25 * flat, "the plane: {adaptive} m, with one window for all {flat} m");
        }
    }

    #[test]
    fn a_tilted_plane_is_reproduced_exactly() {
        let lens = PinholeCamera { distortion: [-0.2, 0.05, 1e-3, -1e-3, 0.0], ..camera() };
        for (camera, depth_tolerance) in [(camera(), 2e-6), (lens, 2e-5)] {
            let plane = Plane::new(Vector::new(0.6, -0.5, -0.8), &Point::new(0.0, 0.0, 0.5)).expect("a direction");
            let depth = plane_depth(&plane, &camera);
            let object = depth.map(|_| true);
            let (smooth, normals) = smooth_depth(&depth, &object, &camera, QUIET, &SmoothParams::default());
            for (row, col, &z) in smooth.pixels() {
                assert!((z - depth[(row, col)]).abs() < depth_tolerance, "({row}, {col}): {z}");
                let n = normals[(row, col)];
                let n = Vector::new(n[0].into(), n[1].into(), n[2].into());
                assert!((n - plane.normal.into_inner()).norm() < 3e-3, "({row}, {col}): {n}");
            }
        }
    }

    #[test]
    fn noise_shrinks_by_the_window() {
        let camera = camera();
        let plane = Plane::new(Vector::new(0.2, -0.3, -1.0), &Point::new(0.0, 0.0, 0.5)).expect("a direction");
        let exact = plane_depth(&plane, &camera);
        let (mut rng, noise) = (Pcg64Mcg::seed_from_u64(5), Normal::new(0.0, 1e-3).expect("finite"));
        let noisy = exact.map(|z| z + noise.sample(&mut rng) as f32);
        let (smooth, _) = smooth_depth(&noisy, &noisy.map(|_| true), &camera, QUIET, &SmoothParams::default());
        let inner: Vec<f64> = smooth
            .pixels()
            .filter(|(r, c, z)| (4..56).contains(r) && (4..76).contains(c) && !z.is_nan())
            .map(|(r, c, z)| f64::from(z - exact[(r, c)]))
            .collect();
        assert!(inner.len() > 3700, "{} of 3744 pixels kept", inner.len());
        let rms = (inner.iter().map(|e| e * e).sum::<f64>() / inner.len() as f64).sqrt();
        // The centre of a quadratic on 9×9 pixels has σ √(1/81 + 2 (20/3)²/2772) = 0.21 σ.
        assert!((1.6e-4..2.6e-4).contains(&rms), "rms {rms}");
    }

    #[test]
    fn a_ball_keeps_its_radius() {
        let camera = camera();
        let center = Vector::new(0.0, 0.0, 0.35);
        let depth = Raster::from_fn(60, 80, |row, col| {
            let ray = camera.ray(col as f64, row as f64);
            let (a, b) = (ray.norm_squared(), ray.dot(&center));
            let root = b * b - a * (center.norm_squared() - 0.03_f64.powi(2));
            if root > 0.0 { ((b - root.sqrt()) / a) as f32 } else { f32::NAN }
        });
        let (smooth, _) = smooth_depth(&depth, &depth.map(|z| z.is_finite()), &camera, QUIET, &SmoothParams::default());
        let mut off: Vec<f64> = smooth
            .pixels()
            .filter(|(_, _, z)| z.is_finite())
            .map(|(r, c, &z)| (camera.ray(c as f64, r as f64) * f64::from(z) - center).norm() - 0.03)
            .collect();
        off.sort_by(f64::total_cmp);
        assert!(
            off.len() > 1500 && off[off.len() / 2].abs() < 5e-5,
            "{} points, median {}",
            off.len(),
            off[off.len() / 2]
        );
    }

    #[test]
    fn noise_does_not_pull_a_ball_in() {
        let camera = camera();
        let center = Vector::new(0.0, 0.0, 0.3);
        let (mut rng, noise) = (Pcg64Mcg::seed_from_u64(5), Normal::new(0.0, 1e-3).expect("finite"));
        let depth = Raster::from_fn(60, 80, |row, col| {
            let ray = camera.ray(col as f64, row as f64);
            let (a, b) = (ray.norm_squared(), ray.dot(&center));
            let root = b * b - a * (center.norm_squared() - 0.025_f64.powi(2));
            if root > 0.0 { ((b - root.sqrt()) / a + noise.sample(&mut rng)) as f32 } else { f32::NAN }
        });
        let (smooth, _) = smooth_depth(&depth, &depth.map(|z| z.is_finite()), &camera, QUIET, &SmoothParams::default());
        let off: Vec<f64> = smooth
            .pixels()
            .filter(|(r, c, z)| z.is_finite() && (r.abs_diff(29) as f64).hypot(c.abs_diff(39) as f64) < 15.0)
            .map(|(r, c, &z)| (camera.ray(c as f64, r as f64) * f64::from(z) - center).norm() - 0.025)
            .collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        assert!(off.len() > 600 && mean.abs() < 7e-5, "{} points, {mean} off", off.len());
    }

    #[test]
    fn a_step_is_not_blended() {
        let camera = camera();
        let depth = Raster::from_fn(60, 80, |_, col| if col < 40 { 0.5 } else { 0.508 });
        let noise = DepthNoise { sigma: 3e-4, sigma_quadratic: 0.0 };
        let (smooth, _) = smooth_depth(&depth, &depth.map(|_| true), &camera, noise, &SmoothParams::default());
        // Two columns from an 8 mm step the far side has little weight left.
        assert!((smooth[(30, 37)] - 0.5).abs() < 5e-4 && (smooth[(30, 42)] - 0.508).abs() < 5e-4);
    }

    #[test]
    fn lone_lines_and_grazing_surfaces_are_dropped() {
        let camera = camera();
        let line = Raster::from_fn(60, 80, |row, _| row == 30);
        let flat = Raster::filled(60, 80, 0.5);
        let (smooth, _) = smooth_depth(&flat, &line, &camera, QUIET, &SmoothParams::default());
        assert!(smooth.as_slice().iter().all(|z| z.is_nan()));
        let grazing = Plane::new(Vector::new(0.0, -1.0, -0.1), &Point::new(0.0, 0.0, 0.5)).expect("a direction");
        let depth = plane_depth(&grazing, &camera);
        let rays_steep = SmoothParams { min_incidence_cosine: 0.5, ..SmoothParams::default() };
        let (smooth, normals) = smooth_depth(&depth, &depth.map(|z| *z > 0.0), &camera, QUIET, &rays_steep);
        assert!(smooth[(30, 40)].is_nan() && normals[(30, 40)] == [0.0; 3]);
    }

    #[test]
    fn faults_name_the_field() {
        assert_eq!(SmoothParams::default().fault(), None);
        let wrong = SmoothParams { radius: 0, ..SmoothParams::default() };
        assert_eq!(wrong.fault(), Some(("smooth.radius", 0.0, "between 1 and 8 pixels")));
    }
}
