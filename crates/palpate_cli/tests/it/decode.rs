//! `decode`, and `benchmark tactile` on what it wrote.

use crate::workshop::palpate;
use assert_cmd::Command;
use palpate::geometry::Raster;
use palpate::io::{read_color, read_height_map_npy, read_mask, write_color};
use std::path::Path;

type Image = Raster<[u8; 3]>;

/// Lit from three sides, as a GelSight is.
fn light(row: usize, col: usize) -> [u8; 3] {
    let (y, x) = (row as f32 / 48.0, col as f32 / 64.0);
    [(90.0 + 60.0 * x) as u8, (110.0 + 40.0 * y) as u8, (170.0 - 50.0 * x) as u8]
}

/// A round contact that is brighter on one side and darker on the other.
fn touched(row: usize, col: usize) -> [u8; 3] {
    let (y, x) = (row as f32 - 24.0, col as f32 - 30.0);
    let shift = if y.hypot(x) < 9.0 { 4.0 * x } else { 0.0 };
    light(row, col).map(|v| (f32::from(v) + shift) as u8)
}

fn image(value: impl Fn(usize, usize) -> [u8; 3]) -> Image {
    Raster::from_fn(48, 64, value)
}

/// A folder with the background `bg.png`, in which images are decoded by threshold.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        let bench = Self(tempfile::tempdir().expect("temporary folder"));
        bench.put("bg.png", &image(light));
        bench
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    fn put(&self, name: &str, image: &Image) {
        write_color(self.path(name), image).expect("written");
    }

    fn command(&self, images: &[&str]) -> Vec<String> {
        let mut args = vec!["decode".to_owned()];
        args.extend(images.iter().map(|name| self.path(name)));
        for (flag, value) in [("--background", self.path("bg.png")), ("--output", self.path("out"))] {
            args.extend([flag.to_owned(), value]);
        }
        args.extend(["--sensor", "gelsight-mini", "--decoder", "threshold"].map(str::to_owned));
        args
    }

    fn decode(&self, images: &[&str]) -> crate::workshop::Said {
        palpate(self.command(images))
    }

    fn decode_one(&self, value: impl Fn(usize, usize) -> [u8; 3]) -> crate::workshop::Said {
        self.put("touch.png", &image(value));
        self.decode(&["touch.png"])
    }
}

#[test]
fn an_image_gives_a_height_map_a_mask_and_a_picture() {
    let bench = Bench::new();
    bench.put("touch.png", &image(touched));
    let mut args = bench.command(&["touch.png"]);
    args.push("--picture".to_owned());
    palpate(args).expect(0, &["touch: contact on"]);
    let heights = read_height_map_npy(bench.path("out/touch_height.npy")).expect("written");
    let mask = read_mask(bench.path("out/touch_contact.png")).expect("written");
    assert_eq!((heights.shape(), mask.shape()), ((48, 64), (48, 64)));
    assert!(mask[(24, 36)] && mask[(24, 24)] && !mask[(5, 5)]);
    assert!(read_color(bench.path("out/touch_picture.png")).expect("written").cols() > 128);
}

#[test]
fn no_contact_is_the_relaxed_gel_and_no_error() {
    let bench = Bench::new();
    bench.decode_one(light).expect(0, &["touch: no contact"]);
    let heights = read_height_map_npy(bench.path("out/touch_height.npy")).expect("written");
    assert!(heights.as_slice().iter().all(|&z| z == 0.0));
    assert!(!read_mask(bench.path("out/touch_contact.png")).expect("written").as_slice().contains(&true));
}

#[test]
fn images_that_do_not_belong_say_why() {
    let bench = Bench::new();
    let size = "the image is 60×48 px; the no-contact image is 64×48";
    bench.put("touch.png", &Raster::from_fn(48, 60, touched));
    bench.decode(&["touch.png"]).expect(1, &["touch.png", size, "nothing was decoded (1 failed)"]);
    bench.decode_one(|r, c| [touched(r, c)[1]; 3]).expect(1, &["the image is grey"]);
    let swapped = |r, c| {
        let [red, green, blue] = touched(r, c);
        [blue, green, red]
    };
    bench.decode_one(swapped).expect(1, &["red and blue exchanged", "RGB is needed"]);
    bench.decode_one(|r, c| [touched(r, c)[0], 255, 90]).expect(1, &["100 % of the image is over- or underexposed"]);
    bench.decode_one(|r, c| light(r, c).map(|v| v - 50)).expect(1, &["50 levels off the no-contact image"]);
    bench.decode(&["nowhere.png"]).expect(1, &["cannot read", "nowhere.png"]);
    std::fs::write(bench.path("touch.png"), b"P6").expect("written");
    bench.decode(&["touch.png"]).expect(1, &["touch.png: not a readable PNG or JPEG file"]);
}

