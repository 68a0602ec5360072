//! The layout of the YCB-Sight data set, simulated subset: one folder per object.
//!
//! `depthCam.npy` (N × 3, metres, object frame), `pose.txt` (`<k>.npy,[qx qy qz qw],[tx ty tz]` per line), and for each k
//! `gt_height_map/<k>.npy` (480 × 640, pixels of 0.0295 mm, larger = pressed further in), `gt_contact_mask/<k>.npy` (bool) and
//! `gelsight/<k>.jpg` (optional here). Poses are those of first contact, **before** the 1 mm press. Beside them we keep
//! `camera.json` and `background.jpg` (the no-contact image), which the original does not have in each object's folder.

use super::error::read_bytes;
use super::npy::write_mask_npy;
use super::{IoError, atomic_write, read_color, read_npy, write_jpeg, write_npy};
use crate::camera::PinholeCamera;
use crate::geometry::{Isometry, Point, Raster};
use crate::scene::PoseSigma;
use crate::simulate::{YcbSightObject, ycb_sight_camera, ycb_sight_camera_pose};
use crate::tactile::{Contact, TactileSensor, Touch};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::path::Path;

/// Size of a height unit and of a pixel, metres.
const PIXEL: f64 = 0.0295e-3;
/// Quality of the set's images: OpenCV's default.
const JPEG_QUALITY: u8 = 95;
/// Press after first contact, metres.
const PRESS: f64 = 1.0e-3;

/// An object of the set and what had to be assumed.
#[derive(Debug, Clone)]
pub struct YcbSightFile {
    /// What the folder holds; [`YcbSightObject::into_scene`] makes a scene of it.
    pub object: YcbSightObject,
    /// What was doubtful and what was done about it.
    pub warnings: Vec<String>,
}

/// `camera.json`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    camera: PinholeCamera,
    translation: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

/// Their sensor frame at first contact, seen from ours in the pressed pose: their x of column c is (c − 320)·k, ours (c − 319.5)·k
/// (rows alike), and the press moved ours by d along +z.
fn pose_from_sensor() -> Translation3<f64> {
    Translation3::new(-PIXEL / 2.0, -PIXEL / 2.0, PRESS)
}

/// Reads one object's folder. Touches come in the file's order; the sensor is the preset `ycb-sight`.
///
/// Without `camera.json` the camera of the simulated set is assumed, aimed by the mean of the touches' positions, and a warning
/// says so.
///
/// # Errors
/// [`IoError`] with the file, and for `pose.txt` the line.
pub fn read_ycb_sight(folder: impl AsRef<Path>) -> Result<YcbSightFile, IoError> {
    let folder = folder.as_ref();
    let sensor = sensor();
    let poses = read_poses(&folder.join("pose.txt"))?;
    let touches: Vec<Touch> =
        poses.par_iter().map(|(stem, pose)| read_touch(folder, stem, pose, &sensor)).collect::<Result<_, _>>()?;
    let depth_cloud = read_points(&folder.join("depthCam.npy"))?;
    let mut warnings = Vec::new();
    let camera_file = folder.join("camera.json");
    let (camera, world_from_camera) = if camera_file.is_file() {
        read_camera(&camera_file)?
    } else {
        warnings.push(format!(
            "{}: no camera.json; the depth raster is recovered with the simulated set's camera (400 × 400, 0.5 m in front of \
             and above the object), aimed by the mean of the {} touches",
            folder.display(),
            touches.len()
        ));
        (ycb_sight_camera(), ycb_sight_camera_pose(&middle(&touches, &depth_cloud)))
    };
    let name = folder.file_name().map_or_else(|| "object".to_owned(), |n| n.to_string_lossy().into_owned());
    let pose_sigma = PoseSigma::default();
    let background = folder.join("background.jpg");
    let tactile_background = if background.is_file() { Some(read_color(&background)?) } else { None };
    let object = YcbSightObject {
        name,
        depth_cloud,
        camera,
        world_from_camera,
        sensor,
        pose_sigma,
        touches,
        tactile_background,
    };
    Ok(YcbSightFile { object, warnings })
}

