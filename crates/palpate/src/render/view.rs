use super::Item;
use crate::camera::PinholeCamera;
use crate::geometry::{Aabb, Isometry, Point, Vector};
use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion};

/// From which side to look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Look {
    /// The broadest side, turned by 30° and seen from 20° above.
    Auto,
    /// Direction from the object to the viewer, radians: azimuth 0 is the front (−y), π/2 the right side (+x); elevation
    /// π/2 is the top.
    From {
        /// About the up direction, counter-clockwise seen from above.
        azimuth: f64,
        /// Above the horizon.
        elevation: f64,
    },
    /// The direction of a real camera, the picture fitted to the shapes.
    Along {
        /// Pose of that camera (x right, y down, z forward).
        world_from_camera: Isometry,
    },
}

/// From which side to look, and which way is up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// The side.
    pub look: Look,
    /// Up in the world frame; any length but zero. The ground, which catches the shadow, lies across it.
    pub up: Vector,
}

impl Default for View {
    fn default() -> Self {
        Self { look: Look::Auto, up: Vector::z() }
    }
}

impl View {
    /// The direction of a real camera turned by 25° about the up direction: what it saw, and some of what it did not.
    pub fn beside(world_from_camera: &Isometry, up: Vector) -> Self {
        let axis = Unit::try_new(up, 0.0).unwrap_or_else(Vector::z_axis);
        let turn = UnitQuaternion::from_axis_angle(&axis, 25_f64.to_radians());
        let turned = Isometry::from_parts(world_from_camera.translation, turn * world_from_camera.rotation);
        Self { look: Look::Along { world_from_camera: turned }, up }
    }
}

/// A placed camera: what a view becomes once the shapes and the picture's size are known.
#[derive(Debug, Clone, Copy)]
pub struct Viewpoint {
    /// The picture's camera.
    pub camera: PinholeCamera,
    /// Its pose.
    pub world_from_camera: Isometry,
    /// Unit up direction, world frame.
    pub up: Vector,
    /// Height of the ground along `up`: the lowest point of the shapes.
    pub ground: f64,
    /// Diagonal of the box round the shapes, metres.
    pub extent: f64,
    /// Middle of the box round the shapes.
    pub center: Point,
}

/// Half the vertical opening angle: a long lens, so that parallel edges stay nearly parallel.
const TAN_HALF_OPENING: f64 = 0.19;
/// Share of the picture that the shapes may fill.
const FILL: f64 = 0.86;

impl Viewpoint {
    /// Places the camera so that every point of the items is in the picture; `size` is (width, height), pixels.
    ///
    /// `None` if there is no finite point or the picture has no pixel.
    pub fn fit(view: &View, items: &[Item], size: (usize, usize)) -> Option<Self> {
        let finite = |p: &&Point| p.iter().all(|c| c.is_finite());
        let points: Vec<&Point> = items.iter().flat_map(Item::points).filter(finite).collect();
        let bounds = Aabb::of(points.iter().copied())?;
        let up = view.up.try_normalize(0.0)?;
        if size.0 == 0 || size.1 == 0 {
            return None;
        }
        let orientation = orientation(view.look, &up, &points);
        let (width, height) = (size.0 as f64, size.1 as f64);
        let tan = [FILL * TAN_HALF_OPENING * width / height, FILL * TAN_HALF_OPENING];
        let center = bounds.center();
        let extent = bounds.diagonal().max(1e-6);

        // In the camera's axes, centred across the picture: the distance at which the last point enters it.
        let seen: Vec<Vector> = points.iter().map(|p| orientation.inverse_transform_vector(&(*p - center))).collect();
        let mut shift = Vector::zeros();
        let mut distance = extent;
        // A perspective centre depends on the distance and the other way round; a few rounds settle both.
        for _ in 0..8 {
            distance = seen.iter().fold(extent * 0.6, |d, p| {
                let q = p - shift;
                d.max(q.x.abs() / tan[0] - q.z).max(q.y.abs() / tan[1] - q.z)
            });
            for axis in 0..2 {
                let ratio = |p: &Vector| (p[axis] - shift[axis]) / (p.z + distance);
                let (low, high) = seen.iter().map(ratio).fold((f64::MAX, f64::MIN), |(l, h), r| (l.min(r), h.max(r)));
                shift[axis] += 0.5 * (low + high) * distance;
            }
        }
        let eye = center + orientation * (shift - Vector::z() * distance);
        let ground = points.iter().map(|p| up.dot(&p.coords)).fold(f64::MAX, f64::min);
        let focal = 0.5 * height / TAN_HALF_OPENING;
        let camera = PinholeCamera {
            width: size.0,
            height: size.1,
            fx: focal,
            fy: focal,
            cx: 0.5 * (width - 1.0),
            cy: 0.5 * (height - 1.0),
            distortion: [0.0; 5],
        };
        let world_from_camera = Isometry::from_parts(eye.into(), orientation);
        Some(Self { camera, world_from_camera, up, ground, extent, center })
    }

