//! A camera from pictures of a chessboard: corners, model, place.
//!
//! # References
//! Zhang, *A flexible new technique for camera calibration*, PAMI 22(11), 2000 (start and refinement).

mod board;
mod bundle;
mod calibration;
mod corners;
mod coverage;
mod error;
mod extrinsics;
mod fixed;
mod grid;
mod homography;
mod start;
mod subpixel;

pub use board::{Board, BoardSearch, BoardView, find_board};
pub use calibration::{CalibratedView, CameraCalibration, CameraSigma, Outliers, calibrate_camera};
pub use coverage::{Coverage, coverage, draw_coverage};
pub use error::{BoardError, CalibrationError};
pub use extrinsics::{BoardPose, PairedExtrinsics, board_pose, paired_extrinsics};
pub use fixed::Fixed;
