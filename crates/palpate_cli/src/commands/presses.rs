use crate::Outcome;
use crate::progress::progress_bar;
use anyhow::{Context as _, bail};
use palpate::io::{PressSetHeader, begin_press_set, has_press_shard, write_press_shard};
use palpate::simulate::{LightParams, PressSampler, PressSetParams};
use rayon::prelude::*;
use std::path::PathBuf;

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate presses ycb/*.ply --count 12000 --output presses
  palpate presses ycb/004_sugar_box.ply --count 200 --depth 1.0 --primitives 0 --light clean --output test
  palpate presses ycb/*.ply --count 100000 --output presses --shard 3/16     # one of sixteen jobs of a cluster

Run the same command again to go on where it was interrupted. The layout is plain npy: docs/tactile.md.")]
pub(crate) struct Args {
    /// Meshes in metres (.ply, .obj, .off, .stl) or primitive:NAME as in `palpate simulate`; none with --primitives 1
    #[arg(value_name = "MESH")]
    meshes: Vec<String>,
    /// Folder of the set; made if it is missing, gone on with if it holds the same set
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Presses of the whole set
    #[arg(long, default_value_t = 1000, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,
    /// Presses of a shard
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    shard_size: u32,
    /// Make the shards whose number leaves the rest i−1 when divided by n
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: Option<(usize, usize)>,
    /// Sensor: ycb-sight, gelsight-r15, gelsight-mini, digit
    #[arg(long, default_value = "ycb-sight", value_name = "PRESET")]
    sensor: String,
    /// Press depth, millimetres: one value, or a range drawn from uniformly
    #[arg(long, default_value = "0.3,1.5", value_name = "MM[,MM]", value_parser = range)]
    depth: (f64, f64),
    /// Share of presses on analytic primitives (flat, round and edged indenters without facets)
    #[arg(long, default_value_t = 0.4, value_name = "SHARE")]
    primitives: f64,
    /// Width of the images kept, pixels: a whole part of the sensor's
    #[arg(long, value_name = "PX")]
    width: Option<usize>,
    /// What befalls the images
    #[arg(long, value_enum, default_value_t = Light::Camera)]
    light: Light,
    /// Seed of everything random
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Light {
    /// JPEG of quality 95 and nothing else, as in YCB-Sight
    Clean,
    /// Noise of σ up to 4 grey levels, JPEG of quality 70 to 97
    Camera,
    /// The same, and gain, offset and a smooth drift of the light since the no-contact image
    Varied,
}

/// `I/N` with 1 ≤ I ≤ N, as (I − 1, N).
pub(crate) fn shard(text: &str) -> Result<(usize, usize), String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse::<usize>().ok()?, n.parse::<usize>().ok()?)));
    match parts {
        Some((i, n)) if (1..=n).contains(&i) => Ok((i - 1, n)),
        _ => Err("I/N is needed with 1 ≤ I ≤ N, such as 3/16".to_owned()),
    }
}

fn range(text: &str) -> Result<(f64, f64), String> {
    let number = |s: &str| s.trim().parse::<f64>().map_err(|e| format!("'{s}': {e}"));
    match text.split_once(',') {
        Some((low, high)) => Ok((number(low)?, number(high)?)),
        None => number(text).map(|d| (d, d)),
    }
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let objects: Vec<_> = args.meshes.iter().map(|m| super::simulate::load(m)).collect::<Result<_, _>>()?;
    let names: Vec<String> = objects.iter().map(|(name, _)| name.clone()).collect();
    if let Some(name) = names.iter().enumerate().find(|(i, n)| names[..*i].contains(n)).map(|(_, n)| n) {
        bail!("two meshes are called '{name}'; their presses could not be told apart");
    }
    let defaults = PressSetParams::default();
    let width = args.width.unwrap_or_else(|| {
        palpate::tactile::TactileSensor::preset(&args.sensor).map_or(defaults.width, |s| s.width.min(defaults.width))
    });
    let params = PressSetParams {
        sensor: args.sensor,
        seed: args.seed,
        width,
        depth: (args.depth.0 * 1e-3, args.depth.1 * 1e-3),
        primitives: args.primitives,
        light: match args.light {
            Light::Clean => LightParams::clean(),
            Light::Camera => LightParams::camera(),
            Light::Varied => LightParams::default(),
        },
        ..defaults
    };
    let sampler = PressSampler::new(objects, params.clone())?;
    let header = PressSetHeader {
        format: 1,
        presses: args.count as usize,
        shard_size: args.shard_size as usize,
        objects: names,
        params,
    };
    begin_press_set(&args.output, &header, &sampler.background())?;
    let (part, parts) = args.shard.unwrap_or((0, 1));
    let todo: Vec<usize> =
        (0..header.shards()).filter(|shard| shard % parts == part && !has_press_shard(&args.output, *shard)).collect();
    let missing = todo.iter().map(|&s| header.presses_of(s).len()).sum();
    let bar = progress_bar(missing, "{bar:40} {pos}/{len} presses, {per_sec}, {eta} left");
    for shard in todo {
        let presses = header
            .presses_of(shard)
            .into_par_iter()
            .map(|index| {
                let made = sampler.sample(index);
                bar.inc(1);
                made
            })
            .collect::<Result<Vec<_>, _>>()?;
        write_press_shard(&args.output, shard, &presses).with_context(|| format!("shard {shard}"))?;
    }
    bar.finish_and_clear();
    let done = (0..header.shards()).filter(|&s| has_press_shard(&args.output, s)).count();
    println!("{done} of {} shards complete in {}", header.shards(), args.output.display());
    Ok(Outcome::Done)
}
