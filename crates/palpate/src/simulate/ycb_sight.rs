use super::scene::check_mesh;
use super::seed::stream;
use super::touches::{FarthestFirst, aim, sample_surface};
use super::{SimulateError, TouchParams, camera, look_at};
use crate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use crate::geometry::{Bvh, Isometry, Point, Raster, TriangleMesh, Vector};
use crate::scene::{PoseSigma, Scene};
use crate::tactile::{TactileSensor, Touch, press};
use rand::RngExt as _;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;

/// What the YCB-Sight set holds of one object: 60 touches all round, and a depth cloud.
#[derive(Debug, Clone)]
pub struct YcbSightObject {
    /// Name of the object.
    pub name: String,
    /// Depth readings, **object** frame (which is the world), metres, in no particular order.
    pub depth_cloud: Vec<Point>,
    /// The camera that saw them.
    pub camera: PinholeCamera,
    /// Its pose.
    pub world_from_camera: Isometry,
    /// The fingertip.
    pub sensor: TactileSensor,
    /// Uncertainty of the touch poses.
    pub pose_sigma: PoseSigma,
    /// Touches, lowest first.
    pub touches: Vec<Touch>,
    /// Image of the gel that nothing touches, if known. The original set has one for all objects, beside them.
    pub tactile_background: Option<Raster<[u8; 3]>>,
}

/// The simulated depth camera of the YCB-Sight set: 400 × 400, 60° field of view.
pub fn ycb_sight_camera() -> PinholeCamera {
    // f = 200 / tan 30°; the generator's principal point is the corner of pixel (200, 200), here at its centre as in its readers.
    let f = 200.0 / (TAU / 12.0).tan();
    PinholeCamera { width: 400, height: 400, fx: f, fy: f, cx: 200.0, cy: 200.0, distortion: [0.0; 5] }
}

/// Its pose: half a metre in front (+x) of the object's centroid, half a metre above the origin, looking 45° down.
pub fn ycb_sight_camera_pose(centroid: &Point) -> Isometry {
    let eye = Point::new(centroid.x + 0.5, centroid.y, 0.5);
    look_at(&eye, &(eye + Vector::new(-1.0, 0.0, -1.0)))
}

/// Readings of the simulated depth camera: 1σ of each coordinate, metres.
const CLOUD_SIGMA: f64 = 1.0e-3;
/// Touches of an object.
const TOUCHES: usize = 60;

/// Simulates what the YCB-Sight set holds of an object, in the object's own frame; nothing supports it.
///
/// 40 presses from the sides (5 heights × 8 angles), 10 from above and 10 from below (5 × 2 over the inner part of its box), yaw
/// the minimal rotation, 1 mm deep, map 640 × 480. Aims that miss or that cannot be pressed are replaced by presses in
/// farthest-point order over the whole surface, so that there are 60 whenever 60 places can be pressed.
///
/// `params.count` and `params.map_width` are the protocol's own and are not read.
///
/// # Errors
/// [`SimulateError`] for a parameter out of range or an unusable mesh.
///
/// # References
/// Suresh et al., *ShapeMap 3-D*, ICRA 2022 (YCB-Sight). Theirs picks the cloud point nearest to a line from the axis in a frame
/// turned to the object's principal axes, and arranges top and bottom by object class; here rays find the points.
pub fn simulate_ycb_sight(
    name: &str,
    mesh: &TriangleMesh,
    seed: u64,
    params: &TouchParams,
) -> Result<YcbSightObject, SimulateError> {
    simulate_at(name, mesh, seed, params, TactileSensor::preset(&params.sensor)?.width)
}

