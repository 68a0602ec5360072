//! The scene folder: `scene.toml` beside plain files.

use super::error::read_bytes;
use super::scene_format::{self, BackgroundToml, PoseToml, SceneToml, SensorToml, TouchToml};
use super::{IoError, parse_depth_png, read_color, read_height_map_npy, read_mask, read_mesh};
use crate::camera::{Background, DepthNoise, Frame};
use crate::geometry::{Isometry, Plane, Point, Raster, Vector};
use crate::scene::{PoseSigma, Scene};
use crate::tactile::{Contact, RelaxedGel, TactileSensor, Touch};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// A scene as it was recorded.
#[derive(Debug, Clone)]
pub struct SceneFile {
    /// What a reconstruction may read.
    pub scene: Scene,
    /// The truth's mesh in the world frame, for evaluation only. The file exists; it was not read.
    pub truth: Option<PathBuf>,
    /// No-contact image of the sensor, if recorded: what decoders compare tactile images with.
    pub tactile_background: Option<Raster<[u8; 3]>>,
    /// What was doubtful and what was done about it.
    pub warnings: Vec<String>,
}

/// Everything that [`check_scene`] found.
#[derive(Debug)]
#[non_exhaustive]
pub struct SceneCheck {
    /// The scene, if nothing is wrong.
    pub scene: Option<SceneFile>,
    /// Everything that is wrong; a reconstruction would stop at the first.
    pub errors: Vec<IoError>,
    /// Everything that is doubtful.
    pub warnings: Vec<String>,
}

/// Reads a scene: a folder that holds `scene.toml`, or that file.
///
/// # Errors
/// The first thing that is wrong, as an [`IoError`] that names the file and, for a file of the scene, the key that asked for it.
pub fn read_scene(folder: impl AsRef<Path>) -> Result<SceneFile, IoError> {
    let check = load(folder.as_ref(), false);
    match (check.scene, check.errors.into_iter().next()) {
        (_, Some(error)) => Err(error),
        (Some(scene), None) => Ok(scene),
        (None, None) => unreachable!("a scene without errors was read"),
    }
}

/// Reads a scene like [`read_scene`], collects everything that is wrong instead of stopping at the first, reads the truth too, and
/// looks for what is doubtful: poses in millimetres, an implausible depth unit, a contact mask without contact.
pub fn check_scene(folder: impl AsRef<Path>) -> SceneCheck {
    load(folder.as_ref(), true)
}

/// Reads the files of one scene and gathers what is wrong with them.
pub(super) struct Loader {
    file: PathBuf,
    pub(super) errors: Vec<IoError>,
    pub(super) warnings: Vec<String>,
}

/// `scene.toml` of a folder, or that file.
pub(super) fn scene_path(folder: &Path) -> PathBuf {
    if folder.is_file() { folder.to_owned() } else { folder.join("scene.toml") }
}

fn load(folder: &Path, thorough: bool) -> SceneCheck {
    let mut loader = Loader::new(scene_path(folder));
    let text = read_bytes(&loader.file);
    let scene = loader.keep(text).and_then(|text| loader.load(&String::from_utf8_lossy(&text), thorough));
    let Loader { errors, warnings, .. } = loader;
    let scene = scene.filter(|_| errors.is_empty()).map(|scene| SceneFile { warnings: warnings.clone(), ..scene });
    SceneCheck { scene, errors, warnings }
}

impl Loader {
    pub(super) fn new(file: PathBuf) -> Self {
        Self { file, errors: Vec::new(), warnings: Vec::new() }
    }

