use super::Convolution;
use safetensors::{Dtype, SafeTensors};
use std::collections::BTreeMap;

/// Name of the architecture in weight files.
pub const ARCHITECTURE: &str = "palpate-compact";
/// Raised whenever the same file would mean another network.
pub const VERSION: u32 = 1;

/// What is wrong with a weight file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// Not a safetensors file, or cut short.
    #[error("not a readable safetensors file: {reason}")]
    Malformed {
        /// What is wrong.
        reason: String,
    },
    /// Weights of another network.
    #[error("the weights are of '{found}'; {needed} is needed")]
    Architecture {
        /// Architecture and version found.
        found: String,
        /// What is needed.
        needed: String,
    },
    /// A tensor is not there.
    #[error("tensor '{name}' is missing")]
    Missing {
        /// Its name.
        name: String,
    },
    /// A tensor has the wrong shape or type.
    #[error("tensor '{name}' is {found}; {needed} is needed")]
    Shape {
        /// Its name.
        name: String,
        /// Type and shape found.
        found: String,
        /// Type and shape needed.
        needed: String,
    },
    /// A weight is NaN or infinite.
    #[error("tensor '{name}' holds {found}; all weights must be finite")]
    NotFinite {
        /// Its name.
        name: String,
        /// Value found.
        found: f32,
    },
}

/// Tensors by name, and the file's metadata.
#[derive(Debug, Clone)]
pub struct Weights {
    values: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    metadata: BTreeMap<String, String>,
}

impl Weights {
    /// Parses a safetensors file of float16 or float32.
    ///
    /// # Errors
    /// [`WeightsError::Malformed`], [`WeightsError::Shape`] for other types, [`WeightsError::NotFinite`].
    pub fn parse(bytes: &[u8]) -> Result<Self, WeightsError> {
        let malformed = |e: safetensors::SafeTensorError| WeightsError::Malformed { reason: e.to_string() };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(malformed)?;
        let metadata = header.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect();
        let file = SafeTensors::deserialize(bytes).map_err(malformed)?;
        let mut values = BTreeMap::new();
        for (name, view) in file.tensors() {
            let data: Vec<f32> = match view.dtype() {
                Dtype::F32 => view.data().as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
                Dtype::F16 => view.data().as_chunks().0.iter().map(|&b| half::f16::from_le_bytes(b).to_f32()).collect(),
                other => {
                    let found = format!("{other:?} {:?}", view.shape());
                    return Err(WeightsError::Shape { name, found, needed: "F16 or F32".to_owned() });
                }
            };
            if let Some(&found) = data.iter().find(|v| !v.is_finite()) {
                return Err(WeightsError::NotFinite { name, found });
            }
            values.insert(name, (view.shape().to_vec(), data));
        }
        Ok(Self { values, metadata })
    }

    fn tensor(&self, name: String, shape: &[usize]) -> Result<&[f32], WeightsError> {
        let Some((found, data)) = self.values.get(&name) else { return Err(WeightsError::Missing { name }) };
        if found != shape {
            return Err(WeightsError::Shape { name, found: format!("{found:?}"), needed: format!("{shape:?}") });
        }
        Ok(data)
    }

    /// A value of the file's metadata.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }

    /// The convolutions `name.0`, `name.1`, … of stride 1: kernel size, inputs, outputs.
    pub(super) fn layers(
        &self,
        name: &str,
        layers: &[(usize, usize, usize)],
    ) -> Result<Vec<Convolution>, WeightsError> {
        let layer = |(i, &(size, inputs, outputs)): (usize, &(usize, usize, usize))| {
            self.convolution(&format!("{name}.{i}"), size, 1, inputs, outputs)
        };
        layers.iter().enumerate().map(layer).collect()
    }

    /// The convolution `name.weight` \[outputs, inputs, size, size\] with `name.bias` \[outputs\].
    pub(super) fn convolution(
        &self,
        name: &str,
        size: usize,
        stride: usize,
        inputs: usize,
        outputs: usize,
    ) -> Result<Convolution, WeightsError> {
        let weights = self.tensor(format!("{name}.weight"), &[outputs, inputs, size, size])?;
        let bias = self.tensor(format!("{name}.bias"), &[outputs])?;
        Ok(Convolution::new(size, stride, inputs, weights, bias.to_vec()))
    }

    /// Checks that the file is of this network.
    pub(super) fn check_architecture(&self) -> Result<(), WeightsError> {
        let get = |key: &str| self.metadata.get(key).map_or("?", String::as_str);
        let found = (get("architecture"), get("version"));
        if found != (ARCHITECTURE, VERSION.to_string().as_str()) {
            let found = format!("{} v{}", found.0, found.1);
            return Err(WeightsError::Architecture { found, needed: format!("{ARCHITECTURE} v{VERSION}") });
        }
        Ok(())
    }
}