/// [`simulate_ycb_sight`] with maps of any width.
fn simulate_at(
    name: &str,
    mesh: &TriangleMesh,
    seed: u64,
    params: &TouchParams,
    map_width: usize,
) -> Result<YcbSightObject, SimulateError> {
    let sensor = params.validate()?;
    check_mesh(name, mesh)?;
    let mut noise = stream(seed, name, 0, "touch pose noise");
    let mut touches = press_all(name, mesh, seed, params, (&sensor, map_width));
    let mut tactile_background = None;
    if let Some(optics) = params.images.optics(&sensor)? {
        tactile_background = Some(params.images.no_contact(&optics)?);
        for touch in &mut touches {
            let contact = touch.contact.as_ref().filter(|c| c.height_map.shape() == (sensor.height, sensor.width));
            touch.image = contact.map(|c| params.images.render(&optics, c)).transpose()?;
        }
    }
    touches.sort_by(|a, b| a.world_from_sensor.translation.z.total_cmp(&b.world_from_sensor.translation.z));
    for touch in &mut touches {
        touch.world_from_sensor *= super::touches::pose_noise(params, &mut noise);
    }
    let camera = ycb_sight_camera();
    let world_from_camera = ycb_sight_camera_pose(&centroid(mesh));
    let depth = camera::cast(mesh, &camera, &world_from_camera, (0..camera.height, 0..camera.width));
    let mut rng = stream(seed, name, 0, "depth noise");
    let depth_cloud = unproject(&depth, &camera)
        .map(|p| {
            let mut normal = || rng.sample::<f64, _>(StandardNormal) * CLOUD_SIGMA;
            world_from_camera * (p + Vector::new(normal(), normal(), normal()))
        })
        .collect();
    let pose_sigma = PoseSigma { translation: params.pose_sigma_translation, rotation: params.pose_sigma_rotation };
    let name = name.to_owned();
    Ok(YcbSightObject { name, depth_cloud, camera, world_from_camera, sensor, pose_sigma, touches, tactile_background })
}

/// Camera-frame points of the pixels that read something, row-major.
fn unproject<'a>(depth: &'a Raster<f32>, camera: &'a PinholeCamera) -> impl Iterator<Item = Point> + 'a {
    let read = depth.pixels().filter(|(.., z)| z.is_finite());
    read.map(|(row, col, &z)| Point::from(camera.ray(col as f64, row as f64) * f64::from(z)))
}

/// Area centroid of the surface.
fn centroid(mesh: &TriangleMesh) -> Point {
    let mut sum = Vector::zeros();
    let mut area = 0.0;
    for face in 0..mesh.faces.len() {
        let [a, b, c] = mesh.triangle(face);
        let weight = mesh.area_vector(face).norm();
        sum += (a.coords + b.coords + c.coords) * (weight / 3.0);
        area += weight;
    }
    Point::from(sum / area)
}

fn press_all(
    name: &str,
    mesh: &TriangleMesh,
    seed: u64,
    params: &TouchParams,
    (sensor, map_width): (&TactileSensor, usize),
) -> Vec<Touch> {
    let attempt = |aim: &Isometry| {
        let pressed = press(mesh, aim, sensor, map_width, &params.press).ok()?;
        Some(Touch { contact: Some(pressed.contact), image: None, world_from_sensor: pressed.world_from_sensor })
    };
    let mut touches: Vec<Touch> = planned_aims(mesh).iter().filter_map(attempt).collect();
    // Fill up: farthest from everything touched so far.
    let mut rng = stream(seed, name, 0, "touch candidates");
    let candidates = sample_surface(mesh, params.candidates, &mut rng);
    let made = touches.iter().map(|t| Point::from(t.world_from_sensor.translation.vector));
    let mut order = FarthestFirst::new(candidates.iter().map(|(p, _)| *p).collect());
    made.for_each(|p| order.keep_away_from_point(&p));
    while touches.len() < TOUCHES {
        let Some(next) = order.next() else { break };
        let (point, normal) = &candidates[next];
        if let Some(touch) = attempt(&aim(point, normal, 0.0)) {
            order.keep_away_from(next);
            touches.push(touch);
        }
    }
    touches
}

