//! Depth and colour of two cameras in one raster.

use super::PinholeCamera;
use super::undistort::{STEP_SHARE, sample_color};
use crate::geometry::{Isometry, Point, Raster};

/// A reading may lie so much behind the surface that hides it, as a share of its depth, and still count as that surface.
const SAME_SURFACE: f64 = 0.01;

/// The depth image as the colour camera would have taken it: the readings as a surface, drawn into the colour camera with the
/// nearest kept. NaN where there is none.
///
/// Four neighbouring readings of one surface make two triangles, within which 1/z is linear over the image: exact for planes,
/// for any resolution of the two. A reading without such neighbours counts for the pixel that it falls on.
///
/// * `depth` – metres, NaN without a reading; of the depth camera's size
pub fn register_depth(
    depth: &Raster<f32>,
    depth_camera: &PinholeCamera,
    color_camera: &PinholeCamera,
    color_from_depth: &Isometry,
) -> Raster<f32> {
    let mut out = Raster::filled(color_camera.height, color_camera.width, f32::NAN);
    let ideal = PinholeCamera { distortion: [0.0; 5], ..*color_camera };
    // Drawn without distortion, in which triangles have straight sides; each pixel is then looked up along its own ray.
    let moved = Raster::par_from_fn(depth.rows(), depth.cols(), |row, col| {
        let z = f64::from(depth[(row, col)]);
        // Written so that NaN fails too.
        if !(z > 0.0) {
            return None;
        }
        let p = color_from_depth * Point::from(depth_camera.ray(col as f64, row as f64) * z);
        let place = color_camera.project(&p)?;
        let straight = ideal.project(&p)?;
        Some(Vertex { place, straight, z: p.z, reading: z })
    });
    for row in 0..depth.rows() {
        for col in 0..depth.cols() {
            if let Some(vertex) = moved[(row, col)] {
                keep_nearest(&mut out, vertex.place.0.round(), vertex.place.1.round(), vertex.z);
            }
        }
    }
    // Readings only stand in where no triangle reaches: those are exact.
    let single = out;
    let mut out = Raster::filled(color_camera.height, color_camera.width, f32::NAN);
    for row in 1..depth.rows() {
        for col in 1..depth.cols() {
            let four = [(row - 1, col - 1), (row - 1, col), (row, col), (row, col - 1)].map(|at| moved[at]);
            let [Some(a), Some(b), Some(c), Some(d)] = four else { continue };
            let readings = [a, b, c, d].map(|v| v.reading);
            let low = readings.iter().copied().fold(f64::INFINITY, f64::min);
            let high = readings.iter().copied().fold(0.0, f64::max);
            if high - low <= STEP_SHARE * low {
                triangle(&mut out, color_camera, &ideal, [a, b, c]);
                triangle(&mut out, color_camera, &ideal, [a, c, d]);
            }
        }
    }
    for (z, alone) in out.as_mut_slice().iter_mut().zip(single.as_slice()) {
        let hides = *alone < *z * (1.0 - SAME_SURFACE as f32);
        if z.is_nan() || hides {
            *z = *alone;
        }
    }
    out
}

/// The colours as the depth camera would have taken them: each reading gets the colour where it falls in the colour image. Black
/// where there is no reading, where it falls outside, and where something nearer hides it from the colour camera.
///
/// * `color` – of the colour camera's size
pub fn register_color(
    color: &Raster<[u8; 3]>,
    color_camera: &PinholeCamera,
    depth: &Raster<f32>,
    depth_camera: &PinholeCamera,
    color_from_depth: &Isometry,
) -> Raster<[u8; 3]> {
    let seen = register_depth(depth, depth_camera, color_camera, color_from_depth);
    Raster::par_from_fn(depth.rows(), depth.cols(), |row, col| {
        let z = f64::from(depth[(row, col)]);
        // Written so that NaN fails too.
        if !(z > 0.0) {
            return [0; 3];
        }
        let p = color_from_depth * Point::from(depth_camera.ray(col as f64, row as f64) * z);
        let Some((u, v)) = color_camera.project(&p).filter(|(u, v)| color_camera.contains(*u, *v)) else {
            return [0; 3];
        };
        let at = |x: f64, n: usize| (x.round().max(0.0) as usize).min(n - 1);
        let nearest = f64::from(seen[(at(v, color.rows()), at(u, color.cols()))]);
        // A steep surface passes through several depths within a pixel.
        let hidden = nearest < p.z * (1.0 - 2.0 * SAME_SURFACE);
        if hidden { [0; 3] } else { sample_color(color, u, v) }
    })
}

