//! The one place where the benchmark meets the pipeline.

use super::dataset::Loaded;
use super::shape::{Answer, Job};
use std::path::Path;

/// Reconstructs by the library.
pub(super) fn reconstruct(_job: &Job) -> anyhow::Result<Answer> {
    anyhow::bail!("not built yet")
}

/// Reads a scene folder and its truth.
pub(super) fn read_scene_with_truth(_path: &Path) -> anyhow::Result<Loaded> {
    anyhow::bail!("not built yet")
}

/// The parameters of the reconstruction, on one line.
pub(super) fn parameters() -> anyhow::Result<String> {
    Ok("default".to_owned())
}
