//! `capture touch`, a folder of images standing in for the device.

use crate::workshop::{Said, Workshop};
use assert_cmd::Command;
use palpate::geometry::Raster;
use palpate::io::{read_scene, write_color};
use std::path::Path;

/// The gel, pressed so deep (0 to 1).
fn frame(depth: f64) -> Raster<[u8; 3]> {
    Raster::from_fn(240, 320, |r, c| {
        let (y, x) = (r as f64 - 120.0, c as f64 - 150.0);
        let press = if y.hypot(x) < 40.0 { depth * 1.5 * x } else { 0.0 };
        [90.0 + press, 120.0, 140.0 - press].map(|v| v as u8)
    })
}

/// Twelve frames of nothing, then so many presses, let go in between.
pub(crate) fn record(folder: &Path, presses: usize) {
    std::fs::create_dir_all(folder).expect("made");
    let mut depths = vec![0.0; 12];
    for _ in 0..presses {
        depths.extend([0.4, 0.8, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0, 0.0]);
    }
    for (i, depth) in depths.iter().enumerate() {
        write_color(folder.join(format!("{i:04}.png")), &frame(*depth)).expect("written");
    }
}

fn capture(shop: &Workshop, flags: &[&str], input: &str) -> Said {
    let mut args = vec!["capture", "touch"];
    args.extend(flags);
    let scene = shop.text("s");
    args.extend(["--output", &scene]);
    let output = Command::new(assert_cmd::cargo::cargo_bin!("palpate")).args(&args).write_stdin(input).output();
    let output = output.expect("the program starts");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Said { status: output.status.code().unwrap_or(-1), out: text(output.stdout), err: text(output.stderr) }
}

const FIRST: &str = "0.1 0.0 0.3 1 0 0 0\n";
const SECOND: &str = "{\"translation\": [0.2, 0.0, 0.3], \"quaternion_xyzw\": [1, 0, 0, 0]}\n";

#[test]
fn settled_contacts_are_added_with_the_poses_of_standard_input() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 2);
    let frames = shop.text("frames");
    let said = capture(&shop, &["--frames", &frames, "--pose", "-"], &format!("{FIRST}{SECOND}"));
    said.expect(0, &["2 touches added, 4 in all", "touches/002.png: (0.1000, 0.0000, 0.3000) m"]);
    let scene = read_scene(shop.path("s")).expect("still a scene").scene;
    let added: Vec<f64> = scene.touches[2..].iter().map(|t| t.world_from_sensor.translation.x).collect();
    assert_eq!(added, [0.1, 0.2]);
    assert!(scene.touches[2].image.is_some());
}

#[test]
fn a_file_gives_the_pose_and_the_hand_carries_the_sensor() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 1);
    shop.put("pose.txt", FIRST.as_bytes());
    let mounting = "gripper_from_sensor = { translation = [0.0, 0.0, 0.05], quaternion_xyzw = [0.0, 0.0, 0.0, 1.0] }";
    shop.put("hand.toml", mounting.as_bytes());
    let (frames, hand, pose) = (shop.text("frames"), shop.text("hand.toml"), format!("file:{}", shop.text("pose.txt")));
    let flags = ["--frames", &frames, "--pose", &pose, "--hand-eye", &hand, "--touches", "1"];
    capture(&shop, &flags, "").expect(0, &["1 touches added"]);
    let scene = read_scene(shop.path("s")).expect("a scene").scene;
    // The hand looks down from 0.3 m; the gel is 50 mm below it.
    assert!((scene.touches[2].world_from_sensor.translation.z - 0.25).abs() < 1e-12);
}

#[test]
fn a_contact_without_a_pose_is_lost_and_said() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 2);
    let before = std::fs::read(shop.path("s/scene.toml")).expect("there");
    let frames = shop.text("frames");
    let said = capture(&shop, &["--frames", &frames, "--pose", "-"], "");
    said.expect(3, &["a contact was not saved", "there is no pose for touch 2", "0 touches added"]);
    assert!(said.err.contains("2 contacts settled and were not saved"), "{}", said.err);
    assert!(!said.err.contains("no contact settled"), "{}", said.err);
    assert_eq!(std::fs::read(shop.path("s/scene.toml")).expect("there"), before);
    let said = capture(&shop, &["--frames", &frames, "--pose", "-"], &format!("1 2 3\n{SECOND}"));
    said.expect(3, &["'1 2 3' is no pose: seven numbers", "1 touches added, 3 in all"]);
    let missing = format!("file:{}", shop.text("nowhere.txt"));
    let said = capture(&shop, &["--frames", &frames, "--pose", &missing, "--pose-timeout", "0.1"], "");
    said.expect(3, &["no pose for touch 3", "nowhere.txt"]);
}

