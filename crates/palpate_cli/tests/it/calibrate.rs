//! `calibrate`: what users get wrong, and a gel from presses to heights.

use crate::workshop::{Said, palpate};
use palpate::geometry::{Point, Raster, Sphere};
use palpate::io::{read_camera, read_height_map_npy, write_color};

type Image = Raster<[u8; 3]>;

/// A folder with images.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("temporary folder"))
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    fn put(&self, name: &str, image: &Image) -> &Self {
        write_color(self.path(name), image).expect("written");
        self
    }

    fn exists(&self, name: &str) -> bool {
        self.0.path().join(name).exists()
    }

    fn camera(&self, board: &str, images: &[&str]) -> Said {
        self.camera_with(board, images, &[])
    }

    fn camera_with(&self, board: &str, images: &[&str], flags: &[&str]) -> Said {
        let mut args = vec!["calibrate".to_owned(), "camera".to_owned()];
        args.extend(images.iter().map(|name| self.path(name)));
        args.extend(["--board", board, "--square", "0.02", "--output"].map(str::to_owned));
        args.push(self.path("camera.toml"));
        args.extend(flags.iter().map(|f| (*f).to_owned()));
        palpate(args)
    }

    /// `calibrate gel` on five presses unless others are named.
    fn gel(&self, presses: &[&str], flags: &[&str]) -> Said {
        let mut args = vec!["calibrate".to_owned(), "gel".to_owned()];
        args.extend(presses.iter().map(|name| self.path(name)));
        args.extend(["--background".to_owned(), self.path("bg.png"), "--output".to_owned(), self.path("sensor.toml")]);
        args.extend(flags.iter().map(|f| (*f).to_owned()));
        palpate(args)
    }
}

/// A board of 5×4 inner corners of 16 px, seen straight on.
fn board(x: f64, y: f64) -> Image {
    Raster::from_fn(120, 160, |row, col| {
        let (c, r) = ((col as f64 - x) / 16.0, (row as f64 - y) / 16.0);
        let inside = (0.0..6.0).contains(&c) && (0.0..5.0).contains(&r);
        let dark = (c.floor() + r.floor()).rem_euclid(2.0) == 0.0;
        [if inside && dark { 30 } else { 220 }; 3]
    })
}

#[test]
fn images_without_a_board_are_named_and_nothing_is_written() {
    let bench = Bench::new();
    bench.put("flat.png", &Raster::filled(120, 160, [90; 3])).put("board.png", &board(20.3, 18.6));
    std::fs::write(bench.path("torn.png"), b"\x89PNG").expect("written");
    let said = bench.camera("5x4", &["flat.png", "torn.png"]);
    said.expect(1, &["flat.png", "no contrast", "torn.png", "no board was found in any of 2 images"]);
    bench
        .camera("9x6", &["board.png"])
        .expect(1, &["no board of 9×6 inner corners", "has 5×4", "inner corners are counted"]);
    bench.camera("4x3", &["board.png"]).expect(1, &["at least", "4×3 were announced"]);
    bench.camera("5x4", &["board.png"]).expect(1, &["1 different views of the board", "at least 3 are needed"]);
    bench.put("again.png", &board(20.3, 18.6)).put("once_more.png", &board(20.3, 18.6));
    let repeated = bench.camera("5x4", &["board.png", "again.png", "once_more.png"]);
    repeated.expect(1, &["1 different views of the board (2 repeat others)"]);
    // Straight on at different places: nothing tells the focal length.
    bench.put("right.png", &board(44.1, 18.2)).put("below.png", &board(20.3, 30.4)).put("both.png", &board(40.7, 28.9));
    bench
        .camera("5x4", &["board.png", "right.png", "below.png", "both.png"])
        .expect(1, &["ill-conditioned", "tilted by 20°"]);
    bench.put("large.png", &Raster::filled(240, 320, [90; 3]));
    bench.camera("5x4", &["board.png", "large.png"]).expect(1, &["large.png is 320×240 px", "board.png is 160×120"]);
    bench.camera("5", &["board.png"]).expect(2, &["'5' is not like 9x6"]);
    bench.camera("5x1", &["board.png"]).expect(1, &["the board's rows is 1"]);
    bench.camera("5x4", &["nowhere.png"]).expect(1, &["cannot read", "nowhere.png"]);
    assert!(!bench.exists("camera.toml"));
}