/// Reads one touch alone: its maps, and its image if there is one. The pose is not read and stands at the origin.
///
/// * `stem` – name of its files without the extension, usually a number
///
/// # Errors
/// [`IoError`] with the file.
pub fn read_ycb_sight_press(folder: impl AsRef<Path>, stem: &str) -> Result<Touch, IoError> {
    read_touch(folder.as_ref(), stem, &Isometry::identity(), &sensor())
}

/// Writes one object's folder (made if it is missing; its parent must exist), `pose.txt` last.
///
/// # Errors
/// [`IoError::Content`] for a touch without a 640 × 480 map, which the layout demands; [`IoError::NoFolder`] or
/// [`IoError::Write`].
pub fn write_ycb_sight(folder: impl AsRef<Path>, object: &YcbSightObject) -> Result<(), IoError> {
    let folder = folder.as_ref();
    let images = object.touches.iter().any(|touch| touch.image.is_some());
    for part in ["", "gt_height_map", "gt_contact_mask"].iter().chain(images.then_some(&"gelsight")) {
        make_folder(&folder.join(part))?;
    }
    if let Some(background) = &object.tactile_background {
        write_jpeg(folder.join("background.jpg"), background, JPEG_QUALITY)?;
    }
    let cloud: Vec<f32> = object.depth_cloud.iter().flat_map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect();
    write_npy(folder.join("depthCam.npy"), &[object.depth_cloud.len(), 3], &cloud)?;
    let camera = CameraFile {
        camera: object.camera,
        translation: object.world_from_camera.translation.vector.into(),
        quaternion_xyzw: object.world_from_camera.rotation.coords.into(),
    };
    let json = serde_json::to_vec_pretty(&camera)
        .map_err(|source| IoError::Write { path: folder.join("camera.json"), source: source.into() })?;
    atomic_write(folder.join("camera.json"), |w| w.write_all(&json))?;
    let mut poses = String::new();
    for (k, touch) in object.touches.iter().enumerate() {
        write_touch(folder, k, touch)?;
        let pose = touch.world_from_sensor * pose_from_sensor().inverse();
        let (q, t) = (pose.rotation.coords, pose.translation.vector);
        poses += &format!("{k}.npy,[{} {} {} {}],[{} {} {}]\n", q.x, q.y, q.z, q.w, t.x, t.y, t.z);
    }
    atomic_write(folder.join("pose.txt"), |w| w.write_all(poses.as_bytes()))
}

fn sensor() -> TactileSensor {
    TactileSensor::preset("ycb-sight").expect("a listed preset")
}

fn make_folder(folder: &Path) -> Result<(), IoError> {
    if let Some(parent) = folder.parent().filter(|p| !p.as_os_str().is_empty() && !p.is_dir()) {
        return Err(IoError::NoFolder { path: folder.to_owned(), folder: parent.to_owned() });
    }
    std::fs::create_dir_all(folder).map_err(|source| IoError::Write { path: folder.to_owned(), source })
}

fn write_touch(folder: &Path, k: usize, touch: &Touch) -> Result<(), IoError> {
    let path = folder.join(format!("gt_height_map/{k}.npy"));
    let sensor = sensor();
    let needed = (sensor.height, sensor.width);
    let Some(contact) = &touch.contact else {
        return Err(IoError::content(&path, format!("touch {k} has no height map; this layout needs one")));
    };
    if contact.height_map.shape() != needed {
        let (rows, cols) = contact.height_map.shape();
        return Err(IoError::content(
            &path,
            format!(
                "the map of touch {k} is {rows} × {cols}; this layout needs 480 × 640 (simulate with --map-width 640)"
            ),
        ));
    }
    let heights: Vec<f32> = contact.height_map.as_slice().iter().map(|&z| (-f64::from(z) / PIXEL) as f32).collect();
    write_npy(&path, &[needed.0, needed.1], &heights)?;
    if let Some(image) = &touch.image {
        write_jpeg(folder.join(format!("gelsight/{k}.jpg")), image, JPEG_QUALITY)?;
    }
    write_mask_npy(&folder.join(format!("gt_contact_mask/{k}.npy")), &contact.mask)
}

