use super::boards::{self, BoardArgs, Search, name};
use crate::Outcome;
use crate::targets::{Targets, one_name};
use anyhow::{Context as _, bail};
use palpate::calibrate::camera::{
    BoardView, CameraCalibration, Fixed, Outliers, calibrate_camera, coverage, draw_coverage,
};
use palpate::camera::{PinholeCamera, undistort_color, undistort_gray};
use palpate::io::{
    CameraFile, Picture, create_folder, read_camera, read_picture, write_camera, write_color, write_picture,
};
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Error from which the user is warned, pixels: docs/bench-guide.md.
const RMS_LIMIT: f64 = 0.5;

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate calibrate camera pictures/ --board 9x6 --square 0.025 --output camera.toml --coverage coverage.png
  palpate calibrate camera ir/*.png --board 9x6 --square 0.025 --fix k3 --output infrared.toml

Ten to twenty pictures are good: the board tilted by 20° to 45° to all sides, near and far, and into each corner of the image. camera.toml holds the
table [camera] of a scene. Good: rms under 0.3 px, fx ± under 0.5 %.

Exit status 1: no calibration, and nothing is written; 3: done, but some images showed no board or fit badly, rms is over 0.5 px, or k3 had to
be kept.")]
pub(crate) struct Args {
    /// Pictures of the board, or folders of them; colour, grey, or 16-bit infrared (cover the projector)
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    #[command(flatten)]
    board: BoardArgs,
    /// File for the camera
    #[arg(short, long, value_name = "TOML")]
    output: PathBuf,
    /// Parameters to keep: aspect (fx = fy), centre, focal, k1, k2, tangential (p1, p2), k3, distortion (all five)
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAME")]
    fix: Vec<Fix>,
    /// A camera to start from, may be the one of --output; parameters of --fix keep its values, and not 0
    #[arg(long, value_name = "TOML")]
    start: Option<PathBuf>,
    /// Leave out pictures that fit over three times worse than the usual one
    #[arg(long)]
    drop_outliers: bool,
    /// Write the pictures without distortion into this folder, as PNG of their names; 16-bit grey stays so
    #[arg(long, value_name = "DIR")]
    undistort: Option<PathBuf>,
    /// Draw where in the image the corners fell; no picture of the board where it lies in a folder of them
    #[arg(long, value_name = "PNG")]
    coverage: Option<PathBuf>,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
enum Fix {
    Aspect,
    Centre,
    Focal,
    K1,
    K2,
    Tangential,
    K3,
    Distortion,
}

fn fixed(names: &[Fix]) -> Fixed {
    let names: BTreeSet<Fix> = names.iter().copied().collect();
    let has = |name: Fix| names.contains(&name);
    let lens = |name: Fix| has(name) || has(Fix::Distortion);
    Fixed {
        aspect: has(Fix::Aspect),
        principal_point: has(Fix::Centre),
        focal: has(Fix::Focal),
        k1: lens(Fix::K1),
        k2: lens(Fix::K2),
        tangential: lens(Fix::Tangential),
        k3: lens(Fix::K3),
    }
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let board = args.board.board()?;
    // An earlier run's picture in the folder of the boards; another name would be a board's.
    let of_coverage = |p: &&Path| p.file_stem().is_some_and(|stem| stem.to_string_lossy().contains("coverage"));
    let own: Vec<&Path> = args.coverage.as_deref().filter(of_coverage).into_iter().collect();
    let images = boards::images(&args.images, &own)?;
    check_targets(&args, &images)?;
    let start = args.start.as_ref().map(read_camera).transpose()?;
    let search = boards::search(&images, &args.board)?;
    for (_, reason) in &search.failed {
        eprintln!("palpate: {reason}");
    }
    if search.found.is_empty() {
        bail!("no board was found in any of {} images", search.failed.len());
    }
    if let Some(start) = &start {
        let found = (start.camera.width, start.camera.height);
        if found != search.size {
            bail!(
                "--start is a camera of {}×{} px; the images are {}×{}",
                found.0,
                found.1,
                search.size.0,
                search.size.1
            );
        }
    }
    let views: Vec<BoardView> = search.found.iter().map(|f| f.view.clone()).collect();
    let outliers = if args.drop_outliers { Outliers::Drop } else { Outliers::Keep };
    let result =
        calibrate_camera(&board, &views, search.size, fixed(&args.fix), start.as_ref().map(|s| &s.camera), outliers)
            .with_context(|| format!("{} boards in {} images", views.len(), views.len() + search.failed.len()))?;
    let file = CameraFile { camera: result.camera, world_from_camera: None };
    if let Some(path) = &args.coverage {
        write_color(path, &draw_coverage(&views, search.size))?;
    }
    if let Some(folder) = &args.undistort {
        undistort(folder, &images, &result.camera)?;
    }
    // Last: where there is a camera, all that was asked for is there.
    write_camera(&args.output, &file, &table(&result, &search))?;
    if args.json {
        println!("{}", report(&result, &search));
    } else {
        say(&result, &search, &args);
    }
    let poor = warn(&result);
    let losses = !search.failed.is_empty() || result.views.iter().any(|v| v.outlier || !v.used);
    Ok(if losses || poor { Outcome::Degraded } else { Outcome::Done })
}

/// Says what is doubtful.
fn warn(result: &CameraCalibration) -> bool {
    if result.kept_k3 {
        crate::say::warn(
            "k3 was kept as by --fix k3: with it the lens found folds the image over itself. More boards at the image's \
             border would tell it",
        );
    }
    // Written so that NaN fails too.
    let poor = !(result.rms <= RMS_LIMIT);
    if poor {
        crate::say::warn(format!(
            "rms {:.2} px is over {RMS_LIMIT} px: blurred pictures, a board that is not flat, or pictures of two cameras or \
             two zooms? See the worst views",
            result.rms
        ));
    }
    poor || result.kept_k3
}

/// No picture is overwritten, and all that is asked for can be written. The camera to start from is read before.
fn check_targets(args: &Args, images: &[PathBuf]) -> anyhow::Result<()> {
    let mut targets = Targets::keep(images);
    targets.file(&args.output, "--output")?;
    if let Some(path) = &args.coverage {
        targets.file(path, "--coverage")?;
    }
    if let Some(folder) = &args.undistort {
        let pictures = different(images).map(|path| (flat_name(path), path.display().to_string()));
        targets.files_in(folder, pictures).context("--undistort")?;
    }
    Ok(())
}

/// Each picture once, though it may be named twice.
fn different(images: &[PathBuf]) -> impl Iterator<Item = &PathBuf> {
    let mut seen = BTreeSet::new();
    images.iter().filter(move |path| seen.insert(one_name(path)))
}

fn flat_name(path: &Path) -> String {
    let stem = path.file_stem().map_or_else(|| "image".into(), |s| s.to_string_lossy());
    format!("{stem}.png")
}

fn undistort(folder: &Path, images: &[PathBuf], camera: &PinholeCamera) -> anyhow::Result<()> {
    create_folder(folder)?;
    for path in different(images) {
        // An unreadable image was said to be one.
        let Ok(picture) = read_picture(path) else { continue };
        let flat = match picture {
            Picture::Color(image) => Picture::Color(undistort_color(&image, camera).0),
            Picture::Gray16(image) => Picture::Gray16(undistort_gray(&image, camera).0),
        };
        write_picture(folder.join(flat_name(path)), &flat)?;
    }
    Ok(())
}

/// Six decimals are more than anyone believes.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

fn table(result: &CameraCalibration, search: &Search) -> toml::Table {
    let s = &result.sigma;
    let sigma = [s.fx, s.fy, s.cx, s.cy].into_iter().chain(s.distortion).map(|v| toml::Value::Float(rounded(v)));
    let mut table = toml::Table::new();
    table.insert("rms_px".into(), rounded(result.rms).into());
    table.insert("views".into(), (result.views.iter().filter(|v| v.used).count() as i64).into());
    table.insert("kept_k3".into(), result.kept_k3.into());
    table.insert("standard_deviations".into(), toml::Value::Array(sigma.collect()));
    let bad = search.found.iter().zip(&result.views).filter(|(_, v)| v.outlier);
    table.insert("outliers".into(), bad.map(|(f, _)| toml::Value::String(name(&f.path))).collect::<Vec<_>>().into());
    table
}

fn report(result: &CameraCalibration, search: &Search) -> serde_json::Value {
    let (c, s) = (&result.camera, &result.sigma);
    let views: Vec<_> = search
        .found
        .iter()
        .zip(&result.views)
        .map(|(f, v)| {
            json!({
                "image": f.path, "rms_px": v.rms, "worst_px": v.worst, "outlier": v.outlier, "used": v.used,
                "translation": v.camera_from_board.translation.vector.as_slice(),
                "quaternion_xyzw": v.camera_from_board.rotation.coords.as_slice(),
            })
        })
        .collect();
    let views_found: Vec<BoardView> = search.found.iter().map(|f| f.view.clone()).collect();
    let covered = coverage(&views_found, search.size);
    json!({
        "width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "distortion": c.distortion,
        "standard_deviations": { "fx": s.fx, "fy": s.fy, "cx": s.cx, "cy": s.cy, "distortion": s.distortion },
        "rms_px": result.rms,
        "kept_k3": result.kept_k3,
        "largest_tilt_between_views_deg": result.tilts,
        "covered_share": covered.share,
        "uncovered_corners": covered.bare,
        "views": views,
        "without_board": search.failed.iter().map(|f| json!({ "image": f.0, "reason": f.1 })).collect::<Vec<_>>(),
    })
}

fn say(result: &CameraCalibration, search: &Search, args: &Args) {
    let (c, s) = (&result.camera, &result.sigma);
    for (found, view) in search.found.iter().zip(&result.views) {
        let remark = match (view.used, view.outlier) {
            (true, true) => "  OUTLIER: fits over three times worse than the usual view; --drop-outliers leaves it out",
            (false, true) => "  outlier, left out",
            (false, false) => "  repeats another view, left out",
            (true, false) => "",
        };
        println!("{}: {:.3} px, worst corner {:.2} px{remark}", name(&found.path), view.rms, view.worst);
    }
    let used = result.views.iter().filter(|v| v.used).count();
    println!("{}: {used} views, rms {:.3} px", args.output.display(), result.rms);
    println!(
        "fx {:.2} ± {:.2}  fy {:.2} ± {:.2}  cx {:.2} ± {:.2}  cy {:.2} ± {:.2} px",
        c.fx, s.fx, c.fy, s.fy, c.cx, s.cx, c.cy, s.cy
    );
    for ((name, value), sd) in ["k1", "k2", "p1", "p2", "k3"].into_iter().zip(c.distortion).zip(s.distortion) {
        print!("{name} {value:.4} ± {sd:.4}  ");
    }
    println!();
    let views: Vec<BoardView> = search.found.iter().map(|f| f.view.clone()).collect();
    let covered = coverage(&views, search.size);
    println!(
        "corners in {:.0} % of the image; boards tilted by up to {:.0}° to each other",
        100.0 * covered.share,
        result.tilts
    );
    if !covered.bare.is_empty() {
        println!("no board reached the {}: the distortion is a guess there", covered.bare.join(", the "));
    }
}
