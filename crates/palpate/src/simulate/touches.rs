use super::SimulateError;
use super::seed::stream;
use crate::geometry::{Isometry, Plane, Point, Raster, TriangleMesh, Vector};
use crate::tactile::optics::{MarkerParams, TactileOptics};
use crate::tactile::{Contact, PressParams, Pressed, TactileSensor, Touch, press};
use nalgebra::{Translation3, UnitQuaternion};
use rand::RngExt as _;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Which touches are made, with what, and how well their poses are known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TouchParams {
    /// Touches to make. The first of a longer list are the same.
    pub count: usize,
    /// Preset name of the sensor.
    pub sensor: String,
    /// Width of the height maps, pixels, at most the sensor's. Larger: finer maps, bigger files, slower.
    pub map_width: usize,
    /// Points of the surface that touches are chosen from. Larger: evener spread, more time before the first touch.
    pub candidates: usize,
    /// Whether tactile images are rendered, at the sensor's size.
    pub images: TactileImages,
    /// Which sides are touched.
    pub reach: TouchReach,
    /// The press.
    pub press: PressParams,
    /// 1σ of the recorded position, per axis, metres.
    pub pose_sigma_translation: f64,
    /// 1σ of the recorded orientation, per axis, radians.
    pub pose_sigma_rotation: f64,
}

impl Default for TouchParams {
    fn default() -> Self {
        Self {
            count: 20,
            sensor: "ycb-sight".to_owned(),
            map_width: 320,
            candidates: 3000,
            images: TactileImages::None,
            reach: TouchReach::Whole,
            press: PressParams::default(),
            pose_sigma_translation: 0.0,
            pose_sigma_rotation: 0.0,
        }
    }
}

/// Which sides of an object the simulated touches reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TouchReach {
    /// All of them, as in the YCB-Sight set: as if the object were held for the touches below.
    #[default]
    Whole,
    /// What a robot reaches while the object stands on its support: pad and body stay above the support plane, so never the underside.
    AboveSupport,
}

/// What tactile images show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TactileImages {
    /// None are made.
    #[default]
    None,
    /// Colours of the gel's slopes, as in YCB-Sight.
    Plain,
    /// With the shadows that the rim of the contact casts.
    Shadows,
    /// With shadows and with marker dots that the press moves.
    Markers,
}

impl TactileImages {
    /// The optics of a sensor, if images are made.
    ///
    /// # Errors
    /// [`SimulateError::Optics`] for a sensor without a photometric table.
    pub(super) fn optics(self, sensor: &TactileSensor) -> Result<Option<TactileOptics>, SimulateError> {
        Ok(if self == Self::None { None } else { Some(TactileOptics::preset(sensor)?) })
    }

    /// The image of a contact of the sensor's size.
    ///
    /// # Errors
    /// [`SimulateError::Optics`].
    pub fn render(self, optics: &TactileOptics, contact: &Contact) -> Result<Raster<[u8; 3]>, SimulateError> {
        if matches!(self, Self::None | Self::Plain) {
            return Ok(optics.render(&contact.height_map)?);
        }
        let mut image = optics.render_with_shadows(contact)?;
        if self == Self::Markers {
            optics.draw_markers(&mut image, contact, (0.0, 0.0), &MarkerParams::default())?;
        }
        Ok(image)
    }

    /// The image of the gel that nothing touches.
    ///
    /// # Errors
    /// [`SimulateError::Optics`].
    pub fn no_contact(self, optics: &TactileOptics) -> Result<Raster<[u8; 3]>, SimulateError> {
        let sensor = optics.sensor();
        let (rows, cols) = (sensor.height, sensor.width);
        self.render(
            optics,
            &Contact { height_map: sensor.relaxed(rows, cols), mask: Raster::filled(rows, cols, false) },
        )
    }
}

