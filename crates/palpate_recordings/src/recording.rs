//! A recording of ROS 2 to a scene: one depth frame, its colours, and the tactile images of the touches with their poses.

use crate::messages::{CameraInfo, CompressedImage, Header, Image, PointCloud2, PoseStamped, TransformStamped};
use crate::{ImportError, Imported, Mcap, Message, TfTree, cloud, images};
use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use palpate::geometry::{Isometry, Point, Raster};
use palpate::scene::{PoseSigma, Scene};
use palpate::tactile::{NoContact, TactileSensor, Touch};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Time between messages that belong together, nanoseconds.
const TOGETHER: i64 = 100_000_000;

/// Which moments are touches.
#[derive(Debug, Clone, PartialEq)]
pub enum TouchSource {
    /// Each message of this topic (`PoseStamped`): its stamp and, unless a sensor frame is named, its pose.
    Poses(String),
    /// Stamps, seconds.
    Stamps(Vec<f64>),
    /// Every tactile image that shows contact: for recordings that hold one image a touch.
    EveryContact,
}

/// What to take from a recording.
#[derive(Debug, Clone)]
pub struct RecordingSpec {
    /// File, or folder of rosbag2.
    pub path: PathBuf,
    /// Topic of the depth image (`Image`, `CompressedImage`) or cloud (`PointCloud2`).
    pub depth: String,
    /// Topic of its `CameraInfo`.
    pub info: String,
    /// Topic of the colours, registered to depth; `None` for none.
    pub color: Option<String>,
    /// Topic of the tactile images; `None` for no touches.
    pub tactile: Option<String>,
    /// Which moments are touches.
    pub touches: TouchSource,
    /// Frame of the tactile sensor in the tf tree; `None`: the poses of [`TouchSource::Poses`] are the sensor's.
    pub sensor_frame: Option<String>,
    /// Frame that becomes the world.
    pub world_frame: String,
    /// The sensor.
    pub sensor: Option<TactileSensor>,
    /// No-contact image; `None`: the first tactile image.
    pub tactile_background: Option<Raster<[u8; 3]>>,
    /// Depth frame nearest to this stamp, seconds, which must lie within the recording; `None` for the first.
    pub time: Option<f64>,
    /// A recording without its end counts as far as it goes.
    pub allow_truncated: bool,
}

/// What the first pass finds.
#[derive(Default)]
struct Index {
    topics: BTreeMap<String, String>,
    tf: TfTree,
    info: Option<CameraInfo>,
    poses: Vec<PoseStamped>,
    /// Stamp and order of each message of the image topics.
    stamps: BTreeMap<String, Vec<i64>>,
}

/// Reads a scene out of a recording: twice through the file, nothing of it is kept but what the scene needs.
///
/// # Errors
/// [`ImportError`], which names the topic, the message or the missing link.
pub fn import_recording(spec: &RecordingSpec) -> Result<Imported, ImportError> {
    let index = first_pass(spec)?;
    let topics = [Some(&spec.depth), Some(&spec.info), spec.color.as_ref(), spec.tactile.as_ref()];
    for topic in topics.into_iter().flatten() {
        has_topic(spec, &index, topic)?;
    }
    if let TouchSource::Poses(topic) = &spec.touches {
        has_topic(spec, &index, topic)?;
    }
    let info = index.info.as_ref().ok_or_else(|| nothing(&spec.info, "message of the camera's numbers"))?;
    let camera = camera(info, &spec.info)?;
    let mut warnings = Vec::new();
    let depth_stamp = pick(&index, &spec.depth, spec.time, "depth image")?;
    let color_stamp = match &spec.color {
        None => None,
        Some(topic) => Some(nearest(&index, topic, depth_stamp).ok_or_else(|| {
            nothing(topic, &format!("image within {} ms of the depth frame at {depth_stamp} ns", TOGETHER / 1_000_000))
        })?),
    };
    let moments = moments(spec, &index)?;
    let mut picked = second_pass(spec, depth_stamp, color_stamp, moments.as_deref())?;
    let world_from_camera = index.tf.lookup(&spec.world_frame, &info.header.frame, depth_stamp)?;
    let depth = picked.depth.take().ok_or_else(|| nothing(&spec.depth, "depth image"))?;
    let depth = match depth {
        Depth::Image(depth) => depth,
        Depth::Points(frame, points) => {
            let camera_from_cloud = index.tf.lookup(&info.header.frame, &frame, depth_stamp)?;
            cloud::project(&points, None, &camera, &camera_from_cloud).0
        }
    };
    let size = |what: &str, topic: &str, cols: usize, rows: usize| {
        if (cols, rows) == (camera.width, camera.height) {
            return Ok(());
        }
        let reason = format!(
            "the {what} of topic '{topic}' is {cols}×{rows} px, the camera of '{}' {}×{}",
            spec.info, camera.width, camera.height
        );
        Err(ImportError::Value(reason))
    };
    size("depth image", &spec.depth, depth.cols(), depth.rows())?;
    if let (Some(color), Some(topic)) = (&picked.color, &spec.color) {
        size("colour image", topic, color.cols(), color.rows())?;
    }
    if !depth.as_slice().iter().any(|z| z.is_finite()) {
        return Err(nothing(&spec.depth, "reading: every pixel of the frame is empty"));
    }
    let background = spec.tactile_background.clone().or_else(|| {
        let first = picked.first_tactile.clone()?;
        warnings.push("the first tactile image is taken as the one without contact".to_owned());
        Some(first)
    });
    let touches = touches(spec, &index, picked.touches, background.as_ref(), &mut warnings)?;
    let frame = Frame {
        camera,
        world_from_camera,
        depth,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
        color: picked.color,
        mask: None,
        support: None,
    };
    let name = spec.path.file_stem().map_or_else(|| "recording".to_owned(), |n| n.to_string_lossy().into_owned());
    let sensor = spec.sensor.clone().filter(|_| !touches.is_empty());
    let tactile_background = background.filter(|_| sensor.is_some());
    let scene = Scene { name, frame, sensor, pose_sigma: PoseSigma::default(), touches };
    Ok(Imported { scene, tactile_background, warnings })
}

