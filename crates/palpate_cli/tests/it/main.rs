//! What only a process shows: exit status, messages, files.

mod bad_input;
mod calibrate;
mod capture;
mod capture_sockets;
mod compare;
mod decode;
mod explore;
mod follow;
mod import;
mod presses;
mod reconstruct;
mod register;
mod render;
mod scene_folder;
mod simulate;
mod surface;
mod symmetry;
#[cfg(feature = "nn")]
mod train;
mod workshop;
