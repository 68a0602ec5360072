//! `import`: from a recording to a scene that checks.

use crate::workshop::palpate;
use palpate::io::read_scene;
use std::path::Path;

fn fixture() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../palpate_recordings/tests/it/fixtures/bench.mcap");
    path.display().to_string()
}

const TOPICS: [&str; 6] = ["--depth", "/camera/depth", "--info", "/camera/info", "--color", "/camera/color"];

#[test]
fn a_recording_becomes_a_scene_and_is_not_overwritten() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = folder.path().join("s").display().to_string();
    let bag = fixture();
    palpate(["import", "recording", &bag, "--list"]).expect(0, &["/gel/image: 3 of sensor_msgs/msg/Image (cdr)"]);
    let base = ["import", "recording", &bag, "--output", &scene];
    let all = [&base[..], &TOPICS].concat();
    palpate(&all).expect(0, &["scene.toml: 0 touches"]);
    palpate(&all).expect(1, &["there is already a scene here; --force overwrites it"]);
    let read = read_scene(&scene).expect("a scene").scene;
    assert_eq!(read.frame.depth.shape(), (48, 64));
    let touches = [
        "--tactile",
        "/gel/image",
        "--touch-on",
        "/touch",
        "--sensor-frame",
        "gel",
        "--sensor",
        "gelsight-mini",
        "--force",
    ];
    palpate([&all[..], &touches].concat())
        .expect(1, &["'/gel/image'", "the image is 64×48 px, the sensor's are 320×240"]);
    palpate(["check", &scene]).expect(0, &[]);
}

#[test]
fn what_is_missing_leaves_no_scene() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = folder.path().join("s").display().to_string();
    let run = |recording: &str, more: &[&str]| {
        palpate([&["import", "recording", recording, "--output", &scene][..], &TOPICS, more].concat())
    };
    run(&fixture(), &["--world-frame", "map"])
        .expect(1, &["no transform from 'camera_optical' to 'map'", "known frames"]);
    let cut = folder.path().join("cut.mcap");
    let bytes = std::fs::read(fixture()).expect("there");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).expect("written");
    run(&cut.display().to_string(), &[]).expect(1, &["cut.mcap: the recording is cut short", "--allow-truncated"]);
    let missing = run("nowhere.mcap", &[]);
    missing.expect(1, &["cannot read nowhere.mcap"]);
    assert_eq!(missing.err.matches("No such file").count(), 1, "{}", missing.err);
    run(&fixture(), &["--time", "999"])
        .expect(1, &["'/camera/depth' has no depth image at 999 s", "recorded from 100.000"]);
    run(&fixture(), &["--tactile", "/gel/image", "--sensor", "thumb"])
        .expect(1, &["no tactile sensor is called 'thumb'"]);
    palpate(["import", "recording", &fixture(), "--output", &scene]).expect(2, &["--depth"]);
    let deep = folder.path().join("a/b").display().to_string();
    palpate([&["import", "recording", &fixture(), "--output", &deep][..], &TOPICS].concat())
        .expect(1, &["does not exist"]);
    assert!(!Path::new(&scene).exists());
}

const CAMERA: &str = "[camera]\nwidth = 64\nheight = 48\nfx = 60.0\nfy = 60.0\ncx = 31.5\ncy = 23.5\n";

/// A cloud of a wall at so many metres, and one point beyond it.
fn cloud(path: &Path, wall: f64, beyond: f64) {
    let mut points: Vec<[f64; 3]> = (0..48 * 64)
        .map(|i| [f64::from(i % 64) - 31.5, f64::from(i / 64) - 23.5, 60.0].map(|v| v * wall / 60.0))
        .collect();
    points[100] = points[100].map(|v| v * beyond / wall);
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        points.len()
    );
    for [x, y, z] in points {
        text.push_str(&format!("{x} {y} {z}\n"));
    }
    std::fs::write(path, text).expect("written");
}

#[test]
fn a_reading_far_away_does_not_stop_an_import() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let at = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(at("camera.toml"), CAMERA).expect("written");
    let run = |name: &str, wall: f64, beyond: f64| {
        cloud(&folder.path().join("cloud.ply"), wall, beyond);
        palpate(["import", "cloud", &at("cloud.ply"), "--camera", &at("camera.toml"), "--output", &at(name)])
    };
    let depth = |name: &str| read_scene(at(name)).expect("a scene").scene.frame.depth;
    run("far", 0.5, 7.0).expect(0, &["the world is the camera's frame"]);
    let read = depth("far");
    assert!((read[(1, 36)] - 7.0).abs() < 1e-4 && (read[(20, 20)] - 0.5).abs() < 1e-4, "{}", read[(1, 36)]);
    run("farther", 0.5, 90.0).expect(3, &["1 readings over 65.535 m"]);
    assert!(depth("farther")[(1, 36)].is_nan());
    run("millimetres", 500.0, 7000.0).expect(1, &["every reading", "are these millimetres?"]);
    assert!(!folder.path().join("millimetres").exists());
    palpate([
        "import",
        "cloud",
        &at("far/depth.png"),
        "--camera",
        &at("camera.toml"),
        "--output",
        &at("far"),
        "--force",
    ])
    .expect(1, &["--output would overwrite", "depth.png, which is read"]);
}
