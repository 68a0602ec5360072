//! Recordings written by others: `fixtures/bench.mcap` and `packed.mcap` by the Python package `mcap`; where Python has it and `rosbags`,
//! every compression and a rosbag2 folder are written anew by `fixtures/make_recording.py`.

use palpate::geometry::Vector;
use palpate::io::{SceneToWrite, read_scene, write_scene};
use palpate::tactile::{RelaxedGel, TactileSensor};
use palpate_recordings::{ImportError, Imported, RecordingSpec, TouchSource, import_recording, summarise};
use std::path::{Path, PathBuf};
use std::process::Command;

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/fixtures/bench.mcap")
}

/// The same moments as a cloud and as PNG and JPEG.
fn packed_fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/fixtures/packed.mcap")
}

pub(crate) fn spec(path: &Path) -> RecordingSpec {
    RecordingSpec {
        path: path.to_owned(),
        depth: "/camera/depth".into(),
        info: "/camera/info".into(),
        color: Some("/camera/color".into()),
        tactile: Some("/gel/image".into()),
        touches: TouchSource::Poses("/touch".into()),
        sensor_frame: Some("gel".into()),
        world_frame: "world".into(),
        sensor: Some(TactileSensor {
            model: "custom".into(),
            width: 64,
            height: 48,
            pixel_pitch: 2e-4,
            relaxed_gel: RelaxedGel::Flat,
        }),
        tactile_background: None,
        time: None,
        allow_truncated: false,
    }
}

/// Everything that the script put into the recording.
fn check(imported: &Imported) {
    let frame = &imported.scene.frame;
    assert_eq!((frame.camera.fx, frame.camera.cy, frame.camera.distortion[0]), (60.0, 23.5, 0.01));
    assert!(frame.depth[(0, 0)].is_nan());
    assert_eq!((frame.depth[(10, 5)], frame.depth[(47, 63)]), (0.610, 0.645));
    assert_eq!(frame.color.as_ref().expect("recorded")[(3, 4)], [15, 12, 7], "bgr8 became RGB");
    let camera = frame.world_from_camera;
    assert!((camera.translation.vector - Vector::new(0.1, 0.0, 0.6)).norm() < 1e-12);
    assert!((camera.rotation * Vector::z() + Vector::z()).norm() < 1e-12, "looks down");
    let touches = &imported.scene.touches;
    // The hand at 0.5 s and, between two transforms, at 0.75 s; the gel 50 mm below it.
    for (touch, x) in touches.iter().zip([0.10, 0.15]) {
        let at = touch.world_from_sensor.translation.vector;
        assert!((at - Vector::new(x, 0.0, 0.15)).norm() < 1e-9, "{at}");
        assert!(touch.image.as_ref().expect("an image")[(24, 38)][0] > 110);
    }
    assert_eq!(touches.len(), 2);
    assert_eq!(imported.tactile_background.as_ref().expect("the first")[(24, 38)], [128, 134, 139]);
}

fn packed(path: &Path, depth: &str) -> RecordingSpec {
    RecordingSpec {
        depth: depth.into(),
        color: Some("/camera/color/compressed".into()),
        tactile: Some("/gel/image/compressed".into()),
        ..spec(path)
    }
}

/// Depth by any way is the depth of the other fixture; colours are exact as PNG and near as JPEG.
fn check_packed(path: &Path) {
    let plain = import_recording(&spec(&fixture())).expect("complete").scene.frame.depth;
    for topic in ["/camera/points", "/camera/depth/compressed", "/camera/depth/compressedDepth"] {
        let imported = import_recording(&packed(path, topic)).unwrap_or_else(|e| panic!("{topic}: {e}"));
        let frame = &imported.scene.frame;
        assert_eq!(frame.depth.shape(), plain.shape());
        for (found, needed) in frame.depth.as_slice().iter().zip(plain.as_slice()) {
            assert!((found - needed).abs() < 1e-6 || found.is_nan() && needed.is_nan(), "{topic}: {found} {needed}");
        }
        assert_eq!(frame.color.as_ref().expect("recorded")[(3, 4)], [15, 12, 7], "bgr8 became RGB");
        let background = imported.tactile_background.as_ref().expect("the first")[(24, 38)];
        let near = background.iter().zip([128u8, 134, 139]).all(|(a, b)| a.abs_diff(b) <= 4);
        assert!(near, "{background:?}");
        assert_eq!(imported.scene.touches.len(), 2);
        assert!(imported.scene.touches[1].image.as_ref().expect("an image")[(24, 38)][0] > 145);
    }
}

