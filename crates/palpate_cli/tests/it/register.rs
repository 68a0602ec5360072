//! `register`: depth and colours of two cameras, and the unit of depth on its way into a scene.

use crate::workshop::{Said, palpate};
use palpate::geometry::Raster;
use palpate::io::{read_scene, write_color, write_depth_png};

const CAMERA: &str = "[camera]\nwidth = 64\nheight = 48\nfx = 60.0\nfy = 60.0\ncx = 31.5\ncy = 23.5\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n";
const MOUNTING: &str = "color_from_depth = { translation = [0.0, 0.0, 0.0], quaternion_xyzw = [0.0, 0.0, 0.0, 1.0] }\n";

struct Pair(tempfile::TempDir);

impl Pair {
    /// A slope from 0.5 to 0.547 m in units of a tenth of a millimetre, red to the left, blue to the right.
    fn new() -> Self {
        let pair = Self(tempfile::tempdir().expect("temporary folder"));
        let depth = Raster::from_fn(48, 64, |r, _| 0.5 + 0.001 * r as f32);
        write_depth_png(pair.path("depth.png"), &depth, 1e-4).expect("written");
        let color = Raster::from_fn(48, 64, |_, c| if c < 32 { [200, 0, 0] } else { [0, 0, 200] });
        write_color(pair.path("color.png"), &color).expect("written");
        std::fs::write(pair.path("camera.toml"), CAMERA).expect("written");
        std::fs::write(pair.path("mounting.toml"), MOUNTING).expect("written");
        pair
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    fn register(&self, more: &[&str]) -> Said {
        let [depth, color, camera] = ["depth.png", "color.png", "camera.toml"].map(|name| self.path(name));
        let (mounting, output) = (self.path("mounting.toml"), self.path("out"));
        let args =
            ["register", "--depth", &depth, "--color", &color, "--depth-camera", &camera, "--color-camera", &camera];
        let rest = ["--extrinsics", &mounting, "--output", &output];
        palpate([&args[..], &rest, more].concat())
    }
}

#[test]
fn the_unit_of_depth_is_carried_on_and_the_next_command_is_said() {
    let pair = Pair::new();
    let said = pair.register(&["--metres-per-unit", "0.0001"]);
    said.expect(0, &["3072 readings of 3072", "--metres-per-unit 0.0001 --output SCENE"]);
    let next = said.out.lines().find_map(|line| line.strip_prefix("next: palpate ")).expect("the next command");
    let scene = pair.path("scene");
    let words = next.split(' ').map(|word| if word == "SCENE" { scene.as_str() } else { word });
    palpate(words).expect(0, &["scene.toml"]);
    let frame = read_scene(&scene).expect("a scene").scene.frame;
    assert!((frame.depth[(20, 9)] - 0.52).abs() < 1e-4, "{}", frame.depth[(20, 9)]);
    let color = frame.color.expect("registered");
    assert_eq!((color[(20, 9)], color[(20, 50)]), ([200, 0, 0], [0, 0, 200]));
}

#[test]
fn what_does_not_belong_together_is_said_and_nothing_is_written() {
    let pair = Pair::new();
    pair.register(&["--metres-per-unit", "0"]).expect(1, &["--metres-per-unit 0: a finite number > 0"]);
    let small = Raster::filled(24, 32, [9; 3]);
    write_color(pair.path("color.png"), &small).expect("written");
    pair.register(&[]).expect(1, &["color.png is 32×24 px, its camera 64×48"]);
    write_color(pair.path("color.png"), &Raster::filled(48, 64, [9; 3])).expect("written");
    std::fs::write(pair.path("mounting.toml"), MOUNTING.replace("1.0]", "0.0]")).expect("written");
    pair.register(&[]).expect(1, &["mounting.toml", "color_from_depth", "a rotation needs length 1"]);
    std::fs::write(pair.path("mounting.toml"), "other = 1\n").expect("written");
    pair.register(&[]).expect(1, &["mounting.toml", "other"]);
    std::fs::write(pair.path("depth.png"), b"\x89PNG").expect("written");
    std::fs::write(pair.path("mounting.toml"), MOUNTING).expect("written");
    pair.register(&[]).expect(1, &["depth.png"]);
    assert!(!std::path::Path::new(&pair.path("out")).exists());
}

#[test]
fn the_folder_of_the_originals_is_no_place_for_the_results() {
    let pair = Pair::new();
    let before = std::fs::read(pair.path("depth.png")).expect("there");
    let here = pair.path("out");
    std::fs::create_dir(&here).expect("made");
    for name in ["depth.png", "color.png", "camera.toml", "mounting.toml"] {
        std::fs::copy(pair.path(name), pair.path(&format!("out/{name}"))).expect("copied");
    }
    let [depth, color, camera, mounting] =
        ["out/depth.png", "out/color.png", "camera.toml", "mounting.toml"].map(|name| pair.path(name));
    let args = ["register", "--depth", &depth, "--color", &color, "--depth-camera", &camera, "--color-camera", &camera];
    let said = palpate([&args[..], &["--extrinsics", &mounting, "--output", &here]].concat());
    said.expect(1, &["--output would overwrite", "depth.png, which is read"]);
    assert_eq!(std::fs::read(depth).expect("there"), before);
}
