//! `palpate train`: networks that read tactile images. Only with the feature `nn`.

mod compact;
mod plot;

use crate::Outcome;
use crate::progress::progress_bar;
use clap::ValueEnum;
use palpate::io::{PressSet, create_folder, read_object_split, write_text};
use palpate_nn::config::TrainConfig;
use palpate_nn::data::{Parts, PressFolder};
use palpate_nn::fcrn::Head;
use palpate_nn::tactile::FcrnTask;
use palpate_nn::train::{Ended, Event, LoopConfig, RunFolder, Task, train};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate presses ycb/*.ply --count 12000 --output presses
  palpate train height-map --data presses --split config/splits/held-out.toml --preset reduced --output run
  palpate train height-map --data presses --split config/splits/held-out.toml --config run/train.toml --output run --resume

Presets: `thesis` as published (480 × 640, width 64), `better` (background subtracted, 240 × 320, width 64), `reduced` (width 4,
64 × 96: for a CPU). Start from one, change the train.toml that the run writes, and give it with --config.

The output folder holds
  best.safetensors        weights of the best validation, with network, sensor, split, seed and this command
  checkpoint.safetensors  all that --resume needs; on the CPU a resumed run gives the same bytes as one that never stopped
  metrics.csv, curves.svg one row and one point per validation
  train.toml              the parameters in effect
Ctrl-C loses only the steps since the last validation.")]
pub(crate) struct Args {
    /// What the network gives
    #[arg(value_enum)]
    network: Network,
    /// Folder of presses, as `palpate presses` makes them
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Which objects are for training, validation and test (TOML; two are in config/splits)
    #[arg(long, value_name = "FILE")]
    split: PathBuf,
    /// Folder of the run; made if it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Parameters to start from
    #[arg(long, value_enum, default_value = "better", conflicts_with = "config")]
    preset: Preset,
    /// Parameters in a TOML file, all of them
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Go on where the run in the output folder stopped
    #[arg(long)]
    resume: bool,
    /// Seed of weights, order, augmentation and dropout, instead of the parameters' one
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Passes over the training presses, instead of the parameters' number
    #[arg(long, value_name = "N")]
    epochs: Option<usize>,
    /// Where to compute; cuda needs a build with the feature `cuda`
    #[arg(long, value_enum, default_value = "cpu")]
    device: Device,
}

#[derive(Clone, Copy, ValueEnum)]
enum Network {
    /// FCRN: height of the gel at each pixel
    HeightMap,
    /// FCRN: where the object touches the gel
    ContactMask,
    /// The small decoder that palpate runs by itself: heights and contact, of images 320 × 240
    Compact,
}

#[derive(Clone, Copy, ValueEnum)]
enum Preset {
    Thesis,
    Better,
    Reduced,
}

#[derive(Clone, Copy, ValueEnum)]
enum Device {
    Cpu,
    Cuda,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    if let Network::Compact = args.network {
        return compact::run(&args);
    }
    let config = effective(&args)?;
    let split = read_object_split(&args.split)?;
    let samples = PressFolder::new(PressSet::open(&args.data)?, &args.data);
    let parts = Parts::of(&samples, &split)?;
    eprintln!("{} presses for training, {} for validation", parts.train.len(), parts.validation.len());
    create_folder(&args.output)?;
    let written = config.to_toml();
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let loop_config = config.run.clone();
    let task = FcrnTask::new(&samples, parts, config, &split.name, &command);
    match args.device {
        Device::Cpu => train_and_report::<palpate_nn::CpuAutodiff, _>(&task, &loop_config, &written, &args),
        #[cfg(feature = "cuda")]
        Device::Cuda => train_and_report::<palpate_nn::CudaAutodiff, _>(&task, &loop_config, &written, &args),
        #[cfg(not(feature = "cuda"))]
        Device::Cuda => anyhow::bail!("this palpate was built without CUDA; build it with --features cuda"),
    }
}

fn effective(args: &Args) -> anyhow::Result<TrainConfig> {
    let (head, head_name) = match args.network {
        Network::HeightMap => (Head::HeightMap, "height-map"),
        Network::ContactMask => (Head::ContactMask, "contact-mask"),
        Network::Compact => unreachable!("trained by its own module"),
    };
    let mut config = if let Some(path) = &args.config {
        TrainConfig::open(path)?
    } else {
        let preset = args.preset.to_possible_value().expect("none is skipped");
        TrainConfig::preset(&format!("{}-{head_name}", preset.get_name()))?
    };
    anyhow::ensure!(
        config.network.head.is_height() == head.is_height(),
        "the parameters are for {:?}, not for {head_name}",
        config.network.head
    );
    config.run.seed = args.seed.unwrap_or(config.run.seed);
    config.run.epochs = args.epochs.unwrap_or(config.run.epochs);
    config.validate()?;
    Ok(config)
}

/// Trains any network, with a progress bar, and keeps `curves.svg` up to date.
///
/// * `written` – content of `train.toml`, written once the run has begun: a refused one leaves the file of the other run
fn train_and_report<B, T>(task: &T, config: &LoopConfig, written: &str, args: &Args) -> anyhow::Result<Outcome>
where
    B: palpate_nn::AutodiffBackend,
    T: Task<B>,
{
    let folder = RunFolder::new(&args.output);
    let curves = args.output.join("curves.svg");
    let bar = progress_bar(0, "{wide_bar} {pos}/{len} steps, {eta} left, {msg}");
    let mut kept = Ok(());
    let mut started = false;
    let mut watch = |event: Event<'_>| {
        match event {
            Event::Step { step, steps, loss } => {
                if !started {
                    started = true;
                    kept = write_text(args.output.join("train.toml"), written).map_err(Into::into);
                    bar.set_length(steps as u64);
                    bar.set_position(step as u64 - 1);
                    // Of a resumed run, the steps before are no work of today.
                    bar.reset_eta();
                }
                bar.set_position(step as u64);
                bar.set_message(format!("loss {loss:.4}"));
            }
            Event::Validated { log, best } => {
                if let Some(row) = log.rows.last() {
                    let values: Vec<String> =
                        log.names.iter().zip(&row.values).map(|(n, v)| format!("{n} {v:.4}")).collect();
                    let mark = if best { " (best)" } else { "" };
                    let line =
                        format!("epoch {:.2}: loss {:.4}, {}{mark}", row.epoch, row.train_loss, values.join(", "));
                    bar.suspend(|| eprintln!("{line}"));
                }
                kept = plot::write(&curves, log);
            }
            _ => {}
        }
        if kept.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    let outcome = train::<B, T>(task, config, &folder, args.resume, &Default::default(), &mut watch);
    bar.finish_and_clear();
    let outcome = outcome?;
    kept?;
    let why = match outcome.ended {
        Ended::Patience => "stopped early: no improvement",
        Ended::Finished | Ended::Stopped => "finished",
    };
    let name = task.metrics()[0].name;
    match outcome.best {
        Some((step, value)) => println!("{why} after {} steps; best {name} {value:.5} at step {step}", outcome.step),
        None => println!("{why} after {} steps; no validation gave a number", outcome.step),
    }
    println!("{}", display(&folder.best()));
    Ok(Outcome::Done)
}

fn display(path: &Path) -> String {
    path.display().to_string()
}
