use super::{DataError, PressSample, Samples};
use palpate::geometry::Raster;
use palpate::io::PressSet;
use palpate::tactile::TactileSensor;
use std::path::Path;

/// A press data set on disk.
#[derive(Debug)]
pub struct PressFolder {
    set: PressSet,
    name: String,
}

impl PressFolder {
    /// * `folder` – of the set, for messages
    pub fn new(set: PressSet, folder: &Path) -> Self {
        Self { set, name: folder.display().to_string() }
    }
}

impl Samples for PressFolder {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn len(&self) -> usize {
        self.set.len()
    }

    fn object(&self, index: usize) -> &str {
        &self.set.record(index).object
    }

    fn load(&self, index: usize) -> Result<PressSample, DataError> {
        let sample = self.set.sample(index)?;
        Ok(PressSample { image: sample.image, height_map: sample.contact.height_map, mask: sample.contact.mask })
    }

    fn background(&self) -> &Raster<[u8; 3]> {
        self.set.background()
    }

    fn sensor(&self) -> &TactileSensor {
        self.set.sensor()
    }
}