    /// * `text` – of the scene's file
    pub(super) fn load(&mut self, text: &str, thorough: bool) -> Option<SceneFile> {
        let parsed = scene_format::parse(&self.file, text);
        let toml = self.keep(parsed)?;
        // Each part is read even if another is wrong: `check` shall say everything at once.
        let frame = self.frame(&toml);
        let sensor = toml.sensor.as_ref().map(|s| self.sensor(s));
        let sigma = toml.sensor.as_ref().map_or(PoseSigma::default(), |s| PoseSigma {
            translation: s.pose_sigma.translation,
            rotation: s.pose_sigma.rotation,
        });
        for (key, value) in [("translation", sigma.translation), ("rotation", sigma.rotation)] {
            self.need(value >= 0.0 && value.is_finite(), || {
                format!("[sensor] pose_sigma.{key} = {value}; a finite number ≥ 0 is needed")
            });
        }
        self.need(sensor.is_some() || toml.touches.is_empty(), || {
            format!("there are {} [[touches]] but no [sensor]", toml.touches.len())
        });
        let sensor = sensor.flatten();
        let background = toml.sensor.as_ref().and_then(|s| s.background.as_ref());
        let background = background.and_then(|file| {
            self.read("[sensor] background", file, |path| sized(read_color(path)?, path, sensor.as_ref()))
        });
        let touches = self.touches(&toml.touches, 0, sensor.as_ref(), background.is_some());
        let truth = toml.truth.as_ref().map(|t| self.truth(&t.mesh, thorough));
        let scene = Scene { name: toml.name, frame: frame?, sensor, pose_sigma: sigma, touches: touches? };
        if thorough {
            self.doubts(&scene);
        }
        Some(SceneFile { scene, truth: truth.flatten(), tactile_background: background, warnings: Vec::new() })
    }

    fn keep<T>(&mut self, result: Result<T, IoError>) -> Option<T> {
        result.map_err(|error| self.errors.push(error)).ok()
    }

    fn need(&mut self, holds: bool, reason: impl FnOnce() -> String) {
        if !holds {
            self.errors.push(IoError::Scene { path: self.file.clone(), reason: reason() });
        }
    }

    fn warn(&mut self, text: impl std::fmt::Display) {
        self.warnings.push(format!("{}: {text}", self.file.display()));
    }

    fn path(&self, relative: &str) -> PathBuf {
        self.file.parent().unwrap_or(Path::new(".")).join(relative)
    }

    /// Reads a file that `key` names.
    fn try_read<T>(&self, key: &str, file: &str, read: impl FnOnce(&Path) -> Result<T, IoError>) -> Result<T, IoError> {
        read(&self.path(file)).map_err(|source| IoError::InScene {
            scene: self.file.clone(),
            key: key.to_owned(),
            source: Box::new(source),
        })
    }

    fn read<T>(&mut self, key: &str, file: &str, read: impl FnOnce(&Path) -> Result<T, IoError>) -> Option<T> {
        let result = self.try_read(key, file, read);
        self.keep(result)
    }

    fn pose(&mut self, key: &str, pose: &PoseToml) -> Option<Isometry> {
        match pose.isometry() {
            Ok((isometry, None)) => Some(isometry),
            Ok((isometry, Some(length))) => {
                self.warn(format!("{key}: the quaternion has the length {length:.6}, not 1; it was normalised"));
                Some(isometry)
            }
            Err(reason) => {
                self.need(false, || format!("{key}: {reason}"));
                None
            }
        }
    }

    fn frame(&mut self, toml: &SceneToml) -> Option<Frame> {
        let c = &toml.camera;
        let camera = c.camera();
        if let Err(error) = camera.validate() {
            self.need(false, || format!("[camera] {error}"));
        }
        let inside = (0.0..c.width as f64).contains(&c.cx) && (0.0..c.height as f64).contains(&c.cy);
        if !inside {
            self.warn(format!(
                "[camera] the principal point ({}, {}) is outside the {}×{} image",
                c.cx, c.cy, c.width, c.height
            ));
        }
        let pose = c
            .world_from_camera
            .as_ref()
            .map_or(Some(Isometry::identity()), |p| self.pose("[camera] world_from_camera", p));
        let d = &toml.depth;
        self.need(d.metres_per_unit.is_finite() && d.metres_per_unit > 0.0, || {
            format!("[depth] metres_per_unit = {}; a finite number > 0 is needed", d.metres_per_unit)
        });
        for (key, value) in [("sigma", d.sigma), ("sigma_quadratic", d.sigma_quadratic)] {
            self.need(value >= 0.0 && value.is_finite(), || {
                format!("[depth] {key} = {value}; a finite number ≥ 0 is needed")
            });
        }
        let size = [c.width, c.height];
        let depth = self.read("[depth] file", &d.file, |path| {
            let depth = parse_depth_png(path, &read_bytes(path)?, d.metres_per_unit)?;
            fits(depth, path, size)
        });
        let color =
            toml.color.as_ref().map(|f| self.read("[color] file", &f.file, |path| fits(read_color(path)?, path, size)));
        let mask = toml.mask.as_ref().map(|f| {
            self.read("[mask] file", &f.file, |path| {
                let mask = fits(read_mask(path)?, path, size)?;
                let any = mask.as_slice().contains(&true);
                any.then_some(mask).ok_or_else(|| IoError::content(path, "no pixel is 255: the object is nowhere"))
            })
        });
        let support = toml.support.as_ref().map(|s| self.support(s.normal, s.offset));
        Some(Frame {
            camera,
            world_from_camera: pose?,
            depth: depth?,
            background: match d.background {
                BackgroundToml::Absent => Background::Absent,
                BackgroundToml::Unknown => Background::Unknown,
            },
            noise: DepthNoise { sigma: d.sigma, sigma_quadratic: d.sigma_quadratic },
            color: color.flatten(),
            mask: mask.flatten(),
            support: support.flatten(),
        })
    }