    /// A distant camera with the same shapes in its square picture: the view of a light.
    pub(super) fn seen_by_light(&self, towards_light: &Vector, resolution: usize) -> Self {
        let orientation = looking(&-towards_light, &self.up);
        let distance = 20.0 * self.extent;
        // The shapes fit a ball of the box's half diagonal; the ground shadow needs no more, as only shapes cast it.
        let focal = 0.5 * resolution as f64 * distance / (0.55 * self.extent);
        let middle = 0.5 * (resolution as f64 - 1.0);
        let camera = PinholeCamera {
            width: resolution,
            height: resolution,
            fx: focal,
            fy: focal,
            cx: middle,
            cy: middle,
            distortion: [0.0; 5],
        };
        let eye = self.center + towards_light * distance;
        Self { camera, world_from_camera: Isometry::from_parts(eye.into(), orientation), ..*self }
    }

    /// Direction of a pixel with z = 1, camera frame. The picture's camera has no distortion.
    #[inline]
    pub(super) fn ray(&self, u: f64, v: f64) -> Vector {
        Vector::new((u - self.camera.cx) / self.camera.fx, (v - self.camera.cy) / self.camera.fy, 1.0)
    }

    /// The same picture with `factor` samples per pixel and axis.
    pub(super) fn supersampled(&self, factor: usize) -> Self {
        let f = factor as f64;
        let c = self.camera;
        let camera = PinholeCamera {
            width: c.width * factor,
            height: c.height * factor,
            fx: c.fx * f,
            fy: c.fy * f,
            cx: (c.cx + 0.5) * f - 0.5,
            cy: (c.cy + 0.5) * f - 0.5,
            ..c
        };
        Self { camera, ..*self }
    }
}

/// The rotation world ← camera of the stated side.
fn orientation(look: Look, up: &Vector, points: &[&Point]) -> UnitQuaternion<f64> {
    let world_from_upright = UnitQuaternion::rotation_between(&Vector::z(), up)
        .unwrap_or_else(|| UnitQuaternion::new(Vector::x() * std::f64::consts::PI));
    let (azimuth, elevation) = match look {
        Look::Along { world_from_camera } => return world_from_camera.rotation,
        Look::From { azimuth, elevation } => (azimuth, elevation),
        Look::Auto => (broadest_azimuth(points, &world_from_upright) + 30_f64.to_radians(), 20_f64.to_radians()),
    };
    let (ca, sa) = (azimuth.cos(), azimuth.sin());
    let (ce, se) = (elevation.cos(), elevation.sin());
    let towards_viewer = world_from_upright * Vector::new(sa * ce, -ca * ce, se);
    // Seen from the very top, the picture's upper edge is the far side, as when one walks up to the object.
    let upwards = world_from_upright * Vector::new(-sa * se, ca * se, ce);
    looking(&-towards_viewer, &upwards)
}

/// The rotation world ← camera that looks along `forward` with `up` upwards in the picture.
fn looking(forward: &Vector, up: &Vector) -> UnitQuaternion<f64> {
    let z = forward.normalize();
    let x = z.cross(up).try_normalize(1e-9).unwrap_or_else(|| {
        let other = if z.x.abs() < 0.9 { Vector::x() } else { Vector::y() };
        z.cross(&other).normalize()
    });
    let y = z.cross(&x);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    UnitQuaternion::from_rotation_matrix(&rotation)
}

