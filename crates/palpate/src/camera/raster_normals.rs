use super::PinholeCamera;
use super::smooth::oriented;
use super::window_fit::LocalPlane;
use crate::geometry::Raster;

/// Fewest readings of a fit.
const LEAST: f32 = 6.0;
/// Determinant of the readings' scatter, pixels⁴, below which they lie on one line: of three neighbours in an L it is a third.
const LINE: f32 = 0.1;

/// Unit normals of a depth image in the **camera** frame, facing the camera, from the window round each pixel; NaN where there is no reading, where fewer
/// than six readings are near, and where they lie on one line.
///
/// * `depth` – metres, NaN = no reading · `radius` – half the window, pixels (4 = 9×9) · `max_step` – readings farther than this along the ray are of
///   another surface, metres
///
/// One least-squares plane in the inverse depth, which is *exactly* linear in (u, v) on a plane without lens distortion. Neither denoises nor weighs:
/// [`smooth_depth`](super::smooth_depth) does, and takes many times as long. O(pixels · window).
pub fn raster_normals(depth: &Raster<f32>, camera: &PinholeCamera, radius: usize, max_step: f64) -> Raster<[f32; 3]> {
    let (rows, cols) = depth.shape();
    let inverse = depth.map(|z| 1.0 / z);
    Raster::par_from_fn(rows, cols, |row, col| {
        let none = [f32::NAN; 3];
        if depth[(row, col)].is_nan() {
            return none;
        }
        fitted(depth, &inverse, (row, col), radius, max_step as f32)
            .and_then(|plane| oriented(&plane, camera, (row, col), 0.0))
            .map_or(none, |(_, normal)| normal)
    })
}