    /// n · x = offset holds for any length of n; the plane has a unit normal.
    fn support(&mut self, normal: [f64; 3], offset: f64) -> Option<Plane> {
        let n = Vector::from(normal);
        let length = n.norm();
        let plane = Plane::new(n, &Point::from(n * (offset / length.powi(2)))).filter(|_| length > 1e-6);
        self.need(plane.is_some(), || format!("[support] normal = {normal:?}, offset = {offset} is not a plane"));
        if plane.is_some() && (length - 1.0).abs() > 1e-3 {
            self.warn(format!(
                "[support] the normal has the length {length:.6}, not 1; normal and offset were divided by it"
            ));
        }
        plane
    }

    fn sensor(&mut self, s: &SensorToml) -> Option<TactileSensor> {
        let mut sensor = if s.model == "custom" {
            let (Some(width), Some(height), Some(pixel_pitch)) = (s.width, s.height, s.pixel_pitch) else {
                self.need(false, || "[sensor] model = \"custom\" needs width, height and pixel_pitch".into());
                return None;
            };
            TactileSensor { model: s.model.clone(), width, height, pixel_pitch, relaxed_gel: RelaxedGel::Flat }
        } else {
            match TactileSensor::preset(&s.model) {
                Ok(sensor) => sensor,
                Err(error) => {
                    self.need(false, || format!("[sensor] model: {error}, custom"));
                    return None;
                }
            }
        };
        // What the file states wins over the preset: a gel may have been measured.
        sensor.width = s.width.unwrap_or(sensor.width);
        sensor.height = s.height.unwrap_or(sensor.height);
        sensor.pixel_pitch = s.pixel_pitch.unwrap_or(sensor.pixel_pitch);
        if let Some(file) = &s.relaxed_gel {
            sensor.relaxed_gel =
                RelaxedGel::Map(self.read("[sensor] relaxed_gel", file, |path| read_height_map_npy(path))?);
        }
        if let Err(error) = sensor.validate() {
            self.need(false, || format!("[sensor] {error}"));
            return None;
        }
        Some(sensor)
    }

