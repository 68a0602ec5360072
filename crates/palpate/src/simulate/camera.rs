use super::SimulateError;
use super::seed::stream;
use crate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use crate::geometry::{Bvh, Isometry, Plane, Point, Raster, TriangleMesh, Vector};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The simulated depth camera and where it stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraParams {
    /// Image width, pixels. Larger with the same focal length: a wider view.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Focal length, pixels. Larger: the object fills more of the image. 554.26 is a 60° wide view at 640.
    pub focal: f64,
    /// Distance from the object's middle, metres. Larger: coarser sampling. Grown in steps of 5 % until the object fits.
    pub range: f64,
    /// Elevation of the camera over the support plane of view 0, 1, 2, …, degrees; later views start again. Larger: more of the
    /// top, less of the sides.
    pub elevations_deg: Vec<f64>,
    /// 1σ of the depth noise along z, metres. 1 mm is a good structured-light camera at 0.7 m.
    pub sigma: f64,
    /// Quadratic part of the noise, 1/metre: σ(z) = `sigma` + this · z².
    pub sigma_quadratic: f64,
    /// Share of object pixels that read nothing. Larger: more holes.
    pub dropout: f64,
    /// Whether the scene carries the object's mask.
    pub with_mask: bool,
}

impl Default for CameraParams {
    fn default() -> Self {
        Self {
            width: 640,
            height: 480,
            focal: 554.26,
            range: 0.7,
            elevations_deg: vec![30.0, 42.0, 55.0],
            sigma: 1.0e-3,
            sigma_quadratic: 0.0,
            dropout: 0.0,
            with_mask: true,
        }
    }
}

impl CameraParams {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`SimulateError::Params`] with field, value and rule.
    pub fn validate(&self) -> Result<(), SimulateError> {
        let check = |field, found: f64, ok: bool, needed| {
            if ok { Ok(()) } else { Err(SimulateError::Params { field, found, needed }) }
        };
        let size = |n: usize| (8..=8192).contains(&n);
        check("camera.width", self.width as f64, size(self.width), "in 8..=8192 px")?;
        check("camera.height", self.height as f64, size(self.height), "in 8..=8192 px")?;
        check("camera.focal", self.focal, self.focal > 0.0 && self.focal.is_finite(), "positive")?;
        check("camera.range", self.range, self.range > 0.0 && self.range.is_finite(), "positive")?;
        let count = self.elevations_deg.len();
        check("camera.elevations_deg (count)", count as f64, count > 0, "at least one")?;
        let steep = self.elevations_deg.iter().find(|e| !(-89.9..=89.9).contains(*e));
        check("camera.elevations_deg", steep.copied().unwrap_or(0.0), steep.is_none(), "in [-89.9, 89.9] degrees")?;
        let noise = self.sigma.min(self.sigma_quadratic);
        check("camera.sigma", noise, noise >= 0.0 && (self.sigma + self.sigma_quadratic).is_finite(), "at least 0")?;
        check("camera.dropout", self.dropout, (0.0..1.0).contains(&self.dropout), "in [0, 1)")
    }

    /// The pinhole model: no distortion, principal point in the middle.
    pub fn pinhole(&self) -> PinholeCamera {
        PinholeCamera {
            width: self.width,
            height: self.height,
            fx: self.focal,
            fy: self.focal,
            cx: 0.5 * (self.width as f64 - 1.0),
            cy: 0.5 * (self.height as f64 - 1.0),
            distortion: [0.0; 5],
        }
    }
}

/// Camera pose at `eye` looking at `target`: z forward, y down (against the world's +z), x right.
pub fn look_at(eye: &Point, target: &Point) -> Isometry {
    Isometry::face_towards(eye, target, &-Vector::z())
}

