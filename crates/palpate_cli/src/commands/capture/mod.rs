//! `palpate capture`: touches from a running sensor into a scene.

mod frames;
mod pose_source;

use crate::{Outcome, say};
use anyhow::{Context as _, bail, ensure};
use clap::Subcommand;
use frames::{Frame, FrameSource};
use indicatif::{ProgressBar, ProgressStyle};
use palpate::capture::{ContactWatcher, WatchParams, Watched};
use palpate::geometry::{Isometry, Raster};
use palpate::io::{self, SceneAppender, SensorFile, read_color, read_sensor};
use palpate::tactile::{self, DecodeError, NoContact, RelaxedGel, TactileSensor, fill_markers};
use pose_source::PoseSource;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Save each contact that has settled, with the robot's pose, into a scene
    Touch(TouchArgs),
}

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate capture touch --device /dev/video2 --video-size 640x480 --sensor sensor.toml --pose tcp:127.0.0.1:7000 --output SCENE
  palpate capture touch --frames recorded/ --sensor gelsight-mini --pose file:pose.json --output SCENE

SCENE exists already (`palpate init`, `palpate import`). The gel must be free at the start: ten frames become the background. A contact is saved once, when
it has been still for five frames; lift off before the next. The device may be unplugged and come back. Ctrl-C ends; the scene is complete at any moment.

