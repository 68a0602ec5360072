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
    run("nowhere.mcap", &[]).expect(1, &["cannot read nowhere.mcap"]);
    run(&fixture(), &["--tactile", "/gel/image", "--sensor", "thumb"])
        .expect(1, &["no tactile sensor is called 'thumb'"]);
    palpate(["import", "recording", &fixture(), "--output", &scene]).expect(2, &["--depth"]);
    let deep = folder.path().join("a/b").display().to_string();
    palpate([&["import", "recording", &fixture(), "--output", &deep][..], &TOPICS].concat())
        .expect(1, &["does not exist"]);
    assert!(!Path::new(&scene).exists());
}
