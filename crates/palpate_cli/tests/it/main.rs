//! What only a process shows: exit status, messages, files.

mod bad_input;
mod calibrate;
mod capture;
mod compare;
mod decode;
mod explore;
mod follow;
mod import;
mod presses;
mod reconstruct;
mod render;
mod scene_folder;
mod simulate;
mod surface;
#[cfg(feature = "nn")]
mod train;
mod workshop;
