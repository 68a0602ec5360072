//! New scene folders: from a [`Scene`] in memory, or from the files that a user has at hand.

use super::error::read_bytes;
use super::images::check_depth;
use super::scene::{implausible_median, median};
use super::scene_format::{
    self, BackgroundToml, CameraToml, DepthToml, FileToml, PoseSigmaToml, PoseToml, SceneToml, SensorToml, SupportToml,
    TouchToml, TruthToml,
};
use super::{
    IoError, atomic_write, parse_color, parse_depth_png, parse_mask, write_color, write_depth_png,
    write_height_map_npy, write_jpeg, write_mask, write_mesh,
};
use crate::camera::{Background, PinholeCamera};
use crate::geometry::{Isometry, Raster, TriangleMesh};
use crate::scene::Scene;
use crate::tactile::{RelaxedGel, TactileSensor, Touch};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// What [`write_scene`] writes.
#[derive(Debug, Clone, Copy)]
pub struct SceneToWrite<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The truth in the world frame, if known.
    pub truth: Option<&'a TriangleMesh>,
    /// No-contact image of the sensor, if recorded.
    pub tactile_background: Option<&'a Raster<[u8; 3]>>,
    /// Quality, 1 to 100, of tactile images written as JPEG; `None` writes them as PNG, without loss and ten times as large.
    pub jpeg_quality: Option<u8>,
    /// Unit of the depth image, metres: see [`depth_unit`].
    pub metres_per_unit: f64,
}

impl<'a> SceneToWrite<'a> {
    /// The scene alone, depth in the finest unit that holds it.
    pub fn new(scene: &'a Scene) -> Self {
        let metres_per_unit = depth_unit(&scene.frame.depth);
        Self { scene, truth: None, tactile_background: None, jpeg_quality: None, metres_per_unit }
    }
}

/// The finest unit, metres, in which 16 bits reach the farthest reading: 0.0001 to 6.55 m, 0.0002 to 13.1 m, 0.0005 to 32.7 m, else 0.001.
pub fn depth_unit(depth: &Raster<f32>) -> f64 {
    // NaN is never the larger.
    let farthest = f64::from(depth.as_slice().iter().copied().fold(0.0, f32::max));
    [1e-4, 2e-4, 5e-4].into_iter().find(|unit| farthest <= 65535.0 * unit).unwrap_or(1e-3)
}

/// Writes a scene folder (made if it is missing; its parent must exist). `scene.toml` comes last: a folder that an
/// interrupted run left behind is not a scene.
///
/// # Errors
/// [`IoError::NoFolder`] or [`IoError::Write`]; [`IoError::Content`] if a depth does not fit its unit.
pub fn write_scene(folder: impl AsRef<Path>, what: &SceneToWrite) -> Result<(), IoError> {
    let folder = folder.as_ref();
    let (scene, frame) = (what.scene, &what.scene.frame);
    check_depth(&folder.join("depth.png"), &frame.depth, what.metres_per_unit)?;
    make_folder(folder)?;
    let mut toml = SceneToml::new(
        scene.name.clone(),
        camera_toml(&frame.camera, Some(PoseToml::from(&frame.world_from_camera))),
        DepthToml {
            file: "depth.png".into(),
            metres_per_unit: what.metres_per_unit,
            background: background_toml(frame.background),
            sigma: frame.noise.sigma,
            sigma_quadratic: frame.noise.sigma_quadratic,
        },
    );
    write_depth_png(folder.join("depth.png"), &frame.depth, what.metres_per_unit)?;
    if let Some(color) = &frame.color {
        write_color(folder.join("color.png"), color)?;
        toml.color = Some(FileToml { file: "color.png".into() });
    }
    if let Some(mask) = &frame.mask {
        write_mask(folder.join("mask.png"), mask)?;
        toml.mask = Some(FileToml { file: "mask.png".into() });
    }
    toml.support = frame.support.map(|p| SupportToml { normal: p.normal.into_inner().into(), offset: p.offset });
    if let Some(sensor) = &scene.sensor {
        make_folder(&folder.join("touches"))?;
        let mut sensor_toml = sensor_toml(folder, sensor)?;
        sensor_toml.pose_sigma =
            PoseSigmaToml { translation: scene.pose_sigma.translation, rotation: scene.pose_sigma.rotation };
        if let Some(background) = what.tactile_background {
            sensor_toml.background = Some(image_file(folder, "touches/background", background, what.jpeg_quality)?);
        }
        toml.sensor = Some(sensor_toml);
    }
    for (i, touch) in scene.touches.iter().enumerate() {
        toml.touches.push(touch_toml(folder, i, touch, what.jpeg_quality)?);
    }
    if let Some(mesh) = what.truth {
        write_mesh(folder.join("truth.ply"), mesh)?;
        toml.truth = Some(TruthToml { mesh: "truth.ply".into() });
    }
    write_text(folder, &toml)
}