/// The protocol's aims that hit the object.
fn planned_aims(mesh: &TriangleMesh) -> Vec<Isometry> {
    const MARGIN: f64 = 0.01;
    const CIRCLE: f64 = 0.2;
    // A little off the axes: on symmetric meshes rays along them meet vertices exactly, and may slip through.
    const OFF_AXIS: f64 = 1e-3;
    let Some(bounds) = mesh.bounds() else { return Vec::new() };
    let bvh = Bvh::new(mesh);
    let hit = |from: Point, direction: Vector| {
        let hit = bvh.cast_ray(&from, &direction, f64::MAX)?;
        Some(aim(&(from + direction * hit.distance), &mesh.face_normal(hit.face), 0.0))
    };
    let (center, half) = (bounds.center(), bounds.size() / 2.0);
    let reach = CIRCLE + half.norm();
    let inner = |h: f64| (h - MARGIN).max(0.5 * h);
    let mut aims = Vec::new();
    for height in 0..5 {
        let z = center.z + inner(half.z) * (f64::from(height) / 2.0 - 1.0);
        for angle in 0..8 {
            let a = TAU * f64::from(angle) / 8.0 + OFF_AXIS;
            let out = Vector::new(a.cos(), a.sin(), 0.0);
            aims.extend(hit(Point::new(center.x, center.y, z) + out * reach, -out));
        }
    }
    // Five along the longer side, two across.
    let (long, short) = if half.x >= half.y { (Vector::x(), Vector::y()) } else { (Vector::y(), Vector::x()) };
    let (long, short) = (long * inner(half.dot(&long)), short * inner(half.dot(&short)));
    for down in [-Vector::z(), Vector::z()] {
        for i in 0..5 {
            for j in [-0.5, 0.5 + OFF_AXIS] {
                let along = f64::from(i) / 2.0 - 1.0 + OFF_AXIS;
                aims.extend(hit(center + long * along + short * j - down * reach, down));
            }
        }
    }
    aims
}

impl YcbSightObject {
    /// The object as a scene: the depth cloud put back on its camera's raster, the touches in an order whose prefixes are spread.
    ///
    /// Noise across the rays has moved readings by about half a pixel: of readings that share a pixel the nearest stays, and empty
    /// pixels with at least five read neighbours of eight take their mean (they are gaps of the raster, not free rays). The
    /// touches of the set are sorted by height; here they follow in farthest-point order from a seeded first one.
    pub fn into_scene(self, seed: u64) -> Scene {
        let depth = closed_gaps(&rasterize(&self.depth_cloud, &self.camera, &self.world_from_camera));
        let mask = depth.map(|z| z.is_finite());
        let frame = Frame {
            camera: self.camera,
            world_from_camera: self.world_from_camera,
            depth,
            background: Background::Absent,
            noise: DepthNoise { sigma: CLOUD_SIGMA, sigma_quadratic: 0.0 },
            color: None,
            mask: Some(mask),
            support: None,
        };
        let touches = spread(self.touches, seed);
        let sensor = (!touches.is_empty()).then_some(self.sensor);
        Scene { name: self.name, frame, sensor, pose_sigma: self.pose_sigma, touches }
    }

    /// A recorded scene as a YCB-Sight object: its depth image as a cloud, touches lowest first. Support and mask have no place
    /// there; readings outside the mask are left out.
    pub fn from_scene(scene: &Scene, sensor: TactileSensor) -> Self {
        let frame = &scene.frame;
        let object = Raster::from_fn(frame.depth.rows(), frame.depth.cols(), |r, c| {
            if frame.mask.as_ref().is_none_or(|m| m[(r, c)]) { frame.depth[(r, c)] } else { f32::NAN }
        });
        let mut touches = scene.touches.clone();
        touches.sort_by(|a, b| a.world_from_sensor.translation.z.total_cmp(&b.world_from_sensor.translation.z));
        Self {
            name: scene.name.clone(),
            depth_cloud: unproject(&object, &frame.camera).map(|p| frame.world_from_camera * p).collect(),
            camera: frame.camera,
            world_from_camera: frame.world_from_camera,
            sensor,
            pose_sigma: scene.pose_sigma,
            touches,
            tactile_background: None,
        }
    }
}

