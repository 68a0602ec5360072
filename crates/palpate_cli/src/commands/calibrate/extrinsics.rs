use super::boards::{self, BoardArgs, name};
use crate::Outcome;
use anyhow::{Context as _, bail};
use palpate::calibrate::camera::{BoardView, paired_extrinsics};
use palpate::io::{check_writable, read_camera, write_extrinsics};
use serde_json::json;
use std::path::PathBuf;

#[derive(clap::Args)]
#[command(after_help = "Example:
  palpate calibrate extrinsics --depth ir/ --color rgb/ --depth-camera infrared.toml --color-camera color.toml \\
    --board 9x6 --square 0.025 --output extrinsics.toml

Pictures are paired in the order of their names. The depth camera's pictures are its infrared ones. A pair of which one shows no board is left
out. Then: palpate register.")]
pub(crate) struct Args {
    /// Infrared pictures of the depth camera, or folders of them
    #[arg(long, required = true, num_args = 1.., value_name = "IMAGE")]
    depth: Vec<PathBuf>,
    /// Pictures of the colour camera, or folders of them; as many
    #[arg(long, required = true, num_args = 1.., value_name = "IMAGE")]
    color: Vec<PathBuf>,
    /// The depth camera, calibrated
    #[arg(long, value_name = "TOML")]
    depth_camera: PathBuf,
    /// The colour camera, calibrated
    #[arg(long, value_name = "TOML")]
    color_camera: PathBuf,
    #[command(flatten)]
    board: BoardArgs,
    /// File for color_from_depth
    #[arg(short, long, value_name = "TOML")]
    output: PathBuf,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let board = args.board.board()?;
    check_writable(&args.output)?;
    let cameras = [read_camera(&args.depth_camera)?.camera, read_camera(&args.color_camera)?.camera];
    let paths = [boards::images(&args.depth)?, boards::images(&args.color)?];
    if paths[0].len() != paths[1].len() {
        bail!("{} images of --depth and {} of --color; each needs its partner", paths[0].len(), paths[1].len());
    }
    let searches = [boards::search(&paths[0], &args.board)?, boards::search(&paths[1], &args.board)?];
    for ((search, camera), flag) in searches.iter().zip(&cameras).zip(["--depth", "--color"]) {
        let needed = (camera.width, camera.height);
        if !search.found.is_empty() && search.size != needed {
            bail!(
                "the images of {flag} are {}×{} px, {flag}-camera is {}×{}",
                search.size.0,
                search.size.1,
                needed.0,
                needed.1
            );
        }
        search.failed.iter().for_each(|(_, reason)| eprintln!("palpate: {reason}"));
    }
    let view = |k: usize, path: &PathBuf| searches[k].found.iter().find(|f| f.path == *path).map(|f| f.view.clone());
    let pairs: Vec<(String, BoardView, BoardView)> = paths[0]
        .iter()
        .zip(&paths[1])
        .filter_map(|(a, b)| Some((format!("{} and {}", name(a), name(b)), view(0, a)?, view(1, b)?)))
        .collect();
    if pairs.is_empty() {
        bail!("no pair of images shows the board in both");
    }
    let (first, second): (Vec<_>, Vec<_>) = pairs.iter().map(|p| (p.1.clone(), p.2.clone())).unzip();
    let found = paired_extrinsics(&board, [&cameras[0], &cameras[1]], &first, &second)
        .with_context(|| format!("{} pairs", pairs.len()))?;
    write_extrinsics(&args.output, &found.second_from_first, found.rms, found.sigma)?;
    let (t, r) = found.sigma;
    let shift = found.second_from_first.translation.vector;
    if args.json {
        let pair = |(p, rms): (&(String, BoardView, BoardView), &f64)| json!({ "pair": p.0, "rms_px": rms });
        println!(
            "{}",
            json!({
                "color_from_depth": {
                    "translation": shift.as_slice(),
                    "quaternion_xyzw": found.second_from_first.rotation.coords.as_slice(),
                },
                "standard_deviations": { "translation_m": t, "rotation_rad": r },
                "rms_px": found.rms,
                "pairs": pairs.iter().zip(&found.pair_rms).map(pair).collect::<Vec<_>>(),
            })
        );
    } else {
        for (pair, rms) in pairs.iter().zip(&found.pair_rms) {
            println!("{}: {rms:.3} px", pair.0);
        }
        println!(
            "{}: {} pairs, rms {:.3} px; shift ({:.2}, {:.2}, {:.2}) ± ({:.2}, {:.2}, {:.2}) mm, turned by {:.3}° ± {:.3}°",
            args.output.display(),
            pairs.len(),
            found.rms,
            1e3 * shift.x,
            1e3 * shift.y,
            1e3 * shift.z,
            1e3 * t[0],
            1e3 * t[1],
            1e3 * t[2],
            found.second_from_first.rotation.angle().to_degrees(),
            r.iter().copied().fold(0.0, f64::max).to_degrees(),
        );
    }
    let lost = pairs.len() < paths[0].len();
    Ok(if lost { Outcome::Degraded } else { Outcome::Done })
}
