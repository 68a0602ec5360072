//! `palpate calibrate`: one file for each thing that is calibrated.

mod boards;
mod camera;
mod camera_pose;
mod extrinsics;
mod gel;
mod sensor_pose;

pub(crate) use boards::{images_of, parse_pose};

use crate::Outcome;
use clap::Subcommand;

#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// A camera's focal lengths, principal point and distortion, from pictures of a chessboard
    Camera(camera::Args),
    /// How a depth camera and a colour camera are mounted, from boards that both saw
    Extrinsics(extrinsics::Args),
    /// Where a calibrated camera stands, from a board at a known place
    CameraPose(camera_pose::Args),
    /// A tactile sensor's gel, from presses of a ball
    Gel(gel::Args),
    /// Where on the robot a sensor sits (hand–eye)
    SensorPose(sensor_pose::Args),
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    match args.what {
        What::Camera(args) => camera::run(args),
        What::Extrinsics(args) => extrinsics::run(args),
        What::CameraPose(args) => camera_pose::run(args),
        What::Gel(args) => gel::run(args),
        What::SensorPose(args) => sensor_pose::run(args),
    }
}