/// The azimuth from which the horizontal extent is largest: across the principal horizontal direction.
fn broadest_azimuth(points: &[&Point], world_from_upright: &UnitQuaternion<f64>) -> f64 {
    let flat: Vec<Vector> = points.iter().map(|p| world_from_upright.inverse_transform_vector(&p.coords)).collect();
    let n = flat.len() as f64;
    let mean = flat.iter().fold(Vector::zeros(), |a, b| a + b) / n;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in &flat {
        let d = p - mean;
        xx += d.x * d.x;
        xy += d.x * d.y;
        yy += d.y * d.y;
    }
    let anisotropy = (xx - yy).hypot(2.0 * xy);
    // A body of revolution has no broad side: its front will do.
    if anisotropy < 0.1 * (xx + yy) { 0.0 } else { 0.5 * (2.0 * xy).atan2(xx - yy) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PointCloud;

    fn bar() -> PointCloud {
        let points = vec![
            Point::new(-0.2, -0.02, 0.0),
            Point::new(0.2, -0.02, 0.0),
            Point::new(0.2, 0.02, 0.1),
            Point::new(-0.2, 0.02, 0.1),
        ];
        PointCloud { points, normals: None, colors: None }
    }

    #[test]
    fn every_point_is_in_the_picture_and_fills_it() {
        let cloud = bar();
        let items = [Item::cloud(&cloud, [0; 3])];
        for look in
            [Look::Auto, Look::From { azimuth: 1.0, elevation: 0.3 }, Look::From { azimuth: 0.0, elevation: 1.57 }]
        {
            let view = View { look, ..View::default() };
            let v = Viewpoint::fit(&view, &items, (320, 240)).expect("points are finite");
            let uv: Vec<_> = cloud
                .points
                .iter()
                .map(|p| v.camera.project(&v.world_from_camera.inverse_transform_point(p)).expect("in front"))
                .collect();
            assert!(uv.iter().all(|&(u, w)| (0.0..319.0).contains(&u) && (0.0..239.0).contains(&w)), "{look:?} {uv:?}");
            let widest = |f: fn(&(f64, f64)) -> f64| {
                uv.iter().map(f).fold(f64::MIN, f64::max) - uv.iter().map(f).fold(f64::MAX, f64::min)
            };
            let fill = (widest(|p| p.0) / 320.0).max(widest(|p| p.1) / 240.0);
            assert!((fill - FILL).abs() < 0.02, "{look:?} fills {fill}");
        }
    }

    #[test]
    fn front_right_and_top_are_where_the_convention_says() {
        let cloud = bar();
        let items = [Item::cloud(&cloud, [0; 3])];
        let eye = |azimuth: f64, elevation: f64| {
            let view = View { look: Look::From { azimuth, elevation }, ..View::default() };
            let v = Viewpoint::fit(&view, &items, (100, 100)).expect("points are finite");
            (v.world_from_camera * Vector::z(), v.world_from_camera * Vector::y())
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        assert!((eye(0.0, 0.0).0 - Vector::y()).norm() < 1e-9);
        assert!((eye(0.0, 0.0).1 + Vector::z()).norm() < 1e-9);
        assert!((eye(quarter, 0.0).0 + Vector::x()).norm() < 1e-9);
        assert!((eye(0.0, quarter).0 + Vector::z()).norm() < 1e-9);
        assert!((eye(0.0, quarter).1 + Vector::y()).norm() < 1e-9);
    }

    #[test]
    fn the_broad_side_faces_the_viewer() {
        let cloud = bar();
        let points: Vec<&Point> = cloud.points.iter().collect();
        assert!(broadest_azimuth(&points, &UnitQuaternion::identity()).abs() < 1e-9);
        let turned: Vec<Point> = cloud.points.iter().map(|p| Point::new(-p.y, p.x, p.z)).collect();
        let points: Vec<&Point> = turned.iter().collect();
        let azimuth = broadest_azimuth(&points, &UnitQuaternion::identity());
        assert!((azimuth.abs() - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    }

    #[test]
    fn a_view_beside_a_camera_is_25_degrees_from_it_at_the_same_height() {
        let looks_down = Isometry::rotation(Vector::new(-2.2, 0.0, 0.0));
        let View { look: Look::Along { world_from_camera: beside }, .. } = View::beside(&looks_down, Vector::z() * 3.0)
        else {
            panic!("a view along a pose was asked for");
        };
        let (a, b) = (looks_down * Vector::z(), beside * Vector::z());
        assert!((a.z - b.z).abs() < 1e-12);
        assert!((a.xy().angle(&b.xy()) - 25_f64.to_radians()).abs() < 1e-9);
    }

    #[test]
    fn nothing_to_see_is_no_viewpoint() {
        let cloud = PointCloud { points: vec![Point::new(f64::NAN, 0.0, 0.0)], normals: None, colors: None };
        assert!(Viewpoint::fit(&View::default(), &[Item::cloud(&cloud, [0; 3])], (10, 10)).is_none());
        assert!(Viewpoint::fit(&View::default(), &[], (10, 10)).is_none());
    }
}