impl TouchParams {
    /// Checks ranges, and that the sensor exists.
    ///
    /// # Errors
    /// [`SimulateError::Params`], [`SimulateError::Sensor`] or [`SimulateError::Press`].
    pub fn validate(&self) -> Result<TactileSensor, SimulateError> {
        let sensor = TactileSensor::preset(&self.sensor)?;
        self.press.validate()?;
        let check = |field, found: f64, ok: bool, needed| {
            if ok { Ok(()) } else { Err(SimulateError::Params { field, found, needed }) }
        };
        let width = self.map_width;
        check(
            "touch.map_width",
            width as f64,
            width >= 16 && width <= sensor.width,
            "at least 16 and at most the sensor's width",
        )?;
        check(
            "touch.candidates",
            self.candidates as f64,
            self.candidates >= self.count.max(1),
            "at least touch.count",
        )?;
        let sigma = self.pose_sigma_translation.min(self.pose_sigma_rotation);
        let finite = (self.pose_sigma_translation + self.pose_sigma_rotation).is_finite();
        check("touch.pose_sigma", sigma, sigma >= 0.0 && finite, "at least 0")?;
        Ok(sensor)
    }
}

/// Touches the surface in farthest-point order until `params.count` presses have succeeded or no candidate is left.
///
/// Candidates are area-uniform points of the surface. Always the one farthest from all successful touches is tried next, so any
/// prefix is spread over the whole. The sensor comes against the face's normal with a random yaw; up to four yaws are tried.
/// Not reachable, hence skipped: presses that are blocked ([`PressParams::max_retreat`]) or hardly touch
/// ([`PressParams::min_contact`]), and, with [`TouchReach::AboveSupport`], poses whose pad or body would go below the support plane.
/// The arm behind the fingertip is not modelled.
pub(super) fn make_touches(
    object: &str,
    mesh: &TriangleMesh,
    support: Option<&Plane>,
    params: &TouchParams,
    view: usize,
    seed: u64,
) -> Result<Vec<Touch>, SimulateError> {
    let sensor = params.validate()?;
    if params.count == 0 {
        return Ok(Vec::new());
    }
    let mut rng = stream(seed, object, view, "touch candidates");
    let barrier = support.filter(|_| params.reach == TouchReach::AboveSupport);
    let aims: Vec<Isometry> = sample_surface(mesh, params.candidates, &mut rng)
        .into_iter()
        .filter_map(|(point, normal)| {
            let yaws = [(); 4].map(|()| TAU * rng.random::<f64>());
            let mut poses = yaws.into_iter().map(|yaw| aim(&point, &normal, yaw));
            poses.find(|pose| barrier.is_none_or(|plane| stays_above(plane, pose, &sensor, &params.press)))
        })
        .collect();
    let mut noise = stream(seed, object, view, "touch pose noise");
    let optics = params.images.optics(&sensor)?;
    let mut touches = Vec::new();
    let mut order = FarthestFirst::new(aims.iter().map(|a| Point::from(a.translation.vector)).collect());
    while touches.len() < params.count {
        let Some(next) = order.next() else { break };
        let Ok(Pressed { contact, world_from_sensor, .. }) =
            press(mesh, &aims[next], &sensor, params.map_width, &params.press)
        else {
            continue;
        };
        order.keep_away_from(next);
        let image = match &optics {
            None => None,
            Some(optics) if params.map_width == sensor.width => Some(params.images.render(optics, &contact)?),
            // Maps may be coarser than images: the same press, seen at the sensor's size.
            Some(optics) => match press(mesh, &aims[next], &sensor, sensor.width, &params.press) {
                Ok(fine) => Some(params.images.render(optics, &fine.contact)?),
                Err(_) => None,
            },
        };
        let world_from_sensor = world_from_sensor * pose_noise(params, &mut noise);
        touches.push(Touch { contact: Some(contact), image, world_from_sensor });
    }
    Ok(touches)
}

