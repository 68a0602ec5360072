//! What only a process shows: exit status, messages, files.

mod render;
mod compare;
