//! Images as a camera without distortion would have taken them.

use super::PinholeCamera;
use crate::geometry::Raster;

/// Neighbouring readings that differ by a larger share lie on different surfaces: nothing is interpolated between them.
pub(super) const STEP_SHARE: f64 = 0.02;

/// For each pixel of the undistorted image, its place in the distorted one.
fn places(camera: &PinholeCamera) -> (PinholeCamera, impl Fn(usize, usize) -> Option<(f64, f64)> + Sync) {
    let ideal = PinholeCamera { distortion: [0.0; 5], ..*camera };
    let camera = *camera;
    let place = move |row: usize, col: usize| {
        let ray = ideal.ray(col as f64, row as f64);
        let (u, v) = camera.project(&ray.into())?;
        // Beyond the fold of the distortion a ray projects into the image a second time.
        let back = camera.ray(u, v);
        let same = (back.x - ray.x).abs() + (back.y - ray.y).abs() < 1e-6;
        (camera.contains(u, v) && same).then_some((u, v))
    };
    (ideal, place)
}

/// The colour image of a camera with the same fx, fy, cx, cy and without distortion, and that camera. Bilinear; black where
/// the image does not reach.
///
/// The image must have the camera's size.
pub fn undistort_color(image: &Raster<[u8; 3]>, camera: &PinholeCamera) -> (Raster<[u8; 3]>, PinholeCamera) {
    let (ideal, place) = places(camera);
    let out = Raster::par_from_fn(image.rows(), image.cols(), |row, col| {
        place(row, col).map_or([0; 3], |(u, v)| sample_color(image, u, v))
    });
    (out, ideal)
}

/// The same of a grey image of 16 bits (infrared).
///
/// The image must have the camera's size.
pub fn undistort_gray(image: &Raster<u16>, camera: &PinholeCamera) -> (Raster<u16>, PinholeCamera) {
    let (ideal, place) = places(camera);
    let size = (image.cols(), image.rows());
    let out = Raster::par_from_fn(image.rows(), image.cols(), |row, col| {
        place(row, col).map_or(0, |(u, v)| bilinear(size, u, v, |r, c| f64::from(image[(r, c)])) as u16)
    });
    (out, ideal)
}

/// The same of a depth image: z stays, it moves to where its ray goes. Between readings of one surface 1/z is interpolated,
/// which is exact for planes; elsewhere the nearest reading counts. NaN where there is none.
///
/// The image must have the camera's size.
pub fn undistort_depth(depth: &Raster<f32>, camera: &PinholeCamera) -> (Raster<f32>, PinholeCamera) {
    let (ideal, place) = places(camera);
    let out = Raster::par_from_fn(depth.rows(), depth.cols(), |row, col| {
        place(row, col).map_or(f32::NAN, |(u, v)| sample_depth(depth, camera, u, v))
    });
    (out, ideal)
}

/// Bilinear colour at a place; the outer half pixel repeats the border.
pub(super) fn sample_color(image: &Raster<[u8; 3]>, u: f64, v: f64) -> [u8; 3] {
    let size = (image.cols(), image.rows());
    std::array::from_fn(|k| bilinear(size, u, v, |r, c| f64::from(image[(r, c)][k])) as u8)
}

/// The value at a place between four pixels, rounded.
fn bilinear((cols, rows): (usize, usize), u: f64, v: f64, at: impl Fn(usize, usize) -> f64) -> f64 {
    let (c0, c1, fx) = split(u, cols);
    let (r0, r1, fy) = split(v, rows);
    let top = at(r0, c0) * (1.0 - fx) + at(r0, c1) * fx;
    let bottom = at(r1, c0) * (1.0 - fx) + at(r1, c1) * fx;
    (top * (1.0 - fy) + bottom * fy).round()
}

fn split(x: f64, n: usize) -> (usize, usize, f64) {
    let x = x.clamp(0.0, n as f64 - 1.0);
    let low = x as usize;
    (low, (low + 1).min(n - 1), x - low as f64)
}

fn sample_depth(depth: &Raster<f32>, camera: &PinholeCamera, u: f64, v: f64) -> f32 {
    let (c0, c1, fx) = split(u, depth.cols());
    let (r0, r1, fy) = split(v, depth.rows());
    let four = [(r0, c0), (r0, c1), (r1, c0), (r1, c1)];
    let z = four.map(|at| f64::from(depth[at]));
    let (low, high) = (z.iter().copied().fold(f64::INFINITY, f64::min), z.iter().copied().fold(0.0, f64::max));
    // Comparisons with NaN are false: a missing reading leaves the nearest.
    if z.iter().all(|z| *z > 0.0) && high - low <= STEP_SHARE * low {
        // A plane has 1/z linear in the undistorted ray, not in the distorted pixel.
        if let Some(z) = on_plane(camera, four, z, (u, v)) {
            return z as f32;
        }
    }
    let nearest = (if fy < 0.5 { r0 } else { r1 }, if fx < 0.5 { c0 } else { c1 });
    depth[nearest]
}