#[derive(Clone, Copy)]
struct Vertex {
    /// Pixel in the colour camera.
    place: (f64, f64),
    /// The same without distortion.
    straight: (f64, f64),
    z: f64,
    reading: f64,
}

fn keep_nearest(out: &mut Raster<f32>, col: f64, row: f64, z: f64) {
    if row < 0.0 || col < 0.0 || row >= out.rows() as f64 || col >= out.cols() as f64 {
        return;
    }
    let pixel = &mut out[(row as usize, col as usize)];
    if pixel.is_nan() || z < f64::from(*pixel) {
        *pixel = z as f32;
    }
}

fn triangle(out: &mut Raster<f32>, camera: &PinholeCamera, ideal: &PinholeCamera, [a, b, c]: [Vertex; 3]) {
    let range = |pick: fn(&Vertex) -> f64, size: usize| {
        let values = [pick(&a), pick(&b), pick(&c)];
        let low = values.iter().copied().fold(f64::INFINITY, f64::min).floor().max(0.0);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max).ceil().min(size as f64 - 1.0);
        (low as usize, high)
    };
    let ((c0, c1), (r0, r1)) = (range(|v| v.place.0, out.cols()), range(|v| v.place.1, out.rows()));
    if c1 < 0.0 || r1 < 0.0 {
        return;
    }
    let edge = |p: (f64, f64), q: (f64, f64), x: (f64, f64)| (q.0 - p.0) * (x.1 - p.1) - (q.1 - p.1) * (x.0 - p.0);
    let area = edge(a.straight, b.straight, c.straight);
    if area.abs() < 1e-12 {
        return;
    }
    for row in r0..=r1 as usize {
        for col in c0..=c1 as usize {
            let at = if camera.is_distorted() {
                let ray = camera.ray(col as f64, row as f64);
                (ideal.fx * ray.x + ideal.cx, ideal.fy * ray.y + ideal.cy)
            } else {
                (col as f64, row as f64)
            };
            let weights = [
                edge(b.straight, c.straight, at) / area,
                edge(c.straight, a.straight, at) / area,
                edge(a.straight, b.straight, at) / area,
            ];
            // Neighbouring triangles share their sides: a pixel on one must not fall between them.
            if weights.iter().all(|w| *w >= -1e-9) {
                let inverse = weights[0] / a.z + weights[1] / b.z + weights[2] / c.z;
                keep_nearest(out, col as f64, row as f64, 1.0 / inverse);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;

    const DEPTH: PinholeCamera =
        PinholeCamera { width: 160, height: 120, fx: 143.0, fy: 142.0, cx: 79.2, cy: 60.4, distortion: [0.0; 5] };
    const COLOR: PinholeCamera = PinholeCamera {
        width: 200,
        height: 150,
        fx: 171.0,
        fy: 170.0,
        cx: 101.0,
        cy: 73.0,
        distortion: [0.11, -0.24, 0.001, -0.0005, 0.08],
    };

    fn mounting() -> Isometry {
        Isometry::new(Vector::new(-0.025, 0.001, 0.002), Vector::new(0.01, -0.02, 0.005))
    }

    /// Depth of the plane n·x = offset (depth camera's frame) along a ray from `origin`.
    fn plane(origin: Point, ray: Vector) -> f64 {
        let (n, offset) = (Vector::new(0.15, -0.2, 0.95).normalize(), 0.7);
        (offset - n.dot(&origin.coords)) / n.dot(&ray)
    }

    #[test]
    fn a_plane_has_its_exact_depth_in_the_other_camera() {
        let depth = Raster::from_fn(120, 160, |r, c| plane(Point::origin(), DEPTH.ray(c as f64, r as f64)) as f32);
        let seen = register_depth(&depth, &DEPTH, &COLOR, &mounting());
        let depth_from_color = mounting().inverse();
        let (mut worst, mut count) = (0.0f64, 0);
        for (row, col, &z) in seen.pixels().filter(|p| p.2.is_finite()) {
            let ray = depth_from_color.rotation * COLOR.ray(col as f64, row as f64);
            let expected = plane(Point::from(depth_from_color.translation.vector), ray);
            // Single readings at the rim are half a pixel off; the rest is exact.
            let back = depth_from_color * Point::from(COLOR.ray(col as f64, row as f64) * expected);
            let inner =
                DEPTH.project(&back).is_some_and(|(u, v)| (1.0..158.0).contains(&u) && (1.0..118.0).contains(&v));
            if inner {
                worst = worst.max((f64::from(z) - expected).abs());
                count += 1;
            }
        }
        assert!(worst < 5e-7 && count > 20_000, "{worst} {count}");
    }

    #[test]
    fn no_hole_opens_where_the_colour_camera_is_finer() {
        let depth = Raster::filled(120, 160, 0.6f32);
        let fine =
            PinholeCamera { width: 640, height: 480, fx: 560.0, fy: 560.0, cx: 320.0, cy: 240.0, distortion: [0.0; 5] };
        let seen = register_depth(&depth, &DEPTH, &fine, &Isometry::identity());
        let middle = seen.pixels().filter(|p| (20..460).contains(&p.0) && (20..620).contains(&p.1));
        assert!(middle.map(|p| p.2).all(|z| (z - 0.6).abs() < 1e-6));
    }

    #[test]
    fn what_the_colour_camera_cannot_see_gets_no_colour() {
        // A near strip hides part of the wall from a colour camera to the side; the strip is red, the wall green.
        let depth = Raster::from_fn(120, 160, |_, c| if (70..90).contains(&c) { 0.4f32 } else { 0.8 });
        let side = Isometry::translation(-0.1, 0.0, 0.0);
        let seen = register_depth(&depth, &DEPTH, &DEPTH, &side);
        let color = seen.map(|z| if *z < 0.6 { [200, 0, 0] } else { [0, 200, 0] });
        let registered = register_color(&color, &DEPTH, &depth, &DEPTH, &side);
        let mut hidden = 0;
        for (row, col, pixel) in registered.pixels().filter(|p| (5..115).contains(&p.0)) {
            let strip = (71..89).contains(&col);
            assert!(!(strip && pixel[1] > 100), "wall's colour on the strip at {row} {col}");
            assert!(strip || (69..91).contains(&col) || pixel[0] < 100, "strip's colour on the wall at {row} {col}");
            hidden += usize::from(*pixel == [0; 3]);
        }
        assert!(hidden > 500, "{hidden}");
    }

    #[test]
    fn readings_without_a_place_are_dropped() {
        let mut depth = Raster::filled(120, 160, f32::NAN);
        depth[(60, 80)] = 0.5;
        depth[(0, 0)] = f32::INFINITY;
        depth[(1, 1)] = -1.0;
        let seen = register_depth(&depth, &DEPTH, &DEPTH, &Isometry::identity());
        let found: Vec<_> = seen.pixels().filter(|p| p.2.is_finite()).collect();
        assert!(found.len() == 1 && found[0].0 == 60 && found[0].1 == 80, "{found:?}");
    }
}
