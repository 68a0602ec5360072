//! A data set of tactile presses: shards of plain npy arrays that NumPy maps into memory, and an index beside each.
//!
//! ```text
//! DIR/set.json                what was asked for: presses, shard size, sensor, seed, light
//! DIR/background.png          the no-contact image
//! DIR/00000.json              index of shard 0: one record per press; written last, so a shard that has it is complete
//! DIR/00000_images.npy        uint8   [presses, rows, cols, 3]   sRGB
//! DIR/00000_heights.npy       float16 [presses, rows, cols]      z of the gel in the sensor frame, metres
//! DIR/00000_masks.npy         bool    [presses, rows, cols]      contact
//! ```

use super::npy::{NpyRows, write_array};
use super::{IoError, read_color, read_text, write_color, write_text};
use crate::geometry::Raster;
use crate::simulate::{PressRecord, PressSample, PressSetParams};
use crate::tactile::{Contact, TactileSensor};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What a data set of presses is to hold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PressSetHeader {
    /// Version of the layout: 1.
    pub format: u32,
    /// Presses of the complete set.
    pub presses: usize,
    /// Presses of a shard; the last may hold fewer.
    pub shard_size: usize,
    /// Names of the meshes, in the order given.
    pub objects: Vec<String>,
    /// Everything else that the presses depend on.
    pub params: PressSetParams,
}

impl PressSetHeader {
    /// Shards of the complete set.
    pub fn shards(&self) -> usize {
        self.presses.div_ceil(self.shard_size.max(1))
    }

    /// Indices of the presses of a shard.
    pub fn presses_of(&self, shard: usize) -> std::ops::Range<usize> {
        shard * self.shard_size..((shard + 1) * self.shard_size).min(self.presses)
    }
}

/// Begins a set, or goes on with one: writes header and background, or checks that the folder holds the same set.
///
/// # Errors
/// [`IoError::Content`] if another set lies there; else as [`write_text`].
pub fn begin_press_set(folder: &Path, header: &PressSetHeader, background: &Raster<[u8; 3]>) -> Result<(), IoError> {
    super::create_folder(folder)?;
    let path = folder.join("set.json");
    if path.exists() {
        let found = read_header(&path)?;
        if found != *header {
            let reason = "holds a set made with other settings; choose another folder, or remove this one";
            return Err(IoError::content(&path, reason));
        }
        return Ok(());
    }
    write_color(folder.join("background.png"), background)?;
    write_text(path, &to_json(header))
}

/// Whether a shard is complete.
pub fn has_press_shard(folder: &Path, shard: usize) -> bool {
    shard_file(folder, shard, ".json").is_file()
}

/// Writes a shard; its index comes last, so that an interrupted run leaves no shard that looks complete.
///
/// # Errors
/// As [`super::atomic_write`].
pub fn write_press_shard(folder: &Path, shard: usize, presses: &[(PressRecord, PressSample)]) -> Result<(), IoError> {
    let (rows, cols) = presses.first().map_or((0, 0), |(_, s)| s.image.shape());
    let n = presses.len();
    let images = presses.iter().flat_map(|(_, s)| s.image.as_slice().iter().copied());
    write_array(&shard_file(folder, shard, "_images.npy"), "|u1", &[n, rows, cols, 3], images)?;
    let heights = presses.iter().flat_map(|(_, s)| s.contact.height_map.as_slice());
    let heights = heights.map(|&z| half::f16::from_f32(z).to_le_bytes());
    write_array(&shard_file(folder, shard, "_heights.npy"), "<f2", &[n, rows, cols], heights)?;
    let masks = presses.iter().flat_map(|(_, s)| s.contact.mask.as_slice()).map(|&m| [u8::from(m)]);
    write_array(&shard_file(folder, shard, "_masks.npy"), "|b1", &[n, rows, cols], masks)?;
    let records: Vec<&PressRecord> = presses.iter().map(|(record, _)| record).collect();
    write_text(shard_file(folder, shard, ".json"), &to_json(&records))
}

/// A data set of presses on disk: what is complete of it.
#[derive(Debug)]
pub struct PressSet {
    header: PressSetHeader,
    sensor: TactileSensor,
    background: Raster<[u8; 3]>,
    records: Vec<PressRecord>,
    /// Shard and place in it of each record.
    places: Vec<(usize, usize)>,
    folder: PathBuf,
}