fn nothing(topic: &str, what: &str) -> ImportError {
    ImportError::Nothing { topic: topic.to_owned(), what: what.to_owned() }
}

fn has_topic(spec: &RecordingSpec, index: &Index, topic: &str) -> Result<(), ImportError> {
    if index.topics.contains_key(topic) {
        return Ok(());
    }
    let known: Vec<String> = index.topics.iter().map(|(topic, kind)| format!("{topic} ({kind})")).collect();
    Err(ImportError::NoTopic { path: spec.path.clone(), topic: topic.to_owned(), known: known.join(", ") })
}

fn parsed<T>(message: &Message, parse: impl Fn(&[u8]) -> Result<T, String>) -> Result<T, ImportError> {
    if message.encoding != "cdr" {
        return Err(ImportError::MessageEncoding { topic: message.topic.clone(), found: message.encoding.clone() });
    }
    parse(&message.data).map_err(|e| ImportError::message(&message.topic, message.log_time, e))
}

fn of_type(message: &Message, needed: &'static [&'static str], said: &'static str) -> Result<(), ImportError> {
    if needed.iter().any(|n| message.kind == *n || message.kind == n.replace("/msg/", "/")) {
        return Ok(());
    }
    Err(ImportError::Type { topic: message.topic.clone(), found: message.kind.clone(), needed: said })
}

const INFO: &[&str] = &["sensor_msgs/msg/CameraInfo"];
const POSE: &[&str] = &["geometry_msgs/msg/PoseStamped"];
const TF: &[&str] = &["tf2_msgs/msg/TFMessage"];
const PICTURES: &[&str] = &["sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"];
const DEPTHS: &[&str] = &["sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2"];

fn first_pass(spec: &RecordingSpec) -> Result<Index, ImportError> {
    let mut index = Index::default();
    let poses = if let TouchSource::Poses(topic) = &spec.touches { Some(topic) } else { None };
    for message in Mcap::open(&spec.path, spec.allow_truncated)? {
        let message = message?;
        let topic = &message.topic;
        if topic == "/tf" || topic == "/tf_static" {
            of_type(&message, TF, "tf2_msgs/msg/TFMessage")?;
            for transform in parsed(&message, TransformStamped::parse_all)? {
                index.tf.insert(transform, topic == "/tf_static");
            }
        } else if *topic == spec.info {
            of_type(&message, INFO, "sensor_msgs/msg/CameraInfo")?;
            if index.info.is_none() {
                index.info = Some(parsed(&message, CameraInfo::parse)?);
            }
        } else if Some(topic) == poses {
            of_type(&message, POSE, "geometry_msgs/msg/PoseStamped")?;
            index.poses.push(parsed(&message, PoseStamped::parse)?);
        } else if *topic == spec.depth || Some(topic) == spec.color.as_ref() || Some(topic) == spec.tactile.as_ref() {
            let stamp = parsed(&message, Header::of)?.stamp;
            index.stamps.entry(topic.clone()).or_default().push(stamp);
        }
        index.topics.entry(message.topic).or_insert(message.kind);
    }
    Ok(index)
}

