//! `palpate train compact`.

use super::{Args, Device, plot};
use crate::Outcome;
use crate::progress::progress_bar;
use anyhow::Context as _;
use palpate::io::{PressSet, create_folder, read_object_split, read_text, write_text};
use palpate_nn::compact::{CompactConfig, CompactTask, Stage, train_compact};
use palpate_nn::data::{Parts, PressFolder};
use palpate_nn::train::{Ended, Event};
use std::ops::ControlFlow;

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let config = effective(args)?;
    let split = read_object_split(&args.split)?;
    let samples = PressFolder::new(PressSet::open(&args.data)?, &args.data);
    let parts = Parts::of(&samples, &split)?;
    eprintln!("{} presses for training, {} for validation", parts.train.len(), parts.validation.len());
    create_folder(&args.output)?;
    write_text(args.output.join("train.toml"), &toml::to_string_pretty(&config)?)?;
    let command = std::env::args().skip(1).fold("palpate".to_owned(), |text, a| text + " " + &a);
    let task = CompactTask::new(&samples, &parts, &config, &split.name, &command);
    let bar = progress_bar(0, "{wide_bar} {pos}/{len} steps, {eta} left, {msg}");
    let mut plotted = Ok(());
    let mut running = None;
    let mut watch = |stage: Stage, event: Event<'_>| {
        match event {
            Event::Step { step, steps, loss } => {
                if running != Some(stage) {
                    running = Some(stage);
                    bar.set_length(steps as u64);
                    bar.set_position(step as u64 - 1);
                    bar.reset_eta();
                }
                bar.set_position(step as u64);
                bar.set_message(format!("{}: loss {loss:.4}", stage.name()));
            }
            Event::Validated { log, best } => {
                if let Some(row) = log.rows.last() {
                    let values: Vec<String> =
                        log.names.iter().zip(&row.values).map(|(n, v)| format!("{n} {v:.4}")).collect();
                    let mark = if best { " (best)" } else { "" };
                    let (name, loss) = (stage.name(), row.train_loss);
                    let line = format!("{name}, epoch {:.2}: loss {loss:.4}, {}{mark}", row.epoch, values.join(", "));
                    bar.suspend(|| eprintln!("{line}"));
                }
                plotted = plot::write(&args.output.join(stage.name()).join("curves.svg"), log);
            }
            _ => {}
        }
        if plotted.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    let folder = &args.output;
    let trained = match args.device {
        Device::Cpu => train_compact::<palpate_nn::CpuAutodiff>(
            &task,
            &config,
            folder,
            args.resume,
            &palpate_nn::CpuDevice,
            &mut watch,
        ),
        #[cfg(feature = "cuda")]
        Device::Cuda => train_compact::<palpate_nn::CudaAutodiff>(
            &task,
            &config,
            folder,
            args.resume,
            &Default::default(),
            &mut watch,
        ),
        #[cfg(not(feature = "cuda"))]
        Device::Cuda => anyhow::bail!("this palpate was built without CUDA; build it with --features cuda"),
    };
    bar.finish_and_clear();
    let ended = trained?;
    plotted?;
    anyhow::ensure!(ended != Ended::Stopped, "the run was stopped");
    println!("{}", folder.join("compact.safetensors").display());
    Ok(Outcome::Done)
}

fn effective(args: &Args) -> anyhow::Result<CompactConfig> {
    let mut config = match &args.config {
        Some(path) => toml::from_str(&read_text(path)?).with_context(|| path.display().to_string())?,
        None => CompactConfig::preset(0),
    };
    for part in [&mut config.gradient, &mut config.level, &mut config.mask] {
        part.seed = args.seed.unwrap_or(part.seed);
        part.epochs = args.epochs.unwrap_or(part.epochs);
    }
    config.validate()?;
    Ok(config)
}