#[test]
fn one_bad_image_does_not_stop_the_others() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("touches")).expect("made");
    for name in ["touches/a.png", "touches/c.png"] {
        bench.put(name, &image(touched));
    }
    bench.put("touches/b.png", &Raster::filled(10, 10, [9, 99, 200]));
    let said = bench.decode(&["touches"]);
    said.expect(3, &["b.png: the image is 10×10 px", "a: contact", "c: contact"]);
    assert!(Path::new(&bench.path("out/c_height.npy")).is_file());
    assert!(!Path::new(&bench.path("out/b_height.npy")).exists());
}

#[test]
fn an_image_twice_as_large_is_averaged_down() {
    let bench = Bench::new();
    bench.put("touch.png", &Raster::from_fn(96, 128, |r, c| touched(r / 2, c / 2)));
    bench.decode(&["touch.png"]).expect(0, &["touch: contact on"]);
    assert_eq!(read_mask(bench.path("out/touch_contact.png")).expect("written").shape(), (48, 64));
}

#[test]
fn what_is_asked_for_wrongly_is_said_before_anything_is_decoded() {
    let bench = Bench::new();
    bench.put("touch.png", &image(touched));
    std::fs::create_dir(bench.path("empty")).expect("made");
    bench.decode(&["empty"]).expect(1, &["holds no image"]);
    bench.decode(&["touch.png", "touch.png"]).expect(1, &["two images are called 'touch'"]);
    let with = |from: &str, to: &str| {
        let args = bench.command(&["touch.png"]);
        palpate(args.into_iter().map(|a| if a == from { to.to_owned() } else { a }))
    };
    with("gelsight-mini", "gelsite").expect(1, &["'gelsite'", "gelsight-mini"]);
    with("threshold", "lookup").expect(1, &["needs --lookup-table"]);
    with("threshold", "magic").expect(2, &["magic"]);
    bench.put("bg.png", &Raster::from_fn(64, 64, light));
    bench.decode(&["touch.png"]).expect(1, &["background", "64×64 px (width × height)", "64 wide", "48 high"]);
    std::fs::remove_file(bench.path("bg.png")).expect("there");
    bench.decode(&["touch.png"]).expect(1, &["cannot read", "bg.png"]);
    assert!(!Path::new(&bench.path("out/touch_height.npy")).exists());
}

#[test]
fn a_video_without_ffmpeg_says_what_is_missing() {
    let bench = Bench::new();
    std::fs::write(bench.path("press.mp4"), b"not a film").expect("written");
    let output = Command::new(assert_cmd::cargo::cargo_bin!("palpate"))
        .args(bench.command(&["press.mp4"]))
        .env("PATH", bench.path("empty"))
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("`ffmpeg`") && said.contains("not on the PATH"), "{said}");
}

#[test]
fn the_tactile_benchmark_reads_a_folder_of_objects_and_goes_on() {
    let bench = Bench::new();
    palpate(
        [
            "presses",
            "--primitives",
            "1",
            "--count",
            "6",
            "--shard-size",
            "3",
            "--width",
            "64",
            "--light",
            "clean",
            "--depth",
            "1.0",
        ]
        .into_iter()
        .map(str::to_owned)
        .chain(["--output".to_owned(), bench.path("set")]),
    )
    .expect(0, &["2 of 2 shards"]);
    let run = |more: &[&str]| {
        let args =
            ["benchmark", "tactile", &bench.path("set"), "--decoders", "threshold", "--output", &bench.path("out")];
        palpate(args.iter().chain(more))
    };
    run(&["--shard", "2/2"]).expect(0, &["shard 2 of 2: 3 rows"]);
    run(&[]).expect(0, &["6 rows, summary in"]);
    let read = |name: &str| std::fs::read_to_string(bench.path(name)).expect("there");
    let (csv, summary) = (read("out/results.csv"), read("out/summary.md"));
    assert_eq!(csv.lines().count(), 2 + 6);
    assert!(summary.contains("| threshold | 6 | 0 | – |"), "{summary}");
    assert!(summary.contains("No split was given"));
    assert!(read("out/mask.svg").contains("threshold"));
    // Nothing is decoded twice.
    run(&[]).expect(0, &["6 rows"]);
    assert_eq!(read("out/results.csv"), csv);
    run(&["--objects", "teapot"]).expect(1, &["no image is left of 6", "primitive:"]);
    run(&["--limit", "1"]).expect(1, &["results of another kind", "use another --output"]);
}
