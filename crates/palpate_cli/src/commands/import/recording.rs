use super::Target;
use crate::Outcome;
use anyhow::bail;
use palpate::io::{read_color, read_sensor};
use palpate::tactile::TactileSensor;
use palpate_recordings::{RecordingSpec, TouchSource, import_recording, summarise};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate import recording bench.mcap --list
  palpate import recording bag/ --depth /camera/depth/image_raw --info /camera/depth/camera_info --color /camera/color/image_raw \\
    --tactile /gelsight/image --touch-on /touch --sensor-frame gelsight --sensor sensor.toml --output SCENE

Read: sensor_msgs Image (16UC1, mono16, 32FC1; rgb8, bgr8, rgba8, bgra8, mono8), CompressedImage (PNG, JPEG, compressedDepth), CameraInfo,
PointCloud2; tf2_msgs TFMessage; geometry_msgs PoseStamped; all in cdr. Chunks may be zstd, lz4 or plain. SQLite bags: `ros2 bag convert`.
The sensor's pose is taken from the tf tree at the touch's stamp.")]
pub(super) struct Args {
    /// MCAP file, or folder of rosbag2
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
    /// Only say which topics there are
    #[arg(long)]
    list: bool,
    /// Topic of the depth image, or cloud
    #[arg(long, value_name = "TOPIC", required_unless_present = "list")]
    depth: Option<String>,
    /// Topic of the depth camera's CameraInfo
    #[arg(long, value_name = "TOPIC", required_unless_present = "list")]
    info: Option<String>,
    /// Topic of colours that are registered to depth
    #[arg(long, value_name = "TOPIC")]
    color: Option<String>,
    /// Depth frame nearest to this stamp, seconds [default: the first]
    #[arg(long, value_name = "S")]
    time: Option<f64>,
    /// Topic of tactile images
    #[arg(long, value_name = "TOPIC", requires = "sensor")]
    tactile: Option<String>,
    /// Topic of PoseStamped: each message is a touch, and without --sensor-frame its pose the sensor's
    #[arg(long, value_name = "TOPIC")]
    touch_on: Option<String>,
    /// Stamps of the touches, seconds
    #[arg(long, value_name = "S", value_delimiter = ',', conflicts_with = "touch_on")]
    touch_at: Vec<f64>,
    /// tf frame of the gel's apex, z out of the gel, x along the image's columns
    #[arg(long, value_name = "FRAME")]
    sensor_frame: Option<String>,
    /// tf frame that becomes the world
    #[arg(long, default_value = "world", value_name = "FRAME")]
    world_frame: String,
    /// The tactile sensor: a preset, or the sensor.toml of `palpate calibrate gel`
    #[arg(long, value_name = "PRESET|TOML")]
    sensor: Option<String>,
    /// No-contact image [default: that of sensor.toml, else the first tactile image]
    #[arg(long, value_name = "BG")]
    background: Option<PathBuf>,
    /// Take a recording that was cut short as far as it goes
    #[arg(long)]
    allow_truncated: bool,
    /// Scene folder to make
    #[arg(short, long, value_name = "SCENE", required_unless_present = "list")]
    output: Option<PathBuf>,
    /// Overwrite the scene that is already there
    #[arg(long)]
    force: bool,
}

pub(super) fn run(args: Args) -> anyhow::Result<Outcome> {
    if args.list {
        for (topic, t) in summarise(&args.recording, args.allow_truncated)? {
            println!("{topic}: {} of {} ({})", t.count, t.kind, t.encoding);
        }
        return Ok(Outcome::Done);
    }
    let (Some(depth), Some(info)) = (args.depth, args.info) else { bail!("--depth and --info are needed") };
    let Some(output) = args.output else { bail!("--output SCENE is needed") };
    let target = Target { output, force: args.force };
    let is_file = |s: &str| Path::new(s).extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let calibration = args.sensor.as_deref().filter(|s| is_file(s)).map(PathBuf::from);
    target.check([Some(&args.recording), args.background.as_ref()].into_iter().flatten())?;
    let file = calibration.as_ref().map(read_sensor).transpose()?;
    let sensor = match (&file, &args.sensor) {
        (Some(file), _) => Some(file.sensor.clone()),
        (None, Some(name)) => Some(TactileSensor::preset(name)?),
        (None, None) => None,
    };
    let background = match args.background {
        Some(path) => Some(read_color(path)?),
        None => file.map(|f| f.background),
    };
    let touches = match args.touch_on {
        Some(topic) => TouchSource::Poses(topic),
        None if !args.touch_at.is_empty() => TouchSource::Stamps(args.touch_at),
        None => TouchSource::EveryContact,
    };
    let spec = RecordingSpec {
        path: args.recording,
        depth,
        info,
        color: args.color,
        tactile: args.tactile,
        touches,
        sensor_frame: args.sensor_frame,
        world_frame: args.world_frame,
        sensor,
        tactile_background: background,
        time: args.time,
        allow_truncated: args.allow_truncated,
    };
    target.write(import_recording(&spec)?, calibration.as_deref())
}
