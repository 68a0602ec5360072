use super::Target;
use crate::Outcome;
use palpate::geometry::Isometry;
use palpate::io::{CameraFile, read_camera, read_cloud};
use palpate_recordings::{BopFrame, import_bop, import_cloud, import_tum, import_ycb_sight_real};
use std::path::PathBuf;

#[derive(clap::Args)]
pub(super) struct TumArgs {
    /// Folder with depth.txt, rgb.txt and groundtruth.txt
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// The camera, as a camera.toml (the benchmark lists fx, fy, cx, cy of its three; 525, 525, 319.5, 239.5 is its default)
    #[arg(long, value_name = "TOML")]
    camera: PathBuf,
    /// Depth image nearest to this stamp, seconds [default: the first]
    #[arg(long, value_name = "S")]
    time: Option<f64>,
    #[command(flatten)]
    target: Target,
}

pub(super) fn tum(args: TumArgs) -> anyhow::Result<Outcome> {
    args.target.check([&args.camera])?;
    let camera = read_camera(&args.camera)?.camera;
    args.target.write(import_tum(&args.folder, args.time, &camera)?, None)
}

#[derive(clap::Args)]
pub(super) struct BopArgs {
    /// Folder of one scene, with scene_camera.json
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Number of the image
    #[arg(long, default_value_t = 0, value_name = "N")]
    image: u32,
    /// Which of the image's objects is masked [default: no mask]
    #[arg(long, value_name = "N")]
    object: Option<usize>,
    #[command(flatten)]
    target: Target,
}

pub(super) fn bop(args: BopArgs) -> anyhow::Result<Outcome> {
    args.target.check([])?;
    let frame = BopFrame { image: args.image, object: args.object };
    args.target.write(import_bop(&args.folder, frame)?, None)
}

#[derive(clap::Args)]
pub(super) struct CloudArgs {
    /// Cloud, world frame unless --camera-frame, metres
    #[arg(value_name = "CLOUD")]
    cloud: PathBuf,
    /// The camera into whose raster it is put; its world_from_camera is the pose unless --pose is given
    #[arg(long, value_name = "TOML")]
    camera: PathBuf,
    /// world_from_camera: where the camera was
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", value_parser = crate::commands::calibrate::parse_pose, allow_hyphen_values = true)]
    pose: Option<Isometry>,
    /// The cloud is in the camera's frame
    #[arg(long)]
    camera_frame: bool,
    #[command(flatten)]
    target: Target,
}

pub(super) fn cloud(args: CloudArgs) -> anyhow::Result<Outcome> {
    args.target.check([&args.cloud, &args.camera])?;
    let CameraFile { camera, world_from_camera } = read_camera(&args.camera)?;
    let pose = args.pose.or(world_from_camera).unwrap_or_else(Isometry::identity);
    let cloud = read_cloud(&args.cloud)?;
    let cloud = if args.camera_frame { cloud.transformed(&pose) } else { cloud };
    let name = args.cloud.file_stem().map_or_else(|| "cloud".to_owned(), |n| n.to_string_lossy().into_owned());
    let mut imported = import_cloud(&name, &cloud.points, cloud.colors.as_deref(), &camera, &pose)?;
    if args.pose.is_none() && world_from_camera.is_none() {
        let said = "neither --pose nor --camera's world_from_camera: the world is the camera's frame";
        imported.warnings.push(said.to_owned());
    }
    args.target.write(imported, None)
}

#[derive(clap::Args)]
pub(super) struct YcbSightRealArgs {
    /// Folder of one object
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// The camera into whose raster the cloud is put
    #[arg(long, value_name = "TOML")]
    camera: PathBuf,
    #[command(flatten)]
    target: Target,
}

pub(super) fn ycb_sight_real(args: YcbSightRealArgs) -> anyhow::Result<Outcome> {
    args.target.check([&args.camera])?;
    let camera = read_camera(&args.camera)?.camera;
    args.target.write(import_ycb_sight_real(&args.folder, &camera)?, None)
}