/// Area-uniform surface points with their faces' outward normals.
pub(crate) fn sample_surface(mesh: &TriangleMesh, count: usize, rng: &mut Pcg64Mcg) -> Vec<(Point, Vector)> {
    let mut cumulative = Vec::with_capacity(mesh.faces.len());
    let mut total = 0.0;
    for face in 0..mesh.faces.len() {
        total += mesh.area_vector(face).norm();
        cumulative.push(total);
    }
    if total <= 0.0 {
        return Vec::new();
    }
    (0..count)
        .map(|_| {
            let target = rng.random::<f64>() * total;
            let face = cumulative.partition_point(|&c| c <= target).min(mesh.faces.len() - 1);
            let [a, b, c] = mesh.triangle(face);
            // Uniform barycentric coordinates: the square root undoes the crowding at corner a.
            let (r, s) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
            (a + (b - a) * (r * (1.0 - s)) + (c - a) * (r * s), mesh.face_normal(face))
        })
        .collect()
}

/// The pose that looks into the surface: origin at the point, +z = −normal, minimal rotation from +z, then yaw about it.
pub(crate) fn aim(point: &Point, normal: &Vector, yaw: f64) -> Isometry {
    let half_turn = UnitQuaternion::from_axis_angle(&Vector::x_axis(), std::f64::consts::PI);
    let minimal = UnitQuaternion::rotation_between(&Vector::z(), &-normal).unwrap_or(half_turn);
    let yaw = UnitQuaternion::from_axis_angle(&Vector::z_axis(), yaw);
    Isometry::from_parts(Translation3::from(point.coords), minimal * yaw)
}

/// Whether pad and body, a box behind the aimed point, stay on the upper side of the support plane.
fn stays_above(support: &Plane, world_from_aim: &Isometry, sensor: &TactileSensor, params: &PressParams) -> bool {
    let (w, h) = sensor.pad_size();
    [-0.5, 0.5].iter().all(|x| {
        [-0.5, 0.5].iter().all(|y| {
            [-params.body_length, params.depth]
                .iter()
                .all(|&z| support.signed_distance(&(world_from_aim * Point::new(x * w, y * h, z))) >= 0.0)
        })
    })
}

/// One draw of the pose error, in the sensor's frame.
pub(super) fn pose_noise(params: &TouchParams, rng: &mut Pcg64Mcg) -> Isometry {
    let mut normal = || rng.sample::<f64, _>(StandardNormal);
    let translation = Vector::new(normal(), normal(), normal()) * params.pose_sigma_translation;
    let rotation = Vector::new(normal(), normal(), normal()) * params.pose_sigma_rotation;
    Isometry::new(translation, rotation)
}

/// Greedy farthest-point order that forgets what turned out unusable.
pub(crate) struct FarthestFirst {
    points: Vec<Point>,
    /// Squared distance to the nearest kept point; negative once handed out.
    distance: Vec<f64>,
}

impl FarthestFirst {
    pub(crate) fn new(points: Vec<Point>) -> Self {
        let distance = vec![f64::INFINITY; points.len()];
        Self { points, distance }
    }

    /// The candidate farthest from all kept points, the first of equals; each is handed out once.
    pub(crate) fn next(&mut self) -> Option<usize> {
        let mut best = None;
        let mut farthest = -1.0;
        for (i, &d) in self.distance.iter().enumerate() {
            if d > farthest {
                (best, farthest) = (Some(i), d);
            }
        }
        self.distance[best?] = -1.0;
        best
    }

    /// Keeps a point that was handed out: later ones stay away from it.
    pub(crate) fn keep_away_from(&mut self, kept: usize) {
        let center = self.points[kept];
        self.keep_away_from_point(&center);
    }

    /// Hands out a chosen candidate and keeps it.
    pub(crate) fn take(&mut self, chosen: usize) {
        self.distance[chosen] = -1.0;
        self.keep_away_from(chosen);
    }

