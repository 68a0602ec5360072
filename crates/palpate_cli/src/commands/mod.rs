//! One file per command.

pub(crate) mod benchmark;
pub(crate) mod calibrate;
pub(crate) mod capture;
pub(crate) mod check;
pub(crate) mod clean;
pub(crate) mod compare;
pub(crate) mod config;
pub(crate) mod decode;
pub(crate) mod explore;
mod follow;
pub(crate) mod import;
pub(crate) mod init;
pub(crate) mod inspect;
pub(crate) mod mesh;
pub(crate) mod next_touch;
pub(crate) mod presses;
pub(crate) mod reconstruct;
pub(crate) mod register;
pub(crate) mod render;
pub(crate) mod simulate;
pub(crate) mod surface;
pub(crate) mod symmetry;
#[cfg(feature = "nn")]
pub(crate) mod train;

use crate::targets::one_name;
use palpate::io;
use std::path::Path;

/// Copies a gel's calibration into a scene's folder, where `reconstruct` finds it: sensor.toml and what it names.
///
/// The file that is there already stays as it is.
pub(crate) fn copy_calibration(from: &Path, scene: &Path) -> anyhow::Result<()> {
    let target = scene.join("sensor.toml");
    if one_name(from) == one_name(&target) {
        return Ok(());
    }
    let file = io::read_sensor(from)?;
    io::copy_sensor(target, &file)?;
    Ok(())
}
