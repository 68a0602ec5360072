//! Tactile images with truth: a press data set, or objects in the layout of YCB-Sight.

use anyhow::{Context as _, bail};
use palpate::geometry::Raster;
use palpate::io::{PressSet, read_color, read_ycb_sight_press};
use palpate::tactile::{Contact, TactileSensor};
use std::path::{Path, PathBuf};

/// A data set, opened.
pub(super) struct Dataset {
    pub(super) presses: Vec<Press>,
    pub(super) sensor: TactileSensor,
    pub(super) background: Raster<[u8; 3]>,
    source: Source,
}

/// One image, not yet loaded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Press {
    pub(super) object: String,
    /// Name within the data set.
    pub(super) name: String,
    place: usize,
}

enum Source {
    Set(Box<PressSet>),
    /// Folders of the objects, by place.
    Objects(Vec<PathBuf>),
}

impl Dataset {
    /// Opens a folder; `background` is used instead of the data set's own no-contact image.
    pub(super) fn open(folder: &Path, background: Option<&Path>) -> anyhow::Result<Self> {
        let given = background.map(read_color).transpose()?;
        if folder.join("set.json").is_file() {
            let set = PressSet::open(folder)?;
            let press = |i: usize| {
                let record = set.record(i);
                Press { object: record.object.clone(), name: format!("{:06}", record.index), place: i }
            };
            let presses = (0..set.len()).map(press).collect();
            let background = given.unwrap_or_else(|| set.background().clone());
            return Ok(Self { presses, sensor: set.sensor().clone(), background, source: Source::Set(Box::new(set)) });
        }
        let folders = object_folders(folder)?;
        if folders.is_empty() {
            bail!(
                "{} is no press data set (no set.json), and no folder in it has images in gelsight/ (the YCB-Sight layout)",
                folder.display()
            );
        }
        let background = match given {
            Some(background) => background,
            None => own_background(folder)?,
        };
        let mut presses = Vec::new();
        for (place, object) in folders.iter().enumerate() {
            let name = object.file_name().unwrap_or_default().to_string_lossy().into_owned();
            presses.extend(stems(object)?.into_iter().map(|stem| Press { object: name.clone(), name: stem, place }));
        }
        Ok(Self { presses, sensor: TactileSensor::preset("ycb-sight")?, background, source: Source::Objects(folders) })
    }

    /// Image and truth of a press.
    pub(super) fn load(&self, press: &Press) -> anyhow::Result<(Raster<[u8; 3]>, Contact)> {
        match &self.source {
            Source::Set(set) => {
                let sample = set.sample(press.place)?;
                Ok((sample.image, sample.contact))
            }
            Source::Objects(folders) => {
                let touch = read_ycb_sight_press(&folders[press.place], &press.name)?;
                let image = touch.image.with_context(|| format!("there is no gelsight/{}.jpg", press.name))?;
                Ok((image, touch.contact.context("there is no height map")?))
            }
        }
    }
}

/// Folders below (or the folder itself) that hold tactile images, sorted.
fn object_folders(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("reading the data set {}", folder.display()))?;
    let mut folders = entries.map(|e| Ok(e?.path())).collect::<anyhow::Result<Vec<_>>>()?;
    folders.push(folder.to_owned());
    folders.retain(|f| f.join("gelsight").is_dir());
    folders.sort();
    Ok(folders)
}

/// Names of the images of an object, numbers in their order.
fn stems(object: &Path) -> anyhow::Result<Vec<String>> {
    let folder = object.join("gelsight");
    let entries = std::fs::read_dir(&folder).with_context(|| format!("reading {}", folder.display()))?;
    let mut stems = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path.extension().is_some_and(|e| e == "jpg") {
            stems.extend(path.file_stem().map(|s| s.to_string_lossy().into_owned()));
        }
    }
    stems.sort_by_key(|stem| (stem.parse::<u64>().unwrap_or(u64::MAX), stem.clone()));
    Ok(stems)
}

fn own_background(folder: &Path) -> anyhow::Result<Raster<[u8; 3]>> {
    let names = ["background.png", "background.jpg", "bg.jpg", "bg.png"];
    match names.iter().map(|name| folder.join(name)).find(|path| path.is_file()) {
        Some(path) => Ok(read_color(path)?),
        None => {
            bail!("{} has no no-contact image ({}); give one with --background", folder.display(), names.join(", "))
        }
    }
}