fn camera(info: &CameraInfo, topic: &str) -> Result<PinholeCamera, ImportError> {
    let wrong = |reason: String| ImportError::message(topic, info.header.stamp.max(0) as u64, reason);
    let d = &info.distortion;
    let distortion = match info.model.as_str() {
        "" if d.iter().all(|&k| k == 0.0) => [0.0; 5],
        "plumb_bob" | "rational_polynomial" if d.iter().skip(5).all(|&k| k == 0.0) => {
            std::array::from_fn(|i| d.get(i).copied().unwrap_or(0.0))
        }
        "rational_polynomial" => {
            return Err(wrong(format!(
                "distortion {d:?} has more than five terms; plumb_bob (k1 k2 p1 p2 k3) is needed"
            )));
        }
        other => return Err(wrong(format!("the distortion model '{other}' is not known; plumb_bob is needed"))),
    };
    let [fx, _, cx, _, fy, cy, ..] = info.k;
    let camera = PinholeCamera { width: info.width, height: info.height, fx, fy, cx, cy, distortion };
    camera.validate().map_err(|e| wrong(e.to_string()))?;
    Ok(camera)
}

/// The stamp of the message nearest to a time, or of the first.
fn pick(index: &Index, topic: &str, time: Option<f64>, what: &str) -> Result<i64, ImportError> {
    let stamps = index.stamps.get(topic).filter(|s| !s.is_empty()).ok_or_else(|| nothing(topic, what))?;
    let Some(time) = time else { return Ok(stamps[0]) };
    let wanted = (time * 1e9) as i64;
    let (first, last) = stamps.iter().fold((i64::MAX, i64::MIN), |(a, b), &s| (a.min(s), b.max(s)));
    let recorded = first.saturating_sub(TOGETHER)..=last.saturating_add(TOGETHER);
    if !time.is_finite() || !recorded.contains(&wanted) {
        let (from, to) = (first as f64 * 1e-9, last as f64 * 1e-9);
        return Err(nothing(topic, &format!("{what} at {time} s; it was recorded from {from:.3} to {to:.3} s")));
    }
    Ok(stamps.iter().copied().min_by_key(|s| s.abs_diff(wanted)).unwrap_or(stamps[0]))
}

fn nearest(index: &Index, topic: &str, stamp: i64) -> Option<i64> {
    let best = index.stamps.get(topic)?.iter().copied().min_by_key(|s| s.abs_diff(stamp))?;
    (best.abs_diff(stamp) <= TOGETHER as u64).then_some(best)
}

/// Stamps of the tactile images to take; `None`: all.
fn moments(spec: &RecordingSpec, index: &Index) -> Result<Option<Vec<i64>>, ImportError> {
    let Some(topic) = &spec.tactile else { return Ok(Some(Vec::new())) };
    let wanted: Vec<i64> = match &spec.touches {
        TouchSource::EveryContact => return Ok(None),
        TouchSource::Poses(_) => index.poses.iter().map(|p| p.header.stamp).collect(),
        TouchSource::Stamps(stamps) => stamps.iter().map(|s| (s * 1e9) as i64).collect(),
    };
    let image = |stamp: i64| {
        nearest(index, topic, stamp).ok_or_else(|| {
            nothing(
                topic,
                &format!("image within {} ms of the touch at {:.3} s", TOGETHER / 1_000_000, stamp as f64 * 1e-9),
            )
        })
    };
    wanted.into_iter().map(image).collect::<Result<_, _>>().map(Some)
}

enum Depth {
    Image(Raster<f32>),
    Points(String, Vec<Point>),
}

#[derive(Default)]
struct Picked {
    depth: Option<Depth>,
    color: Option<Raster<[u8; 3]>>,
    first_tactile: Option<Raster<[u8; 3]>>,
    touches: BTreeMap<i64, Raster<[u8; 3]>>,
}

