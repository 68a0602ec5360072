//! Scenes to break: a small valid one, made through the library.

use assert_cmd::Command;
use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use palpate::geometry::{Isometry, Plane, Point, Raster, Vector};
use palpate::io::{SceneToWrite, write_scene};
use palpate::scene::{PoseSigma, Scene};
use palpate::tactile::{Contact, TactileSensor, Touch};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A folder that holds the scene `s`.
pub(crate) struct Workshop {
    folder: TempDir,
}

/// What a run said.
pub(crate) struct Said {
    pub(crate) status: i32,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Said {
    /// Panics with everything that was said unless the status is right and every text is somewhere in it.
    #[track_caller]
    pub(crate) fn expect(&self, status: i32, texts: &[&str]) -> &Self {
        let all = format!("{}\n{}", self.out, self.err);
        assert_eq!(self.status, status, "{all}");
        for text in texts {
            assert!(all.contains(text), "'{text}' is missing in:\n{all}");
        }
        assert!(!all.contains("panicked"), "{all}");
        self
    }
}

pub(crate) fn palpate<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Said {
    let output =
        Command::new(assert_cmd::cargo::cargo_bin!("palpate")).args(args).output().expect("the program starts");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Said { status: output.status.code().unwrap_or(-1), out: text(output.stdout), err: text(output.stderr) }
}

impl Workshop {
    /// A tiny scene: 64 × 48 pixels.
    pub(crate) fn new() -> Self {
        Self::scaled(1)
    }

    /// The same scene with enough pixels on the object to reconstruct it: 192 × 144.
    pub(crate) fn detailed() -> Self {
        Self::scaled(3)
    }

    fn scaled(scale: usize) -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        write_scene(folder.path().join("s"), &SceneToWrite::new(&scene(scale))).expect("a valid scene");
        Self { folder }
    }

    pub(crate) fn path(&self, relative: &str) -> PathBuf {
        self.folder.path().join(relative)
    }

    pub(crate) fn text(&self, relative: &str) -> String {
        self.path(relative).display().to_string()
    }

    /// Changes the text of scene.toml; what is replaced must be there.
    pub(crate) fn edit(&self, from: &str, to: &str) -> &Self {
        let path = self.path("s/scene.toml");
        let text = std::fs::read_to_string(&path).expect("scene.toml");
        assert!(text.contains(from), "'{from}' is not in\n{text}");
        std::fs::write(&path, text.replacen(from, to, 1)).expect("written");
        self
    }

    /// Cuts a file to a share of its length.
    pub(crate) fn cut(&self, relative: &str, share: f64) -> &Self {
        let bytes = std::fs::read(self.path(relative)).expect("there");
        self.put(relative, &bytes[..(bytes.len() as f64 * share) as usize])
    }

    pub(crate) fn put(&self, relative: &str, bytes: &[u8]) -> &Self {
        std::fs::write(self.path(relative), bytes).expect("written");
        self
    }

    pub(crate) fn check(&self) -> Said {
        palpate([Path::new("check"), &self.path("s")])
    }
}

/// A sphere of 40 mm over a table, seen from 0.4 m above, touched twice on a flat gel.
fn scene(scale: usize) -> Scene {
    let (width, height, focal) = (64 * scale, 48 * scale, 60.0 * scale as f64);
    let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    let camera = PinholeCamera { width, height, fx: focal, fy: focal, cx, cy, distortion: [0.0; 5] };
    let (distance, radius) = (0.4, 0.04);
    let depth = Raster::from_fn(height, width, |row, col| {
        // Camera on the z axis, looking down at a sphere centred at depth 0.4.
        let ray = camera.ray(col as f64, row as f64);
        let half_b = ray.z * distance;
        let discriminant = half_b * half_b - ray.norm_squared() * (distance * distance - radius * radius);
        if discriminant < 0.0 { f32::NAN } else { ((half_b - discriminant.sqrt()) / ray.norm_squared()) as f32 }
    });
    let mask = depth.map(|z| z.is_finite());
    let down = Vector::new(std::f64::consts::PI, 0.0, 0.0);
    let touch = |x: f64| Touch {
        contact: Some(Contact {
            height_map: Raster::from_fn(24, 32, |r, c| {
                if (10..14).contains(&r) && (14..18).contains(&c) { -5e-4 } else { 0.0 }
            }),
            mask: Raster::from_fn(24, 32, |r, c| (10..14).contains(&r) && (14..18).contains(&c)),
        }),
        image: None,
        world_from_sensor: Isometry::new(Vector::new(x, 0.0, 0.04), down),
    };
    Scene {
        name: "sphere".into(),
        frame: Frame {
            camera,
            world_from_camera: Isometry::new(Vector::new(0.0, 0.0, distance), down),
            depth,
            background: Background::Absent,
            noise: DepthNoise { sigma: 0.001, sigma_quadratic: 0.0 },
            color: None,
            mask: Some(mask),
            support: Plane::new(Vector::z(), &Point::new(0.0, 0.0, -radius)),
        },
        sensor: TactileSensor::preset("gelsight-mini").ok(),
        pose_sigma: PoseSigma::default(),
        touches: vec![touch(0.0), touch(0.01)],
    }
}
