//! A scene folder that grows while it is being reconstructed.

use super::scene::{Loader, SceneFile, scene_path};
use super::scene_format::{self, SensorToml};
use super::{IoError, read_text};
use crate::tactile::{TactileSensor, Touch};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Watches `scene.toml` for touches that are added at its end, as [`super::SceneAppender`] does.
#[derive(Debug)]
pub struct SceneFollower {
    file: PathBuf,
    text: String,
    touches: usize,
    sensor: Option<TactileSensor>,
    has_background: bool,
    /// Of the file when it was last understood: when it was changed, and its length.
    stamp: Option<(SystemTime, u64)>,
    /// A text that could not be read: a second look shows whether someone was still writing.
    doubtful: Option<String>,
}

/// What happened to a scene since the last look.
#[derive(Debug)]
#[non_exhaustive]
pub enum SceneChange {
    /// Nothing.
    None,
    /// These touches were added.
    Touches(Vec<Touch>),
    /// Something else was changed, or a touch was removed: the scene as it is now.
    Rewritten(Box<SceneFile>),
}

impl SceneFollower {
    /// Reads a scene and begins to follow it.
    ///
    /// # Errors
    /// As [`super::read_scene`].
    pub fn open(folder: impl AsRef<Path>) -> Result<(SceneFile, Self), IoError> {
        let file = scene_path(folder.as_ref());
        let stamp = stamp(&file);
        let text = read_text(&file)?;
        let mut follower = Self {
            file,
            text: String::new(),
            touches: 0,
            sensor: None,
            has_background: false,
            stamp: None,
            doubtful: None,
        };
        let scene = follower.take(text, stamp)?;
        Ok((scene, follower))
    }

    /// Looks whether the scene has changed. Costs one look at the file's date where it has not.
    ///
    /// # Errors
    /// [`IoError`] if the scene cannot be read at two looks in a row; the next call looks again.
    pub fn poll(&mut self) -> Result<SceneChange, IoError> {
        let now = stamp(&self.file);
        if now.is_some() && now == self.stamp {
            return Ok(SceneChange::None);
        }
        let text = read_text(&self.file)?;
        match self.change(text.clone(), now) {
            Ok(change) => Ok(change),
            Err(error) if self.doubtful.as_ref() == Some(&text) => {
                self.doubtful = None;
                Err(error)
            }
            Err(_) => {
                self.doubtful = Some(text);
                Ok(SceneChange::None)
            }
        }
    }

    fn change(&mut self, text: String, stamp: Option<(SystemTime, u64)>) -> Result<SceneChange, IoError> {
        let toml = scene_format::parse(&self.file, &text)?;
        let has_background = has_background(toml.sensor.as_ref());
        let grown = text.starts_with(&self.text)
            && toml.sensor.is_some() == self.sensor.is_some()
            && has_background == self.has_background;
        if !grown {
            return self.take(text, stamp).map(|scene| SceneChange::Rewritten(Box::new(scene)));
        }
        let mut loader = Loader::new(self.file.clone());
        let new = &toml.touches[self.touches.min(toml.touches.len())..];
        let read = loader.touches(new, self.touches, self.sensor.as_ref(), has_background);
        if let Some(error) = loader.errors.into_iter().next() {
            return Err(error);
        }
        let read = read.unwrap_or_default();
        self.touches += read.len();
        (self.text, self.stamp, self.doubtful) = (text, stamp, None);
        Ok(if read.is_empty() { SceneChange::None } else { SceneChange::Touches(read) })
    }

    /// The whole scene, from now on the one that is followed.
    fn take(&mut self, text: String, stamp: Option<(SystemTime, u64)>) -> Result<SceneFile, IoError> {
        let mut loader = Loader::new(self.file.clone());
        let scene = loader.load(&text, false);
        if let Some(error) = loader.errors.into_iter().next() {
            return Err(error);
        }
        let mut scene = scene.expect("a scene without errors was read");
        scene.warnings = loader.warnings;
        self.touches = scene.scene.touches.len();
        self.sensor.clone_from(&scene.scene.sensor);
        self.has_background = scene.tactile_background.is_some();
        (self.text, self.stamp, self.doubtful) = (text, stamp, None);
        Ok(scene)
    }
}