fn second_pass(
    spec: &RecordingSpec,
    depth_stamp: i64,
    color_stamp: Option<i64>,
    moments: Option<&[i64]>,
) -> Result<Picked, ImportError> {
    let mut picked = Picked::default();
    for message in Mcap::open(&spec.path, spec.allow_truncated)? {
        let message = message?;
        let stamp = |m: &Message| parsed(m, Header::of).map(|h| h.stamp);
        if message.topic == spec.depth && picked.depth.is_none() && stamp(&message)? == depth_stamp {
            of_type(&message, DEPTHS, "sensor_msgs/msg/Image, CompressedImage or PointCloud2")?;
            picked.depth = Some(depth(&message)?);
        }
        let is_color = Some(&message.topic) == spec.color.as_ref();
        if is_color && picked.color.is_none() && Some(stamp(&message)?) == color_stamp {
            picked.color = Some(picture(&message)?);
        }
        if Some(&message.topic) == spec.tactile.as_ref() {
            let at = stamp(&message)?;
            if picked.first_tactile.is_none() {
                picked.first_tactile = Some(picture(&message)?);
            }
            if moments.is_none_or(|m| m.contains(&at)) {
                picked.touches.insert(at, picture(&message)?);
            }
        }
    }
    Ok(picked)
}

fn depth(message: &Message) -> Result<Depth, ImportError> {
    if message.kind.ends_with("PointCloud2") {
        let cloud = parsed(message, PointCloud2::parse)?;
        let points = cloud.points.into_iter().map(Point::from).collect();
        return Ok(Depth::Points(cloud.header.frame, points));
    }
    let depth = |data: &[u8]| {
        if message.kind.ends_with("CompressedImage") {
            images::compressed_depth(&CompressedImage::parse(data)?)
        } else {
            images::depth(&Image::parse(data)?)
        }
    };
    parsed(message, depth).map(Depth::Image)
}

fn picture(message: &Message) -> Result<Raster<[u8; 3]>, ImportError> {
    of_type(message, PICTURES, "sensor_msgs/msg/Image or CompressedImage")?;
    let picture = |data: &[u8]| {
        if message.kind.ends_with("CompressedImage") {
            images::compressed_color(&CompressedImage::parse(data)?)
        } else {
            images::color(&Image::parse(data)?)
        }
    };
    parsed(message, picture)
}

/// Tactile images with their poses.
fn touches(
    spec: &RecordingSpec,
    index: &Index,
    found: BTreeMap<i64, Raster<[u8; 3]>>,
    background: Option<&Raster<[u8; 3]>>,
    warnings: &mut Vec<String>,
) -> Result<Vec<Touch>, ImportError> {
    let Some(topic) = &spec.tactile else { return Ok(Vec::new()) };
    let sensor = spec.sensor.as_ref().ok_or_else(|| ImportError::Value("touches need a tactile sensor".to_owned()))?;
    let at_touch = |stamp: i64| index.poses.iter().min_by_key(|p| p.header.stamp.abs_diff(stamp));
    let no_contact = match (&spec.touches, background) {
        (TouchSource::EveryContact, Some(background)) => {
            let made = NoContact::new(background.clone(), sensor);
            Some(made.map_err(|e| ImportError::Value(format!("topic '{topic}': the no-contact image: {e}")))?)
        }
        _ => None,
    };
    let (mut touches, mut untouched) = (Vec::new(), 0);
    for (stamp, image) in found {
        if (image.cols(), image.rows()) != (sensor.width, sensor.height) {
            let reason = format!(
                "the image is {}×{} px, the sensor's are {}×{} (width × height)",
                image.cols(),
                image.rows(),
                sensor.width,
                sensor.height
            );
            return Err(ImportError::message(topic, stamp.max(0) as u64, reason));
        }
        if let Some(no_contact) = &no_contact {
            let difference = no_contact.difference(&image);
            let difference = difference.map_err(|e| ImportError::message(topic, stamp.max(0) as u64, e.to_string()))?;
            if NoContact::is_untouched(&difference) {
                untouched += 1;
                continue;
            }
        }
        let world_from_sensor: Isometry = match (&spec.sensor_frame, at_touch(stamp)) {
            (Some(frame), pose) => {
                // The moment that was marked, not that of the nearest image.
                let moment = pose.map_or(stamp, |p| p.header.stamp);
                index.tf.lookup(&spec.world_frame, frame, moment)?
            }
            (None, Some(pose)) => {
                index.tf.lookup(&spec.world_frame, &pose.header.frame, pose.header.stamp)? * pose.pose
            }
            (None, None) => {
                return Err(nothing(
                    topic,
                    "pose for its touches: name the sensor's tf frame, or a topic of PoseStamped",
                ));
            }
        };
        touches.push(Touch { contact: None, image: Some(image), world_from_sensor });
    }
    if untouched > 0 {
        warnings.push(format!("{untouched} tactile images show no contact and were left out"));
    }
    if touches.is_empty() {
        warnings.push(format!("topic '{topic}' holds no touch"));
    }
    Ok(touches)
}