/// File stem and pose of each line.
fn read_poses(path: &Path) -> Result<Vec<(String, Isometry)>, IoError> {
    let bytes = read_bytes(path)?;
    let text = String::from_utf8_lossy(&bytes);
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(i, line)| {
            parse_pose(line).map_err(|reason| {
                IoError::content(
                    path,
                    format!("line {}: {reason}; '<k>.npy,[qx qy qz qw],[tx ty tz]' is needed", i + 1),
                )
            })
        })
        .collect()
}

fn parse_pose(line: &str) -> Result<(String, Isometry), String> {
    let (name, rest) = line.split_once(',').ok_or("no comma after the file name")?;
    let stem = name.trim().strip_suffix(".npy").ok_or_else(|| format!("'{}' is no .npy file", name.trim()))?;
    if stem.is_empty() || !stem.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-') {
        return Err(format!("'{stem}' is no plain file name"));
    }
    let mut groups = rest.split('[').skip(1).map(|group| group.split(']').next().unwrap_or_default());
    let mut numbers = |count: usize, what: &str| -> Result<Vec<f64>, String> {
        let group = groups.next().ok_or_else(|| format!("no {what}"))?;
        let values: Result<Vec<f64>, _> = group.split_whitespace().map(str::parse).collect();
        let values = values.map_err(|e| format!("{what} '{group}': {e}"))?;
        if values.len() != count || !values.iter().all(|v| v.is_finite()) {
            return Err(format!("{what} '{group}' must be {count} finite numbers"));
        }
        Ok(values)
    };
    let q = numbers(4, "quaternion")?;
    let t = numbers(3, "translation")?;
    let rotation = unit_quaternion([q[0], q[1], q[2], q[3]])?;
    Ok((stem.to_owned(), Isometry::from_parts(Translation3::new(t[0], t[1], t[2]), rotation)))
}

fn unit_quaternion([x, y, z, w]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)
        .ok_or_else(|| format!("quaternion [{x} {y} {z} {w}] has no direction"))
}

fn read_touch(folder: &Path, stem: &str, pose: &Isometry, sensor: &TactileSensor) -> Result<Touch, IoError> {
    let path = folder.join(format!("gt_height_map/{stem}.npy"));
    let heights = raster(&path)?;
    let mask_path = folder.join(format!("gt_contact_mask/{stem}.npy"));
    let mask = raster(&mask_path)?;
    let contact = Contact::new(heights.map(|h| (-h * PIXEL) as f32), mask.map(|&m| m != 0.0), sensor)
        .map_err(|error| IoError::content(&path, error.to_string()))?;
    let image_path = folder.join(format!("gelsight/{stem}.jpg"));
    let image = if image_path.is_file() { Some(read_color(&image_path)?) } else { None };
    Ok(Touch { contact: Some(contact), image, world_from_sensor: pose * pose_from_sensor() })
}

/// A two-dimensional array.
fn raster(path: &Path) -> Result<Raster<f64>, IoError> {
    let array = read_npy(path)?;
    let shape = array.shape.clone();
    let map = match shape.as_slice() {
        &[rows, cols] => Raster::from_vec(rows, cols, array.values).filter(|_| rows * cols > 0),
        _ => None,
    };
    map.ok_or_else(|| IoError::content(path, format!("the shape is {shape:?}; a map has two axes (rows, cols)")))
}