fn fitted(
    depth: &Raster<f32>,
    inverse: &Raster<f32>,
    (row, col): (usize, usize),
    radius: usize,
    max_step: f32,
) -> Option<LocalPlane> {
    let (rows, cols) = depth.shape();
    let (z0, w0) = (depth[(row, col)], inverse[(row, col)]);
    let from = col.saturating_sub(radius);
    let to = (col + radius).min(cols - 1);
    // n, Σu, Σv, Σu², Σuv, Σv², Σw, Σuw, Σvw, from the pixel and its inverse depth.
    let mut sums = [0.0_f32; 9];
    for r in row.saturating_sub(radius)..=(row + radius).min(rows - 1) {
        let v = r as f32 - row as f32;
        let span = r * cols + from..r * cols + to + 1;
        // n, Σu, Σu², Σw, Σuw of the row.
        let mut line = [0.0_f32; 5];
        for (k, (z, w)) in depth.as_slice()[span.clone()].iter().zip(&inverse.as_slice()[span]).enumerate() {
            let near = (z - z0).abs() <= max_step;
            let u = (from + k) as f32 - col as f32;
            let (one, w) = if near { (1.0, w - w0) } else { (0.0, 0.0) };
            let terms = [one, one * u, one * u * u, w, w * u];
            line.iter_mut().zip(terms).for_each(|(sum, t)| *sum += t);
        }
        let [n, u, uu, w, uw] = line;
        let terms = [n, u, n * v, uu, u * v, n * v * v, w, uw, w * v];
        sums.iter_mut().zip(terms).for_each(|(sum, t)| *sum += t);
    }
    let [n, u, v, uu, uv, vv, w, uw, vw] = sums;
    if n < LEAST {
        return None;
    }
    let (uu, uv, vv) = (uu - u * u / n, uv - u * v / n, vv - v * v / n);
    let (uw, vw) = (uw - u * w / n, vw - v * w / n);
    let determinant = uu * vv - uv * uv;
    if determinant < LINE {
        return None;
    }
    let (w_u, w_v) = ((uw * vv - vw * uv) / determinant, (vw * uu - uw * uv) / determinant);
    let at = f64::from(w0 + (w - w_u * u - w_v * v) / n);
    let z = 1.0 / at;
    Some(LocalPlane { z, z_u: -f64::from(w_u) * z * z, z_v: -f64::from(w_v) * z * z })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Vector, estimate_normals};
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    fn camera() -> PinholeCamera {
        PinholeCamera { width: 120, height: 90, fx: 110.0, fy: 110.0, cx: 59.5, cy: 44.5, distortion: [0.0; 5] }
    }

    /// Depth of a wall behind a ball, with uniform noise of σ ≈ 1 mm, and the true normals of the ball.
    fn ball(noise: f64) -> (Raster<f32>, Raster<Option<Vector>>) {
        let (camera, center, radius) = (camera(), Point::new(0.0, 0.0, 0.6), 0.12);
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut truth = Raster::filled(90, 120, None);
        let mut depth = Raster::filled(90, 120, 0.9_f32);
        for row in 0..90 {
            for col in 0..120 {
                let ray = camera.ray(col as f64, row as f64);
                let (a, b, c) = (ray.norm_squared(), ray.dot(&center.coords), center.coords.norm_squared());
                let root = b * b - a * (c - radius * radius);
                let mut z = 0.9;
                if root > 0.0 {
                    z = (b - root.sqrt()) / a;
                    truth[(row, col)] = Some((Point::from(ray * z) - center) / radius);
                }
                depth[(row, col)] = (z + noise * rng.random_range(-1.7..1.7)) as f32;
            }
        }
        (depth, truth)
    }

    #[test]
    fn a_tilted_plane_has_its_exact_normal() {
        let camera = camera();
        let n = Vector::new(0.3, -0.5, -0.8).normalize();
        let depth = Raster::from_fn(90, 120, |r, c| (-0.7 * 0.8 / n.dot(&camera.ray(c as f64, r as f64))) as f32);
        let normals = raster_normals(&depth, &camera, 4, 0.05);
        let worst =
            normals.as_slice().iter().map(|m| Vector::from(m.map(f64::from)).cross(&n).norm()).fold(0.0, f64::max);
        assert!(worst < 2e-3, "{worst}");
    }

    #[test]
    fn normals_of_a_noisy_ball_are_no_worse_than_those_of_thirty_neighbours() {
        let (depth, truth) = ball(1e-3);
        let camera = camera();
        let normals = raster_normals(&depth, &camera, 4, 0.02);
        let at: Vec<(usize, usize)> =
            truth.pixels().filter(|(_, _, t)| t.is_some()).map(|(row, col, _)| (row, col)).collect();
        let points: Vec<Point> =
            at.iter().map(|&(r, c)| Point::from(camera.ray(c as f64, r as f64) * f64::from(depth[(r, c)]))).collect();
        let others = estimate_normals(&points, 30, &Point::origin());
        let angle = |n: Vector, at: &(usize, usize)| truth[*at].map_or(0.0, |t| n.dot(&t).clamp(-1.0, 1.0).acos());
        // Seen at less than 70°: beyond, the outline is near.
        let inner = |at: &&(usize, usize)| {
            truth[**at].is_some_and(|t| -t.dot(&camera.ray(at.1 as f64, at.0 as f64).normalize()) > 0.34)
        };
        let inner: Vec<usize> = (0..at.len()).filter(|&i| inner(&&at[i])).collect();
        let mean = |of: &dyn Fn(usize) -> Vector| {
            inner.iter().map(|&i| angle(of(i), &at[i])).sum::<f64>() / inner.len() as f64
        };
        let ours = mean(&|i| Vector::from(normals[at[i]].map(f64::from)));
        let theirs = mean(&|i| others[i]);
        assert!(ours < theirs && ours < 0.1, "{ours} against {theirs} rad");
    }

    #[test]
    fn without_readings_there_is_no_normal() {
        let mut depth = Raster::filled(90, 120, f32::NAN);
        assert!(raster_normals(&depth, &camera(), 4, 0.02).as_slice().iter().all(|n| n[0].is_nan()));
        for col in 0..120 {
            depth[(10, col)] = 0.5;
        }
        let line = raster_normals(&depth, &camera(), 4, 0.02);
        assert!(line.as_slice().iter().all(|n| n[0].is_nan()), "a line has no normal");
    }
}
