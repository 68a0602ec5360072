use super::DataError;
use palpate::geometry::Raster;
use palpate::tactile::TactileSensor;

/// One press: what the sensor saw, and the truth. All three rasters have the same size.
#[derive(Debug, Clone, PartialEq)]
pub struct PressSample {
    /// Tactile image, sRGB.
    pub image: Raster<[u8; 3]>,
    /// z of the gel in the sensor frame, metres, ≤ 0.
    pub height_map: Raster<f32>,
    /// True where the object touches.
    pub mask: Raster<bool>,
}

/// A set of presses of one sensor. Samples are loaded when asked for.
pub trait Samples: Sync {
    /// Name for messages: the folder, if it is one.
    fn name(&self) -> String;

    /// Number of presses.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Name of the object of press `index`, such as `004_sugar_box` or `primitive:sphere`.
    fn object(&self, index: usize) -> &str;

    /// Loads press `index`.
    ///
    /// # Errors
    /// [`DataError::Io`] if a file cannot be read.
    fn load(&self, index: usize) -> Result<PressSample, DataError>;

    /// Image of the gel that nothing touches, sRGB, of the size of the samples.
    fn background(&self) -> &Raster<[u8; 3]>;

    /// The sensor.
    fn sensor(&self) -> &TactileSensor;
}

/// Presses held in memory.
#[derive(Debug, Clone)]
pub struct MemorySamples {
    /// The sensor.
    pub sensor: TactileSensor,
    /// Image without contact.
    pub background: Raster<[u8; 3]>,
    /// Object and press.
    pub presses: Vec<(String, PressSample)>,
}

impl Samples for MemorySamples {
    fn name(&self) -> String {
        "in memory".to_owned()
    }

    fn len(&self) -> usize {
        self.presses.len()
    }

    fn object(&self, index: usize) -> &str {
        &self.presses[index].0
    }

    fn load(&self, index: usize) -> Result<PressSample, DataError> {
        Ok(self.presses[index].1.clone())
    }

    fn background(&self) -> &Raster<[u8; 3]> {
        &self.background
    }

    fn sensor(&self) -> &TactileSensor {
        &self.sensor
    }
}
