use super::{NamedTensors, Precision, TensorFile, WeightsError, load_tensors, named_tensors};
use burn::prelude::*;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

/// Which network some weights belong to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Architecture {
    /// Name of the network.
    pub name: String,
    /// Raised whenever the same config comes to mean another network.
    pub version: u32,
    /// Its config, JSON.
    pub config: String,
}

impl Architecture {
    /// * `config` – whatever the network needs to be made again
    pub fn new(name: &str, version: u32, config: &impl Serialize) -> Self {
        let config = serde_json::to_string(config).expect("a plain struct");
        Self { name: name.to_owned(), version, config }
    }
}

impl fmt::Display for Architecture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} v{} {}", self.name, self.version, self.config)
    }
}

/// Where weights come from: enough to make them again.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Model of the tactile sensor.
    pub sensor: String,
    /// Rows and columns of the input.
    pub input: (usize, usize),
    /// Name of the split of the objects.
    pub split: String,
    /// Seed of the run.
    pub seed: u64,
    /// Command that trained them.
    pub command: String,
    /// What the network reads and gives: the configuration of the run, JSON.
    pub run: String,
}

/// Weights of one network with all that is needed to use them.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightFile {
    /// The network.
    pub architecture: Architecture,
    /// Where the weights come from.
    pub provenance: Provenance,
    /// The weights.
    pub tensors: NamedTensors,
    path: PathBuf,
}

impl WeightFile {
    /// The weights of `model`; of one in training pass `model.valid()`.
    pub fn of<B: Backend, M: Module<B>>(model: &M, architecture: Architecture, provenance: Provenance) -> Self {
        Self::of_tensors(named_tensors(model), architecture, provenance)
    }

    pub(crate) fn of_tensors(tensors: NamedTensors, architecture: Architecture, provenance: Provenance) -> Self {
        Self { architecture, provenance, tensors, path: PathBuf::new() }
    }

    /// Writes the file, complete or not at all.
    ///
    /// # Errors
    /// [`WeightsError::NotFinite`], [`WeightsError::Io`].
    pub fn save(&self, path: &Path, precision: Precision) -> Result<(), WeightsError> {
        self.to_file().save(path, precision)
    }

    pub(crate) fn to_file(&self) -> TensorFile {
        let provenance = serde_json::to_string(&self.provenance).expect("a plain struct");
        let metadata = BTreeMap::from([
            ("architecture".to_owned(), self.architecture.name.clone()),
            ("version".to_owned(), self.architecture.version.to_string()),
            ("config".to_owned(), self.architecture.config.clone()),
            ("provenance".to_owned(), provenance),
        ]);
        TensorFile { metadata, tensors: self.tensors.clone() }
    }

    /// Reads a file of any network.
    ///
    /// # Errors
    /// Those of [`TensorFile::open`]; [`WeightsError::Metadata`].
    pub fn open(path: &Path) -> Result<Self, WeightsError> {
        Self::from_file(TensorFile::open(path)?, path)
    }

    pub(crate) fn from_file(mut file: TensorFile, path: &Path) -> Result<Self, WeightsError> {
        let missing = |key| WeightsError::Metadata { path: path.to_owned(), key };
        let mut text = |key: &'static str| file.metadata.remove(key).ok_or_else(|| missing(key));
        let architecture = Architecture {
            name: text("architecture")?,
            version: text("version")?.parse().map_err(|_| missing("version"))?,
            config: text("config")?,
        };
        let provenance = serde_json::from_str(&text("provenance")?).map_err(|_| missing("provenance"))?;
        Ok(Self { architecture, provenance, tensors: file.tensors, path: path.to_owned() })
    }

    /// The network's config, if the file holds that network.
    ///
    /// # Errors
    /// [`WeightsError::Architecture`], [`WeightsError::Metadata`].
    pub fn config<C: DeserializeOwned>(&self, name: &str, version: u32) -> Result<C, WeightsError> {
        if (self.architecture.name.as_str(), self.architecture.version) != (name, version) {
            return Err(self.other_architecture(format!("{name} v{version}")));
        }
        let path = self.path.clone();
        serde_json::from_str(&self.architecture.config).map_err(|_| WeightsError::Metadata { path, key: "config" })
    }

    /// Puts the weights into a new network made for `needed`.
    ///
    /// # Errors
    /// [`WeightsError::Architecture`] and those of [`load_tensors`].
    pub fn load_into<B: Backend, M: Module<B>>(self, model: M, needed: &Architecture) -> Result<M, WeightsError> {
        self.check(needed)?;
        load_tensors(model, self.tensors, &self.path)
    }

    pub(crate) fn check(&self, needed: &Architecture) -> Result<(), WeightsError> {
        if self.architecture == *needed { Ok(()) } else { Err(self.other_architecture(needed.to_string())) }
    }

    fn other_architecture(&self, needed: String) -> WeightsError {
        WeightsError::Architecture { path: self.path.clone(), found: self.architecture.to_string(), needed }
    }
}
