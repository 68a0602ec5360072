use super::window_fit::{LocalPlane, MAX_RADIUS, WindowFit, fit_window};
use super::{DepthNoise, PinholeCamera};
use crate::geometry::{Raster, Vector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A window steps aside only where at least this share of it has readings of the object: at the outline there is no side to step to.
const WHOLE: f64 = 0.75;
/// And only to a window whose surface is this near to the reading, σ.
const SAME_SURFACE: f64 = 2.5;

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
    /// How far a window steps aside where noise does not explain its residuals, pixels; 0: never. Larger: edges keep their shape up to farther
    /// away, less where steps are near; 2.
    pub shift: usize,
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
            shift: 2,
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
            (self.max_misfit >= 0.0, "smooth.max_misfit", self.max_misfit, "at least 0"),
            (self.shift <= MAX_RADIUS, "smooth.shift", self.shift as f64, "at most 8 pixels"),
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

/// Denoises depth and takes normals in one pass: around each object pixel a plane is fitted robustly to the object's readings.
///
/// * `depth` – metres, NaN = no reading; only pixels with `object` true are read or written
/// * `noise` – σ of a reading; where nothing is stated a typical one is taken
///
/// Returns the denoised depth (NaN where dropped) and unit normals in the **camera** frame, facing the camera.
///
/// The fit is in q = z₀ (1 − z₀/z) ≈ z − z₀, which is *exactly* linear in (u, v) on a plane without lens distortion; in z a
/// tilted plane is curved. The normal is the plane's; the depth is the centre of a quadratic, because a
/// plane lies half a millimetre behind a ball of 40 mm radius, everywhere, while the quadratic's larger noise averages out.
/// Weights after the first solve: 1/(1 + (r/3σ)²)², the Geman–McClure ones.
///
/// Where noise does not explain a window's residuals, at an edge, the window steps aside to where it does, and if there is no such place, it
/// shrinks: edges keep their shape, smooth parts lose their noise. O(object pixels · window).
///
/// # References
/// Kuwahara et al., *Processing of RI-angiocardiographic images*, 1976 (of the windows that hold a pixel, the most uniform one; here the one
/// whose residuals are least); Lepski, *On a problem of adaptive estimation in Gaussian white noise*, 1991 (the largest window that noise explains).
pub fn smooth_depth(
    depth: &Raster<f32>,
    object: &Raster<bool>,
    camera: &PinholeCamera,
    noise: DepthNoise,
    params: &SmoothParams,
) -> (Raster<f32>, Raster<[f32; 3]>) {
    let noise = noise.or_typical();
    let windows = Windows::fit(depth, object, noise, params);
    let (rows, cols) = depth.shape();
    let fitted = Raster::par_from_fn(rows, cols, |row, col| {
        let plane = windows.wide((row, col)).and_then(|wide| windows.chosen(wide, (row, col)));
        plane
            .and_then(|plane| oriented(&plane, camera, (row, col), params.min_incidence_cosine))
            .unwrap_or((f32::NAN, [0.0; 3]))
    });
    (fitted.map(|f| f.0), fitted.map(|f| f.1))
}

/// No window is fitted at a pixel.
const NONE: u32 = u32::MAX;

/// The widest windows of all pixels of an object, and what smaller ones are fitted to.
struct Windows<'a> {
    depth: &'a Raster<f32>,
    object: &'a Raster<bool>,
    noise: DepthNoise,
    params: &'a SmoothParams,
    /// Number of the fit of each pixel.
    at: Raster<u32>,
    fits: Vec<WindowFit>,
    excess: f64,
}

impl<'a> Windows<'a> {
    fn fit(depth: &'a Raster<f32>, object: &'a Raster<bool>, noise: DepthNoise, params: &'a SmoothParams) -> Self {
        let is_read = |at: &(usize, usize)| object[*at] && !depth[*at].is_nan();
        let pixels: Vec<(usize, usize)> = depth.pixels().map(|(r, c, _)| (r, c)).filter(is_read).collect();
        let (rows, cols) = depth.shape();
        let none = Raster::filled(rows, cols, NONE);
        let mut windows = Self { depth, object, noise, params, at: none, fits: Vec::new(), excess: 1.0 };
        let fits: Vec<_> = pixels.par_iter().map(|&at| Some((at, windows.around(at, params.radius)?))).collect();
        for (at, fit) in fits.into_iter().flatten() {
            windows.at[at] = windows.fits.len() as u32;
            windows.fits.push(fit);
        }
        windows.excess = excess_noise(&windows.fits);
        windows
    }