/// A calibrated sensor whose no-contact image is [`frame`] without a press.
fn sensor(folder: &Path) -> String {
    let text = "format = 2\n\n[sensor]\nmodel = \"custom\"\nwidth = 320\nheight = 240\npixel_pitch = 6e-5\nbackground = \"bg.png\"\n\n[gel]\n\
                map = \"quadratic\"\nmarkers = false\n";
    write_color(folder.join("bg.png"), &frame(0.0)).expect("written");
    let weights = vec![0.0f32; 108];
    std::fs::write(folder.join("gel.toml"), format!("{text}weights = {weights:?}\n")).expect("written");
    folder.join("gel.toml").display().to_string()
}

#[test]
fn frames_of_another_order_than_the_sensors_are_refused_as_by_decode() {
    let shop = Workshop::new();
    let before = std::fs::read(shop.path("s/scene.toml")).expect("there");
    record(&shop.path("frames"), 1);
    let (frames, sensor) = (shop.text("frames"), sensor(shop.path("s").parent().expect("a folder")));
    let run = |more: &[&str]| {
        capture(&shop, &[&["--frames", &frames, "--pose", "-", "--sensor", &sensor], more].concat(), FIRST)
    };
    for entry in std::fs::read_dir(shop.path("frames")).expect("there") {
        let path = entry.expect("an entry").path();
        let image = palpate::io::read_color(&path).expect("written");
        write_color(&path, &image.map(|[r, g, b]| [*b, *g, *r])).expect("written");
    }
    let said = ["red and blue exchanged", "against the no-contact image of ", "gel.toml"];
    run(&[]).expect(1, &said);
    let background = shop.text("bg.png");
    run(&["--background", &background]).expect(1, &[&said[..], &["a frame: "]].concat());
    assert_eq!(std::fs::read(shop.path("s/scene.toml")).expect("there"), before);
    assert!(!shop.path("s/sensor.toml").exists() && !shop.path("s/touches/002.png").exists());
    record(&shop.path("frames"), 1);
    run(&[]).expect(0, &["1 touches added"]);
    assert!(shop.path("s/sensor.toml").exists());
}

#[test]
fn frames_are_compared_with_what_they_will_be_decoded_against() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 1);
    let (frames, gel) = (shop.text("frames"), sensor(shop.path("s").parent().expect("a folder")));
    let run = |more: &[&str]| capture(&shop, &[&["--frames", &frames, "--pose", "-"], more].concat(), FIRST);
    // Another light, which neither a gain nor an offset explains.
    let lamp = Raster::from_fn(240, 320, |r, c| {
        let [red, green, blue] = frame(0.0)[(r, c)];
        if c < 160 { [red + 90, green, blue] } else { [red, green, blue + 90] }
    });
    write_color(shop.path("bg.png"), &lamp).expect("written");
    // The scene has no no-contact image: that of the sensor is only like it.
    let doubt = "palpate: warning: the background of the first frames: against the no-contact image of ";
    run(&["--sensor", &gel]).expect(0, &[doubt, "1 touches added, 3 in all"]);
    // With its own the sensor's light does not matter.
    write_color(shop.path("s/rest.png"), &frame(0.0)).expect("written");
    shop.edit("model = \"gelsight-mini\"\n", "model = \"gelsight-mini\"\nbackground = \"rest.png\"\n");
    let said = run(&["--sensor", &gel]);
    said.expect(0, &["1 touches added, 4 in all"]);
    assert!(!said.err.contains("warning"), "{}", said.err);
    // Its own does.
    write_color(shop.path("s/rest.png"), &lamp).expect("written");
    run(&[]).expect(1, &["rest.png", "levels off the no-contact image"]);
}

#[test]
fn a_pose_in_millimetres_is_no_pose() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 2);
    let frames = shop.text("frames");
    let said = capture(&shop, &["--frames", &frames, "--pose", "-"], &format!("100 0 300 1 0 0 0\n{SECOND}"));
    said.expect(
        3,
        &[
            "the pose (100.000, 0.000, 300.000) m is 315.8 m from the camera",
            "are these millimetres?",
            "1 touches added, 3 in all",
        ],
    );
}

