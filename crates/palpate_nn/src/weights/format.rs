use super::{NamedTensor, NamedTensors, WeightsError};
use half::f16;
use palpate::io::{IoError, atomic_write};
use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

/// How numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// 32 bits: exact.
    F32,
    /// 16 bits: half the size, three significant digits, for inference only.
    F16,
}

/// Tensors and text entries, as one safetensors file holds them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TensorFile {
    /// Text by key.
    pub metadata: BTreeMap<String, String>,
    /// Tensors by name.
    pub tensors: NamedTensors,
}

impl TensorFile {
    /// Writes the file; the same content gives the same bytes.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write(&self, out: &mut dyn Write, precision: Precision) -> io::Result<()> {
        let (kind, size) = match precision {
            Precision::F32 => ("F32", 4),
            Precision::F16 => ("F16", 2),
        };
        let mut header = Map::new();
        header.insert("__metadata__".to_owned(), json!(self.metadata));
        let mut start = 0;
        for (name, tensor) in &self.tensors {
            let end = start + tensor.values.len() * size;
            let entry = json!({ "dtype": kind, "shape": tensor.shape, "data_offsets": [start, end] });
            header.insert(name.clone(), entry);
            start = end;
        }
        let mut header = serde_json::to_vec(&Value::Object(header))?;
        header.resize(header.len().next_multiple_of(8), b' ');
        out.write_all(&(header.len() as u64).to_le_bytes())?;
        out.write_all(&header)?;
        let mut bytes = Vec::new();
        for tensor in self.tensors.values() {
            bytes.clear();
            match precision {
                Precision::F32 => bytes.extend(tensor.values.iter().flat_map(|v| v.to_le_bytes())),
                Precision::F16 => bytes.extend(tensor.values.iter().flat_map(|&v| f16::from_f32(v).to_le_bytes())),
            }
            out.write_all(&bytes)?;
        }
        Ok(())
    }

    /// Writes the file under its name, complete or not at all: what was there stays until all bytes are written.
    ///
    /// # Errors
    /// [`WeightsError::NotFinite`], and [`WeightsError::Io`] with the system's reason, such as a full disk.
    pub fn save(&self, path: &Path, precision: Precision) -> Result<(), WeightsError> {
        let stored = |v: f32| if precision == Precision::F16 { f16::from_f32(v).to_f32() } else { v };
        check_finite(&self.tensors, path, stored)?;
        Ok(atomic_write(path, |out| self.write(out, precision))?)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`WeightsError::Io`], [`WeightsError::Malformed`], [`WeightsError::Kind`], [`WeightsError::NotFinite`].
    pub fn open(path: &Path) -> Result<Self, WeightsError> {
        let bytes = std::fs::read(path).map_err(|source| IoError::Read { path: path.to_owned(), source })?;
        Self::parse(&bytes, path)
    }

    /// [`Self::open`] of bytes in memory; `path` names them in messages.
    ///
    /// # Errors
    /// Those of [`Self::open`] but the first.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, WeightsError> {
        let malformed =
            |e: safetensors::SafeTensorError| WeightsError::Malformed { path: path.to_owned(), reason: e.to_string() };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(malformed)?;
        let metadata = header.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect();
        let file = SafeTensors::deserialize(bytes).map_err(malformed)?;
        let mut tensors = NamedTensors::new();
        for (name, view) in file.iter() {
            let data = view.data();
            let values = match view.dtype() {
                Dtype::F32 => data.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
                Dtype::F16 => data.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect(),
                other => {
                    let (tensor, found) = (name.to_owned(), format!("{other:?}"));
                    return Err(WeightsError::Kind { path: path.to_owned(), tensor, found });
                }
            };
            tensors.insert(name.to_owned(), NamedTensor { shape: view.shape().to_vec(), values });
        }
        check_finite(&tensors, path, |v| v)?;
        Ok(Self { metadata, tensors })
    }
}

fn check_finite(tensors: &NamedTensors, path: &Path, stored: impl Fn(f32) -> f32) -> Result<(), WeightsError> {
    for (name, tensor) in tensors {
        if let Some(&found) = tensor.values.iter().find(|&&v| !stored(v).is_finite()) {
            return Err(WeightsError::NotFinite { path: path.to_owned(), tensor: name.clone(), found });
        }
    }
    Ok(())
}
