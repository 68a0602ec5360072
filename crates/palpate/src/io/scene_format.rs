//! `scene.toml`, format 1: its keys as they stand in the file, and the text of a new one.

use super::IoError;
use crate::camera::PinholeCamera;
use crate::geometry::Isometry;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::Deserialize;
use std::fmt::Write as _;
use std::path::Path;

/// The only format so far.
const FORMAT: i64 = 1;

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneToml {
    /// Checked before everything else by [`parse`].
    #[serde(rename = "format")]
    _format: i64,
    pub(super) name: String,
    pub(super) camera: CameraToml,
    pub(super) depth: DepthToml,
    pub(super) color: Option<FileToml>,
    pub(super) mask: Option<FileToml>,
    pub(super) support: Option<SupportToml>,
    pub(super) sensor: Option<SensorToml>,
    #[serde(default)]
    pub(super) touches: Vec<TouchToml>,
    pub(super) truth: Option<TruthToml>,
}

impl SceneToml {
    /// A scene without anything optional.
    pub(super) fn new(name: String, camera: CameraToml, depth: DepthToml) -> Self {
        Self {
            _format: FORMAT,
            name,
            camera,
            depth,
            color: None,
            mask: None,
            support: None,
            sensor: None,
            touches: Vec::new(),
            truth: None,
        }
    }
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraToml {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) fx: f64,
    pub(super) fy: f64,
    pub(super) cx: f64,
    pub(super) cy: f64,
    #[serde(default)]
    pub(super) distortion: [f64; 5],
    pub(super) world_from_camera: Option<PoseToml>,
}

impl CameraToml {
    /// The camera, not validated.
    pub(super) fn camera(&self) -> PinholeCamera {
        let Self { width, height, fx, fy, cx, cy, distortion, .. } = *self;
        PinholeCamera { width, height, fx, fy, cx, cy, distortion }
    }
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PoseToml {
    pub(super) translation: [f64; 3],
    pub(super) quaternion_xyzw: [f64; 4],
}

impl From<&Isometry> for PoseToml {
    fn from(a_from_b: &Isometry) -> Self {
        let q = a_from_b.rotation.coords;
        let positive = if q.w < 0.0 { -1.0 } else { 1.0 };
        // Adding 0 turns −0 into 0.
        Self {
            translation: a_from_b.translation.vector.into(),
            quaternion_xyzw: [q.x, q.y, q.z, q.w].map(|c| c * positive + 0.0),
        }
    }
}

impl PoseToml {
    /// The rigid motion, and the quaternion's length if that is not 1 within rounding.
    ///
    /// A length between 0.1 and 10 is a hand-written or badly rounded quaternion; anything else is no rotation.
    pub(super) fn isometry(&self) -> Result<(Isometry, Option<f64>), String> {
        let [x, y, z, w] = self.quaternion_xyzw;
        if let Some(t) = self.translation.iter().find(|t| !t.is_finite()) {
            return Err(format!("translation holds {t}; finite metres are needed"));
        }
        let q = Quaternion::new(w, x, y, z);
        let length = q.norm();
        if !(0.1..=10.0).contains(&length) {
            return Err(format!(
                "quaternion_xyzw = [{x}, {y}, {z}, {w}] has the length {length}; a rotation needs length 1"
            ));
        }
        let [a, b, c] = self.translation;
        let isometry = Isometry::from_parts(Translation3::new(a, b, c), UnitQuaternion::from_quaternion(q));
        Ok((isometry, ((length - 1.0).abs() > 1e-3).then_some(length)))
    }