#[test]
fn frames_of_another_size_than_the_sensors_do_not_spoil_the_scene() {
    let shop = Workshop::new();
    let before = std::fs::read(shop.path("s/scene.toml")).expect("there");
    record(&shop.path("frames"), 1);
    for entry in std::fs::read_dir(shop.path("frames")).expect("there") {
        let path = entry.expect("an entry").path();
        let image = palpate::io::read_color(&path).expect("written");
        write_color(&path, &Raster::from_fn(120, 320, |r, c| image[(r + 60, c)])).expect("written");
    }
    let said = capture(&shop, &["--frames", &shop.text("frames"), "--pose", "-"], FIRST);
    said.expect(1, &["the size is 320×120", "320×240"]);
    assert_eq!(std::fs::read(shop.path("s/scene.toml")).expect("there"), before);
    assert!(!shop.path("s/touches/002.png").exists());
}

#[test]
fn what_is_missing_is_said_before_anything_is_recorded() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 0);
    let frames = shop.text("frames");
    capture(&shop, &["--device", "/dev/video_none", "--pose", "-"], "")
        .expect(1, &["/dev/video_none: there is no such device"]);
    capture(&shop, &["--frames", &shop.text("lost"), "--pose", "-"], "")
        .expect(1, &["lost: a folder of images or a video"]);
    capture(&shop, &["--frames", &frames, "--pose", "radio"], "").expect(1, &["--pose radio", "tcp:HOST:PORT"]);
    capture(&shop, &["--frames", &frames, "--pose", "-"], FIRST).expect(3, &["no contact settled in 12 frames"]);
    capture(&shop, &["--pose", "-"], "").expect(2, &["--device"]);
    std::fs::write(shop.path("frames/0005.png"), b"\x89PNG torn").expect("written");
    capture(&shop, &["--frames", &frames, "--pose", "-"], FIRST).expect(1, &["0005.png"]);
    write_color(shop.path("frames/0005.png"), &Raster::filled(10, 20, [9; 3])).expect("written");
    capture(&shop, &["--frames", &frames, "--pose", "-"], FIRST)
        .expect(1, &["a frame is 20×10 px, those before 320×240"]);
    std::fs::remove_file(shop.path("s/scene.toml")).expect("there");
    capture(&shop, &["--frames", &frames, "--pose", "-"], FIRST).expect(1, &["is no scene yet", "palpate init"]);
}

/// A program in place of ffmpeg: gives the frames of a file, then complains and ends, as if the cable had been pulled; called
/// again, the next file's.
#[cfg(unix)]
#[test]
fn a_device_that_is_unplugged_is_waited_for() {
    use std::io::Write as _;
    use std::os::unix::fs::PermissionsExt as _;
    let shop = Workshop::new();
    let ppm = |name: &str, depths: &[f64]| {
        let mut file = std::fs::File::create(shop.path(name)).expect("made");
        for depth in depths {
            let image = frame(*depth);
            write!(file, "P6\n320 240\n255\n").expect("written");
            file.write_all(image.as_slice().as_flattened()).expect("written");
        }
    };
    let press = [0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0];
    // Pulled while pressed and saved: the same press is there when it comes back, and is not saved again.
    ppm("part0", &[&[0.0; 12][..], &press].concat());
    ppm("part1", &[&[1.0; 8][..], &[0.0; 4], &press].concat());
    shop.put("video0", b"").put("count", b"0");
    // The device file goes with the cable.
    let script = "#!/bin/sh\ncd \"$(dirname \"$0\")\"\nn=$(cat count)\necho $((n + 1)) > count\ncat part$n\nrm video0\necho 'No such device' >&2\nexit 1\n";
    shop.put("ffmpeg", script.as_bytes());
    std::fs::set_permissions(shop.path("ffmpeg"), std::fs::Permissions::from_mode(0o755)).expect("set");
    let path =
        format!("{}:{}", shop.path("s").parent().expect("a folder").display(), std::env::var("PATH").expect("set"));
    let (device, scene) = (shop.text("video0"), shop.text("s"));
    let args = ["capture", "touch", "--device", &device, "--pose", "-", "--touches", "2", "--output", &scene];
    let plug = shop.path("video0");
    let hand = std::thread::spawn(move || {
        while plug.exists() {
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        // Longer than capture waits between two looks.
        std::thread::sleep(std::time::Duration::from_millis(700));
        std::fs::write(plug, b"")
    });
    let output = Command::new(assert_cmd::cargo::cargo_bin!("palpate"))
        .args(args)
        .env("PATH", path)
        .write_stdin(format!("{FIRST}{SECOND}"))
        .timeout(std::time::Duration::from_mins(1))
        .output()
        .expect("the program starts");
    hand.join().expect("plugged in again").expect("written");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("video0 is gone") && said.contains("No such device") && said.contains("waiting"), "{said}");
    assert_eq!(read_scene(shop.path("s")).expect("a scene").scene.touches.len(), 4);
}
