//! The one place where the benchmark meets the pipeline.

use super::dataset::Loaded;
use super::shape::{Answer, Job};
use anyhow::Context as _;
use palpate::io::{read_mesh, read_scene};
use std::path::Path;

/// Reconstructs by the library.
pub(super) fn reconstruct(_job: &Job) -> anyhow::Result<Answer> {
    anyhow::bail!("not built yet")
}

/// Reads a scene folder and its truth.
pub(super) fn read_scene_with_truth(path: &Path) -> anyhow::Result<Loaded> {
    let file = read_scene(path)?;
    let truth = file.truth.with_context(|| format!("{} has no [truth] to judge by", path.display()))?;
    Ok(Loaded { scene: file.scene, truth: read_mesh(truth)? })
}

/// The parameters of the reconstruction, on one line.
pub(super) fn parameters() -> anyhow::Result<String> {
    Ok("default".to_owned())
}
