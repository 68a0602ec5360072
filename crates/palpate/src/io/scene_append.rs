//! Touches added to a scene folder while it is being recorded.

use super::scene_format::{self, PoseToml, SceneToml};
use super::{IoError, atomic_write, create_folder, read_text, write_color};
use crate::geometry::{Isometry, Raster};
use crate::tactile::TactileSensor;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// A scene folder that touches are added to. `scene.toml` is only ever replaced by a longer one that was read back first: an interruption at any
/// moment leaves the scene as it was or with the touch complete.
#[derive(Debug)]
pub struct SceneAppender {
    folder: PathBuf,
    touches: usize,
    /// Width and height of the sensor's images; `None` without a sensor.
    size: Option<[usize; 2]>,
    /// The no-contact image of the sensor.
    background: Option<PathBuf>,
    world_from_camera: Isometry,
}

impl SceneAppender {
    /// Opens a scene that exists.
    ///
    /// # Errors
    /// [`IoError`] if there is none, or it is not understood.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self, IoError> {
        let folder = folder.as_ref().to_owned();
        let scene = parse(&folder)?.1;
        let background = scene.sensor.as_ref().and_then(|s| s.background.as_ref()).map(|file| folder.join(file));
        let size = scene.sensor.as_ref().map(|s| {
            let preset = TactileSensor::preset(&s.model).map_or([0, 0], |p| [p.width, p.height]);
            [s.width.unwrap_or(preset[0]), s.height.unwrap_or(preset[1])]
        });
        let pose = scene.camera.world_from_camera.as_ref().map(PoseToml::isometry).transpose();
        let pose = pose.map_err(|reason| IoError::Scene {
            path: folder.join("scene.toml"),
            reason: format!("[camera] world_from_camera: {reason}"),
        })?;
        let world_from_camera = pose.map_or_else(Isometry::identity, |p| p.0);
        Ok(Self { folder, touches: scene.touches.len(), size, background, world_from_camera })
    }

    /// Where the scene's camera stands; the identity if nothing is said.
    pub fn world_from_camera(&self) -> Isometry {
        self.world_from_camera
    }

    /// Touches that the scene has.
    pub fn touches(&self) -> usize {
        self.touches
    }

    /// Whether the scene names a sensor.
    pub fn has_sensor(&self) -> bool {
        self.size.is_some()
    }

    /// Whether the scene has a no-contact image.
    pub fn has_background(&self) -> bool {
        self.background.is_some()
    }

    /// The scene's no-contact image: what its images are decoded against.
    pub fn background(&self) -> Option<&Path> {
        self.background.as_deref()
    }

    /// Names the sensor of a scene that has none, with its no-contact image.
    ///
    /// # Errors
    /// As [`Self::add_touch`]; [`IoError::Content`] if there is a sensor already.
    pub fn add_sensor(&mut self, sensor: &TactileSensor, background: &Raster<[u8; 3]>) -> Result<(), IoError> {
        if self.has_sensor() {
            return Err(IoError::content(&self.folder.join("scene.toml"), "[sensor] is already there"));
        }
        let size = [sensor.width, sensor.height];
        self.check_size("touches/background.png", background, Some(size))?;
        create_folder(self.folder.join("touches"))?;
        write_color(self.folder.join("touches/background.png"), background)?;
        let preset = TactileSensor::preset(&sensor.model).is_ok_and(|p| p == *sensor);
        let mut text = format!("\n[sensor]\nmodel = \"{}\"\n", if preset { &sensor.model } else { "custom" });
        if !preset {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "width = {}\nheight = {}\npixel_pitch = {:?}",
                sensor.width, sensor.height, sensor.pixel_pitch
            );
        }
        text.push_str("background = \"touches/background.png\"\n");
        self.append(&text)?;
        (self.size, self.background) = (Some(size), Some(self.folder.join("touches/background.png")));
        Ok(())
    }

    /// Adds a touch: its image first, then `scene.toml`. Returns the image's path.
    ///
    /// # Errors
    /// [`IoError`] if something cannot be written, or the scene was changed into one that is not understood.
    pub fn add_touch(&mut self, image: &Raster<[u8; 3]>, world_from_sensor: &Isometry) -> Result<PathBuf, IoError> {
        create_folder(self.folder.join("touches"))?;
        // Someone else may have put files there.
        let free = (self.touches..self.touches + 100_000)
            .map(|i| format!("touches/{i:03}.png"))
            .find(|f| !self.folder.join(f).exists());
        let file = free.unwrap_or_else(|| format!("touches/{:03}.png", self.touches));
        self.check_size(&file, image, self.size)?;
        write_color(self.folder.join(&file), image)?;
        let pose = PoseToml::from(world_from_sensor).text();
        self.append(&format!("\n[[touches]]\nimage = \"{file}\"\nworld_from_sensor = {pose}\n"))?;
        self.touches += 1;
        Ok(self.folder.join(file))
    }

    /// A scene with an image of another size could not be read any more.
    fn check_size(&self, file: &str, image: &Raster<[u8; 3]>, needed: Option<[usize; 2]>) -> Result<(), IoError> {
        let found = [image.cols(), image.rows()];
        match needed {
            Some(needed) if needed != found => {
                Err(IoError::Size { path: self.folder.join(file), found, needed, needed_by: "[sensor]" })
            }
            _ => Ok(()),
        }
    }

    fn append(&self, block: &str) -> Result<(), IoError> {
        let path = self.folder.join("scene.toml");
        let (mut text, _) = parse(&self.folder)?;
        if !text.ends_with('\n') {
            text.push('\n');
        }
        text.push_str(block);
        scene_format::parse(&path, &text)?;
        atomic_write(&path, |w| w.write_all(text.as_bytes()))
    }
}