/// A board of 5×4 inner corners of 20 mm, 0.26 m in front of a camera of f = 300 px, tilted about x and y, four rays a pixel.
fn tilted(about_x: f64, about_y: f64, aside: f64) -> Image {
    let (sx, cx) = about_x.sin_cos();
    let (sy, cy) = about_y.sin_cos();
    // Columns of the rotation R = Ry Rx: the board's axes and its normal in the camera.
    let axes = [[cy, 0.0, -sy], [sy * sx, cx, cy * sx], [sy * cx, -sx, cy * cx]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let middle = [aside, 0.5 * aside, 0.26];
    let shade = |u: f64, v: f64| {
        let ray = [(u - 159.5) / 300.0, (v - 119.5) / 300.0, 1.0];
        let t = dot(axes[2], middle) / dot(axes[2], ray);
        let on = [t * ray[0] - middle[0], t * ray[1] - middle[1], t - middle[2]];
        let (c, r) = (dot(on, axes[0]) / 0.02 + 3.0, dot(on, axes[1]) / 0.02 + 2.5);
        let inside = (0.0..6.0).contains(&c) && (0.0..5.0).contains(&r);
        let dark = (c.floor() + r.floor()).rem_euclid(2.0) == 0.0;
        if inside && dark { 30.0 } else { 220.0 }
    };
    Raster::from_fn(240, 320, |row, col| {
        let part = |i: usize| if i == 0 { -0.25 } else { 0.25 };
        let sum: f64 = (0..4).map(|i| shade(col as f64 + part(i % 2), row as f64 + part(i / 2))).sum();
        [(sum / 4.0).round() as u8; 3]
    })
}

#[test]
fn images_without_a_board_among_good_ones_are_left_out_and_named() {
    let bench = Bench::new();
    let views =
        [(0.5, 0.0, 0.0), (-0.5, 0.1, 0.03), (0.1, 0.5, -0.03), (0.0, -0.5, 0.02), (0.4, 0.4, -0.02), (-0.3, 0.4, 0.0)];
    let names: Vec<String> = (0..views.len()).map(|i| format!("{i}.png")).collect();
    for (name, (x, y, aside)) in names.iter().zip(views) {
        bench.put(name, &tilted(x, y, aside));
    }
    let good: Vec<&str> = names.iter().map(String::as_str).collect();
    // Boards in the middle alone do not tell the lens.
    let flags = ["--fix", "distortion"];
    bench.camera_with("5x4", &good, &flags).expect(0, &["camera.toml: 6 views"]);
    let file = std::fs::read_to_string(bench.path("camera.toml")).expect("written");
    let fx = read_camera(bench.path("camera.toml")).expect("a camera").camera.fx;
    assert!((fx / 300.0 - 1.0).abs() < 0.01, "{fx}");
    bench.put("flat.png", &Raster::filled(240, 320, [90; 3]));
    std::fs::write(bench.path("torn.png"), b"\x89PNG").expect("written");
    let some = [&good[..], &["flat.png", "torn.png"]].concat();
    bench
        .camera_with("5x4", &some, &flags)
        .expect(3, &["flat.png: ", "no contrast", "torn.png", "camera.toml: 6 views"]);
    assert_eq!(std::fs::read_to_string(bench.path("camera.toml")).expect("written"), file, "they change nothing");
}

/// Six views of [`tilted`], by their names.
fn six_views(bench: &Bench, folder: &str) -> Vec<String> {
    let views =
        [(0.5, 0.0, 0.0), (-0.5, 0.1, 0.03), (0.1, 0.5, -0.03), (0.0, -0.5, 0.02), (0.4, 0.4, -0.02), (-0.3, 0.4, 0.0)];
    std::fs::create_dir_all(bench.path(folder)).expect("made");
    let put = |(i, (x, y, aside)): (usize, (f64, f64, f64))| {
        let name = format!("{folder}/{i}.png");
        bench.put(&name, &tilted(x, y, aside));
        name
    };
    views.into_iter().enumerate().map(put).collect()
}

#[test]
fn nothing_that_is_read_is_overwritten() {
    let bench = Bench::new();
    let views = six_views(&bench, "a");
    let views: Vec<&str> = views.iter().map(String::as_str).collect();
    let before = std::fs::read(bench.path("a/0.png")).expect("there");
    let run =
        |images: &[&str], flags: &[&str]| bench.camera_with("5x4", images, &[&["--fix", "distortion"], flags].concat());
    // Into the folder of the pictures.
    let here = bench.path("a");
    run(&views, &["--undistort", &here]).expect(1, &["--undistort", "would overwrite", "a/0.png, which is read"]);
    let around = bench.path("a/../a/.");
    run(&views, &["--undistort", &around]).expect(1, &["would overwrite"]);
    let picture = bench.path("a/0.png");
    run(&views, &["--coverage", &picture]).expect(1, &["--coverage would overwrite", "a/0.png, which is read"]);
    // One file for two things.
    let camera = bench.path("camera.toml");
    run(&views, &["--coverage", &camera]).expect(1, &["--output and --coverage would both be", "camera.toml"]);
    // Fourteen pictures, seven names.
    six_views(&bench, "b");
    let flat = bench.path("flat");
    let both = run(&["a", "b"], &["--undistort", &flat]);
    both.expect(1, &["a/0.png and ", "b/0.png would both be", "flat/0.png"]);
    // A file where a folder is needed.
    std::fs::write(bench.path("file"), "mine").expect("written");
    let file = bench.path("file");
    run(&views, &["--undistort", &file]).expect(1, &["file is a file, a folder is needed"]);
    assert!(!bench.exists("camera.toml") && !bench.exists("flat"), "half a result is none");
    assert_eq!(std::fs::read(bench.path("a/0.png")).expect("there"), before);
    // A picture in place of the camera's file.
    let mut args: Vec<String> = ["calibrate", "camera"].map(str::to_owned).into();
    args.extend(views.iter().map(|v| bench.path(v)));
    args.extend(["--board", "5x4", "--square", "0.02", "--output"].map(str::to_owned));
    args.push(bench.path("a/0.png"));
    palpate(args).expect(1, &["--output would overwrite", "a/0.png, which is read"]);
    assert_eq!(std::fs::read(bench.path("a/0.png")).expect("there"), before);
    run(&[&views[..], &["a/0.png"]].concat(), &["--undistort", &flat]).expect(3, &["repeats another view"]);
    assert!(bench.exists("flat/5.png") && bench.exists("camera.toml"));
}

#[test]
fn what_an_earlier_run_wrote_into_the_pictures_folder_is_no_picture() {
    let bench = Bench::new();
    six_views(&bench, "a");
    let coverage = bench.path("a/coverage.png");
    let flags = ["--fix", "distortion", "--coverage", &coverage];
    bench.camera_with("5x4", &["a"], &flags).expect(0, &["camera.toml: 6 views"]);
    let camera = bench.path("camera.toml");
    let again = [&flags[..], &["--start", &camera]].concat();
    bench.camera_with("5x4", &["a"], &again).expect(0, &["camera.toml: 6 views"]);
    // A board's picture stays one, though its folder alone was named.
    let board = bench.path("a/0.png");
    let flags_0 = ["--fix", "distortion", "--coverage", &board];
    bench.camera_with("5x4", &["a"], &flags_0).expect(1, &["--coverage would overwrite", "0.png, which is read"]);
    // Named, it is one.
    bench.camera_with("5x4", &["a", "a/coverage.png"], &flags).expect(1, &["--coverage would overwrite"]);
    let into = bench.path("a");
    bench.camera_with("5x4", &["a"], &["--undistort", &into]).expect(1, &["would overwrite", "0.png, which is read"]);
}

#[test]
fn infrared_pictures_stay_infrared_without_distortion() {
    use palpate::io::{read_depth_png, write_depth_png};
    let bench = Bench::new();
    let views = six_views(&bench, "a");
    let views: Vec<&str> = views.iter().map(String::as_str).collect();
    for name in &views {
        // 16 bits of grey as a sensor gives them: a few thousand at most.
        let image = palpate::io::read_gray(bench.path(name)).expect("written");
        write_depth_png(bench.path(name), &image.map(|v| 10.0 * v), 1.0).expect("written");
    }
    let flat = bench.path("flat");
    bench.camera_with("5x4", &views, &["--fix", "distortion", "--undistort", &flat]).expect(0, &[]);
    let grey = |name: &str| read_depth_png(bench.path(name), 1.0).expect("16-bit grey");
    let (before, after) = (grey("a/0.png"), grey("flat/0.png"));
    assert_eq!((after[(5, 5)], after[(120, 160)]), (before[(5, 5)], before[(120, 160)]));
}

#[test]
fn pictures_that_do_not_fit_the_camera_are_doubted() {
    let bench = Bench::new();
    let views = six_views(&bench, "a");
    let views: Vec<&str> = views.iter().map(String::as_str).collect();
    // A camera that is kept, and is another's: it sees 15 % too narrow from top to bottom.
    let other = "[camera]\nwidth = 320\nheight = 240\nfx = 300.0\nfy = 345.0\ncx = 159.5\ncy = 119.5\n";
    std::fs::write(bench.path("other.toml"), other).expect("written");
    let start = bench.path("other.toml");
    let said = bench.camera_with("5x4", &views, &["--fix", "focal,centre,distortion", "--start", &start]);
    said.expect(3, &["6 views", "is over 0.5 px", "pictures of two cameras"]);
}

#[test]
fn pairs_that_do_not_belong_together_give_no_mounting() {
    let bench = Bench::new();
    let views = six_views(&bench, "a");
    let views: Vec<&str> = views.iter().map(String::as_str).collect();
    bench.camera_with("5x4", &views, &["--fix", "distortion"]).expect(0, &[]);
    let run = |depth: &[&str], color: &[&str]| {
        let paths = |names: &[&str]| names.iter().map(|n| bench.path(n)).collect::<Vec<_>>();
        let (depth, color, camera, output) =
            (paths(depth), paths(color), bench.path("camera.toml"), bench.path("mounting.toml"));
        let mut args: Vec<&str> = vec!["calibrate", "extrinsics", "--depth"];
        args.extend(depth.iter().map(String::as_str));
        args.push("--color");
        args.extend(color.iter().map(String::as_str));
        args.extend(["--depth-camera", &camera, "--color-camera", &camera, "--board", "5x4", "--square", "0.02"]);
        args.extend(["--output", &output]);
        palpate(args)
    };
    // Shifted by one: each board with the one before.
    let shifted = [&views[1..], &views[..1]].concat();
    run(&views, &shifted).expect(1, &["6 pairs", "do the pairs belong together"]);
    assert!(!bench.exists("mounting.toml"));
    run(&views, &views).expect(0, &["6 pairs, rms 0."]);
    // Two exchanged among six: these are named.
    let exchanged = [views[0], views[2], views[1], views[3], views[4], views[5]];
    let said = run(&views, &exchanged);
    said.expect(1, &["1.png and 2.png contradict most others", "2.png and 1.png contradict most others"]);
    assert!(!said.err.contains("4.png and 4.png"), "{}", said.err);
    run(&views[..2], &views[..2]).expect(0, &["2 of the 3 pairs that can show a wrong one"]);
    let camera = bench.path("camera.toml");
    let args = ["calibrate", "extrinsics", "--depth", &bench.path("a"), "--color", &bench.path("a"), "--depth-camera"];
    let rest = [&camera, "--color-camera", &camera, "--board", "5x4", "--square", "0.02", "--output", &camera];
    palpate([&args[..], &rest].concat()).expect(1, &["--output would overwrite", "camera.toml, which is read"]);
}

const BALL: f64 = 25.0;
const CONTACT: f64 = 17.0;
const PITCH: f64 = 8e-5;
const PRESSES: [&str; 6] = ["a.png", "b.png", "c.png", "d.png", "e.png", "f.png"];
const PLACES: [[f64; 2]; 6] = [[42.0, 42.0], [118.0, 41.0], [80.0, 60.0], [42.0, 78.0], [117.0, 77.0], [97.0, 55.0]];

fn light(row: usize, col: usize) -> [f64; 3] {
    [70.0 + 0.2 * col as f64, 90.0 + 0.3 * row as f64, 120.0 - 0.1 * col as f64]
}

fn background() -> Image {
    Raster::from_fn(120, 160, |row, col| light(row, col).map(|v| v.round() as u8))
}

/// The gel with slopes (0 to 1) as a function of the place.
fn gel(slope: impl Fn(f64, f64) -> [f64; 2]) -> Image {
    Raster::from_fn(120, 160, |row, col| {
        // Matt: as bright as its normal is turned.
        let slope = slope(col as f64, row as f64);
        let length = (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
        let [gx, gy] = slope.map(|g| g / length);
        let gain = [0.6 * gx + 0.2 * gy + 0.1 * gx * gx, 0.5 * gy, 0.3 * gy - 0.5 * gx];
        let light = light(row, col);
        std::array::from_fn(|k| (light[k] * (1.0 + gain[k])).round() as u8)
    })
}

fn press([x, y]: [f64; 2]) -> Image {
    gel(|col, row| {
        let (dx, dy) = (col - x, row - y);
        let r = dx.hypot(dy).max(1e-9);
        let steepest = CONTACT / (BALL * BALL - CONTACT * CONTACT).sqrt();
        let slope = if r < CONTACT {
            r / (BALL * BALL - r * r).sqrt()
        } else {
            steepest * ((28.0 - r) / (28.0 - CONTACT)).clamp(0.0, 1.0)
        };
        [-slope * dx / r, -slope * dy / r]
    })
}

/// Presses of a ball of 2 mm at 0.08 mm a pixel, and the background.
fn gel_bench() -> Bench {
    let bench = Bench::new();
    bench.put("bg.png", &background());
    for (name, place) in PRESSES.iter().zip(PLACES) {
        bench.put(name, &press(place));
    }
    bench
}

#[test]
fn presses_give_a_sensor_that_decodes_others() {
    let bench = gel_bench();
    let flags = |map| ["--ball-radius", "0.002", "--pixel-pitch", "0.00008", "--map", map];
    for map in ["quadratic", "network", "table"] {
        bench.gel(&PRESSES[..5], &flags(map)).expect(0, &["each press by the others: 5 presses", "0.08000 mm a pixel"]);
        let decode =
            ["decode", &bench.path("f.png"), "--sensor", &bench.path("sensor.toml"), "--output", &bench.path("out")];
        palpate(decode).expect(0, &["f: contact on"]);
        let heights = read_height_map_npy(bench.path("out/f_height.npy")).expect("written");
        let [x, y] = PLACES[5];
        let points: Vec<Point> = heights
            .pixels()
            .filter(|(row, col, _)| (*col as f64 - x).hypot(*row as f64 - y) < CONTACT - 1.0)
            .map(|(row, col, &z)| Point::new(PITCH * col as f64, PITCH * row as f64, f64::from(z)))
            .collect();
        let radius = Sphere::fit(&points).expect("curved").radius;
        let allowed = if map == "table" { 0.12 } else { 0.05 };
        assert!((radius / 0.002 - 1.0).abs() < allowed, "{map}: {radius}");
    }
    let json = bench.gel(
        &PRESSES[..5],
        &["--ball-radius", "0.002", "--pixel-pitch", "0.00008", "--json", "--held-out", &bench.path("f.png")],
    );
    json.expect(0, &["\"held_out\":{", "\"residual_mm\":"]);
    serde_json::from_str::<serde_json::Value>(&json.out).expect("one object");
}

#[test]
fn the_pitch_must_be_known_and_its_sources_agree() {
    let bench = gel_bench();
    let ball = ["--ball-radius", "0.002"];
    bench.gel(&PRESSES, &ball).expect(1, &["the size of a pixel is not known", "slopes have no scale"]);
    // Two sizes of balls change nothing.
    let sizes = ["--ball-radius", "0.002,0.002,0.002,0.003,0.003,0.003"];
    bench.gel(&PRESSES, &sizes).expect(1, &["the size of a pixel is not known"]);
    // Grooves of 1 mm.
    bench.put("ruler.png", &gel(|col, _| [0.7 * (col / (1e-3 / PITCH) * std::f64::consts::TAU).sin(), 0.0]));
    let ruler = bench.path("ruler.png");
    let by_ruler = [&ball[..], &["--ruler", &ruler, "--ruler-marks", "0.001"]].concat();
    bench.gel(&PRESSES, &by_ruler).expect(0, &["0.0800"]);
    std::fs::remove_file(bench.path("sensor.toml")).expect("written");
    let wrong = [&by_ruler[..], &["--pixel-pitch", "0.0000634"]].concat();
    bench.gel(&PRESSES, &wrong).expect(1, &["0.06340 mm by --pixel-pitch, but 0.08", "by --ruler"]);
    let (a, b) = (bench.path("a.png"), bench.path("b.png"));
    let apart = [&ball[..], &["--pixel-pitch", "0.0000634", "--apart", &a, &b, "0.00608"]].concat();
    bench.gel(&PRESSES, &apart).expect(1, &["by --apart", "more than 3 % apart"]);
    let flat = [&ball[..], &["--ruler", &a, "--ruler-marks", "0.001"]].concat();
    bench.gel(&PRESSES, &flat).expect(1, &["a.png", "no evenly spaced marks"]);
    assert!(!bench.exists("sensor.toml"));
    let correct = [&ball[..], &["--pixel-pitch", "0.00008", "--apart", &a, &b, "0.00608"]].concat();
    bench.gel(&PRESSES, &correct).expect(0, &["0.08000 mm a pixel"]);
}

#[test]
fn presses_that_cannot_be_used_say_why() {
    let bench = gel_bench();
    let flags = ["--ball-radius", "0.002", "--pixel-pitch", "0.00008"];
    let one_bad = |image: &Image, texts: &[&str]| {
        bench.put("bad.png", image);
        let mut presses = PRESSES[..4].to_vec();
        presses.push("bad.png");
        let said = bench.gel(&presses, &flags);
        said.expect(3, &[&["bad.png"], texts].concat());
        assert!(bench.exists("sensor.toml"));
    };
    one_bad(&background(), &["there is no contact"]);
    one_bad(&press([20.0, 60.0]), &["cut by the border", "20 px from the border"]);
    one_bad(&Raster::filled(120, 160, [255, 200, 90]), &["over- or underexposed"]);
    one_bad(&background().map(|p| p.map(|v| v / 4)), &["off the no-contact image"]);
    one_bad(&Raster::filled(60, 160, [90; 3]), &["160×60 px"]);
    one_bad(&press(PLACES[2]).map(|[r, g, b]| [*b, *g, *r]), &["red and blue exchanged"]);
    std::fs::remove_file(bench.path("sensor.toml")).expect("written");
    bench.put("none.png", &background());
    let none = bench.gel(&["none.png", "none.png", "a.png"], &flags);
    none.expect(1, &["none.png: there is no contact", "1 usable presses; at least 3"]);
    bench.gel(&PRESSES, &["--ball-radius", "2", "--pixel-pitch", "0.00008"]).expect(1, &["the ball radius is 2 m"]);
    let small = ["--ball-radius", "0.001", "--pixel-pitch", "0.00008"];
    bench.gel(&PRESSES, &small).expect(1, &["contact circle has a radius of 1.3", "the ball only 1.000 mm"]);
    bench.gel(&PRESSES, &["--ball-radius", "0.002", "--pixel-pitch", "0.08"]).expect(1, &["pixel_pitch is 0.08 m"]);
    bench
        .gel(&PRESSES, &["--ball-radius", "0.002,0.003", "--pixel-pitch", "0.00008"])
        .expect(1, &["2 values for 6 presses"]);
    bench.put("bg.png", &Raster::filled(60, 90, [90, 100, 120]));
    let other_size = ["a.png: the image is 160×120 px; the no-contact image is 90×60", "0 usable presses"];
    bench.gel(&["a.png", "c.png", "b.png"], &flags).expect(1, &other_size);
    assert!(!bench.exists("sensor.toml"));
}

#[test]
fn presses_that_repeat_others_prove_nothing() {
    let bench = gel_bench();
    let flags = ["--ball-radius", "0.002", "--pixel-pitch", "0.00008"];
    bench.put("copy.png", &press(PLACES[0])).put("again.png", &press(PLACES[0]));
    let five = bench.gel(&["a.png", "copy.png", "again.png", "a.png", "a.png"], &flags);
    five.expect(1, &["copy.png: the press repeats ", "a.png", "1 usable presses; at least 3"]);
    assert!(!bench.exists("sensor.toml"));
    bench
        .gel(&[&PRESSES[..5], &["copy.png"]].concat(), &flags)
        .expect(3, &["copy.png: the press repeats", "5 presses"]);
    let held_out = |names: &[&str]| {
        let paths: Vec<String> = names.iter().map(|n| bench.path(n)).collect();
        let paths: Vec<&str> = paths.iter().map(String::as_str).collect();
        bench.gel(&PRESSES[..5], &[&flags[..], &["--held-out"], &paths].concat())
    };
    held_out(&["f.png", "copy.png"])
        .expect(3, &["copy.png: the press was calibrated with, as ", "held out: 1 presses"]);
    std::fs::remove_file(bench.path("sensor.toml")).expect("written");
    held_out(&PRESSES[..5]).expect(1, &["e.png: the press was calibrated with", "none of the 5 held-out presses"]);
    assert!(!bench.exists("sensor.toml"));
}

/// The ball of 2 mm is pressed 0.54 mm deep; by a diameter for the radius it would be 0.24 mm.
#[test]
fn the_depth_of_the_presses_is_asked_for() {
    let bench = gel_bench();
    for (radius, depth) in [("0.002", "0.54 mm deep"), ("0.004", "0.24 mm deep")] {
        let said = bench.gel(&PRESSES, &["--ball-radius", radius, "--pixel-pitch", "0.00008"]);
        assert!(said.out.contains(depth) && said.out.contains("may be a diameter"), "{}\n{}", said.out, said.err);
    }
}

#[test]
fn a_sensor_does_not_overwrite_what_it_is_made_of() {
    let bench = gel_bench();
    let flags = ["--ball-radius", "0.002", "--pixel-pitch", "0.00008"];
    // The background's own name is a press.
    bench.put("sensor_background.png", &press(PLACES[5]));
    let before = std::fs::read(bench.path("sensor_background.png")).expect("there");
    let said = bench.gel(&[&PRESSES[..4], &["sensor_background.png"]].concat(), &flags);
    said.expect(1, &["the background beside --output would overwrite", "sensor_background.png, which is read"]);
    assert_eq!(std::fs::read(bench.path("sensor_background.png")).expect("there"), before);
    assert!(!bench.exists("sensor.toml"));
    // In a folder of presses it is of an earlier run.
    std::fs::create_dir(bench.path("presses")).expect("made");
    for (i, place) in PLACES.into_iter().enumerate() {
        bench.put(&format!("presses/{i}.png"), &press(place));
    }
    let (folder, background, output) = (bench.path("presses"), bench.path("bg.png"), bench.path("presses/sensor.toml"));
    let args = ["calibrate", "gel", &folder, "--background", &background, "--output", &output];
    for _ in 0..2 {
        palpate(args.iter().chain(&flags)).expect(0, &["each press by the others: 6 presses"]);
        assert!(bench.exists("presses/sensor_background.png"));
    }
}

#[test]
fn a_sensor_file_that_is_wrong_names_its_key() {
    let bench = gel_bench();
    bench.gel(&PRESSES, &["--ball-radius", "0.002", "--pixel-pitch", "0.00008"]).expect(0, &[]);
    let good = std::fs::read_to_string(bench.path("sensor.toml")).expect("written");
    let decode = || {
        palpate([
            "decode",
            &bench.path("f.png"),
            "--sensor",
            &bench.path("sensor.toml"),
            "--output",
            &bench.path("out"),
        ])
    };
    for (from, to, said) in [
        ("format = 2", "format = 1", "format = 1; this version reads format = 2"),
        ("map = \"quadratic\"", "map = \"cubic\"", "known: quadratic, network, table"),
        ("weights = [", "weights = [1.0, ", "109 numbers are not a map"),
        ("pixel_pitch = 8e-5", "pixel_pitch = 0.08", "pixel_pitch is 0.08 m"),
        ("width = 160", "width = 320", "sensor_background.png: the size is 160×120"),
        ("sensor_background.png", "lost.png", "lost.png"),
    ] {
        assert!(good.contains(from), "{good}");
        std::fs::write(bench.path("sensor.toml"), good.replacen(from, to, 1)).expect("written");
        decode().expect(1, &[said]);
    }
}

#[test]
fn records_of_a_robot_that_are_wrong_say_why() {
    let bench = Bench::new();
    let run = |text: &str, more: &[&str]| {
        std::fs::write(bench.path("records.toml"), text).expect("written");
        let mut args = vec!["calibrate".to_owned(), "sensor-pose".to_owned(), bench.path("records.toml")];
        args.extend(more.iter().map(|m| (*m).to_owned()));
        args.extend(["--output".to_owned(), bench.path("pose.toml")]);
        palpate(args)
    };
    let record = "[[records]]\nimage = \"a.png\"\nbase_from_hand = { translation = [0.0, 0.0, 0.5], quaternion_xyzw = [0.0, 0.0, 0.0, 0.0] }\n";
    run(record, &["--target", "ball"]).expect(1, &["record 0 base_from_hand", "a rotation needs length 1"]);
    run("records = 3", &["--target", "ball"]).expect(1, &["records.toml", "invalid type"]);
    let sound = record.replace("[0.0, 0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, 1.0]");
    run(&sound, &["--target", "ball"]).expect(1, &["needs --ball-radius and --sensor"]);
    run(&sound, &["--target", "board"]).expect(1, &["needs --camera, --board and --square"]);
    let over = sound.replace("a.png", "pose.toml");
    run(&over, &["--target", "ball"]).expect(1, &["--output would overwrite", "pose.toml, which is read"]);
    assert!(!bench.exists("pose.toml"));
}
