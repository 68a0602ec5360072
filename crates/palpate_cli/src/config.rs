//! The parameter file: TOML, unknown keys denied.

use anyhow::Context as _;
use palpate::io;
use palpate::pipeline::ReconstructParams;
use std::path::Path;

pub(crate) fn read(path: &Path) -> anyhow::Result<ReconstructParams> {
    let text = io::read_text(path)?;
    toml::from_str(&text).with_context(|| format!("reading the parameters in '{}'", path.display()))
}

pub(crate) fn to_toml(params: &ReconstructParams) -> anyhow::Result<String> {
    toml::to_string(params).context("writing the parameters")
}