    /// The fit in the window around a pixel.
    fn around(&self, at: (usize, usize), radius: usize) -> Option<WindowFit> {
        fit_window(self.depth, self.object, at, radius.min(MAX_RADIUS), self.sigma(at), self.params)
    }

    fn sigma(&self, at: (usize, usize)) -> f64 {
        self.noise.sigma_at(f64::from(self.depth[at]))
    }

    fn wide(&self, at: (usize, usize)) -> Option<&WindowFit> {
        self.fits.get(self.at[at] as usize)
    }

    fn is_explained(&self, fit: &WindowFit) -> bool {
        fit.misfit(self.excess) <= self.params.max_misfit
    }

    /// The plane at a pixel: of the window around it, of the best one beside, or of a smaller one. A smaller one without a fit, or
    /// without curvature where the larger one has it, is no better.
    fn chosen(&self, wide: &WindowFit, at: (usize, usize)) -> Option<LocalPlane> {
        if self.is_explained(wide) {
            return wide.plane;
        }
        self.beside(wide, at).or_else(|| {
            let mut chosen = *wide;
            for radius in (self.params.min_radius..self.params.radius).rev() {
                match self.around(at, radius) {
                    Some(fit) if fit.plane.is_some() && fit.is_curved() >= chosen.is_curved() => chosen = fit,
                    _ => break,
                }
                if self.is_explained(&chosen) {
                    break;
                }
            }
            chosen.plane
        })
    }

    /// The surface at a pixel by the window beside it that noise explains best, of those no emptier than its own.
    fn beside(&self, own: &WindowFit, (row, col): (usize, usize)) -> Option<LocalPlane> {
        let (shift, full) = (self.params.shift as isize, (2 * self.params.radius + 1).pow(2));
        if shift == 0 || (own.count as f64) < WHOLE * full as f64 {
            return None;
        }
        let (z, sigma) = (f64::from(self.depth[(row, col)]), self.sigma((row, col)));
        let mut best: Option<(f64, LocalPlane)> = None;
        for (dv, du) in (-1..=1).flat_map(|dv| (-1..=1).map(move |du| (dv * shift, du * shift))) {
            let center = row.checked_add_signed(dv).zip(col.checked_add_signed(du));
            let Some(center) = center.filter(|&(r, c)| self.at.get(r, c).is_some()) else { continue };
            let Some(fit) = self.wide(center).filter(|f| f.plane.is_some() && f.count >= own.count) else { continue };
            let Some(plane) = fit.surface_at(-du as f64, -dv as f64, f64::from(self.depth[center])) else { continue };
            let misfit = fit.misfit(self.excess);
            let fits = misfit <= self.params.max_misfit && (plane.z - z).abs() < SAME_SURFACE * sigma;
            if fits && best.as_ref().is_none_or(|b| misfit < b.0) {
                best = Some((misfit, plane));
            }
        }
        best.map(|b| b.1)
    }
}