fn write_text(folder: &Path, toml: &SceneToml) -> Result<(), IoError> {
    atomic_write(folder.join("scene.toml"), |w| w.write_all(scene_format::text(toml).as_bytes()))
}

fn make_folder(folder: &Path) -> Result<(), IoError> {
    if folder.is_dir() {
        return Ok(());
    }
    if let Some(parent) = folder.parent().filter(|p| !p.as_os_str().is_empty() && !p.is_dir()) {
        return Err(IoError::NoFolder { path: folder.to_owned(), folder: parent.to_owned() });
    }
    std::fs::create_dir(folder).map_err(|source| IoError::Write { path: folder.to_owned(), source })
}

fn camera_toml(camera: &PinholeCamera, pose: Option<PoseToml>) -> CameraToml {
    CameraToml {
        width: camera.width,
        height: camera.height,
        fx: camera.fx,
        fy: camera.fy,
        cx: camera.cx,
        cy: camera.cy,
        distortion: camera.distortion,
        world_from_camera: pose,
    }
}

fn background_toml(background: Background) -> BackgroundToml {
    match background {
        Background::Absent => BackgroundToml::Absent,
        Background::Unknown => BackgroundToml::Unknown,
    }
}

/// A preset by its name, with only what differs from it; anything else in full.
fn sensor_toml(folder: &Path, sensor: &TactileSensor) -> Result<SensorToml, IoError> {
    let preset = TactileSensor::preset(&sensor.model).ok();
    let differs = |same: fn(&TactileSensor, &TactileSensor) -> bool| preset.as_ref().is_none_or(|p| !same(p, sensor));
    let mut toml = SensorToml {
        model: preset.as_ref().map_or("custom".into(), |p| p.model.clone()),
        background: None,
        width: differs(|a, b| a.width == b.width).then_some(sensor.width),
        height: differs(|a, b| a.height == b.height).then_some(sensor.height),
        pixel_pitch: differs(|a, b| a.pixel_pitch == b.pixel_pitch).then_some(sensor.pixel_pitch),
        relaxed_gel: None,
        pose_sigma: PoseSigmaToml::default(),
    };
    let flat_by_default = preset.is_none() && sensor.relaxed_gel == RelaxedGel::Flat;
    if !flat_by_default && differs(|a, b| a.relaxed_gel == b.relaxed_gel) {
        let map = match &sensor.relaxed_gel {
            RelaxedGel::Map(map) => map.clone(),
            // Half the resolution: bilinear reading back is off by p²/2R, nanometres.
            _ => sensor.relaxed(sensor.height.div_ceil(2), sensor.width.div_ceil(2)),
        };
        write_height_map_npy(folder.join("touches/relaxed.npy"), &map)?;
        toml.relaxed_gel = Some("touches/relaxed.npy".into());
    }
    Ok(toml)
}

