use crate::{Outcome, say};
use anyhow::Context as _;
use palpate::camera::{SegmentParams, clean_cloud, segment_object};
use palpate::geometry::{Point, PointCloud};
use palpate::io::{self, SceneFile};
use std::path::{Path, PathBuf};

/// More of the outline on the image border than this, and the object is cut off.
const CUT_OFF: f64 = 0.01;

/// Cut the object out of an RGB-D frame or a point cloud
///
/// Writes its points with normals that face the sensor: of a scene in the world frame, of a cloud in the cloud's own.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Scene folder, or a .pcd or .ply cloud
    scene: PathBuf,
    /// Cloud to write: .ply
    #[arg(long, short, value_name = "CLOUD")]
    output: PathBuf,
    /// Pixel on the wanted object; default: the object nearest the image centre
    #[arg(long, value_name = "U,V", value_parser = pixel)]
    pick: Option<(f64, f64)>,
    /// Where the sensor stood, in the cloud's frame, metres (clouds only)
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, default_value = "0,0,0")]
    viewpoint: Point,
    /// Seed of the plane search
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

/// Parses `U,V`.
pub(crate) fn pixel(text: &str) -> Result<(f64, f64), String> {
    let [u, v] = numbers(text, "U,V, two numbers in pixels")?;
    Ok((u, v))
}

/// A pick is for scenes without a mask.
pub(crate) fn warn_of_unused_pick(pick: Option<(f64, f64)>, file: &mut SceneFile) {
    if pick.is_some() && file.scene.frame.mask.is_some() {
        file.warnings.push("--pick is not used: the scene's mask says what the object is".to_owned());
    }
}

fn point(text: &str) -> Result<Point, String> {
    Ok(Point::from(numbers::<3>(text, "X,Y,Z, three numbers in metres")?))
}

fn numbers<const N: usize>(text: &str, needed: &str) -> Result<[f64; N], String> {
    let values: Option<Vec<f64>> =
        text.split(',').map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    values.and_then(|v| v.try_into().ok()).ok_or_else(|| format!("'{text}' is not {needed}"))
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    // A wrong output path must not cost the user the run.
    io::check_cloud_output(&args.output)?;
    let params = SegmentParams { pick: args.pick, seed: args.seed, ..SegmentParams::default() };
    let (cloud, outcome) = if is_cloud(&args.scene) {
        if args.pick.is_some() {
            anyhow::bail!("{}: --pick needs an image; a cloud has none", args.scene.display());
        }
        let cloud = io::read_cloud(&args.scene)?;
        let clean = clean_cloud(&cloud, &args.viewpoint, &params)
            .with_context(|| format!("cleaning {}", args.scene.display()))?;
        println!("{} of {} points kept", clean.cloud.len(), cloud.len());
        (clean.cloud, Outcome::Done)
    } else {
        clean_scene(&args.scene, &params)?
    };
    io::write_cloud(&args.output, &cloud)?;
    Ok(outcome)
}

fn is_cloud(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcd") || e.eq_ignore_ascii_case("ply"))
}

fn clean_scene(path: &Path, params: &SegmentParams) -> anyhow::Result<(PointCloud, Outcome)> {
    let mut file = io::read_scene(path)?;
    warn_of_unused_pick(params.pick, &mut file);
    file.warnings.iter().for_each(say::warn);
    let frame = &file.scene.frame;
    let visible = segment_object(frame, params).with_context(|| format!("finding the object in {}", path.display()))?;
    let cloud = visible.cloud(frame);
    let readings = frame.depth.as_slice().iter().filter(|z| z.is_finite()).count();
    println!("{} of {readings} readings kept", cloud.len());
    match visible.support {
        Some(s) => println!(
            "support plane: normal {:.4} {:.4} {:.4}, offset {:.4} m",
            s.normal.x, s.normal.y, s.normal.z, s.offset
        ),
        None => println!("support plane: none seen"),
    }
    if visible.border_share > CUT_OFF {
        say::warn(format!(
            "{:.0} % of the object's outline lies on the image border: part of it is not seen",
            100.0 * visible.border_share
        ));
        return Ok((cloud, Outcome::Degraded));
    }
    Ok((cloud, Outcome::Done))
}