/// How many times the stated variance the noise has, at least 1: where the fits are good, a quarter of the windows, nothing but noise is left. A
/// sensor noisier than is said does not shrink every window.
fn excess_noise(fits: &[WindowFit]) -> f64 {
    let mut ratios: Vec<f32> = fits.iter().filter_map(WindowFit::variance_ratio).collect();
    let quarter = ratios.len() / 4;
    if ratios.is_empty() { 1.0 } else { f64::from(*ratios.select_nth_unstable_by(quarter, f32::total_cmp).1).max(1.0) }
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
        let object = Raster::filled(camera.height, camera.width, true);
        let noisy = |sigma: f64| {
            let (mut rng, noise) = (Pcg64Mcg::seed_from_u64(3), Normal::new(0.0, sigma).expect("finite"));
            Raster::from_fn(camera.height, camera.width, |_, col| (ridge(col) + noise.sample(&mut rng)) as f32)
        };
        let error = |depth: &Raster<f32>, sigma: f64, params: &SmoothParams, cols: std::ops::Range<usize>| {
            let noise = DepthNoise { sigma, sigma_quadratic: 0.0 };
            let (smooth, _) = smooth_depth(depth, &object, &camera, noise, params);
            let places = (5..55).flat_map(|row| cols.clone().map(move |col| (row, col)));
            let errors: Vec<f64> = places.map(|at| f64::from(smooth[at]) - ridge(at.1)).collect();
            let stay: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
            ((stay.iter().map(|e| e * e).sum::<f64>() / stay.len() as f64).sqrt(), errors.len() - stay.len())
        };
        let here = SmoothParams::default();
        let one = SmoothParams { min_radius: here.radius, shift: 0, ..here };
        // The pixels on the ridge itself are 4 σ from any window's plane if σ is 0.3 mm, and are dropped.
        let places = [(1e-3, 36..39), (1e-3, 39..42), (1e-3, 42..45), (3e-4, 36..39), (3e-4, 42..45)];
        for (sigma, cols) in places {
            let depth = noisy(sigma);
            let [kept, rounded] = [here, one].map(|p| error(&depth, sigma, &p, cols.clone()));
            let said = format!("{kept:?} (m, dropped), with one window for all {rounded:?}");
            assert!(kept.0 < 0.9 * rounded.0 && kept.1 == 0, "columns {cols:?}, σ {sigma}: {said}");
        }
        // Of a sensor that is twice as noisy as is said, too.
        for depth in [noisy(1e-3), noisy(2e-3)] {
            let (adaptive, flat) = (error(&depth, 1e-3, &here, 10..30), error(&depth, 1e-3, &one, 10..30));
            assert!(
                adaptive.0 < 1.25 * flat.0 && adaptive.1 <= flat.1,
                "the plane: {adaptive:?} (m, dropped), with one window for all {flat:?}"
            );
        }
    }

    #[test]
    fn shrinking_loses_no_pixel() {
        // A ridge and noise. A window of 7×7 holds 49 readings, too few for 50 neighbours.
        let camera = camera();
        let (mut rng, noise) = (Pcg64Mcg::seed_from_u64(3), Normal::new(0.0, 1e-3).expect("finite"));
        let depth = Raster::from_fn(camera.height, camera.width, |_, col| {
            (0.6 + 0.002 * (col as f64 - 40.0).abs() + noise.sample(&mut rng)) as f32
        });
        let object = depth.map(|_| true);
        let kept = |min_radius: usize, min_neighbours: usize| {
            let params = SmoothParams { min_radius, min_neighbours, shift: 0, ..SmoothParams::default() };
            let (smooth, _) = smooth_depth(&depth, &object, &camera, QUIET, &params);
            smooth.map(|z| z.to_bits())
        };
        let (one, shrunk, too_few) = (kept(4, 50), kept(3, 6), kept(3, 50));
        let differ = one.pixels().filter(|&(r, c, z)| *z != shrunk[(r, c)]).count();
        assert!(differ > 100, "{differ} pixels have smaller windows where they may");
        assert_eq!(too_few.as_slice(), one.as_slice());
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
    fn parameters_that_are_not_validated_do_not_panic() {
        let camera = camera();
        let flat = Raster::filled(60, 80, 0.5);
        let wild = SmoothParams { radius: 40, min_radius: 0, shift: usize::MAX, ..SmoothParams::default() };
        let (smooth, _) = smooth_depth(&flat, &flat.map(|_| true), &camera, QUIET, &wild);
        assert!((smooth[(30, 40)] - 0.5).abs() < 1e-5);
    }

    #[test]
    fn faults_name_the_field() {
        assert_eq!(SmoothParams::default().fault(), None);
        let wrong = SmoothParams { radius: 0, ..SmoothParams::default() };
        assert_eq!(wrong.fault(), Some(("smooth.radius", 0.0, "between 1 and 8 pixels")));
        for max_misfit in [f64::NAN, -1.0] {
            let wrong = SmoothParams { max_misfit, ..SmoothParams::default() };
            assert_eq!(wrong.fault().map(|f| f.0), Some("smooth.max_misfit"));
        }
        let wrong = SmoothParams { shift: 9, ..SmoothParams::default() };
        assert_eq!(wrong.fault(), Some(("smooth.shift", 9.0, "at most 8 pixels")));
    }
}