/// Writes an image as PNG or JPEG and gives its name.
fn image_file(folder: &Path, stem: &str, image: &Raster<[u8; 3]>, quality: Option<u8>) -> Result<String, IoError> {
    let file = format!("{stem}.{}", if quality.is_some() { "jpg" } else { "png" });
    match quality {
        Some(quality) => write_jpeg(folder.join(&file), image, quality)?,
        None => write_color(folder.join(&file), image)?,
    }
    Ok(file)
}

fn touch_toml(folder: &Path, index: usize, touch: &Touch, quality: Option<u8>) -> Result<TouchToml, IoError> {
    let stem = format!("touches/{index:03}");
    let mut toml = TouchToml {
        image: None,
        height_map: None,
        contact_mask: None,
        world_from_sensor: PoseToml::from(&touch.world_from_sensor),
    };
    if let Some(image) = &touch.image {
        toml.image = Some(image_file(folder, &stem, image, quality)?);
    }
    if let Some(contact) = &touch.contact {
        let (height, mask) = (format!("{stem}_height.npy"), format!("{stem}_contact.png"));
        write_height_map_npy(folder.join(&height), &contact.height_map)?;
        write_mask(folder.join(&mask), &contact.mask)?;
        (toml.height_map, toml.contact_mask) = (Some(height), Some(mask));
    }
    Ok(toml)
}

/// What [`init_scene`] makes a scene from.
#[derive(Debug, Clone)]
pub struct NewScene {
    /// 16-bit depth PNG, 0 = no reading.
    pub depth: PathBuf,
    /// Focal lengths and principal point, pixels, with the distortion; width and height come from the depth image.
    pub intrinsics: PinholeCamera,
    /// Where the camera stands, if known.
    pub world_from_camera: Option<Isometry>,
    /// Colour image of the same size, PNG or JPEG.
    pub color: Option<PathBuf>,
    /// Mask of the same size, PNG.
    pub mask: Option<PathBuf>,
    /// Unit of the depth image, metres.
    pub metres_per_unit: f64,
    /// What a pixel without a reading means.
    pub background: Background,
    /// Overwrite a `scene.toml` that is already there.
    pub overwrite: bool,
}

/// What [`init_scene`] found.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneMade {
    /// Median of the depth readings, metres.
    pub median_depth: Option<f32>,
    /// What is doubtful.
    pub warnings: Vec<String>,
}

