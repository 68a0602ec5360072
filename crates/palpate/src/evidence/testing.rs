//! Exact views of analytic solids, for tests.

use crate::camera::{Background, DepthNoise, Frame, PinholeCamera, Visible};
use crate::geometry::{Isometry, Plane, Point, Raster, Vector};
use crate::tactile::Patch;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// A solid that a ray can meet and whose distance is known.
pub(crate) enum Solid {
    /// Centre, radius.
    Sphere(Point, f64),
    /// Centre, half sizes, yaw about z.
    Box(Point, Vector, f64),
    /// Upright, centre, radius, half height.
    Cylinder(Point, f64, f64),
}

impl Solid {
    /// Exact or lower-bound signed distance.
    pub(crate) fn distance(&self, p: &Point) -> f64 {
        let outside = |q: Vector| q.sup(&Vector::zeros()).norm() + q.max().min(0.0);
        match self {
            Self::Sphere(c, r) => (p - c).norm() - r,
            Self::Box(c, half, yaw) => outside((turn(-yaw) * (p - c)).abs() - half),
            Self::Cylinder(c, r, half) => {
                let d = p - c;
                outside(Vector::new(d.xy().norm() - r, d.z.abs() - half, -1.0))
            }
        }
    }
}

fn turn(yaw: f64) -> nalgebra::Rotation3<f64> {
    nalgebra::Rotation3::from_axis_angle(&Vector::z_axis(), yaw)
}

fn distance(solids: &[Solid], p: &Point) -> f64 {
    solids.iter().map(|s| s.distance(p)).fold(f64::INFINITY, f64::min)
}

/// Outward normal of the union's surface near `p`.
pub(crate) fn normal(solids: &[Solid], p: &Point) -> Vector {
    let e = 1e-7;
    let d = |v: Vector| distance(solids, &(p + v * e)) - distance(solids, &(p - v * e));
    Vector::new(d(Vector::x()), d(Vector::y()), d(Vector::z())).normalize()
}

/// A view of the solids on the plane z = 0 from 45° above, azimuth 20°, 0.5 m away; depth noise σ in metres.
pub(crate) fn view(solids: &[Solid], sigma: f64) -> (Frame, Visible) {
    view_from(solids, sigma, 20.0_f64.to_radians(), std::f64::consts::FRAC_PI_4)
}

pub(crate) fn view_from(solids: &[Solid], sigma: f64, azimuth: f64, elevation: f64) -> (Frame, Visible) {
    let direction = Vector::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
    let eye = Point::from(direction * 0.5) + Vector::z() * 0.04;
    // Image y is down, so the camera's y is the world's −z as far as the view direction lets it be.
    let rotation = nalgebra::UnitQuaternion::face_towards(&-direction, &-Vector::z());
    let world_from_camera = Isometry::from_parts(eye.coords.into(), rotation);
    let camera =
        PinholeCamera { width: 320, height: 240, fx: 400.0, fy: 400.0, cx: 159.5, cy: 119.5, distortion: [0.0; 5] };
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut normals = Raster::filled(camera.height, camera.width, [0.0_f32; 3]);
    let (mut depth, mut denoised) = (normals.map(|_| f32::NAN), normals.map(|_| f32::NAN));
    for row in 0..camera.height {
        for col in 0..camera.width {
            let ray = camera.ray(col as f64, row as f64);
            let world = (world_from_camera * ray).normalize();
            let mut t = 0.2;
            while t < 0.9 {
                let d = distance(solids, &(eye + world * t));
                if d < 1e-9 {
                    break;
                }
                t += d.max(1e-9);
            }
            if t >= 0.9 {
                continue;
            }
            let n = world_from_camera.inverse() * normal(solids, &(eye + world * t));
            let z = t / ray.norm();
            let noise: f64 = StandardNormal.sample(&mut rng);
            depth[(row, col)] = (z + sigma * noise) as f32;
            // Grazing pixels are seen, but denoising would drop them.
            if n.dot(&ray) / ray.norm() > -0.12 {
                continue;
            }
            denoised[(row, col)] = (z + 0.3 * sigma * noise) as f32;
            normals[(row, col)] = [n.x as f32, n.y as f32, n.z as f32];
        }
    }
    let mask = depth.map(|z| z.is_finite());
    let support = Plane::new(Vector::z(), &Point::origin());
    let frame = Frame {
        camera,
        world_from_camera,
        depth,
        background: Background::Absent,
        noise: DepthNoise { sigma, sigma_quadratic: 0.0 },
        color: None,
        mask: Some(mask.clone()),
        support,
    };
    (frame, Visible { mask, depth: denoised, normals, support, border_share: 0.0 })
}

/// A touch of the point where the line from `from` towards `to` first meets the solids: an 8 × 8 mm patch without clearance.
pub(crate) fn touch(solids: &[Solid], from: Point, to: Point) -> Patch {
    let press = (to - from).normalize();
    let hit = march(solids, from, press).expect("the touch meets the object");
    let rotation = nalgebra::UnitQuaternion::rotation_between(&Vector::z(), &press)
        .unwrap_or_else(|| nalgebra::UnitQuaternion::from_axis_angle(&Vector::x_axis(), std::f64::consts::PI));
    let world_from_sensor = Isometry::from_parts(hit.coords.into(), rotation);
    let start = world_from_sensor * nalgebra::Translation3::new(0.0, 0.0, -0.003);
    let points: Vec<Point> = (0..81)
        .filter_map(|i| {
            let local = Point::new(f64::from(i % 9 - 4) * 1e-3, f64::from(i / 9 - 4) * 1e-3, 0.0);
            march(solids, start * local, press).filter(|p| (p - hit).norm() < 0.006)
        })
        .collect();
    let normals = points.iter().map(|p| normal(solids, p)).collect();
    Patch { points, normals, clearance: vec![], world_from_sensor }
}

fn march(solids: &[Solid], from: Point, direction: Vector) -> Option<Point> {
    let mut p = from;
    for _ in 0..200 {
        let d = distance(solids, &p);
        if d < 1e-8 {
            return Some(p);
        }
        p += direction * d;
    }
    None
}