    /// * `first` – number of the first of `touches`
    pub(super) fn touches(
        &mut self,
        touches: &[TouchToml],
        first: usize,
        sensor: Option<&TactileSensor>,
        has_background: bool,
    ) -> Option<Vec<Touch>> {
        let mut poses = Vec::new();
        for (i, touch) in touches.iter().enumerate() {
            let key = format!("[[touches]] {}", first + i);
            poses.push(self.pose(&format!("{key} world_from_sensor"), &touch.world_from_sensor));
            match (&touch.image, &touch.height_map, &touch.contact_mask) {
                (Some(_), None, None) | (_, Some(_), Some(_)) => {}
                (Some(_), ..) => {
                    self.warn(format!("{key}: height_map and contact_mask belong together; the image is used alone"));
                }
                (None, ..) => {
                    self.need(false, || format!("{key} needs image, or height_map with contact_mask, or both"));
                }
            }
        }
        let image_alone = |t: &TouchToml| t.image.is_some() && (t.height_map.is_none() || t.contact_mask.is_none());
        let undecodable = touches.iter().filter(|t| image_alone(t)).count();
        if undecodable > 0 && !has_background {
            self.warn(format!(
                "[sensor] background is missing: without the image of the untouched gel, {undecodable} of {} touches cannot be decoded",
                touches.len()
            ));
        }
        // Hundreds of small files: read in parallel, judged in order.
        let recorded: Vec<Recorded> = touches
            .par_iter()
            .enumerate()
            .map(|(i, t)| self.recorded(&format!("[[touches]] {}", first + i), t, sensor))
            .collect();
        let mut all = Vec::with_capacity(touches.len());
        for ((contact, image), pose) in recorded.into_iter().zip(poses) {
            let contact = contact.map(|c| self.keep(c));
            let image = image.map(|i| self.keep(i));
            all.push(Touch { contact: contact.flatten(), image: image.flatten(), world_from_sensor: pose? });
        }
        Some(all)
    }

    fn recorded(&self, key: &str, touch: &TouchToml, sensor: Option<&TactileSensor>) -> Recorded {
        let contact = touch.height_map.as_ref().zip(touch.contact_mask.as_ref()).map(|(height, mask)| {
            let key_height = format!("{key} height_map");
            let height_map = self.try_read(&key_height, height, |path| {
                let map = read_height_map_npy(path)?;
                match sensor {
                    Some(s) => spans_pad(map, path, s),
                    None => Ok(map),
                }
            })?;
            let mask = self.try_read(&format!("{key} contact_mask"), mask, |path| {
                let (rows, cols) = height_map.shape();
                sized_by(read_mask(path)?, path, [cols, rows], "its height map")
            })?;
            Ok(Contact { height_map, mask })
        });
        let image = touch
            .image
            .as_ref()
            .map(|file| self.try_read(&format!("{key} image"), file, |path| sized(read_color(path)?, path, sensor)));
        (contact, image)
    }

    fn truth(&mut self, mesh: &str, thorough: bool) -> Option<PathBuf> {
        let path = self.path(mesh);
        if thorough {
            return self.read("[truth] mesh", mesh, |path| read_mesh(path).map(|_| ())).map(|()| path);
        }
        // Reconstruction does not need the truth; a scene without it is as good.
        Some(path)
    }

    /// What is readable but hardly meant.
    fn doubts(&mut self, scene: &Scene) {
        let frame = &scene.frame;
        let depth = frame.depth.as_slice();
        let share = depth.iter().filter(|z| z.is_finite()).count() as f64 / depth.len() as f64;
        // Of the object where it is marked: the room behind it may be large.
        let marked = |i: usize| frame.mask.as_ref().is_none_or(|mask| mask.as_slice()[i]);
        let mut seen: Vec<f32> =
            (0..depth.len()).filter(|&i| marked(i) && depth[i].is_finite()).map(|i| depth[i]).collect();
        if let Some(text) = median(&mut seen).and_then(implausible_median) {
            self.warn(format!("[depth] {text}"));
        }
        if share < 0.01 {
            self.warn(format!("[depth] only {:.2} % of the pixels have a reading", 100.0 * share));
        }
        if let Some(mask) = &frame.mask {
            let (marked, read) = mask
                .as_slice()
                .iter()
                .zip(frame.depth.as_slice())
                .filter(|(m, _)| **m)
                .fold((0, 0), |(m, r), (_, z)| (m + 1, r + usize::from(z.is_finite())));
            if read * 2 < marked {
                self.warn(format!("[mask] {marked} pixels are marked, but only {read} of them have a depth reading"));
            }
            if marked == mask.as_slice().len() {
                self.warn("[mask] every pixel is marked; 255 is the object, 0 everything else");
            } else if border_share(mask) > 0.9 {
                self.warn(format!(
                    "[mask] {:.0} % of the image border is marked as the object; is the mask inverted (255 is the object, 0 everything else)?",
                    100.0 * border_share(mask)
                ));
            }
        }
        self.doubtful_touches(scene);
    }

