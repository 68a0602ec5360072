//! What only a process shows: exit status, messages, files.

mod bad_input;
mod compare;
mod decode;
mod explore;
mod presses;
mod reconstruct;
mod render;
mod scene_folder;
mod simulate;
mod surface;
mod workshop;