fn read_points(path: &Path) -> Result<Vec<Point>, IoError> {
    let array = read_npy(path)?;
    if array.shape.len() != 2 || array.shape[1] != 3 {
        return Err(IoError::content(path, format!("the shape is {:?}; N × 3 is needed", array.shape)));
    }
    let points: Vec<Point> = array.values.chunks_exact(3).map(|c| Point::new(c[0], c[1], c[2])).collect();
    match points.iter().position(|p| !p.iter().all(|c| c.abs() < 100.0)) {
        Some(i) => Err(IoError::content(path, format!("point {i} is {}; finite metres are needed", points[i]))),
        None => Ok(points),
    }
}

fn read_camera(path: &Path) -> Result<(PinholeCamera, Isometry), IoError> {
    let file: CameraFile = serde_json::from_slice(&read_bytes(path)?)
        .map_err(|error| IoError::malformed(path, "camera.json", error.to_string()))?;
    let [x, y, z] = file.translation;
    let rotation = unit_quaternion(file.quaternion_xyzw).map_err(|reason| IoError::content(path, reason))?;
    let c = &file.camera;
    let sane = (1..=16384).contains(&c.width) && (1..=16384).contains(&c.height) && c.fx > 0.0 && c.fy > 0.0;
    if !sane || !(x + y + z).is_finite() {
        return Err(IoError::content(path, "image size, focal lengths or translation are out of range"));
    }
    Ok((file.camera, Isometry::from_parts(Translation3::new(x, y, z), rotation)))
}

