use super::boards::{self, BoardArgs};
use crate::Outcome;
use crate::targets::Targets;
use anyhow::{Context as _, bail, ensure};
use palpate::calibrate::camera::board_pose;
use palpate::geometry::Isometry;
use palpate::io::{CameraFile, read_camera, write_camera};
use std::path::PathBuf;

#[derive(clap::Args)]
#[command(
    after_help = "Example: the board lies on the table, its first corner at the world's origin, its z axis down into the table:
  palpate calibrate camera-pose board.png --camera camera.toml --board 9x6 --square 0.025 --world-from-board 0,0,0,1,0,0,0 \\
    --output camera.toml

The board's frame: origin at the first inner corner, x along the columns, y along the rows, z into the board. The first corner is the one whose square, towards
the others, is dark."
)]
pub(crate) struct Args {
    /// A picture of the board at its known place
    #[arg(value_name = "IMAGE")]
    image: PathBuf,
    /// The camera, calibrated
    #[arg(long, value_name = "TOML")]
    camera: PathBuf,
    #[command(flatten)]
    board: BoardArgs,
    /// Where the board lies, metres and quaternion
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", value_parser = boards::parse_pose, allow_hyphen_values = true)]
    world_from_board: Isometry,
    /// File for the camera with world_from_camera; may be the same
    #[arg(short, long, value_name = "TOML")]
    output: PathBuf,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let board = args.board.board()?;
    Targets::keep([&args.image]).file(&args.output, "--output")?;
    ensure!(
        !board.is_ambiguous(),
        "a board of {}×{} inner corners looks the same turned by half: use one with an even and an odd number",
        board.cols,
        board.rows
    );
    let camera = read_camera(&args.camera)?.camera;
    let search = boards::search(std::slice::from_ref(&args.image), &args.board)?;
    let Some(found) = search.found.first() else {
        bail!("{}", search.failed.first().map_or("no image", |f| f.1.as_str()));
    };
    ensure!(
        search.size == (camera.width, camera.height),
        "{} is {}×{} px, the camera {}×{}",
        args.image.display(),
        search.size.0,
        search.size.1,
        camera.width,
        camera.height
    );
    let pose = board_pose(&camera, &board, &found.view).with_context(|| args.image.display().to_string())?;
    let world_from_camera = args.world_from_board * pose.camera_from_board.inverse();
    let mut table = toml::Table::new();
    table.insert("board_rms_px".into(), pose.rms.into());
    write_camera(&args.output, &CameraFile { camera, world_from_camera: Some(world_from_camera) }, &table)?;
    let t = world_from_camera.translation.vector;
    let sd = |i: usize| pose.covariance[(i, i)].max(0.0).sqrt();
    println!(
        "{}: camera at ({:.4}, {:.4}, {:.4}) m; corners fit to {:.3} px; the board's place is known to {:.2} mm and {:.3}°",
        args.output.display(),
        t.x,
        t.y,
        t.z,
        pose.rms,
        1e3 * sd(3).hypot(sd(4)).hypot(sd(5)),
        sd(0).hypot(sd(1)).hypot(sd(2)).to_degrees()
    );
    if pose.rms > 1.0 {
        crate::say::warn(format!(
            "{:.1} px is much: is this the calibrated camera, and the square's side right?",
            pose.rms
        ));
        return Ok(Outcome::Degraded);
    }
    Ok(Outcome::Done)
}