#[test]
fn clouds_and_compressed_images_give_the_same_scene() {
    check_packed(&packed_fixture());
    let depth_alone = |topic| RecordingSpec { color: None, ..packed(&packed_fixture(), topic) };
    let wrong = fails(&depth_alone("/gel/image/compressed"));
    assert!(wrong.contains("'rgb8; jpeg compressed bgr8' is not a PNG; 16UC1 as PNG is needed"), "{wrong}");
    let wrong = fails(&depth_alone("/camera/color/compressed"));
    assert!(wrong.contains("a depth image is 16-bit grey"), "{wrong}");
    let cloud = RecordingSpec { color: Some("/camera/points".into()), ..packed(&packed_fixture(), "/camera/points") };
    let wrong = fails(&cloud);
    assert!(wrong.contains("'sensor_msgs/msg/PointCloud2'; sensor_msgs/msg/Image or CompressedImage"), "{wrong}");
}

#[test]
fn a_recording_of_another_program_becomes_a_scene() {
    let topics = summarise(&fixture(), false).expect("readable");
    assert_eq!((topics["/tf"].count, topics["/gel/image"].count), (11, 3));
    assert_eq!(topics["/camera/depth"].kind, "sensor_msgs/msg/Image");
    let imported = import_recording(&spec(&fixture())).expect("complete");
    check(&imported);
    // What is written reads back as a scene.
    let folder = tempfile::tempdir().expect("temporary folder");
    let background = imported.tactile_background.as_ref();
    let what = SceneToWrite { tactile_background: background, ..SceneToWrite::new(&imported.scene) };
    write_scene(folder.path().join("s"), &what).expect("written");
    assert_eq!(read_scene(folder.path().join("s")).expect("a scene").scene.touches.len(), 2);
    // The poses of /touch are the gel's in the hand's frame.
    let by_pose = RecordingSpec { sensor_frame: None, ..spec(&fixture()) };
    check(&import_recording(&by_pose).expect("complete"));
    let by_contact = RecordingSpec { touches: TouchSource::EveryContact, ..spec(&fixture()) };
    check(&import_recording(&by_contact).expect("complete"));
    let by_stamp = RecordingSpec { touches: TouchSource::Stamps(vec![100.5, 100.75]), ..spec(&fixture()) };
    check(&import_recording(&by_stamp).expect("complete"));
}

#[test]
fn every_compression_and_rosbag2_are_read() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/fixtures/make_recording.py");
    let python = std::env::var("PALPATE_PYTHON").unwrap_or_else(|_| "python3".into());
    let has = Command::new(&python).args(["-c", "import mcap_ros2, rosbags, numpy, PIL"]).output();
    if !has.is_ok_and(|o| o.status.success()) {
        eprintln!("SKIPPED: recordings made anew: {python} lacks mcap-ros2-support, rosbags, numpy or pillow");
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let make = |compression: &str, what: &str| {
        let file = folder.path().join(format!("{compression}_{what}.mcap"));
        let bag = folder.path().join(format!("bag_{compression}_{what}"));
        let args = [&file, Path::new(compression), &bag, Path::new(what)];
        let run = Command::new(&python).arg(&script).args(args).output().expect("runs");
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        [file, bag]
    };
    for compression in ["zstd", "lz4", "none"] {
        for path in make(compression, "plain") {
            check(&import_recording(&spec(&path)).expect("complete"));
        }
    }
    for path in make("zstd", "packed") {
        check_packed(&path);
    }
}

fn fails(spec: &RecordingSpec) -> String {
    import_recording(spec).expect_err("something is wrong").to_string()
}