    /// Keeps a point that need not be a candidate.
    pub(crate) fn keep_away_from_point(&mut self, center: &Point) {
        for (p, d) in self.points.iter().zip(&mut self.distance) {
            *d = d.min((p - center).norm_squared());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Solid;
    use super::*;

    fn cube() -> TriangleMesh {
        Solid::named("cube").expect("listed").mesh(1e-5, 3e-3)
    }

    fn touches(count: usize, params: TouchParams) -> Vec<Touch> {
        let support = Plane::new(Vector::z(), &Point::origin());
        make_touches("cube", &cube(), support.as_ref(), &TouchParams { count, ..params }, 0, 7).expect("valid")
    }

    #[test]
    fn a_shorter_list_is_the_prefix_of_a_longer_one() {
        let params = TouchParams {
            map_width: 80,
            pose_sigma_translation: 1e-3,
            pose_sigma_rotation: 0.02,
            ..TouchParams::default()
        };
        let (few, many) = (touches(3, params.clone()), touches(8, params));
        assert_eq!((few.len(), many.len()), (3, 8));
        for (a, b) in few.iter().zip(&many) {
            assert_eq!(a.world_from_sensor, b.world_from_sensor);
            assert_eq!(a.contact, b.contact);
        }
    }

    #[test]
    fn touches_from_above_the_support_are_spread_and_leave_the_underside_alone() {
        let reach = TouchReach::AboveSupport;
        let made = touches(12, TouchParams { map_width: 80, reach, ..TouchParams::default() });
        let origins: Vec<Point> = made.iter().map(|t| Point::from(t.world_from_sensor.translation.vector)).collect();
        for (i, a) in origins.iter().enumerate() {
            assert!(a.z > 0.004, "{a}");
            assert!(origins[..i].iter().all(|b| (a - b).norm() > 0.02), "{i}: {a}");
        }
        // Every face but the lower one is touched.
        for normal in [Vector::x(), -Vector::x(), Vector::y(), -Vector::y(), Vector::z()] {
            assert!(made.iter().any(|t| (t.world_from_sensor * -Vector::z()).dot(&normal) > 0.99), "{normal:?}");
        }
        assert!(made.iter().all(|t| (t.world_from_sensor * -Vector::z()).z > -0.5));
    }

    #[test]
    fn by_the_protocol_every_side_is_touched() {
        let made = touches(12, TouchParams { map_width: 80, ..TouchParams::default() });
        for normal in [Vector::x(), Vector::y(), Vector::z()].into_iter().flat_map(|n| [n, -n]) {
            assert!(made.iter().any(|t| (t.world_from_sensor * -Vector::z()).dot(&normal) > 0.99), "{normal:?}");
        }
    }

    #[test]
    fn pose_noise_has_the_stated_sigma_and_does_not_change_what_is_felt() {
        let exact = touches(8, TouchParams { map_width: 80, ..TouchParams::default() });
        let noisy = touches(
            8,
            TouchParams {
                map_width: 80,
                pose_sigma_translation: 1e-3,
                pose_sigma_rotation: 0.02,
                ..TouchParams::default()
            },
        );
        let (mut translation, mut rotation) = (0.0, 0.0);
        for (a, b) in exact.iter().zip(&noisy) {
            assert_eq!(a.contact, b.contact);
            let error = a.world_from_sensor.inverse() * b.world_from_sensor;
            translation += error.translation.vector.norm_squared() / 24.0;
            rotation += error.rotation.scaled_axis().norm_squared() / 24.0;
        }
        // 24 draws: the estimate of σ² has a relative σ of 0.29.
        assert!((translation / 1e-6 - 1.0).abs() < 0.9, "{translation}");
        assert!((rotation / 4e-4 - 1.0).abs() < 0.9, "{rotation}");
    }

    #[test]
    fn opposite_normals_do_not_break_the_pose() {
        for normal in [Vector::z(), -Vector::z(), Vector::x()] {
            let pose = aim(&Point::new(1.0, 2.0, 3.0), &normal, 0.4);
            assert!((pose * Vector::z() + normal).norm() < 1e-12);
        }
    }
}