--pose: - (a line on standard input for each touch, when it is asked for), file:PATH (what the file holds at that moment), tcp:HOST:PORT or unix:PATH
(palpate listens; the last line counts, for one touch: a robot that sends its pose once sends it anew for each). A pose is one line: seven numbers x y z qx qy qz qw, metres, or JSON
{\"translation\": [x, y, z], \"quaternion_xyzw\": [x, y, z, w]}. It is the sensor's; with --hand-eye it is the hand's.

Devices and videos are read through the program `ffmpeg`. The background of the first frames must look like the scene's no-contact image, as for `palpate decode`; where the
scene has none it must have the size and colours of that of the sensor.toml, and another light is a warning. A pose over 10 m from the
camera is none: metres are needed.

Exit status 3: a contact was lost because it had no pose, or none settled.")]
struct TouchArgs {
    /// Video device, like /dev/video0
    #[arg(long, value_name = "DEVICE", conflicts_with = "frames", required_unless_present = "frames")]
    device: Option<PathBuf>,
    /// A folder of images (in the order of their names) or a video, in place of a device
    #[arg(long, value_name = "DIR|VIDEO")]
    frames: Option<PathBuf>,
    /// Size to ask of the device
    #[arg(long, value_name = "WxH")]
    video_size: Option<String>,
    /// Frames a second to ask of the device
    #[arg(long, value_name = "N")]
    frame_rate: Option<u32>,
    /// The sensor: a preset, or the sensor.toml of `palpate calibrate gel` [default: the scene's]
    #[arg(long, value_name = "PRESET|TOML")]
    sensor: Option<String>,
    /// No-contact image [default: that of sensor.toml is for decoding; the first frames are watched against]
    #[arg(long, value_name = "BG")]
    background: Option<PathBuf>,
    /// Where poses come from
    #[arg(long, value_name = "-|file:PATH|tcp:HOST:PORT|unix:PATH")]
    pose: String,
    /// The sensor in the hand (`palpate calibrate sensor-pose`): poses are then the hand's
    #[arg(long, value_name = "TOML")]
    hand_eye: Option<PathBuf>,
    /// Seconds to wait for a pose
    #[arg(long, default_value_t = 5.0, value_name = "S")]
    pose_timeout: f64,
    /// Stop after so many touches
    #[arg(long, value_name = "N")]
    touches: Option<usize>,
    /// Change that is contact, grey levels
    #[arg(long, default_value_t = WatchParams::default().contact, value_name = "LEVELS")]
    contact_level: f32,
    /// Frames that a contact must be still
    #[arg(long, default_value_t = WatchParams::default().settle, value_name = "N")]
    settle: usize,
    /// Scene folder to add touches to
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    match args.what {
        What::Touch(args) => touch(&args),
    }
}

fn touch(args: &TouchArgs) -> anyhow::Result<Outcome> {
    ensure!(
        args.pose_timeout.is_finite() && args.pose_timeout >= 0.0,
        "--pose-timeout {}: a number of seconds ≥ 0 is needed",
        args.pose_timeout
    );
    let scene = SceneAppender::open(&args.output).with_context(|| {
        format!("{} is no scene yet; `palpate init` or `palpate import` make one", args.output.display())
    })?;
    let calibration = args.sensor.as_deref().map(Path::new).filter(|p| p.extension().is_some_and(|e| e == "toml"));
    // Without another the touches will be decoded with the calibration that lies in the scene.
    let own = args.output.join("sensor.toml");
    let used = calibration.or((args.sensor.is_none() && own.is_file()).then_some(&own));
    let file = used.map(read_sensor).transpose()?;
    let reference = match (scene.background(), used, &file) {
        // Touches will be decoded against it, whatever the calibration.
        (Some(path), _, _) => Some(Reference::of_scene(path, file.as_ref().is_some_and(|f| f.markers))?),
        (None, Some(path), Some(file)) => Some(Reference::of_sensor(file, path)?),
        _ => None,
    };
    let calibrated = file.map(|f| f.sensor);
    let sensor = match (calibration, &args.sensor) {
        (Some(_), _) => calibrated,
        (None, Some(name)) => Some(TactileSensor::preset(name)?),
        (None, None) => None,
    };
    ensure!(
        sensor.is_some() || scene.has_sensor(),
        "{}: the scene names no sensor; --sensor is needed",
        args.output.display()
    );
    let hand_eye = args.hand_eye.as_deref().map(read_hand_eye).transpose()?;
    let params = WatchParams { contact: args.contact_level, settle: args.settle, ..WatchParams::default() };
    let watcher = match &args.background {
        Some(path) => ContactWatcher::with_background(params, &read_color(path)?)?,
        None => ContactWatcher::new(params)?,
    };
    let poses = PoseSource::open(&args.pose)?;
    let source =
        FrameSource::open(args.device.as_deref(), args.frames.as_deref(), args.video_size.as_deref(), args.frame_rate)?;
    let view = View::new();
    let session =
        Session { args, scene, sensor, hand_eye, watcher, poses, calibration, reference, view, saved: 0, lost: 0 };
    session.run(source)
}

/// The no-contact image with which frames are compared.
struct Reference {
    no_contact: NoContact,
    markers: bool,
    path: PathBuf,
    /// Whether touches will be decoded against it; else against another of the same sensor, perhaps in another light.
    decisive: bool,
}

impl Reference {
    /// The no-contact image that the scene has.
    fn of_scene(path: &Path, markers: bool) -> anyhow::Result<Self> {
        let image = without_markers(&read_color(path)?, markers);
        let sensor = TactileSensor {
            model: "custom".to_owned(),
            width: image.cols(),
            height: image.rows(),
            // Not looked at where only images are.
            pixel_pitch: 5e-5,
            relaxed_gel: RelaxedGel::Flat,
        };
        let no_contact = NoContact::new(image, &sensor).with_context(|| path.display().to_string())?;
        Ok(Self { no_contact, markers, path: path.to_owned(), decisive: true })
    }

    /// That of the calibration, where the scene has none.
    fn of_sensor(file: &SensorFile, path: &Path) -> anyhow::Result<Self> {
        let image = without_markers(&file.background, file.markers);
        let no_contact = NoContact::new(image, &file.sensor).with_context(|| path.display().to_string())?;
        Ok(Self { no_contact, markers: file.markers, path: path.to_owned(), decisive: false })
    }

    /// The check that decoding makes of an image: size, colours, order of the channels, light. Returns a doubt about the light.
    ///
    /// * `what` – the image, in messages
    fn check(&self, image: &Raster<[u8; 3]>, what: &str) -> anyhow::Result<Option<String>> {
        let image = without_markers(image, self.markers);
        let against = format!("{what}: against the no-contact image of {}", self.path.display());
        match self.no_contact.difference(&image) {
            Ok(_) => Ok(None),
            Err(error @ DecodeError::OtherLight { .. }) if !self.decisive => Ok(Some(format!("{against}: {error}"))),
            Err(error) => Err(error).context(against),
        }
    }
}

fn without_markers(image: &Raster<[u8; 3]>, markers: bool) -> Raster<[u8; 3]> {
    if markers { fill_markers(image, &tactile::markers(image)) } else { image.clone() }
}

#[derive(serde::Deserialize)]
struct HandEye {
    gripper_from_sensor: Pose,
}

#[derive(serde::Deserialize)]
struct Pose {
    translation: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

fn read_hand_eye(path: &Path) -> anyhow::Result<Isometry> {
    let file: HandEye = toml::from_str(&io::read_text(path)?).with_context(|| path.display().to_string())?;
    let pose = file.gripper_from_sensor;
    io::pose(pose.translation, pose.quaternion_xyzw)
        .map_err(|e| anyhow::anyhow!("{}: gripper_from_sensor: {e}", path.display()))
}

/// The farthest from the camera that a touch is taken for one of its scene, metres.
const REACH: f64 = 10.0;

/// A robot that says millimetres is far away.
fn within_reach(world_from_sensor: &Isometry, world_from_camera: &Isometry) -> anyhow::Result<()> {
    let [sensor, camera] = [world_from_sensor, world_from_camera].map(|pose| pose.translation.vector);
    let far = (sensor - camera).norm();
    ensure!(
        far <= REACH,
        "the pose ({:.3}, {:.3}, {:.3}) m is {far:.1} m from the camera, at most {REACH:.0} m is a touch of this scene: metres are needed, are \
         these millimetres?",
        sensor.x,
        sensor.y,
        sensor.z
    );
    Ok(())
}

struct Session<'a> {
    args: &'a TouchArgs,
    scene: SceneAppender,
    sensor: Option<TactileSensor>,
    hand_eye: Option<Isometry>,
    watcher: ContactWatcher,
    poses: PoseSource,
    /// Until it has been put into the scene.
    calibration: Option<&'a Path>,
    /// Until the background of the first frames has been compared with it.
    reference: Option<Reference>,
    view: View,
    saved: usize,
    lost: usize,
}

impl Session<'_> {
    fn run(mut self, mut source: FrameSource) -> anyhow::Result<Outcome> {
        let mut frames = 0;
        while self.args.touches.is_none_or(|n| self.saved < n) {
            match source.next() {
                Frame::Image(image) => {
                    frames += 1;
                    self.frame(&image)?;
                }
                Frame::Gone(reason) => {
                    self.watcher.gap();
                    self.view.say(&format!("palpate: {reason}; waiting for it to come back"));
                    self.view.state("no device");
                }
                Frame::Waiting => self.view.state("no device"),
                Frame::Failed(error) => return Err(error),
                Frame::End => break,
            }
        }
        self.view.finish();
        if frames == 0 {
            bail!("there was no frame");
        }
        println!("{}: {} touches added, {} in all", self.args.output.display(), self.saved, self.scene.touches());
        if self.lost > 0 {
            eprintln!("palpate: {} contacts settled and were not saved, for the reasons above", self.lost);
        } else if self.saved == 0 {
            eprintln!(
                "palpate: no contact settled in {frames} frames; is the gel free at the start, and the touch held still?"
            );
        }
        Ok(if self.lost > 0 || self.saved == 0 { Outcome::Degraded } else { Outcome::Done })
    }

    fn frame(&mut self, image: &Raster<[u8; 3]>) -> anyhow::Result<()> {
        let watched = self.watcher.step(image)?;
        if let Some(background) = self.watcher.background()
            && let Some(reference) = self.reference.take()
        {
            let mut doubt = reference.check(&background, "the background of the first frames")?;
            // A background of a file says nothing about the frames.
            doubt = doubt.or(reference.check(image, "a frame")?);
            if let Some(doubt) = doubt {
                self.view.say(&say::warning(doubt));
            }
        }
        self.view.frame(watched);
        if watched != Watched::Settled {
            return Ok(());
        }
        self.view.state("contact: waiting for a pose");
        let number = self.scene.touches();
        let pose = self.poses.next(Duration::from_secs_f64(self.args.pose_timeout), number).and_then(|pose| {
            let pose = self.hand_eye.map_or(pose, |sensor| pose * sensor);
            within_reach(&pose, &self.scene.world_from_camera())?;
            Ok(pose)
        });
        match pose {
            Ok(pose) => self.save(image, &pose)?,
            Err(error) => {
                self.lost += 1;
                self.view.say(&format!("palpate: a contact was not saved: {error:#}"));
            }
        }
        Ok(())
    }

    fn save(&mut self, image: &Raster<[u8; 3]>, pose: &Isometry) -> anyhow::Result<()> {
        if let Some(path) = self.calibration.take() {
            crate::commands::copy_calibration(path, &self.args.output)?;
        }
        if let Some(sensor) = self.sensor.as_ref().filter(|_| !self.scene.has_sensor()) {
            let background = self.watcher.background().context("there is no background yet")?;
            self.scene.add_sensor(sensor, &background)?;
        }
        let path = self.scene.add_touch(image, pose)?;
        self.saved += 1;
        let t = pose.translation.vector;
        self.view.pose(format!("({:.3}, {:.3}, {:.3}) m", t.x, t.y, t.z));
        self.view.say(&format!("{}: ({:.4}, {:.4}, {:.4}) m", path.display(), t.x, t.y, t.z));
        Ok(())
    }
}

