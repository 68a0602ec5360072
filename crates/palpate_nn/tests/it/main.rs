//! The networks, their training and their files.

mod network;
mod parity;
mod presses;
mod training;
mod weights;