/// Nearest reading of each pixel that a point of the cloud projects to.
fn rasterize(cloud: &[Point], camera: &PinholeCamera, world_from_camera: &Isometry) -> Raster<f32> {
    let camera_from_world = world_from_camera.inverse();
    let mut depth = Raster::filled(camera.height, camera.width, f32::NAN);
    for p in cloud {
        let p = camera_from_world * p;
        let Some((u, v)) = camera.project(&p) else { continue };
        let (row, col) = (v.round() as isize, u.round() as isize);
        if depth.at(row, col).is_some() {
            let pixel = &mut depth[(row as usize, col as usize)];
            // `min` prefers the reading over NaN.
            *pixel = pixel.min(p.z as f32);
        }
    }
    depth
}

/// Fills the gaps that the noise across the rays left: pixels with at least five read neighbours of eight, then, ring by ring, every
/// empty pixel that the object encloses. A gap left open would count as a ray that passes the object.
fn closed_gaps(depth: &Raster<f32>) -> Raster<f32> {
    let mut depth = filled_where(depth, 5, |_, _| true);
    let outside = reached_from_border(&depth);
    let enclosed = |row: usize, col: usize| !outside[(row, col)];
    while depth.pixels().any(|(row, col, z)| z.is_nan() && enclosed(row, col)) {
        depth = filled_where(&depth, 1, enclosed);
    }
    depth
}

/// The empty pixels that are joined, by edges, to the border of the image.
fn reached_from_border(depth: &Raster<f32>) -> Raster<bool> {
    let (rows, cols) = depth.shape();
    let mut reached = Raster::filled(rows, cols, false);
    let mut stack: Vec<(usize, usize)> = (0..rows).flat_map(|r| [(r, 0), (r, cols - 1)]).collect();
    stack.extend((0..cols).flat_map(|c| [(0, c), (rows - 1, c)]));
    while let Some((row, col)) = stack.pop() {
        if reached[(row, col)] || depth[(row, col)].is_finite() {
            continue;
        }
        reached[(row, col)] = true;
        let steps = [(row.wrapping_sub(1), col), (row + 1, col), (row, col.wrapping_sub(1)), (row, col + 1)];
        stack.extend(steps.into_iter().filter(|&(r, c)| r < rows && c < cols));
    }
    reached
}

/// Each empty pixel that may be filled and has `least` read neighbours takes their mean.
fn filled_where(depth: &Raster<f32>, least: usize, may: impl Fn(usize, usize) -> bool) -> Raster<f32> {
    Raster::from_fn(depth.rows(), depth.cols(), |row, col| {
        if depth[(row, col)].is_finite() || !may(row, col) {
            return depth[(row, col)];
        }
        let (mut sum, mut count) = (0.0, 0);
        for dr in -1..=1 {
            for dc in -1..=1 {
                if let Some(z) = depth.at(row as isize + dr, col as isize + dc).filter(|z| z.is_finite()) {
                    sum += z;
                    count += 1;
                }
            }
        }
        if count >= least { sum / count as f32 } else { f32::NAN }
    })
}

