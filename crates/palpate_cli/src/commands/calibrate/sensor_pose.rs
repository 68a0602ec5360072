use super::boards::{self, BoardArgs};
use crate::Outcome;
use crate::targets::Targets;
use anyhow::{Context as _, bail, ensure};
use palpate::calibrate::camera::board_pose;
use palpate::calibrate::sensor_pose::{BallContact, PoseRecord, ball_center, calibrate_on_ball, calibrate_on_board};
use palpate::geometry::Isometry;
use palpate::io::{self, read_camera, read_color, read_height_map_npy, read_mask, read_sensor};
use palpate::tactile::{Contact, TactileDecoder as _};
use serde::Deserialize;
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
#[command(after_help = "RECORDS is a TOML file:
  [[records]]
  image = \"000.png\"                # of the board, or of the gel pressed on the ball
  base_from_hand = { translation = [0.4, 0.0, 0.5], quaternion_xyzw = [1.0, 0.0, 0.0, 0.0] }
In place of image, a tactile record may have height_map = \"000_height.npy\" and contact_mask = \"000_contact.png\".

Examples:
  palpate calibrate sensor-pose records.toml --target board --camera camera.toml --board 9x6 --square 0.025 --output camera_in_hand.toml
  palpate calibrate sensor-pose records.toml --target board --standing --camera camera.toml --board 9x6 --square 0.025 --output base_from_camera.toml
  palpate calibrate sensor-pose records.toml --target ball --ball-radius 0.006 --sensor sensor.toml --output sensor_in_hand.toml