    fn doubtful_touches(&mut self, scene: &Scene) {
        // A coarse sample of what is seen is enough to notice a wrong unit or frame.
        let frame = &scene.frame;
        let stride = (frame.depth.as_slice().len() / 4096).max(1);
        let is_object = |r: usize, c: usize| frame.mask.as_ref().is_none_or(|m| m[(r, c)]);
        let points: Vec<Point> = frame
            .depth
            .pixels()
            .filter(|(r, c, z)| z.is_finite() && is_object(*r, *c))
            .step_by(stride)
            .map(|(r, c, &z)| {
                frame.world_from_camera * Point::from(frame.camera.ray(c as f64, r as f64) * f64::from(z))
            })
            .collect();
        for (i, touch) in scene.touches.iter().enumerate() {
            let at = Point::from(touch.world_from_sensor.translation.vector);
            let nearest = points.iter().map(|p| (p - at).norm()).fold(f64::INFINITY, f64::min);
            if nearest.is_finite() && nearest > 0.5 {
                self.warn(format!(
                    "[[touches]] {i}: {nearest:.2} m from the nearest point that the camera sees; is world_from_sensor in metres and in the camera's world?"
                ));
            }
            let Some((contact, sensor)) = touch.contact.as_ref().zip(scene.sensor.as_ref()) else { continue };
            if !contact.mask.as_slice().contains(&true) {
                self.warn(format!("[[touches]] {i}: the contact mask is empty: nothing was touched"));
            }
            // A reconstruction would stop there.
            if let Err(error) = contact.validate(sensor) {
                self.need(false, || format!("[[touches]] {i}: {error}"));
            }
        }
    }
}

type Recorded = (Option<Result<Contact, IoError>>, Option<Result<Raster<[u8; 3]>, IoError>>);

/// The median of the readings, which are reordered.
pub(super) fn median(depth: &mut [f32]) -> Option<f32> {
    let middle = depth.len() / 2;
    (!depth.is_empty()).then(|| *depth.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Says so if a median depth is no distance from which something that a fingertip explores is looked at, metres.
pub(super) fn implausible_median(median: f32) -> Option<String> {
    (!(0.1..=3.0).contains(&median))
        .then(|| format!("the median depth is {median:.4} m; is metres_per_unit right (0.001 and 0.0001 are usual)?"))
}

/// Share of the image border that is marked.
fn border_share(mask: &Raster<bool>) -> f64 {
    let (rows, cols) = mask.shape();
    let border = mask.pixels().filter(|(r, c, _)| *r == 0 || *c == 0 || r + 1 == rows || c + 1 == cols);
    let (marked, all) = border.fold((0, 0), |(marked, all), (_, _, m)| (marked + usize::from(*m), all + 1));
    f64::from(marked as u32) / f64::from(all.max(1) as u32)
}

fn sized_by<T>(
    image: Raster<T>,
    path: &Path,
    needed: [usize; 2],
    needed_by: &'static str,
) -> Result<Raster<T>, IoError> {
    let found = [image.cols(), image.rows()];
    if found == needed { Ok(image) } else { Err(IoError::Size { path: path.to_owned(), found, needed, needed_by }) }
}

fn fits<T>(image: Raster<T>, path: &Path, needed: [usize; 2]) -> Result<Raster<T>, IoError> {
    sized_by(image, path, needed, "[camera]")
}

fn sized<T>(image: Raster<T>, path: &Path, sensor: Option<&TactileSensor>) -> Result<Raster<T>, IoError> {
    match sensor {
        Some(s) => sized_by(image, path, [s.width, s.height], "[sensor]"),
        None => Ok(image),
    }
}

/// A map may be coarser than the sensor, but it spans the pad: the same aspect within a pixel.
fn spans_pad(map: Raster<f32>, path: &Path, sensor: &TactileSensor) -> Result<Raster<f32>, IoError> {
    let (rows, cols) = map.shape();
    let expected = cols as f64 * sensor.height as f64 / sensor.width as f64;
    if (rows as f64 - expected).abs() <= 1.0 {
        return Ok(map);
    }
    Err(IoError::content(
        path,
        format!(
            "the height map is {cols}×{rows} (width × height), the sensor's image {}×{}; the map must span the whole pad",
            sensor.width, sensor.height
        ),
    ))
}
