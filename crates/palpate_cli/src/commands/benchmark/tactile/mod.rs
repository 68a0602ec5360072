//! Decodes every image of a data set by every decoder and keeps what came out.

mod dataset;
mod results;
mod summary;

use crate::Outcome;
use crate::decoders::{self, DecoderFiles, DecoderKind};
use crate::progress::LateBar;
use anyhow::bail;
use dataset::{Dataset, Press};
use palpate::io::{ObjectSplit, SplitPart, read_object_split};
use palpate::metrics::compare_contacts;
use palpate::simulate::Disturbance;
use palpate::tactile::{NoContact, TactileDecoder};
use rayon::prelude::*;
use results::{Key, Row};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Instant;

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate presses ycb/*.ply --count 600 --depth 1.0 --primitives 0 --light clean --seed 7 --output presses
  palpate benchmark tactile presses --split config/splits/held-out.toml --output tactile
  palpate benchmark tactile presses --decoders lookup,threshold --lookup-table DIR --output baselines
  palpate benchmark tactile presses --shard 2/8 --output tactile     # one of eight jobs; without --shard the rows are merged

The same command again goes on where it was interrupted.")]
pub(crate) struct Args {
    /// Press data set (see `palpate presses`), or a folder of objects in the YCB-Sight layout with images in gelsight/
    dataset: PathBuf,
    /// Folder for results.csv, summary.md and the plots
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Decoders
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [DecoderKind::Compact], value_name = "NAME,…")]
    decoders: Vec<DecoderKind>,
    #[command(flatten)]
    files: DecoderFiles,
    /// No-contact image, instead of the data set's own
    #[arg(long, short, value_name = "BG")]
    background: Option<PathBuf>,
    /// TOML with the lists train, validation and test of the objects that learned decoders saw (config/splits)
    #[arg(long, value_name = "FILE")]
    split: Option<PathBuf>,
    /// Objects of the split to decode
    #[arg(long, value_enum, default_value_t = PartArg::Test, requires = "split")]
    part: PartArg,
    /// Only objects whose name holds one of these
    #[arg(long, value_delimiter = ',', value_name = "NAME,…")]
    objects: Vec<String>,
    /// Disturb every image after the no-contact image was taken: gain-0.8, gain-1.2, gain-1.05, offset-10, offset-red-10,
    /// noise-5, jpeg-80, drift-3, drift-6 (grey levels)
    #[arg(long, value_name = "NAME", value_parser = disturbance)]
    disturb: Option<(String, Disturbance)>,
    /// At most so many images of an object, spread over those there are
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Decode the images whose number leaves the rest i−1 when divided by n, into a file of its own
    #[arg(long, value_name = "I/N", value_parser = crate::commands::presses::shard)]
    shard: Option<(usize, usize)>,
}

/// Which objects of a split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PartArg {
    /// Seen by the optimizer
    Train,
    /// Decided which weights were kept
    Validation,
    /// Seen by neither
    Test,
}

impl PartArg {
    fn part(self) -> SplitPart {
        match self {
            Self::Train => SplitPart::Train,
            Self::Validation => SplitPart::Validation,
            Self::Test => SplitPart::Test,
        }
    }
}

fn disturbance(name: &str) -> Result<(String, Disturbance), String> {
    let known = || Disturbance::BENCHMARK.map(|(name, _)| name).join(", ");
    let found = Disturbance::named(name).ok_or_else(|| format!("known: {}", known()))?;
    Ok((name.to_owned(), found))
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let dataset = Dataset::open(&args.dataset, args.background.as_deref())?;
    let split = args.split.as_deref().map(read_object_split).transpose()?;
    let chosen = choose(&dataset.presses, &args, split.as_ref())?;
    let no_contact = NoContact::new(dataset.background.clone(), &dataset.sensor)?;
    let mut tools: Vec<(String, DecoderKind, Box<dyn TactileDecoder>)> = Vec::new();
    for kind in args.decoders.iter().copied().collect::<BTreeSet<_>>() {
        tools.push((
            label(kind, &args.files),
            kind,
            decoders::make(kind, no_contact.clone(), &dataset.sensor, &args.files)?,
        ));
    }
    palpate::io::create_folder(&args.output)?;
    let conditions = conditions(&args, &dataset, split.as_ref(), chosen.len());
    let results = results::open(&args.output, &conditions, args.shard)?;
    let (part, parts) = args.shard.unwrap_or((0, 1));
    let done: BTreeSet<Key> = results.rows.iter().map(|row| row.key.clone()).collect();
    let mine = chosen.iter().enumerate().filter(|(i, _)| i % parts == part).map(|(_, press)| *press);
    let todo: Vec<(&Press, Vec<usize>)> = mine
        .map(|press| {
            let open = (0..tools.len()).filter(|&t| !done.contains(&key(press, &tools[t].0)));
            (press, open.collect::<Vec<_>>())
        })
        .filter(|(_, open)| !open.is_empty())
        .collect();
    let bar = LateBar::new(Some(todo.len()), "images");
    let results = Mutex::new(results);
    todo.par_iter().try_for_each(|(press, open)| {
        let rows = decode_press(&dataset, press, args.disturb.as_ref(), open.iter().map(|&t| &tools[t]));
        bar.step();
        let mut results = results.lock().map_err(|_| anyhow::anyhow!("another worker failed"))?;
        rows.into_iter().try_for_each(|row| results.push(row))
    })?;
    drop(bar);
    let rows = results.into_inner().map_err(|_| anyhow::anyhow!("a worker failed"))?.finish()?;
    let failed = rows.iter().filter(|row| !row.error.is_empty()).count();
    if let Some((i, n)) = args.shard {
        println!("shard {} of {n}: {} rows; run without --shard to sum up", i + 1, rows.len());
    } else {
        summary::write(&args.output, &rows, &notes(&args, split.as_ref(), &conditions))?;
        println!("{} rows, summary in {}", rows.len(), args.output.join("summary.md").display());
    }
    if failed > 0 {
        crate::say::warn(format!(
            "{failed} of {} images could not be decoded; the column `error` says why",
            rows.len()
        ));
        return Ok(Outcome::Degraded);
    }
    Ok(Outcome::Done)
}

/// The presses that the flags ask for.
fn choose<'a>(presses: &'a [Press], args: &Args, split: Option<&ObjectSplit>) -> anyhow::Result<Vec<&'a Press>> {
    let wanted = |press: &&Press| {
        let named = args.objects.is_empty() || args.objects.iter().any(|name| press.object.contains(name.as_str()));
        named && split.is_none_or(|split| split.part(&press.object) == Some(args.part.part()))
    };
    let mut chosen: Vec<&Press> = presses.iter().filter(wanted).collect();
    if chosen.is_empty() {
        let names: BTreeSet<&str> = presses.iter().map(|press| press.object.as_str()).collect();
        let names: Vec<&str> = names.into_iter().collect();
        bail!("no image is left of {} on {}; check --split and --objects", presses.len(), names.join(", "));
    }
    // Sorted by object, in the data set's order within one.
    chosen.sort_by(|a, b| a.object.cmp(&b.object));
    if let Some(limit) = args.limit {
        let limit = limit as usize;
        let spread = |images: &[&'a Press]| -> Vec<&'a Press> {
            let n = images.len().min(limit);
            (0..n).map(|i| images[i * images.len() / n]).collect()
        };
        chosen = chosen.chunk_by(|a, b| a.object == b.object).flat_map(spread).collect();
    }
    Ok(chosen)
}

fn key(press: &Press, decoder: &str) -> Key {
    Key { object: press.object.clone(), press: press.name.clone(), decoder: decoder.to_owned() }
}

/// The decoder's name in the results; other weights than our own are named.
fn label(kind: DecoderKind, files: &DecoderFiles) -> String {
    match (&files.weights, kind) {
        (Some(weights), DecoderKind::Compact | DecoderKind::Fcrn) => {
            format!("{}:{}", kind.name(), weights.file_stem().unwrap_or_default().to_string_lossy())
        }
        _ => kind.name().to_owned(),
    }
}

/// One row for each decoder; what fails is a row too.
fn decode_press<'a>(
    dataset: &Dataset,
    press: &Press,
    disturb: Option<&(String, Disturbance)>,
    tools: impl Iterator<Item = &'a (String, DecoderKind, Box<dyn TactileDecoder>)>,
) -> Vec<Row> {
    let loaded = dataset.load(press).map(|(image, truth)| match disturb {
        Some((_, disturbance)) => (disturbance.apply(&image, &format!("{}/{}", press.object, press.name), 0), truth),
        None => (image, truth),
    });
    tools
        .map(|(label, kind, decoder)| {
            let judge = || -> Result<Row, String> {
                let (image, truth) = loaded.as_ref().map_err(|e| format!("{e:#}"))?;
                let begun = Instant::now();
                let contact = decoder.decode(image, &dataset.sensor).map_err(|e| e.to_string())?;
                let seconds = begun.elapsed().as_secs_f64();
                let errors = compare_contacts(&contact, truth, &dataset.sensor).map_err(|e| e.to_string())?;
                Ok(Row::new(key(press, label), &errors, kind.gives_heights(), seconds))
            };
            judge().unwrap_or_else(|error| Row::failed(key(press, label), error))
        })
        .collect()
}

/// What the rows depend on beside object, image and decoder.
fn conditions(args: &Args, dataset: &Dataset, split: Option<&ObjectSplit>, images: usize) -> String {
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let split =
        split.map_or_else(|| "no split".to_owned(), |s| format!("split {} ({})", s.name, args.part.part().name()));
    format!(
        "palpate {} benchmark tactile, data set {} (sensor {}), {images} images, {split}, background {}{}",
        env!("CARGO_PKG_VERSION"),
        name(&args.dataset),
        dataset.sensor.model,
        args.background.as_ref().map_or_else(|| "the data set's".to_owned(), name),
        args.disturb.as_ref().map_or_else(String::new, |(name, _)| format!(", images disturbed by {name}"))
    )
}

fn notes(args: &Args, split: Option<&ObjectSplit>, conditions: &str) -> Vec<String> {
    let seen = match (split, args.part.part()) {
        (None, _) => {
            "**No split was given: learned decoders may have been trained on these objects.** Baselines are not concerned."
        }
        (Some(_), SplitPart::Test) => {
            "Objects of the split's test list: no learned decoder of this split has seen them."
        }
        (Some(_), SplitPart::Train) => {
            "**Train = test: learned decoders of this split were trained on these objects.**"
        }
        (Some(_), SplitPart::Validation) => {
            "**Validation objects: they decided which weights of learned decoders of this split were kept.**"
        }
    };
    vec![format!("Made by {conditions}."), seen.to_owned()]
}