#[test]
fn what_is_missing_is_named() {
    let good = spec(&fixture());
    let wrong = |change: &dyn Fn(&mut RecordingSpec)| {
        let mut spec = good.clone();
        change(&mut spec);
        fails(&spec)
    };
    let topic = wrong(&|s| s.depth = "/depth".into());
    assert!(topic.contains("no topic '/depth'") && topic.contains("/camera/depth (sensor_msgs/msg/Image)"), "{topic}");
    let kind = wrong(&|s| s.info = "/camera/depth".into());
    assert!(kind.contains("'sensor_msgs/msg/Image'; sensor_msgs/msg/CameraInfo is needed"), "{kind}");
    let encoding = wrong(&|s| s.depth = "/camera/color".into());
    assert!(encoding.contains("depth is encoded as 'bgr8'; 16UC1"), "{encoding}");
    let encoding = wrong(&|s| s.color = Some("/camera/depth".into()));
    assert!(encoding.contains("colour is encoded as '16UC1'"), "{encoding}");
    let link = wrong(&|s| s.world_frame = "map".into());
    assert!(
        link.contains("no transform from 'camera_optical' to 'map'") && link.contains("known frames: camera_optical"),
        "{link}"
    );
    let frame = wrong(&|s| s.sensor_frame = Some("thumb".into()));
    assert!(frame.contains("from 'thumb' to 'world'"), "{frame}");
    let late = wrong(&|s| s.touches = TouchSource::Stamps(vec![104.0]));
    assert!(late.contains("no image within 100 ms of the touch at 104.000 s"), "{late}");
    let pose = wrong(&|s| (s.touches, s.sensor_frame) = (TouchSource::Stamps(vec![100.5]), None));
    assert!(pose.contains("'/gel/image' has no pose for its touches"), "{pose}");
    let size = wrong(&|s| s.sensor = TactileSensor::preset("digit").ok());
    assert!(size.contains("the image is 64×48 px, the sensor's are 320×240"), "{size}");
    let size = wrong(&|s| (s.tactile, s.touches) = (Some("/touch".into()), TouchSource::Stamps(vec![100.5])));
    assert!(size.contains("'geometry_msgs/msg/PoseStamped'; sensor_msgs/msg/Image or CompressedImage"), "{size}");
}

#[test]
fn a_recording_cut_short_is_an_error_unless_that_is_allowed() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let bytes = std::fs::read(fixture()).expect("there");
    // The last fifth is an index, which is not needed.
    for share in [0.1, 0.5, 0.7] {
        let path = folder.path().join("cut.mcap");
        std::fs::write(&path, &bytes[..(bytes.len() as f64 * share) as usize]).expect("written");
        let error = summarise(&path, false).expect_err("cut");
        assert!(matches!(error, ImportError::Truncated { .. }), "{share}: {error}");
        assert!(error.to_string().contains("cut.mcap: the recording is cut short"), "{error}");
        assert!(summarise(&path, true).is_ok());
    }
}

#[test]
fn hostile_bytes_are_errors() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("bad.mcap");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("written");
        summarise(&path, true)
    };
    assert!(read(b"").is_err() && read(b"SQLite format 3\0").is_err());
    let bytes = std::fs::read(fixture()).expect("there");
    // Each byte of the first records, and some of the rest, turned: an error or another reading, never a panic.
    for at in (0..bytes.len()).filter(|at| *at < 600 || at.is_multiple_of(97)) {
        let mut bad = bytes.clone();
        bad[at] ^= 0xff;
        let _ = read(&bad);
        let _ = import_recording(&RecordingSpec { allow_truncated: true, ..spec(&path) });
    }
    let outside = fails(&RecordingSpec { time: Some(999.0), ..spec(&fixture()) });
    assert!(outside.contains("has no depth image at 999 s; it was recorded from 100.000 to"), "{outside}");
    let error = summarise(folder.path().join("none.mcap").as_path(), false).expect_err("missing").to_string();
    assert!(error.contains("cannot read") && error.contains("none.mcap"), "{error}");
    let empty = tempfile::tempdir().expect("temporary folder");
    assert!(fails(&spec(empty.path())).contains("the folder holds no .mcap file"));
    std::fs::write(empty.path().join("x.db3"), b"SQLite format 3\0").expect("written");
    assert!(fails(&spec(empty.path())).contains("x.db3 is not MCAP; convert it with `ros2 bag convert`"));
}