    pub(super) fn text(&self) -> String {
        format!("{{ translation = {:?}, quaternion_xyzw = {:?} }}", self.translation, self.quaternion_xyzw)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum BackgroundToml {
    Absent,
    Unknown,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DepthToml {
    pub(super) file: String,
    pub(super) metres_per_unit: f64,
    /// A pixel without a reading proves nothing unless the recorder says that it does.
    #[serde(default = "unknown")]
    pub(super) background: BackgroundToml,
    /// Both 0: not stated.
    #[serde(default)]
    pub(super) sigma: f64,
    #[serde(default)]
    pub(super) sigma_quadratic: f64,
}

fn unknown() -> BackgroundToml {
    BackgroundToml::Unknown
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FileToml {
    pub(super) file: String,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SupportToml {
    pub(super) normal: [f64; 3],
    pub(super) offset: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SensorToml {
    pub(super) model: String,
    pub(super) background: Option<String>,
    pub(super) width: Option<usize>,
    pub(super) height: Option<usize>,
    pub(super) pixel_pitch: Option<f64>,
    pub(super) relaxed_gel: Option<String>,
    #[serde(default)]
    pub(super) pose_sigma: PoseSigmaToml,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PoseSigmaToml {
    #[serde(default)]
    pub(super) translation: f64,
    #[serde(default)]
    pub(super) rotation: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TouchToml {
    pub(super) image: Option<String>,
    pub(super) height_map: Option<String>,
    pub(super) contact_mask: Option<String>,
    pub(super) world_from_sensor: PoseToml,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TruthToml {
    pub(super) mesh: String,
}

/// Reads the text of `path`. An unknown key, a missing one or a wrong type is an error that names it with its line.
pub(super) fn parse(path: &Path, text: &str) -> Result<SceneToml, IoError> {
    let wrong = |reason: String| IoError::Scene { path: path.to_owned(), reason };
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| wrong(e.to_string().trim_end().to_owned()))?;
    match table.get("format") {
        Some(toml::Value::Integer(FORMAT)) => {}
        Some(other) => return Err(wrong(format!("format = {other}; this version reads format = {FORMAT}"))),
        None => return Err(wrong(format!("the key 'format' is missing; this version reads format = {FORMAT}"))),
    }
    toml::from_str(text).map_err(|e| wrong(e.to_string().trim_end().to_owned()))
}

/// The text of a scene file.
pub(super) fn text(scene: &SceneToml) -> String {
    let mut t = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut t, scene);
    t
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn write_text(t: &mut String, scene: &SceneToml) -> std::fmt::Result {
    let camera = &scene.camera;
    writeln!(t, "format = {FORMAT}\nname = {}\n", quoted(&scene.name))?;
    writeln!(t, "[camera]\nwidth = {}\nheight = {}", camera.width, camera.height)?;
    writeln!(t, "fx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}", camera.fx, camera.fy, camera.cx, camera.cy)?;
    if camera.distortion != [0.0; 5] {
        writeln!(t, "distortion = {:?}", camera.distortion)?;
    }
    if let Some(pose) = &camera.world_from_camera {
        writeln!(t, "world_from_camera = {}", pose.text())?;
    }
    let depth = &scene.depth;
    writeln!(t, "\n[depth]\nfile = {}\nmetres_per_unit = {:?}", quoted(&depth.file), depth.metres_per_unit)?;
    let background = if depth.background == BackgroundToml::Absent { "absent" } else { "unknown" };
    writeln!(t, "background = \"{background}\"")?;
    if depth.sigma != 0.0 || depth.sigma_quadratic != 0.0 {
        writeln!(t, "sigma = {:?}\nsigma_quadratic = {:?}", depth.sigma, depth.sigma_quadratic)?;
    }
    for (key, file) in [("color", &scene.color), ("mask", &scene.mask)] {
        if let Some(file) = file {
            writeln!(t, "\n[{key}]\nfile = {}", quoted(&file.file))?;
        }
    }
    if let Some(support) = &scene.support {
        writeln!(t, "\n[support]\nnormal = {:?}\noffset = {:?}", support.normal, support.offset)?;
    }
    if let Some(sensor) = &scene.sensor {
        writeln!(t, "\n[sensor]\nmodel = {}", quoted(&sensor.model))?;
        if let Some(background) = &sensor.background {
            writeln!(t, "background = {}", quoted(background))?;
        }
        for (key, value) in [("width", sensor.width), ("height", sensor.height)] {
            if let Some(value) = value {
                writeln!(t, "{key} = {value}")?;
            }
        }
        if let Some(pitch) = sensor.pixel_pitch {
            writeln!(t, "pixel_pitch = {pitch:?}")?;
        }
        if let Some(relaxed) = &sensor.relaxed_gel {
            writeln!(t, "relaxed_gel = {}", quoted(relaxed))?;
        }
        let sigma = sensor.pose_sigma;
        writeln!(t, "pose_sigma = {{ translation = {:?}, rotation = {:?} }}", sigma.translation, sigma.rotation)?;
    }
    for touch in &scene.touches {
        writeln!(t, "\n[[touches]]")?;
        let files = [("image", &touch.image), ("height_map", &touch.height_map), ("contact_mask", &touch.contact_mask)];
        for (key, file) in files {
            if let Some(file) = file {
                writeln!(t, "{key} = {}", quoted(file))?;
            }
        }
        writeln!(t, "world_from_sensor = {}", touch.world_from_sensor.text())?;
    }
    if let Some(truth) = &scene.truth {
        writeln!(t, "\n[truth]\nmesh = {}", quoted(&truth.mesh))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) const EXAMPLE: &str = r#"
format = 1
name = "mustard \"bottle\""
[camera]
width = 640
height = 480
fx = 554.26
fy = 554
cx = 319.5
cy = 239.5
distortion = [0.1, 0.0, 0.0, 0.0, 0.0]
world_from_camera = { translation = [0.5, 0, 0.5], quaternion_xyzw = [-0.6533, -0.6533, 0.2706, 0.2706] }
[depth]
file = "depth.png"
metres_per_unit = 0.0001
background = "absent"
sigma = 0.001
[color]
file = "color.png"
[support]
normal = [0.0, 0.0, 1.0]
offset = 0.0
[sensor]
model = "custom"
width = 640
height = 480
pixel_pitch = 0.0000295
relaxed_gel = "touches/relaxed.npy"
pose_sigma = { translation = 0.001, rotation = 0.1 }
[[touches]]
image = "touches/000.png"
world_from_sensor = { translation = [0.03, 0.01, 0.12], quaternion_xyzw = [1.0, 0.0, 0.0, 0.0] }
[truth]
mesh = "truth.ply"
"#;

    #[test]
    fn the_text_of_a_scene_reads_as_the_same_scene() {
        let path = Path::new("scene.toml");
        let scene = parse(path, EXAMPLE).expect("the documented example");
        let again = parse(path, &text(&scene)).expect("our own text");
        assert_eq!(format!("{scene:?}"), format!("{again:?}"));
        assert_eq!(again.camera.fy, 554.0);
    }

    #[test]
    fn unknown_missing_and_future_keys_are_named() {
        let path = Path::new("folder/scene.toml");
        let error = |from: &str, to: &str| parse(path, &EXAMPLE.replace(from, to)).expect_err(to).to_string();
        let unknown = error("cx = 319.5", "cx = 319.5\nfocal = 1.0");
        assert!(unknown.contains("folder/scene.toml") && unknown.contains("unknown field `focal`"), "{unknown}");
        let missing = error("cx = 319.5\n", "");
        assert!(missing.contains("missing field `cx`"), "{missing}");
        let future = error("format = 1", "format = 2");
        assert!(future.contains("format = 2; this version reads format = 1"), "{future}");
    }

    #[test]
    fn a_pose_survives_and_only_hopeless_quaternions_fail() {
        let axis = nalgebra::Unit::new_normalize(crate::geometry::Vector::new(1.0, 2.0, -0.5));
        let pose = Isometry::from_parts(Translation3::new(0.1, -0.2, 0.3), UnitQuaternion::from_axis_angle(&axis, 4.0));
        let (back, _) = PoseToml::from(&pose).isometry().expect("a rotation");
        assert!(((pose.inverse() * back).to_homogeneous() - nalgebra::Matrix4::identity()).norm() < 1e-12);
        let with = |q| PoseToml { translation: [0.0; 3], quaternion_xyzw: q }.isometry();
        assert_eq!(with([0.0, 0.0, 0.0, 2.0]).expect("long").1, Some(2.0));
        assert_eq!(with([-0.6533, -0.6533, 0.2706, 0.2706]).expect("rounded").1, None);
        for q in [[0.0; 4], [f64::NAN, 0.0, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0, 0.0]] {
            assert!(with(q).is_err(), "{q:?}");
        }
    }
}
