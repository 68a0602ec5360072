use crate::{Outcome, say};
use anyhow::{Context as _, bail, ensure};
use palpate::camera::{Background, PinholeCamera};
use palpate::geometry::Isometry;
use palpate::io::{NewScene, init_scene, read_camera};
use serde::Deserialize;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Depth image: 16-bit grey PNG, 0 = no reading
    #[arg(long, value_name = "PNG")]
    depth: PathBuf,
    /// fx,fy,cx,cy in pixels; a camera.toml of `palpate calibrate camera`; or a JSON file with these keys (and, optionally,
    /// distortion: k1 k2 p1 p2 k3)
    #[arg(long, value_name = "FX,FY,CX,CY|TOML|JSON", allow_hyphen_values = true)]
    intrinsics: String,
    /// Colour image of the same size and view, PNG or JPEG
    #[arg(long, value_name = "IMAGE")]
    color: Option<PathBuf>,
    /// Mask of the object, PNG, 255 = object; without it the object is segmented
    #[arg(long, value_name = "PNG")]
    mask: Option<PathBuf>,
    /// Metres per unit of the depth image: 0.001 (most drivers) or 0.0001 are usual
    #[arg(long, default_value_t = 0.001, value_name = "M")]
    metres_per_unit: f64,
    /// What a depth of 0 means
    #[arg(long, value_enum, default_value_t = Missing::Unknown)]
    background: Missing,
    /// Overwrite the scene that is already there
    #[arg(long)]
    force: bool,
    /// Folder to make
    #[arg(long, short, value_name = "SCENE")]
    output: PathBuf,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Missing {
    /// Nothing is there: the ray is free
    Absent,
    /// The sensor failed: nothing is known
    Unknown,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    ensure!(
        args.metres_per_unit.is_finite() && args.metres_per_unit > 0.0,
        "--metres-per-unit {}: a finite number > 0 is needed",
        args.metres_per_unit
    );
    let (intrinsics, world_from_camera) = intrinsics(&args.intrinsics)?;
    let new = NewScene {
        intrinsics,
        world_from_camera,
        depth: args.depth,
        color: args.color,
        mask: args.mask,
        metres_per_unit: args.metres_per_unit,
        background: match args.background {
            Missing::Absent => Background::Absent,
            Missing::Unknown => Background::Unknown,
        },
        overwrite: args.force,
    };
    let made = init_scene(&args.output, &new)?;
    made.warnings.iter().for_each(say::warn);
    let depth = made.median_depth.map_or_else(String::new, |z| format!(": median depth {z:.3} m"));
    println!("{}{depth}", args.output.join("scene.toml").display());
    Ok(Outcome::Done)
}

/// Keys that other programs write beside these are no business of ours.
#[derive(Deserialize)]
struct Calibration {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    distortion: serde_json::Value,
}

fn intrinsics(text: &str) -> anyhow::Result<(PinholeCamera, Option<Isometry>)> {
    let camera =
        |[fx, fy, cx, cy]: [f64; 4], distortion| PinholeCamera { width: 1, height: 1, fx, fy, cx, cy, distortion };
    let numbers: Vec<Option<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    if let [Some(fx), Some(fy), Some(cx), Some(cy)] = numbers[..] {
        return Ok((camera([fx, fy, cx, cy], [0.0; 5]), None));
    }
    let path = Path::new(text);
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
        let file = read_camera(path)?;
        return Ok((file.camera, file.world_from_camera));
    }
    if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        bail!("--intrinsics {text}: four numbers FX,FY,CX,CY, a .toml or a .json file are needed");
    }
    let content = std::fs::read_to_string(path).with_context(|| format!("cannot read {text}"))?;
    let found: Calibration =
        serde_json::from_str(&content).with_context(|| format!("{text}: fx, fy, cx and cy are needed"))?;
    // Some programs write a remark where there is no distortion.
    let distortion = if found.distortion.is_array() {
        serde_json::from_value(found.distortion)
            .with_context(|| format!("{text}: distortion must be k1, k2, p1, p2, k3"))?
    } else if found.distortion.is_object() || found.distortion.is_number() {
        bail!("{text}: distortion must be a list k1, k2, p1, p2, k3, not {}", found.distortion);
    } else {
        [0.0; 5]
    };
    Ok((camera([found.fx, found.fy, found.cx, found.cy], distortion), None))
}
