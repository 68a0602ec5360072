//! From trained modules to the file that `palpate` runs.

use crate::weights::{NamedTensors, Precision, Provenance, TensorFile, WeightsError};
use palpate::tactile::compact::{ARCHITECTURE, VERSION, Weights};
use std::collections::BTreeMap;
use std::path::Path;

/// Tensors of a part as `palpate` names them: `layers.0.weight` becomes `<part>.0.weight`.
pub(super) fn named(part: &str, tensors: &NamedTensors) -> NamedTensors {
    let name = |path: &str| format!("{part}.{}", path.strip_prefix("layers.").unwrap_or(path));
    tensors.iter().map(|(path, tensor)| (name(path), tensor.clone())).collect()
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