/// Where the object is: the middle of the touches' box, or of the cloud's if there is none.
fn middle(touches: &[Touch], cloud: &[Point]) -> Point {
    let origins: Vec<Point> = touches.iter().map(|t| t.world_from_sensor.translation.vector.into()).collect();
    let bounds = crate::geometry::Aabb::of(if origins.is_empty() { cloud } else { &origins });
    bounds.map_or_else(Point::origin, |b| b.center())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{SimulateParams, Solid, TouchParams, simulate_scene};
    use crate::tactile::{LiftParams, lift};

    /// Two full-size touches of a capsule, as a robot would record them.
    fn recorded() -> (crate::scene::Scene, YcbSightObject) {
        let touch = TouchParams { count: 2, map_width: 640, candidates: 100, ..TouchParams::default() };
        let mesh = Solid::named("capsule").expect("listed").mesh(2e-5, 5e-3);
        let scene = simulate_scene("capsule", &mesh, &SimulateParams { touch, ..SimulateParams::default() });
        let scene = scene.expect("valid").scene;
        let object = YcbSightObject::from_scene(&scene, sensor());
        (scene, object)
    }

    #[test]
    fn a_scene_survives_the_layout_and_its_patches_move_by_less_than_a_micrometre() {
        let (scene, object) = recorded();
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("capsule");
        write_ycb_sight(&path, &object).expect("written");
        let read = read_ycb_sight(&path).expect("read back");
        assert!(read.warnings.is_empty(), "{:?}", read.warnings);
        let back = read.object.into_scene(0);
        assert_eq!(back.touches.len(), 2);
        for touch in &scene.touches {
            let patch = |t: &Touch| {
                lift(t.contact.as_ref().expect("recorded"), &sensor(), &t.world_from_sensor, &LiftParams::default())
                    .expect("contact")
            };
            let expected = patch(touch);
            let distance = |t: &&Touch| {
                (t.world_from_sensor.translation.vector - touch.world_from_sensor.translation.vector).norm()
            };
            let twin = back.touches.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("two");
            let found = patch(twin);
            assert_eq!(found.points.len(), expected.points.len());
            assert!(found.points.iter().zip(&expected.points).all(|(a, b)| (a - b).norm() < 1e-6));
            assert!(found.normals.iter().zip(&expected.normals).all(|(a, b)| (a - b).norm() < 1e-3));
            assert!(found.clearance.iter().zip(&expected.clearance).all(|(a, b)| (a - b).norm() < 1e-6));
        }
        // The raster of our own camera comes back pixel by pixel.
        let same = back.frame.depth.pixels().filter(|&(r, c, z)| {
            let before = scene.frame.depth[(r, c)];
            before.is_finite() && (z - before).abs() < 1e-5
        });
        let seen = scene.frame.depth.as_slice().iter().filter(|z| z.is_finite()).count();
        assert_eq!(same.count(), seen);
    }

    #[test]
    fn files_hold_what_the_set_documents() {
        let (scene, object) = recorded();
        let folder = tempfile::tempdir().expect("temporary folder");
        write_ycb_sight(folder.path(), &object).expect("written");
        let heights = read_npy(folder.path().join("gt_height_map/0.npy")).expect("there");
        assert_eq!(heights.shape, [480, 640]);
        // Pixels, larger = deeper: the corner of the relaxed dome is 47 px, blurred at the border to 45.
        let largest = heights.values.iter().copied().fold(0.0, f64::max);
        assert!((44.0..48.0).contains(&largest), "{largest}");
        assert_eq!(read_npy(folder.path().join("gt_contact_mask/1.npy")).expect("there").shape, [480, 640]);
        // Their reading (seed: p = ((c − 320) k, (r − 240) k, (33.898 − H) k)) meets ours.
        let poses = read_poses(&folder.path().join("pose.txt")).expect("there");
        let p_local = Point::new(
            (400.0 - 320.0) * PIXEL,
            (240.0 - 240.0) * PIXEL,
            PRESS - heights.values[240 * 640 + 400] * PIXEL,
        );
        let theirs = poses[0].1 * p_local;
        let touch = &object.touches[0];
        let z = touch.contact.as_ref().expect("recorded").height_map[(240, 400)];
        let ours = touch.world_from_sensor * Point::new((400.0 - 319.5) * PIXEL, 0.5 * PIXEL, f64::from(z));
        assert!((theirs - ours).norm() < 1e-8, "{theirs} {ours}");
        assert_eq!(scene.touches.len(), poses.len());
    }

    #[test]
    fn without_its_camera_the_set_is_read_and_says_so() {
        let (_, object) = recorded();
        let folder = tempfile::tempdir().expect("temporary folder");
        write_ycb_sight(folder.path(), &object).expect("written");
        std::fs::remove_file(folder.path().join("camera.json")).expect("there");
        let read = read_ycb_sight(folder.path()).expect("read");
        assert!(read.warnings[0].contains("no camera.json"), "{:?}", read.warnings);
        assert_eq!(read.object.camera.width, 400);
    }

    #[test]
    fn pose_lines_are_checked() {
        let (stem, pose) = parse_pose("7.npy,[ 0.   1.e+00 0. 0.],[1 2. -3e-1]").expect("numpy print");
        assert_eq!(stem, "7");
        assert!((pose.translation.vector.z + 0.3).abs() < 1e-12 && pose.rotation.coords.y == 1.0);
        for (line, says) in [
            ("7.npy,[0 0 0 0],[1 2 3]", "no direction"),
            ("7.npy,[0 0 1],[1 2 3]", "4 finite numbers"),
            ("7.npy,[0 0 0 1]", "no translation"),
            ("../7.npy,[0 0 0 1],[1 2 3]", "plain file name"),
            ("7.npy,[0 0 0 x],[1 2 3]", "quaternion"),
        ] {
            let error = parse_pose(line).expect_err(line);
            assert!(error.contains(says), "{line}: {error}");
        }
    }

    #[test]
    fn coarse_maps_are_refused_with_the_remedy() {
        let (_, mut object) = recorded();
        let sensor = sensor();
        let relaxed = sensor.relaxed(240, 320);
        object.touches[1].contact = Some(Contact { mask: relaxed.map(|_| false), height_map: relaxed });
        let folder = tempfile::tempdir().expect("temporary folder");
        let error = write_ycb_sight(folder.path(), &object).expect_err("coarse").to_string();
        assert!(error.contains("240 × 320") && error.contains("--map-width 640"), "{error}");
        assert!(!folder.path().join("pose.txt").exists());
    }
}