/// 1/z at a pixel from four pixels around it: the plane (least squares) through them.
fn on_plane(camera: &PinholeCamera, four: [(usize, usize); 4], z: [f64; 4], (u, v): (f64, f64)) -> Option<f64> {
    let center = camera.ray(u, v);
    let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros());
    let scale = camera.fx;
    for ((row, col), z) in four.into_iter().zip(z) {
        let ray = camera.ray(col as f64, row as f64);
        let terms = nalgebra::Vector3::new((ray.x - center.x) * scale, (ray.y - center.y) * scale, 1.0);
        normal += terms * terms.transpose();
        right += terms / z;
    }
    // On the image's edge the four are two: the nearest is as good.
    let inverse = (normal.try_inverse()? * right).z;
    let z = 1.0 / inverse;
    (inverse.is_finite() && z > 0.0 && normal.determinant() > 1e-3).then_some(z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Vector};

    const CAMERA: PinholeCamera = PinholeCamera {
        width: 160,
        height: 120,
        fx: 133.2,
        fy: 133.2,
        cx: 80.5,
        cy: 58.4,
        distortion: [-0.282, 0.044, 0.0011, -0.0003, 0.127],
    };

    fn plane_depth(camera: &PinholeCamera, row: usize, col: usize) -> f32 {
        let (n, offset) = (Vector::new(0.2, -0.3, 0.9).normalize(), 0.6);
        (offset / n.dot(&camera.ray(col as f64, row as f64))) as f32
    }

    #[test]
    fn the_depth_of_a_plane_is_exact() {
        let depth = Raster::from_fn(120, 160, |r, c| plane_depth(&CAMERA, r, c));
        let (flat, ideal) = undistort_depth(&depth, &CAMERA);
        let mut worst = 0.0f32;
        for (row, col, &z) in flat.pixels().filter(|p| p.2.is_finite()) {
            let inside = (1..119).contains(&row) && (1..159).contains(&col);
            let place = CAMERA.project(&Point::from(ideal.ray(col as f64, row as f64))).expect("in front");
            let inner = (0.0..159.0).contains(&place.0) && (0.0..119.0).contains(&place.1);
            if inside && inner {
                worst = worst.max((z - plane_depth(&ideal, row, col)).abs());
            }
        }
        assert!(worst < 2e-7, "{worst}");
        assert!(flat.pixels().filter(|p| p.2.is_finite()).count() > 15000);
    }

    #[test]
    fn readings_are_not_mixed_across_an_edge_nor_invented() {
        let depth = Raster::from_fn(120, 160, |r, c| {
            if r == 60 {
                f32::NAN
            } else if c < 80 {
                0.5
            } else {
                1.0
            }
        });
        let (flat, _) = undistort_depth(&depth, &CAMERA);
        assert!(flat.as_slice().iter().all(|z| z.is_nan() || (*z - 0.5).abs() < 1e-6 || (*z - 1.0).abs() < 1e-6));
        let lost = flat.as_slice().iter().filter(|z| z.is_nan()).count();
        assert!(lost > 100, "{lost}");
    }

    #[test]
    fn a_straight_line_bent_by_the_lens_is_straight_again() {
        let ideal = PinholeCamera { distortion: [0.0; 5], ..CAMERA };
        // Brightness along the straight coordinate x of each ray: linear in the undistorted column.
        let shade = |ray: Vector| 128.0 + 180.0 * ray.x;
        let image = Raster::from_fn(120, 160, |r, c| [shade(CAMERA.ray(c as f64, r as f64)).round() as u8; 3]);
        let (flat, camera) = undistort_color(&image, &CAMERA);
        assert_eq!(camera, ideal);
        for (row, col, pixel) in flat.pixels().filter(|p| *p.2 != [0; 3]) {
            let expected = shade(ideal.ray(col as f64, row as f64));
            assert!((f64::from(pixel[0]) - expected).abs() < 1.6, "{row} {col} {pixel:?} {expected}");
        }
    }

    #[test]
    fn without_distortion_nothing_changes() {
        let camera = PinholeCamera { distortion: [0.0; 5], ..CAMERA };
        let depth = Raster::from_fn(120, 160, |r, c| 0.5 + (r * c % 7) as f32);
        assert_eq!(undistort_depth(&depth, &camera).0, depth);
        let image = Raster::from_fn(120, 160, |r, c| [r as u8, c as u8, 7]);
        assert_eq!(undistort_color(&image, &camera).0, image);
        let infrared = Raster::from_fn(120, 160, |r, c| (300 * r + c) as u16);
        assert_eq!(undistort_gray(&infrared, &camera).0, infrared);
    }
}