/// Makes a scene folder without touches: checks the images, copies them and writes `scene.toml`.
///
/// # Errors
/// [`IoError`] naming the image that cannot be read or has another size than the depth image, or why nothing can be written.
pub fn init_scene(folder: impl AsRef<Path>, new: &NewScene) -> Result<SceneMade, IoError> {
    let folder = folder.as_ref();
    let target = folder.join("scene.toml");
    if target.exists() && !new.overwrite {
        return Err(IoError::content(&target, "there is already a scene here; it would be overwritten"));
    }
    let bytes = read_bytes(&new.depth)?;
    let depth = parse_depth_png(&new.depth, &bytes, new.metres_per_unit)?;
    let mut readings: Vec<f32> = depth.as_slice().iter().copied().filter(|z| z.is_finite()).collect();
    let median_depth = median(&mut readings);
    let doubt = median_depth.and_then(implausible_median);
    let warnings = doubt.into_iter().map(|text| format!("{}: {text}", new.depth.display())).collect();
    let camera = PinholeCamera { width: depth.cols(), height: depth.rows(), ..new.intrinsics };
    camera.validate().map_err(|e| IoError::content(&new.depth, format!("the intrinsics do not fit: {e}")))?;

    let name = folder.canonicalize().ok().or_else(|| Some(folder.to_owned()));
    let name = name.as_deref().and_then(Path::file_name).map_or("scene".into(), |n| n.to_string_lossy().into_owned());
    let depth_toml = DepthToml {
        file: "depth.png".into(),
        metres_per_unit: new.metres_per_unit,
        background: background_toml(new.background),
        sigma: 0.0,
        sigma_quadratic: 0.0,
    };
    let mut toml =
        SceneToml::new(name, camera_toml(&camera, new.world_from_camera.as_ref().map(PoseToml::from)), depth_toml);
    let mut copies = vec![("depth.png".to_string(), bytes)];
    let fits = |path: &Path, (rows, cols): (usize, usize)| {
        let (found, needed) = ([cols, rows], [camera.width, camera.height]);
        if found == needed {
            Ok(())
        } else {
            Err(IoError::Size { path: path.to_owned(), found, needed, needed_by: "the depth image" })
        }
    };
    if let Some(path) = &new.color {
        let bytes = read_bytes(path)?;
        fits(path, parse_color(path, &bytes)?.shape())?;
        let file = if bytes.starts_with(b"\x89PNG") { "color.png" } else { "color.jpg" };
        toml.color = Some(FileToml { file: file.into() });
        copies.push((file.into(), bytes));
    }
    if let Some(path) = &new.mask {
        let bytes = read_bytes(path)?;
        fits(path, parse_mask(path, &bytes)?.shape())?;
        toml.mask = Some(FileToml { file: "mask.png".into() });
        copies.push(("mask.png".into(), bytes));
    }
    make_folder(folder)?;
    for (file, bytes) in copies {
        atomic_write(folder.join(file), |w| w.write_all(&bytes))?;
    }
    write_text(folder, &toml)?;
    Ok(SceneMade { median_depth, warnings })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{DepthNoise, Frame};
    use crate::geometry::{Isometry, Plane, Point, Vector};
    use crate::io::{check_scene, read_scene};
    use crate::scene::PoseSigma;
    use crate::tactile::Contact;

    pub(in crate::io) fn scene() -> Scene {
        let camera = PinholeCamera {
            width: 16,
            height: 12,
            fx: 20.0,
            fy: 21.0,
            cx: 7.5,
            cy: 5.5,
            distortion: [0.01, 0.0, 0.0, 0.0, 0.0],
        };
        let pose = |x| Isometry::new(Vector::new(x, 0.1, 0.6), Vector::new(0.0, 0.4, 0.0));
        let contact = Contact {
            // Below the dome of the relaxed gel everywhere.
            height_map: Raster::from_fn(6, 8, |r, c| -5e-3 - 1e-4 * (r + c) as f32),
            mask: Raster::from_fn(6, 8, |r, _| r > 2),
        };
        Scene {
            name: "a \"test\"".into(),
            frame: Frame {
                camera,
                world_from_camera: pose(0.0),
                depth: Raster::from_fn(12, 16, |r, c| if r == 0 { f32::NAN } else { 0.5 + 0.001 * c as f32 }),
                background: Background::Absent,
                noise: DepthNoise { sigma: 0.002, sigma_quadratic: 0.001 },
                color: Some(Raster::from_fn(12, 16, |r, c| [r as u8, c as u8, 7])),
                mask: Some(Raster::from_fn(12, 16, |r, _| r > 3)),
                support: Plane::new(Vector::z(), &Point::new(0.0, 0.0, -0.01)),
            },
            sensor: Some(TactileSensor::preset("ycb-sight").expect("a preset")),
            pose_sigma: PoseSigma { translation: 0.001, rotation: 0.02 },
            touches: vec![
                Touch { contact: Some(contact), image: None, world_from_sensor: pose(0.1) },
                Touch { contact: None, image: Some(Raster::filled(480, 640, [1, 2, 3])), world_from_sensor: pose(0.2) },
            ],
        }
    }

    #[test]
    fn the_unit_of_depth_reaches_the_farthest_reading() {
        let folder = tempfile::tempdir().expect("temporary folder");
        for (farthest, unit) in [(6.5, 1e-4), (6.6, 2e-4), (13.2, 5e-4), (40.0, 1e-3)] {
            let mut scene = scene();
            scene.frame.depth[(5, 5)] = farthest;
            let path = folder.path().join(format!("{farthest}"));
            let what = SceneToWrite::new(&scene);
            assert_eq!(what.metres_per_unit, unit);
            write_scene(&path, &what).expect("written");
            let read = read_scene(&path).expect("a scene").scene.frame.depth;
            assert!((read[(5, 5)] - farthest).abs() < 1e-5 && (read[(3, 0)] - 0.5).abs() < 1e-5, "{}", read[(5, 5)]);
        }
    }

    #[test]
    fn a_depth_beyond_every_unit_leaves_no_folder() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let mut scene = scene();
        scene.frame.depth[(5, 6)] = 70.0;
        let path = folder.path().join("s");
        let error = write_scene(&path, &SceneToWrite::new(&scene)).expect_err("too far").to_string();
        assert!(error.contains("70 m at pixel (6, 5)") && error.contains("0 to 65.535 m"), "{error}");
        assert!(!path.exists());
    }

    #[test]
    fn a_written_scene_is_read_back() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let at = folder.path().join("scene");
        let scene = scene();
        let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(Point::from).to_vec();
        let truth = TriangleMesh::new(points, vec![[0, 1, 2]]).expect("valid");
        let rest = Raster::filled(480, 640, [7, 8, 9]);
        let what = SceneToWrite { truth: Some(&truth), tactile_background: Some(&rest), ..SceneToWrite::new(&scene) };
        write_scene(&at, &what).expect("written");
        let back = read_scene(&at).expect("read");
        assert!(back.warnings.is_empty(), "{:?}", back.warnings);
        assert_eq!(back.tactile_background.as_ref(), Some(&rest));
        assert_eq!(back.truth, Some(at.join("truth.ply")));
        let (a, b) = (&scene, &back.scene);
        assert_eq!((&a.name, &a.sensor, a.pose_sigma), (&b.name, &b.sensor, b.pose_sigma));
        assert_eq!((&a.frame.camera, &a.frame.color, &a.frame.mask), (&b.frame.camera, &b.frame.color, &b.frame.mask));
        assert_eq!(
            (a.frame.background, a.frame.noise, a.frame.support),
            (b.frame.background, b.frame.noise, b.frame.support)
        );
        for (x, y) in a.frame.depth.as_slice().iter().zip(b.frame.depth.as_slice()) {
            assert!(x.is_nan() && y.is_nan() || (x - y).abs() <= 0.5001e-4);
        }
        for (x, y) in a.touches.iter().zip(&b.touches) {
            assert_eq!((&x.contact, &x.image), (&y.contact, &y.image));
            let moved = x.world_from_sensor.inverse() * y.world_from_sensor;
            assert!(moved.translation.vector.norm() < 1e-12 && moved.rotation.angle() < 1e-7);
        }
        assert!(check_scene(&at).errors.is_empty());
    }

    #[test]
    fn a_sensor_of_its_own_keeps_its_gel() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let mut scene = scene();
        scene.touches.clear();
        let dome = RelaxedGel::Dome { radius: 0.03 };
        let mine = TactileSensor { model: "mine".into(), width: 100, height: 80, pixel_pitch: 1e-4, relaxed_gel: dome };
        scene.sensor = Some(mine.clone());
        write_scene(folder.path(), &SceneToWrite::new(&scene)).expect("written");
        let back = read_scene(folder.path()).expect("read").scene.sensor.expect("a sensor");
        assert_eq!((back.model.as_str(), back.width, back.height), ("custom", 100, 80));
        let (a, b) = (mine.relaxed(40, 50), back.relaxed(40, 50));
        assert!(a.as_slice().iter().zip(b.as_slice()).all(|(a, b)| (a - b).abs() < 1e-7));
    }
}