fn parse(folder: &Path) -> Result<(String, SceneToml), IoError> {
    let path = folder.join("scene.toml");
    let text = read_text(&path)?;
    let scene = scene_format::parse(&path, &text)?;
    Ok((text, scene))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Background, PinholeCamera};
    use crate::io::{NewScene, init_scene, read_scene, write_depth_png};

    fn scene() -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("temporary folder");
        let depth = folder.path().join("d.png");
        write_depth_png(&depth, &Raster::filled(12, 16, 0.5), 0.001).expect("written");
        let intrinsics =
            PinholeCamera { width: 1, height: 1, fx: 20.0, fy: 20.0, cx: 7.5, cy: 5.5, distortion: [0.0; 5] };
        let new = NewScene {
            depth,
            intrinsics,
            world_from_camera: Some(Isometry::translation(0.0, 0.0, -0.5)),
            color: None,
            mask: None,
            metres_per_unit: 0.001,
            background: Background::Unknown,
            overwrite: false,
        };
        init_scene(folder.path().join("s"), &new).expect("made");
        folder
    }

    #[test]
    fn touches_are_added_behind_what_is_there() {
        let folder = scene();
        let path = folder.path().join("s");
        let toml = path.join("scene.toml");
        let remark = "# measured by hand\n";
        std::fs::write(&toml, std::fs::read_to_string(&toml).expect("there") + remark).expect("written");
        let sensor = TactileSensor { pixel_pitch: 8e-5, ..TactileSensor::preset("gelsight-mini").expect("listed") };
        let image = |v| Raster::filled(240, 320, [v, 90, 120]);
        let mut scene = SceneAppender::open(&path).expect("a scene");
        assert!(!scene.has_sensor());
        scene.add_sensor(&sensor, &image(1)).expect("added");
        let pose = Isometry::translation(0.1, 0.2, 0.3);
        scene.add_touch(&image(2), &pose).expect("added");
        // Opened anew, as after a restart; and a file in the way.
        std::fs::write(path.join("touches/001.png"), "mine").expect("written");
        let mut scene = SceneAppender::open(&path).expect("a scene");
        assert_eq!((scene.touches(), scene.has_sensor(), scene.has_background()), (1, true, true));
        let second = scene.add_touch(&image(3), &pose).expect("added");
        assert!(second.ends_with("touches/002.png"), "{}", second.display());
        let read = read_scene(&path).expect("valid").scene;
        assert_eq!(read.touches.len(), 2);
        assert_eq!(read.sensor.expect("added").pixel_pitch, 8e-5);
        assert_eq!(read.touches[1].image.as_ref().expect("an image")[(0, 0)], [3, 90, 120]);
        assert_eq!(read.touches[0].world_from_sensor.translation, pose.translation);
        assert_eq!(read.frame.world_from_camera.translation.z, -0.5);
        assert!(std::fs::read_to_string(&toml).expect("there").contains(remark));
    }

    #[test]
    fn a_scene_that_is_none_is_an_error_and_stays() {
        let folder = scene();
        let missing = SceneAppender::open(folder.path().join("t")).expect_err("none").to_string();
        assert!(missing.contains("scene.toml"), "{missing}");
        let path = folder.path().join("s");
        let mut scene = SceneAppender::open(&path).expect("a scene");
        std::fs::write(path.join("scene.toml"), "format = 1\nbroken").expect("written");
        let error = scene.add_touch(&Raster::filled(2, 2, [0; 3]), &Isometry::identity()).expect_err("broken");
        assert!(error.to_string().contains("scene.toml"), "{error}");
        assert!(!path.join("touches/001.png").exists());
        assert_eq!(std::fs::read_to_string(path.join("scene.toml")).expect("there"), "format = 1\nbroken");
    }
}
