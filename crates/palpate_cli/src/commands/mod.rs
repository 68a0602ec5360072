//! One file per command.

pub(crate) mod benchmark;
pub(crate) mod check;
pub(crate) mod clean;
pub(crate) mod compare;
pub(crate) mod config;
pub(crate) mod decode;
pub(crate) mod explore;
pub(crate) mod init;
pub(crate) mod inspect;
pub(crate) mod next_touch;
pub(crate) mod presses;
pub(crate) mod reconstruct;
pub(crate) mod render;
pub(crate) mod simulate;
pub(crate) mod surface;
pub(crate) mod symmetry;
#[cfg(feature = "nn")]
pub(crate) mod train;