Thirty records of a board, forty of a ball, spread over the pad; the hand turned about all axes by 20° and more.")]
pub(crate) struct Args {
    /// Where the hand was and what the sensor saw
    #[arg(value_name = "RECORDS")]
    records: PathBuf,
    /// What it saw
    #[arg(long, value_enum)]
    target: Target,
    /// The camera stands and the board is in the hand: gives base_from_camera
    #[arg(long)]
    standing: bool,
    /// The camera, calibrated (board)
    #[arg(long, value_name = "TOML")]
    camera: Option<PathBuf>,
    /// Inner corners along and across the board (board)
    #[arg(long, value_name = "COLSxROWS", value_parser = boards::parse_size)]
    board: Option<(usize, usize)>,
    /// Side of a square, metres (board)
    #[arg(long, value_name = "M")]
    square: Option<f64>,
    /// Half the side of the window in which a corner is refined, pixels
    #[arg(long, value_name = "PX")]
    corner_window: Option<usize>,
    /// Radius of the ball, metres (ball)
    #[arg(long, value_name = "M")]
    ball_radius: Option<f64>,
    /// The tactile sensor, calibrated (ball)
    #[arg(long, value_name = "TOML")]
    sensor: Option<PathBuf>,
    /// File for the pose
    #[arg(short, long, value_name = "TOML")]
    output: PathBuf,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Target {
    /// A chessboard, for a camera
    Board,
    /// A ball that stands, for a tactile sensor in the hand
    Ball,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Records {
    records: Vec<Record>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    image: Option<PathBuf>,
    height_map: Option<PathBuf>,
    contact_mask: Option<PathBuf>,
    base_from_hand: Pose,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pose {
    translation: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

/// What is written, whatever it was found on.
struct Found {
    key: &'static str,
    pose: Isometry,
    /// Turn and shift.
    sigma: ([f64; 3], [f64; 3]),
    covariance: Vec<Vec<f64>>,
    rms_m: f64,
    used: usize,
    lost: usize,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let text = io::read_text(&args.records)?;
    let file: Records = toml::from_str(&text).with_context(|| args.records.display().to_string())?;
    let mut records = Vec::new();
    for (i, record) in file.records.into_iter().enumerate() {
        let pose = io::pose(record.base_from_hand.translation, record.base_from_hand.quaternion_xyzw);
        let pose = pose.map_err(|e| anyhow::anyhow!("{}: record {i} base_from_hand: {e}", args.records.display()))?;
        records.push((record, pose));
    }
    let seen = records.iter().flat_map(|(r, _)| [&r.image, &r.height_map, &r.contact_mask]).flatten();
    let named = [Some(&args.records), args.camera.as_ref(), args.sensor.as_ref()].into_iter().flatten().cloned();
    let inputs = seen.map(|file| beside(&args.records, file)).chain(named);
    Targets::keep(inputs).file(&args.output, "--output")?;
    let found = match args.target {
        Target::Board => on_board(&args, &records)?,
        Target::Ball => on_ball(&args, &records)?,
    };
    write(&args.output, &found)?;
    let t = found.pose.translation.vector;
    if args.json {
        println!(
            "{}",
            json!({
                found.key: { "translation": t.as_slice(), "quaternion_xyzw": found.pose.rotation.coords.as_slice() },
                "standard_deviation_rotation_rad": found.sigma.0,
                "standard_deviation_translation_m": found.sigma.1,
                "covariance_rotation_translation": found.covariance,
                "rms_m": found.rms_m, "records": found.used, "left_out": found.lost,
            })
        );
    } else {
        let largest = |v: [f64; 3]| v.into_iter().fold(0.0, f64::max);
        println!(
            "{}: {} = ({:.2}, {:.2}, {:.2}) ± {:.2} mm, turned by {:.2}° ± {:.2}°; {} records, {:.2} mm left on average",
            args.output.display(),
            found.key,
            1e3 * t.x,
            1e3 * t.y,
            1e3 * t.z,
            1e3 * largest(found.sigma.1),
            found.pose.rotation.angle().to_degrees(),
            largest(found.sigma.0).to_degrees(),
            found.used,
            1e3 * found.rms_m
        );
    }
    Ok(if found.lost > 0 { Outcome::Degraded } else { Outcome::Done })
}

fn sigma(covariance: &[Vec<f64>]) -> ([f64; 3], [f64; 3]) {
    let sd = |i: usize| covariance[i][i].max(0.0).sqrt();
    ([sd(0), sd(1), sd(2)], [sd(3), sd(4), sd(5)])
}

fn beside(records: &Path, file: &Path) -> PathBuf {
    records.parent().unwrap_or(Path::new(".")).join(file)
}

fn on_board(args: &Args, records: &[(Record, Isometry)]) -> anyhow::Result<Found> {
    let board_args = BoardArgs::of(args.board, args.square, args.corner_window);
    let (Some(camera), Some(board_args)) = (&args.camera, &board_args) else {
        bail!("--target board needs --camera, --board and --square");
    };
    let (camera, board) = (read_camera(camera)?.camera, board_args.board()?);
    ensure!(
        !board.is_ambiguous(),
        "a board of {}×{} inner corners looks the same turned by half: use one with an even and an odd number",
        board.cols,
        board.rows
    );
    let mut paths = Vec::new();
    for (i, (record, _)) in records.iter().enumerate() {
        let image =
            record.image.as_ref().with_context(|| format!("{}: record {i} has no image", args.records.display()))?;
        paths.push(beside(&args.records, image));
    }
    let search = boards::search(&paths, board_args)?;
    search.failed.iter().for_each(|(_, reason)| eprintln!("palpate: {reason}"));
    ensure!(
        search.found.is_empty() || search.size == (camera.width, camera.height),
        "the images are {}×{} px, the camera {}×{}",
        search.size.0,
        search.size.1,
        camera.width,
        camera.height
    );
    let mut pairs = Vec::new();
    for found in &search.found {
        // An image may be named twice, with two poses: both are used, and the contradiction shows.
        for (_, (_, base_from_hand)) in paths.iter().zip(records).filter(|(p, _)| **p == found.path) {
            let pose = board_pose(&camera, &board, &found.view).with_context(|| found.path.display().to_string())?;
            pairs.push(PoseRecord { base_from_hand: *base_from_hand, camera_from_target: pose.camera_from_board });
        }
    }
    let result = calibrate_on_board(&pairs, !args.standing)?;
    let covariance: Vec<Vec<f64>> = (0..6).map(|r| (0..6).map(|c| result.covariance[(r, c)]).collect()).collect();
    Ok(Found {
        key: if args.standing { "base_from_camera" } else { "gripper_from_camera" },
        pose: result.pose,
        sigma: sigma(&covariance),
        covariance,
        rms_m: result.rms_translation,
        used: pairs.len(),
        lost: search.failed.len(),
    })
}

fn on_ball(args: &Args, records: &[(Record, Isometry)]) -> anyhow::Result<Found> {
    let (Some(radius), Some(sensor)) = (args.ball_radius, &args.sensor) else {
        bail!("--target ball needs --ball-radius and --sensor");
    };
    ensure!(!args.standing, "--standing is for cameras: a tactile sensor is in the hand");
    ensure!((5e-4..0.1).contains(&radius), "--ball-radius {radius}: between 0.0005 and 0.1 m is needed");
    let sensor = read_sensor(sensor)?;
    let decoder = sensor.decoder(None)?;
    let (mut contacts, mut lost) = (Vec::new(), 0);
    for (i, (record, base_from_hand)) in records.iter().enumerate() {
        let contact = contact(&args.records, record, i, |image| Ok(decoder.decode(&image, &sensor.sensor)?));
        let center = contact.and_then(|c| {
            ball_center(&c, &sensor.sensor, radius)
                .with_context(|| format!("record {i} shows no ball: there is no contact"))
        });
        match center {
            Ok(center) => contacts.push(BallContact { base_from_hand: *base_from_hand, center }),
            Err(error) => {
                eprintln!("palpate: {}: {error:#}", args.records.display());
                lost += 1;
            }
        }
    }
    let result = calibrate_on_ball(&contacts)?;
    let covariance: Vec<Vec<f64>> = (0..6).map(|r| (0..6).map(|c| result.covariance[(r, c)]).collect()).collect();
    Ok(Found {
        key: "gripper_from_sensor",
        pose: result.hand_from_sensor,
        sigma: sigma(&covariance),
        covariance,
        rms_m: result.rms,
        used: contacts.len(),
        lost,
    })
}

fn contact(
    file: &Path,
    record: &Record,
    index: usize,
    decode: impl Fn(palpate::geometry::Raster<[u8; 3]>) -> anyhow::Result<Contact>,
) -> anyhow::Result<Contact> {
    match (&record.image, &record.height_map, &record.contact_mask) {
        (_, Some(height), Some(mask)) => {
            let height_map = read_height_map_npy(beside(file, height))?;
            let mask = read_mask(beside(file, mask))?;
            ensure!(height_map.shape() == mask.shape(), "record {index}: height map and contact mask differ in size");
            Ok(Contact { height_map, mask })
        }
        (Some(image), ..) => decode(read_color(beside(file, image))?).with_context(|| format!("record {index}")),
        _ => bail!("record {index} needs image, or height_map with contact_mask"),
    }
}

fn write(path: &Path, found: &Found) -> anyhow::Result<()> {
    let t: [f64; 3] = found.pose.translation.vector.into();
    let q = found.pose.rotation.coords;
    let text = format!(
        "{} = {{ translation = {t:?}, quaternion_xyzw = [{:?}, {:?}, {:?}, {:?}] }}\n\n[calibration]\nrecords = {}\nrms_m = {:?}\n\
         standard_deviation_rotation_rad = {:?}\nstandard_deviation_translation_m = {:?}\n# of turn (radians) and shift (metres) about the \
         parent's axes\ncovariance = {:?}\n",
        found.key, q.x, q.y, q.z, q.w, found.used, found.rms_m, found.sigma.0, found.sigma.1, found.covariance
    );
    io::write_text(path, &text)?;
    Ok(())
}
