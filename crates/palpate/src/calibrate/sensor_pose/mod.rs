//! Where on the robot a sensor sits, and where it stands in the robot's world: hand–eye calibration.
//!
//! Two kinds of record. A **camera** sees a board that does not move (or moves with the hand, the camera standing): each record gives the board's
//! whole pose. A **tactile sensor** presses a ball that does not move: each record gives the ball's centre in the sensor's frame.

mod ball;
mod board;
mod error;
mod solve;

pub use ball::{BallContact, BallPoseCalibration, ball_center, calibrate_on_ball};
pub use board::{HandEye, PoseRecord, calibrate_on_board};
pub use error::SensorPoseError;
