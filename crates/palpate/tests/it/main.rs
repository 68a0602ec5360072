//! One integration binary: linking is what costs.

mod board_pictures;
mod chessboard;
mod claims;
mod explore;
mod gel;
mod hand_eye;
mod layering;
mod mesh_clean_up;
mod metrics;
mod optics;
mod photometry;
mod poisson;
mod property;
mod readers;
mod robust;
mod segment;
mod session;
mod touch;
mod workshop;