/// Takes a depth image of an object that stands on z = 0; exact pose, absent background.
///
/// Rays through pixel centres are cast at the mesh; noise is added along z. The azimuth is drawn from `seed`, `object` and `view`.
pub(super) fn take_frame(object: &str, mesh: &TriangleMesh, params: &CameraParams, view: usize, seed: u64) -> Frame {
    let camera = params.pinhole();
    let azimuth = std::f64::consts::TAU * stream(seed, object, view, "azimuth").random::<f64>();
    let elevation = params.elevations_deg[view % params.elevations_deg.len()].to_radians();
    let direction = Vector::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
    let (world_from_camera, window) = fit(mesh, &camera, &direction, params.range);
    let mut depth = cast(mesh, &camera, &world_from_camera, window);
    let mask = params.with_mask.then(|| depth.map(|z| z.is_finite()));
    let noise = DepthNoise { sigma: params.sigma, sigma_quadratic: params.sigma_quadratic };
    disturb(&mut depth, noise, params.dropout, &mut stream(seed, object, view, "depth noise"));
    Frame {
        camera,
        world_from_camera,
        depth,
        background: Background::Absent,
        noise,
        color: None,
        mask,
        support: Plane::new(Vector::z(), &Point::origin()),
    }
}

/// Rows and columns that the object can cover: row range, column range, ends excluded.
type Window = (std::ops::Range<usize>, std::ops::Range<usize>);

/// The nearest pose not nearer than `range` from which the whole object is seen with a margin, and where in the image it is.
fn fit(mesh: &TriangleMesh, camera: &PinholeCamera, direction: &Vector, range: f64) -> (Isometry, Window) {
    const MARGIN_PX: f64 = 8.0;
    let center = mesh.bounds().map_or_else(Point::origin, |b| b.center());
    let mut range = range;
    // 200 steps of 5 % reach 17,000 times the range: any object fits before.
    for _ in 0..200 {
        let world_from_camera = look_at(&(center + direction * range), &center);
        let camera_from_world = world_from_camera.inverse();
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let in_front = mesh.vertices.iter().all(|v| match camera.project(&(camera_from_world * v)) {
            Some((u, v)) => {
                low = [low[0].min(u), low[1].min(v)];
                high = [high[0].max(u), high[1].max(v)];
                true
            }
            None => false,
        });
        let fits = in_front
            && low.iter().all(|&x| x >= MARGIN_PX)
            && high[0] <= camera.width as f64 - 1.0 - MARGIN_PX
            && high[1] <= camera.height as f64 - 1.0 - MARGIN_PX;
        if fits {
            let span = |i: usize| low[i].floor() as usize..high[i].ceil() as usize + 1;
            return (world_from_camera, (span(1), span(0)));
        }
        range *= 1.05;
    }
    (look_at(&(center + direction * range), &center), (0..camera.height, 0..camera.width))
}

/// Depth along the optical axis of every pixel, NaN off the object; exact, rows in parallel.
pub(super) fn cast(
    mesh: &TriangleMesh,
    camera: &PinholeCamera,
    world_from_camera: &Isometry,
    (rows, cols): Window,
) -> Raster<f32> {
    let bvh = Bvh::new(mesh);
    let eye = Point::from(world_from_camera.translation.vector);
    let mut depth = Raster::filled(camera.height, camera.width, f32::NAN);
    let width = camera.width;
    depth.as_mut_slice().par_chunks_mut(width).enumerate().filter(|(row, _)| rows.contains(row)).for_each(
        |(row, line)| {
            for col in cols.clone() {
                // The ray has z = 1, so the distance in units of its length is the depth.
                let ray = world_from_camera * camera.ray(col as f64, row as f64);
                if let Some(hit) = bvh.cast_ray(&eye, &ray, f64::MAX) {
                    line[col] = hit.distance as f32;
                }
            }
        },
    );
    depth
}