/// Farthest-point order of the touches from a seeded first one.
fn spread(touches: Vec<Touch>, seed: u64) -> Vec<Touch> {
    if touches.is_empty() {
        return touches;
    }
    let first = stream(seed, "ycb-sight", 0, "first touch").random_range(0..touches.len());
    let mut order = FarthestFirst::new(touches.iter().map(|t| t.world_from_sensor.translation.vector.into()).collect());
    order.take(first);
    let mut indices = vec![first];
    while let Some(next) = order.next() {
        order.keep_away_from(next);
        indices.push(next);
    }
    let mut touches: Vec<Option<Touch>> = touches.into_iter().map(Some).collect();
    indices.into_iter().filter_map(|i| touches[i].take()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Solid;
    use super::*;
    use crate::tactile::{LiftParams, lift};

    fn object() -> YcbSightObject {
        let params = TouchParams { candidates: 500, ..TouchParams::default() };
        let mesh = Solid::named("cylinder").expect("listed").mesh(2e-5, 5e-3);
        simulate_at("cylinder", &mesh, 0, &params, 80).expect("valid")
    }

    #[test]
    fn sixty_touches_go_all_round_lowest_first_and_lie_on_the_object() {
        let made = object();
        assert_eq!(made.touches.len(), 60);
        let z: Vec<f64> = made.touches.iter().map(|t| t.world_from_sensor.translation.z).collect();
        assert!(z.is_sorted());
        let into: Vec<Vector> = made.touches.iter().map(|t| t.world_from_sensor * Vector::z()).collect();
        let count = |ok: &dyn Fn(&Vector) -> bool| into.iter().filter(|d| ok(d)).count();
        assert_eq!(count(&|d| d.z > 0.99), 10);
        assert_eq!(count(&|d| d.z < -0.99), 10);
        assert_eq!(count(&|d| d.z.abs() < 0.01), 40);
        let solid = Solid::named("cylinder").expect("listed");
        for touch in made.touches.iter().step_by(7) {
            let contact = touch.contact.as_ref().expect("recorded");
            let patch = lift(contact, &made.sensor, &touch.world_from_sensor, &LiftParams::default()).expect("contact");
            assert!(patch.points.iter().all(|p| solid.signed_distance(p).abs() < 0.1e-3));
        }
    }

    #[test]
    fn the_camera_looks_45_degrees_down_at_the_object_from_x() {
        let pose = ycb_sight_camera_pose(&Point::new(0.01, 0.02, 0.05));
        assert!((pose * Vector::z() - Vector::new(-1.0, 0.0, -1.0).normalize()).norm() < 1e-12);
        // Image right is +y of the object, as in the generator.
        assert!((pose * Vector::x() - Vector::y()).norm() < 1e-12);
        assert!((ycb_sight_camera().fx - 346.41).abs() < 0.01);
    }

    #[test]
    fn the_raster_recovered_from_a_noisy_cloud_has_no_gaps_and_stays_near_the_object() {
        let made = object();
        let points = made.depth_cloud.len();
        let scene = made.into_scene(0);
        let read = scene.frame.depth.as_slice().iter().filter(|z| z.is_finite()).count();
        assert!(read as f64 > 0.9 * points as f64 && (read as f64) < 1.15 * points as f64, "{read} of {points}");
        let solid = Solid::named("cylinder").expect("listed");
        for (row, col, &z) in scene.frame.depth.pixels().filter(|(.., z)| z.is_finite()) {
            let p = Point::from(scene.frame.camera.ray(col as f64, row as f64) * f64::from(z));
            let d = solid.signed_distance(&(scene.frame.world_from_camera * p));
            assert!(d.abs() < 8e-3, "{row} {col}: {d}");
        }
    }

    #[test]
    fn a_prefix_of_the_scene_is_spread_whatever_the_seed() {
        let made = object();
        let (a, b) = (made.clone().into_scene(0), made.into_scene(1));
        assert_ne!(a.touches[0].world_from_sensor, b.touches[0].world_from_sensor);
        for scene in [a, b] {
            let origins: Vec<Point> =
                scene.touches[..8].iter().map(|t| t.world_from_sensor.translation.vector.into()).collect();
            for (i, p) in origins.iter().enumerate() {
                assert!(origins[..i].iter().all(|q| (p - q).norm() > 0.035), "{i}");
            }
        }
    }
}
