//! What only a process shows: exit status, messages, files.

mod compare;
mod render;
mod surface;