/// Noise and dropouts, a stream of its own for each row.
fn disturb(depth: &mut Raster<f32>, noise: DepthNoise, dropout: f64, rng: &mut Pcg64Mcg) {
    let cols = depth.cols();
    for line in depth.as_mut_slice().chunks_mut(cols) {
        let mut rng = Pcg64Mcg::seed_from_u64(rng.random());
        for z in line.iter_mut().filter(|z| z.is_finite()) {
            let true_z = f64::from(*z);
            let error: f64 = rng.sample(StandardNormal);
            *z = (true_z + error * noise.sigma_at(true_z)) as f32;
            if dropout > 0.0 && rng.random::<f64>() < dropout {
                *z = f32::NAN;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Solid;
    use super::*;

    #[test]
    fn the_optical_axis_points_at_the_target_and_the_image_is_upright() {
        let pose = look_at(&Point::new(0.5, 0.1, 0.6), &Point::new(0.1, 0.2, 0.05));
        let target = pose.inverse_transform_point(&Point::new(0.1, 0.2, 0.05));
        assert!(target.x.abs() < 1e-12 && target.y.abs() < 1e-12 && target.z > 0.0, "{target}");
        // What is higher in the world is higher in the image: smaller v.
        let above = pose.inverse_transform_point(&Point::new(0.1, 0.2, 0.15));
        assert!(above.y < 0.0 && above.x.abs() < 1e-12);
    }

    #[test]
    fn depth_of_a_sphere_is_the_closed_form_and_noise_has_the_stated_sigma() {
        let solid = Solid::named("sphere").expect("listed");
        let mesh = solid.mesh(5e-6, 3e-3);
        let clean = CameraParams { sigma: 0.0, ..CameraParams::default() };
        let frame = take_frame("sphere", &mesh, &clean, 0, 0);
        let center = frame.world_from_camera.inverse_transform_point(&Point::new(0.0, 0.0, 0.04));
        assert!((center.z - 0.7).abs() < 1e-9);
        let mut hits = 0;
        for (row, col, &z) in frame.depth.pixels() {
            let ray = frame.camera.ray(col as f64, row as f64);
            let (a, b) = (ray.norm_squared(), ray.dot(&center.coords));
            let discriminant = b * b - a * (center.coords.norm_squared() - 0.04 * 0.04);
            // Where the ray only grazes, the chords of the mesh decide.
            if discriminant > 1e-4 {
                hits += 1;
                let expected = (b - discriminant.sqrt()) / a;
                assert!((f64::from(z) - expected).abs() < 0.05e-3, "{row} {col}: {z} {expected}");
            } else if discriminant < 0.0 {
                assert!(z.is_nan());
            }
        }
        assert!(hits > 2500, "{hits}");
        let noisy = take_frame("sphere", &mesh, &CameraParams::default(), 0, 0);
        let errors: Vec<f64> = (noisy.depth.as_slice().iter().zip(frame.depth.as_slice()))
            .filter(|(a, _)| a.is_finite())
            .map(|(a, b)| f64::from(a - b))
            .collect();
        let sigma = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((sigma / 1e-3 - 1.0).abs() < 0.05, "{sigma}");
    }

    #[test]
    fn a_long_object_is_seen_whole_from_farther_away() {
        let mesh = Solid::Cuboid { size: [0.9, 0.05, 0.05] }.mesh(1e-5, 0.05);
        let frame = take_frame("beam", &mesh, &CameraParams::default(), 0, 3);
        assert!(frame.world_from_camera.translation.vector.norm() > 0.75);
        let (rows, cols) = frame.depth.shape();
        let on_border =
            frame.depth.pixels().any(|(r, c, z)| z.is_finite() && (r == 0 || c == 0 || r + 1 == rows || c + 1 == cols));
        assert!(!on_border);
    }

    #[test]
    fn dropouts_leave_the_mask_whole() {
        let mesh = Solid::named("cube").expect("listed").mesh(1e-5, 0.01);
        let frame = take_frame("cube", &mesh, &CameraParams { dropout: 0.3, ..CameraParams::default() }, 1, 0);
        let mask = frame.mask.expect("asked for");
        let seen = mask.as_slice().iter().filter(|&&m| m).count() as f64;
        let read = frame.depth.as_slice().iter().filter(|z| z.is_finite()).count() as f64;
        assert!((read / seen - 0.7).abs() < 0.03, "{read} of {seen}");
    }
}
