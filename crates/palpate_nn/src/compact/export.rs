//! From trained modules to the file that `palpate` runs: batch normalisation folded into the convolutions.

use crate::weights::{NamedTensor, NamedTensors, Precision, Provenance, TensorFile, WeightsError};
use palpate::tactile::compact::{ARCHITECTURE, VERSION, Weights};
use std::collections::BTreeMap;
use std::path::Path;

/// ε of burn's batch normalisation, which its running variance is divided with.
const EPSILON: f32 = 1e-5;

/// Tensors of a part as `palpate` names them: `layers.0.weight` becomes `<part>.0.weight`; `….conv` and `….norm` become one
/// convolution with bias.
pub(super) fn folded(part: &str, tensors: &NamedTensors) -> NamedTensors {
    let mut out = NamedTensors::new();
    let name = |path: &str| format!("{part}.{}", path.strip_prefix("layers.").unwrap_or(path));
    for (path, tensor) in tensors {
        let Some(place) = path.strip_suffix(".conv.weight") else {
            if !path.contains(".norm.") {
                out.insert(name(path), tensor.clone());
            }
            continue;
        };
        let of_norm = |key: &str| tensors.get(&format!("{place}.norm.{key}")).map_or(&[][..], |t| &t.values);
        let (gamma, beta) = (of_norm("gamma"), of_norm("beta"));
        let (mean, variance) = (of_norm("running_mean"), of_norm("running_var"));
        let mut weight = tensor.clone();
        let per_output = weight.values.len() / weight.shape[0];
        let scale: Vec<f32> = gamma.iter().zip(variance).map(|(g, v)| g / (v + EPSILON).sqrt()).collect();
        for (values, s) in weight.values.chunks_exact_mut(per_output).zip(&scale) {
            values.iter_mut().for_each(|v| *v *= s);
        }
        let bias: Vec<f32> = beta.iter().zip(mean).zip(&scale).map(|((b, m), s)| b - m * s).collect();
        out.insert(name(&format!("{place}.bias")), NamedTensor { shape: vec![bias.len()], values: bias });
        out.insert(name(&format!("{place}.weight")), weight);
    }
    out
}

/// Parts as `palpate` reads them.
pub(super) fn weights(tensors: NamedTensors) -> Weights {
    let file = TensorFile { metadata: BTreeMap::new(), tensors };
    let mut bytes = Vec::new();
    file.write(&mut bytes, Precision::F32).expect("memory can be written");
    Weights::parse(&bytes).expect("just written; a training step that gave NaN was refused before")
}

/// Writes the file of the whole network, float16.
///
/// # Errors
/// [`WeightsError::NotFinite`], [`WeightsError::Io`].
pub(super) fn save(tensors: NamedTensors, provenance: &Provenance, path: &Path) -> Result<(), WeightsError> {
    let text = |s: &str| s.to_owned();
    let metadata = BTreeMap::from([
        (text("architecture"), text(ARCHITECTURE)),
        (text("version"), VERSION.to_string()),
        (text("sensor"), provenance.sensor.clone()),
        (text("split"), provenance.split.clone()),
        (text("seed"), provenance.seed.to_string()),
        (text("command"), provenance.command.clone()),
        (text("run"), provenance.run.clone()),
    ]);
    TensorFile { metadata, tensors }.save(path, Precision::F16)
}
