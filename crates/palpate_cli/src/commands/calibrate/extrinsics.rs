use super::boards::{self, BoardArgs, name};
use crate::Outcome;
use crate::targets::Targets;
use anyhow::{Context as _, bail};
use palpate::calibrate::camera::{BoardView, CalibrationError, paired_extrinsics};
use palpate::io::{read_camera, write_extrinsics};
use serde_json::json;
use std::path::PathBuf;

/// Pairs from which a wrong one can be told.
const GOOD_PAIRS: usize = 3;
/// Error from which the user is warned, pixels.
const RMS_LIMIT: f64 = 1.0;

#[derive(clap::Args)]
#[command(after_help = "Example:
  palpate calibrate extrinsics --depth ir/ --color rgb/ --depth-camera infrared.toml --color-camera color.toml \\
    --board 9x6 --square 0.025 --output extrinsics.toml

Pictures are paired in the order of their names. The depth camera's pictures are its infrared ones. A pair of which one shows no board is left
out. Then: palpate register.

Exit status 1: no mounting, for example because no one fits all pairs to 3 px; 3: done, but some pairs were left out or fit badly (over 1 px in
all, or three times the usual pair).")]
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
    let paths = [boards::images(&args.depth, &[])?, boards::images(&args.color, &[])?];
    let inputs = paths.iter().flatten().chain([&args.depth_camera, &args.color_camera]);
    Targets::keep(inputs).file(&args.output, "--output")?;
    let cameras = [read_camera(&args.depth_camera)?.camera, read_camera(&args.color_camera)?.camera];
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
    let found = paired_extrinsics(&board, [&cameras[0], &cameras[1]], &first, &second);
    if let Err(CalibrationError::PairsDisagree { apart, .. }) = &found {
        for &i in apart {
            eprintln!("palpate: {} contradict most others", pairs[i].0);
        }
    }
    let found = found.with_context(|| format!("{} pairs", pairs.len()))?;
    write_extrinsics(&args.output, &found.second_from_first, found.rms, found.sigma)?;
    let (t, r) = found.sigma;
    let shift = found.second_from_first.translation.vector;
    if args.json {
        let pair = |i: usize| json!({ "pair": pairs[i].0, "rms_px": found.pair_rms[i], "apart": found.apart[i] });
        println!(
            "{}",
            json!({
                "color_from_depth": {
                    "translation": shift.as_slice(),
                    "quaternion_xyzw": found.second_from_first.rotation.coords.as_slice(),
                },
                "standard_deviations": { "translation_m": t, "rotation_rad": r },
                "rms_px": found.rms,
                "pairs": (0..pairs.len()).map(pair).collect::<Vec<_>>(),
            })
        );
    } else {
        for ((pair, rms), apart) in pairs.iter().zip(&found.pair_rms).zip(&found.apart) {
            let remark =
                if *apart { "  over three times the usual pair: did the board move? leave it out" } else { "" };
            println!("{}: {rms:.3} px{remark}", pair.0);
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
    if pairs.len() < GOOD_PAIRS {
        crate::say::warn(format!(
            "{} of the {GOOD_PAIRS} pairs that can show a wrong one: take five or more, tilted",
            pairs.len()
        ));
    }
    let poor = found.rms > RMS_LIMIT || found.apart.contains(&true);
    if poor {
        crate::say::warn(format!(
            "rms {:.2} px, over {RMS_LIMIT} px or with pairs apart: do all pairs belong together, are both cameras these?",
            found.rms
        ));
    }
    let lost = pairs.len() < paths[0].len();
    Ok(if lost || poor { Outcome::Degraded } else { Outcome::Done })
}