fn has_background(sensor: Option<&SensorToml>) -> bool {
    sensor.is_some_and(|s| s.background.is_some())
}

fn stamp(file: &Path) -> Option<(SystemTime, u64)> {
    let data = fs::metadata(file).ok()?;
    Some((data.modified().ok()?, data.len()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Isometry, Raster};
    use crate::io::{SceneAppender, write_depth_png};

    const SCENE: &str = "format = 1\nname = \"s\"\n[camera]\nwidth = 16\nheight = 12\nfx = 20.0\nfy = 20.0\ncx = 7.5\ncy = 5.5\n\
        [depth]\nfile = \"d.png\"\nmetres_per_unit = 0.001\nbackground = \"unknown\"\n";

    fn scene(sensor: &str) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("temporary folder");
        write_depth_png(folder.path().join("d.png"), &Raster::filled(12, 16, 0.5), 0.001).expect("written");
        std::fs::write(folder.path().join("scene.toml"), format!("{SCENE}{sensor}")).expect("written");
        folder
    }

    fn image(v: u8) -> Raster<[u8; 3]> {
        Raster::filled(240, 320, [v, 90, 120])
    }

    #[test]
    fn added_touches_come_once_and_in_order() {
        let folder = scene("[sensor]\nmodel = \"gelsight-mini\"\n");
        let (file, mut follower) = SceneFollower::open(folder.path()).expect("a scene");
        assert!(file.scene.touches.is_empty());
        assert!(matches!(follower.poll().expect("read"), SceneChange::None));
        let mut writer = SceneAppender::open(folder.path()).expect("a scene");
        for v in [1, 2] {
            writer.add_touch(&image(v), &Isometry::translation(0.1, f64::from(v), 0.0)).expect("added");
        }
        let SceneChange::Touches(new) = follower.poll().expect("read") else { panic!("two touches were added") };
        let seen: Vec<u8> = new.iter().map(|t| t.image.as_ref().expect("an image")[(0, 0)][0]).collect();
        assert_eq!(seen, [1, 2]);
        assert!(matches!(follower.poll().expect("read"), SceneChange::None));
        writer.add_touch(&image(3), &Isometry::identity()).expect("added");
        assert!(matches!(follower.poll().expect("read"), SceneChange::Touches(t) if t.len() == 1));
    }

    #[test]
    fn another_change_is_a_new_scene() {
        let folder = scene("");
        let (_, mut follower) = SceneFollower::open(folder.path()).expect("a scene");
        let sensor = TactileSensor::preset("gelsight-mini").expect("listed");
        SceneAppender::open(folder.path()).expect("a scene").add_sensor(&sensor, &image(9)).expect("added");
        let SceneChange::Rewritten(file) = follower.poll().expect("read") else { panic!("there is a sensor now") };
        assert!(file.scene.sensor.is_some() && file.tactile_background.is_some());
        std::fs::write(folder.path().join("scene.toml"), SCENE.replace("\"s\"", "\"t\"")).expect("written");
        let SceneChange::Rewritten(file) = follower.poll().expect("read") else { panic!("it has another name") };
        assert_eq!(file.scene.name, "t");
    }

    #[test]
    fn a_file_being_written_is_looked_at_twice() {
        let folder = scene("[sensor]\nmodel = \"gelsight-mini\"\n");
        let (_, mut follower) = SceneFollower::open(folder.path()).expect("a scene");
        let toml = folder.path().join("scene.toml");
        let whole = std::fs::read_to_string(&toml).expect("there");
        std::fs::write(&toml, format!("{whole}[[touches]]\nimage = \"0.p")).expect("written");
        assert!(matches!(follower.poll().expect("patient"), SceneChange::None));
        let error = follower.poll().expect_err("still broken").to_string();
        assert!(error.contains("scene.toml"), "{error}");
        std::fs::write(&toml, whole).expect("written");
        assert!(matches!(follower.poll().expect("whole again"), SceneChange::None));
    }
}
