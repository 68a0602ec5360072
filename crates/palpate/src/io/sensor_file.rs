//! A calibrated gel in a file: `sensor.toml` with its no-contact image (and its table) beside it.

use super::lookup_table::read_lookup_table;
use super::{IoError, atomic_write, create_folder, read_color, read_text, write_color, write_npy};
use crate::calibrate::gel::{GelCalibration, GelDecoder, GelMap, SlopeNetwork};
use crate::geometry::Raster;
use crate::tactile::{LookupTable, RelaxedGel, SlopeRegressor, TactileSensor};
use serde::Deserialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Since 2 the map `quadratic` gives the tilt of the normal; in 1 it gave the slope.
const FORMAT: i64 = 2;

/// A calibrated sensor.
#[derive(Debug, Clone)]
pub struct SensorFile {
    /// Size and pitch.
    pub sensor: TactileSensor,
    /// Its no-contact image when it was calibrated.
    pub background: Raster<[u8; 3]>,
    /// From colour to slope.
    pub map: GelMap,
    /// Whether the gel has printed dots.
    pub markers: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Toml {
    format: i64,
    sensor: SensorToml,
    gel: GelToml,
    /// How it was found: for people.
    #[serde(rename = "calibration")]
    _calibration: Option<toml::Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorToml {
    #[serde(rename = "model")]
    _model: String,
    width: usize,
    height: usize,
    pixel_pitch: f64,
    background: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GelToml {
    map: String,
    #[serde(default)]
    markers: bool,
    #[serde(default)]
    weights: Vec<f32>,
    table: Option<String>,
}

impl SensorFile {
    /// Its decoder.
    ///
    /// * `background` – a no-contact image that was taken later, instead of the calibration's
    ///
    /// # Errors
    /// As [`GelDecoder::new`].
    pub fn decoder(&self, background: Option<&Raster<[u8; 3]>>) -> Result<GelDecoder, crate::tactile::DecodeError> {
        GelDecoder::new(self.map.clone(), background.unwrap_or(&self.background), self.markers, &self.sensor)
    }
}

/// Reads a calibrated gel.
///
/// # Errors
/// [`IoError`] that names the file and the key.
pub fn read_sensor(path: impl AsRef<Path>) -> Result<SensorFile, IoError> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let wrong = |reason: String| IoError::Scene { path: path.to_owned(), reason };
    let toml: Toml = toml::from_str(&text).map_err(|e| wrong(e.to_string().trim_end().to_owned()))?;
    if toml.format != FORMAT {
        return Err(wrong(format!("format = {}; this version reads format = {FORMAT}", toml.format)));
    }
    let s = toml.sensor;
    let sensor = TactileSensor {
        model: "custom".to_owned(),
        width: s.width,
        height: s.height,
        pixel_pitch: s.pixel_pitch,
        relaxed_gel: RelaxedGel::Flat,
    };
    sensor.validate().map_err(|e| wrong(format!("[sensor] {e}")))?;
    let beside = |file: &str| path.parent().unwrap_or(Path::new(".")).join(file);
    let within = |key: &str, source: IoError| IoError::InScene {
        scene: path.to_owned(),
        key: key.to_owned(),
        source: Box::new(source),
    };
    let background = read_color(beside(&s.background)).map_err(|e| within("[sensor] background", e))?;
    let found = [background.cols(), background.rows()];
    if found != [s.width, s.height] {
        let path = beside(&s.background);
        return Err(IoError::Size { path, found, needed: [s.width, s.height], needed_by: "[sensor] width and height" });
    }
    let bad_weights =
        || wrong(format!("[gel] weights: {} numbers are not a map '{}'", toml.gel.weights.len(), toml.gel.map));
    let map = match toml.gel.map.as_str() {
        "quadratic" => {
            let (pairs, rest) = toml.gel.weights.as_chunks::<2>();
            let map = SlopeRegressor::from_weights(pairs.to_vec()).filter(|_| rest.is_empty());
            GelMap::Quadratic(map.ok_or_else(bad_weights)?)
        }
        "network" => GelMap::Network(SlopeNetwork::from_weights(toml.gel.weights.clone()).ok_or_else(bad_weights)?),
        "table" => {
            let Some(folder) = &toml.gel.table else {
                return Err(wrong("[gel] map = \"table\" needs table = \"FOLDER\"".to_owned()));
            };
            GelMap::Table(read_lookup_table(beside(folder)).map_err(|e| within("[gel] table", e))?)
        }
        other => return Err(wrong(format!("[gel] map = \"{other}\"; known: quadratic, network, table"))),
    };
    Ok(SensorFile { sensor, background, map, markers: toml.gel.markers })
}

/// Writes a calibrated gel: `NAME.toml`, `NAME_background.png` and, for a table, the folder `NAME_table`. The TOML comes last.
///
/// * `calibration` – the table `[calibration]`: what is said about how it was found
///
/// # Errors
/// As [`atomic_write`].
pub fn write_sensor(path: impl AsRef<Path>, gel: &GelCalibration, calibration: &toml::Table) -> Result<(), IoError> {
    let file = SensorFile {
        sensor: gel.sensor.clone(),
        background: gel.background.clone(),
        map: gel.map.clone(),
        markers: gel.markers,
    };
    write_sensor_file(path.as_ref(), &file, calibration)
}

/// Writes what [`read_sensor`] read, into another folder.
///
/// # Errors
/// As [`atomic_write`].
pub fn copy_sensor(path: impl AsRef<Path>, file: &SensorFile) -> Result<(), IoError> {
    write_sensor_file(path.as_ref(), file, &toml::Table::new())
}

fn write_sensor_file(path: &Path, gel: &SensorFile, calibration: &toml::Table) -> Result<(), IoError> {
    let stem = path.file_stem().map_or_else(|| "sensor".to_owned(), |s| s.to_string_lossy().into_owned());
    let beside = |file: &str| path.parent().unwrap_or(Path::new("")).join(file);
    let background = format!("{stem}_background.png");
    write_color(beside(&background), &gel.background)?;
    let s = &gel.sensor;
    let mut text = format!(
        "format = {FORMAT}\n\n[sensor]\nmodel = \"custom\"\nwidth = {}\nheight = {}\npixel_pitch = {:?}\nbackground = {}\n\n[gel]\n\
         map = \"{}\"\nmarkers = {}\n",
        s.width,
        s.height,
        s.pixel_pitch,
        toml::Value::String(background),
        gel.map.kind().name(),
        gel.markers
    );
    // Writing to a string cannot fail.
    match &gel.map {
        GelMap::Quadratic(regressor) => {
            let _ = writeln!(text, "weights = {:?}", regressor.weights().as_flattened());
        }
        GelMap::Network(network) => {
            let _ = writeln!(text, "weights = {:?}", network.weights());
        }
        GelMap::Table(table) => {
            let folder = format!("{stem}_table");
            write_table(&beside(&folder), table)?;
            let _ = writeln!(text, "table = {}", toml::Value::String(folder));
        }
    }
    if !calibration.is_empty() {
        let _ = write!(text, "\n[calibration]\n{calibration}");
    }
    atomic_write(path, |w| w.write_all(text.as_bytes()))
}

/// In the layout of the YCB-Sight release, so that `--lookup-table` takes it too.
fn write_table(folder: &Path, table: &LookupTable) -> Result<(), IoError> {
    create_folder(folder)?;
    let (magnitude, direction) = table.to_arrays();
    let shape = [LookupTable::BINS; 3];
    let single = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect::<Vec<_>>();
    write_npy(folder.join("grad_mag.npy"), &shape, &single(magnitude))?;
    write_npy(folder.join("grad_dir.npy"), &shape, &single(direction))
}