impl PressSet {
    /// Opens a set and reads the indices of its complete shards.
    ///
    /// # Errors
    /// [`IoError::Read`] if there is no set, [`IoError::Content`] if it is empty or not understood.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self, IoError> {
        let folder = folder.as_ref().to_owned();
        let path = folder.join("set.json");
        let header = read_header(&path)?;
        let sensor =
            TactileSensor::preset(&header.params.sensor).map_err(|e| IoError::content(&path, e.to_string()))?;
        let background = read_color(folder.join("background.png"))?;
        let (mut records, mut places) = (Vec::new(), Vec::new());
        for shard in (0..header.shards()).filter(|&s| has_press_shard(&folder, s)) {
            let path = shard_file(&folder, shard, ".json");
            let index: Vec<PressRecord> = from_json(&path)?;
            places.extend((0..index.len()).map(|i| (shard, i)));
            records.extend(index);
        }
        if records.is_empty() {
            return Err(IoError::content(&path, format!("none of the {} shards is complete", header.shards())));
        }
        Ok(Self { header, sensor, background, records, places, folder })
    }

    /// What the set was to hold.
    pub fn header(&self) -> &PressSetHeader {
        &self.header
    }

    /// Presses that are there.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Never: an empty set cannot be opened.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Record of the `i`-th press that is there.
    pub fn record(&self, i: usize) -> &PressRecord {
        &self.records[i]
    }

    /// No-contact image, of the set's size.
    pub fn background(&self) -> &Raster<[u8; 3]> {
        &self.background
    }

    /// The sensor.
    pub fn sensor(&self) -> &TactileSensor {
        &self.sensor
    }

    /// Reads the `i`-th press that is there.
    ///
    /// # Errors
    /// [`IoError::Read`] or [`IoError::Malformed`] if a shard is damaged.
    pub fn sample(&self, i: usize) -> Result<PressSample, IoError> {
        let (shard, place) = self.places[i];
        let (rows, cols) = self.background.shape();
        let open = |suffix: &str, descr: &str, shape: &[usize]| {
            NpyRows::open(&shard_file(&self.folder, shard, suffix), descr, shape)?.read(place)
        };
        let image = open("_images.npy", "|u1", &[rows, cols, 3])?;
        let heights = open("_heights.npy", "<f2", &[rows, cols])?;
        let mask = open("_masks.npy", "|b1", &[rows, cols])?;
        let heights = heights.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32());
        let whole = "the shape was checked";
        Ok(PressSample {
            image: Raster::from_vec(rows, cols, image.as_chunks::<3>().0.to_vec()).expect(whole),
            contact: Contact {
                height_map: Raster::from_vec(rows, cols, heights.collect()).expect(whole),
                mask: Raster::from_vec(rows, cols, mask.iter().map(|&m| m != 0).collect()).expect(whole),
            },
        })
    }
}

fn shard_file(folder: &Path, shard: usize, suffix: &str) -> PathBuf {
    folder.join(format!("{shard:05}{suffix}"))
}

fn read_header(path: &Path) -> Result<PressSetHeader, IoError> {
    let header: PressSetHeader = from_json(path)?;
    if header.format != 1 || header.shard_size == 0 {
        let reason = format!(
            "format {} with shards of {}; format 1 and shards of at least 1 press are read",
            header.format, header.shard_size
        );
        return Err(IoError::content(path, reason));
    }
    Ok(header)
}

fn from_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, IoError> {
    serde_json::from_str(&read_text(path)?).map_err(|e| IoError::malformed(path, "JSON", e.to_string()))
}

fn to_json<T: Serialize>(value: &T) -> String {
    serde_json::to_string_pretty(value).expect("plain values can be written as JSON") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::PressSampler;

    fn small_set(folder: &Path) -> PressSampler {
        let params = PressSetParams { primitives: 1.0, width: 64, ..PressSetParams::default() };
        let sampler = PressSampler::new(Vec::new(), params.clone()).expect("valid");
        let header = PressSetHeader { format: 1, presses: 5, shard_size: 2, objects: Vec::new(), params };
        begin_press_set(folder, &header, &sampler.background()).expect("writable");
        for shard in [0, 2] {
            let presses: Vec<_> = header.presses_of(shard).map(|i| sampler.sample(i).expect("pressed")).collect();
            write_press_shard(folder, shard, &presses).expect("writable");
        }
        sampler
    }

    #[test]
    fn what_is_there_is_read_back_and_the_missing_shard_is_not() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let sampler = small_set(folder.path());
        let set = PressSet::open(folder.path()).expect("readable");
        assert_eq!((0..set.len()).map(|i| set.record(i).index).collect::<Vec<_>>(), [0, 1, 4]);
        let (record, made) = sampler.sample(4).expect("pressed");
        assert_eq!(*set.record(2), record);
        let read = set.sample(2).expect("readable");
        assert_eq!((&read.image, &read.contact.mask), (&made.image, &made.contact.mask));
        let pairs = read.contact.height_map.as_slice().iter().zip(made.contact.height_map.as_slice());
        assert!(pairs.map(|(a, b)| (a - b).abs()).fold(0.0f32, f32::max) < 1e-6);
    }

    #[test]
    fn damage_and_foreign_sets_are_errors() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path();
        assert!(matches!(PressSet::open(path), Err(IoError::Read { .. })));
        let sampler = small_set(path);
        let other = PressSetHeader {
            format: 1,
            presses: 6,
            shard_size: 2,
            objects: Vec::new(),
            params: sampler.params().clone(),
        };
        let error = begin_press_set(path, &other, &sampler.background()).expect_err("another set");
        assert!(error.to_string().contains("other settings"), "{error}");
        let images = path.join("00000_images.npy");
        let bytes = std::fs::read(&images).expect("there");
        std::fs::write(&images, &bytes[..bytes.len() - 7]).expect("writable");
        let set = PressSet::open(path).expect("the index is whole");
        assert!(matches!(set.sample(0), Err(IoError::Malformed { .. })));
    }
}
