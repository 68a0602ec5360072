//! A camera by itself: the table `[camera]` of a scene in a file of its own, as calibration writes it.

use super::scene_format::{CameraToml, PoseToml};
use super::{IoError, atomic_write, read_text};
use crate::camera::PinholeCamera;
use crate::geometry::Isometry;
use serde::Deserialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// A camera and where it stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraFile {
    /// The camera.
    pub camera: PinholeCamera,
    /// Its pose, if known.
    pub world_from_camera: Option<Isometry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Toml {
    camera: CameraToml,
    /// How it was found: for people.
    #[serde(rename = "calibration")]
    _calibration: Option<toml::Table>,
}

/// Reads a camera file.
///
/// # Errors
/// [`IoError::Read`], or [`IoError::Scene`] for a wrong key or a camera that cannot be.
pub fn read_camera(path: impl AsRef<Path>) -> Result<CameraFile, IoError> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let wrong = |reason: String| IoError::Scene { path: path.to_owned(), reason };
    let toml: Toml = toml::from_str(&text).map_err(|e| wrong(e.to_string().trim_end().to_owned()))?;
    let c = toml.camera;
    let camera = c.camera();
    camera.validate().map_err(|e| wrong(format!("[camera] {e}")))?;
    let pose = c.world_from_camera.map(|p| p.isometry()).transpose();
    let pose = pose.map_err(|e| wrong(format!("[camera] world_from_camera: {e}")))?;
    Ok(CameraFile { camera, world_from_camera: pose.map(|p| p.0) })
}

/// Writes a camera file.
///
/// * `calibration` – the table `[calibration]`: what is said about how it was found
///
/// # Errors
/// As [`atomic_write`].
pub fn write_camera(path: impl AsRef<Path>, file: &CameraFile, calibration: &toml::Table) -> Result<(), IoError> {
    let mut text = String::new();
    let c = &file.camera;
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "[camera]\nwidth = {}\nheight = {}\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\ndistortion = {:?}",
        c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.distortion
    );
    if let Some(pose) = &file.world_from_camera {
        let _ = writeln!(text, "world_from_camera = {}", PoseToml::from(pose).text());
    }
    if !calibration.is_empty() {
        let _ = write!(text, "\n[calibration]\n{calibration}");
    }
    atomic_write(path, |w| w.write_all(text.as_bytes()))
}

/// A pose from its numbers; the quaternion may be rounded.
///
/// # Errors
/// What is wrong with the numbers.
pub fn pose(translation: [f64; 3], quaternion_xyzw: [f64; 4]) -> Result<Isometry, String> {
    PoseToml { translation, quaternion_xyzw }.isometry().map(|p| p.0)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ExtrinsicsToml {
    color_from_depth: PoseToml,
    #[serde(rename = "calibration")]
    _calibration: Option<toml::Table>,
}

/// Reads how a depth and a colour camera are mounted: `color_from_depth`.
///
/// # Errors
/// [`IoError::Read`], or [`IoError::Scene`] for a wrong key or a pose that cannot be.
pub fn read_extrinsics(path: impl AsRef<Path>) -> Result<Isometry, IoError> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let wrong = |reason: String| IoError::Scene { path: path.to_owned(), reason };
    let toml: ExtrinsicsToml = toml::from_str(&text).map_err(|e| wrong(e.to_string().trim_end().to_owned()))?;
    toml.color_from_depth.isometry().map(|p| p.0).map_err(|e| wrong(format!("color_from_depth: {e}")))
}

/// Writes how a depth and a colour camera are mounted.
///
/// * `rms_px` – of the corners
/// * `sigma` – one standard deviation per axis, metres and radians
///
/// # Errors
/// As [`atomic_write`].
pub fn write_extrinsics(
    path: impl AsRef<Path>,
    color_from_depth: &Isometry,
    rms_px: f64,
    (translation, rotation): ([f64; 3], [f64; 3]),
) -> Result<(), IoError> {
    let pose = PoseToml::from(color_from_depth).text();
    let text = format!(
        "color_from_depth = {pose}\n\n[calibration]\nrms_px = {rms_px:?}\nstandard_deviation_translation_m = {translation:?}\n\
         standard_deviation_rotation_rad = {rotation:?}\n"
    );
    atomic_write(path, |w| w.write_all(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_survives_writing_and_reading() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("camera.toml");
        let distortion = [-0.28, 0.04, 0.001, -0.0003, 0.127];
        let camera = PinholeCamera { width: 640, height: 480, fx: 532.8, fy: 532.9, cx: 341.7, cy: 234.1, distortion };
        let pose = Isometry::new(nalgebra::Vector3::new(0.1, -0.2, 0.7), nalgebra::Vector3::new(2.0, 0.1, 0.3));
        let mut table = toml::Table::new();
        table.insert("rms_px".into(), 0.198.into());
        write_camera(&path, &CameraFile { camera, world_from_camera: Some(pose) }, &table).expect("written");
        let back = read_camera(&path).expect("read");
        assert_eq!(back.camera, camera);
        let off = back.world_from_camera.expect("written") * pose.inverse();
        assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-7);
    }

    #[test]
    fn wrong_keys_and_impossible_cameras_name_what_is_wrong() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("camera.toml");
        for (text, said) in [
            ("[camera]\nwidth = 6\nheight = 4\nfx = 1.0\nfy = 1.0\ncx = 3.0\ncy = 2.0\nf = 3", "unknown field `f`"),
            ("[camera]\nwidth = 6\nheight = 4\nfx = -1.0\nfy = 1.0\ncx = 3.0\ncy = 2.0", "fx is -1"),
            ("", "missing field `camera`"),
        ] {
            std::fs::write(&path, text).expect("written");
            let error = read_camera(&path).expect_err("wrong").to_string();
            assert!(error.contains(said) && error.contains("camera.toml"), "{error}");
        }
    }
}