/// One line on a terminal: contact or not, frame rate, last pose. Nothing elsewhere.
struct View {
    bar: ProgressBar,
    recent: std::collections::VecDeque<Instant>,
    pose: String,
}

impl View {
    fn new() -> Self {
        let bar = ProgressBar::new_spinner();
        bar.set_style(ProgressStyle::with_template("{spinner} {msg}").expect("the template is valid"));
        Self { bar, recent: std::collections::VecDeque::new(), pose: "none".to_owned() }
    }

    fn frame(&mut self, watched: Watched) {
        let now = Instant::now();
        self.recent.push_back(now);
        while self.recent.len() > 60 {
            self.recent.pop_front();
        }
        let span = self.recent.front().map_or(0.0, |first| (now - *first).as_secs_f64());
        let rate = if span > 0.0 { (self.recent.len() - 1) as f64 / span } else { 0.0 };
        let state = match watched {
            Watched::WarmUp => "background",
            Watched::NoContact => "no contact",
            Watched::Moving => "CONTACT, moving",
            Watched::Settled => "CONTACT, settled",
            Watched::Held => "CONTACT, saved: lift off",
        };
        self.bar.set_message(format!("{state} | {rate:.0} frames/s | last pose {}", self.pose));
        self.bar.tick();
    }

    fn state(&self, state: &str) {
        self.bar.set_message(format!("{state} | last pose {}", self.pose));
        self.bar.tick();
    }

    fn pose(&mut self, pose: String) {
        self.pose = pose;
    }

    fn say(&self, line: &str) {
        self.bar.suspend(|| eprintln!("{line}"));
    }

    fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
