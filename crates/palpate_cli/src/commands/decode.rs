use crate::decoders::{self, DecoderFiles, DecoderKind};
use crate::progress::LateBar;
use crate::video::{self, Frames};
use crate::{Outcome, say};
use anyhow::{Context as _, bail};
use palpate::geometry::Raster;
use palpate::io::{create_folder, read_color, read_sensor, write_color, write_height_map_npy, write_mask};
use palpate::render::render_contact;
use palpate::tactile::{Contact, NoContact, TactileDecoder, TactileSensor};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Frames of a video that are decoded beside one another.
const FRAMES_AT_ONCE: usize = 32;

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate decode touch.png --background nothing.png --sensor gelsight-mini --output maps --picture
  palpate decode touches/ press.mp4 --background nothing.png --sensor digit --output maps

Writes NAME_height.npy (32-bit floats, z of the gel in the sensor frame, metres, 0 at the relaxed apex, indented < 0),
NAME_contact.png (255 = contact) and with --picture NAME_picture.png; NAME is the image's file name, for a video its name and
the number of the frame. An image without contact gives the relaxed gel and an empty mask.

Exit status 1: nothing could be decoded; 3: some images could not, the others are written.")]
pub(crate) struct Args {
    /// Tactile images (.png .jpg), folders of them, or videos (.mp4 .avi .mkv .mov .webm; needs the program ffmpeg)
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// No-contact image of this very sensor in this light; images may be 2, 3, … times as large [default: that of a calibrated sensor]
    #[arg(short, long, value_name = "BG")]
    background: Option<PathBuf>,
    /// Sensor: ycb-sight, gelsight-r15, gelsight-mini, digit, or the sensor.toml of `palpate calibrate gel`
    #[arg(short, long, value_name = "PRESET|TOML")]
    sensor: String,
    /// Folder for the maps; made if it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// How images are decoded [default: calibrated for a calibrated sensor, else compact]
    #[arg(long, value_enum)]
    decoder: Option<DecoderKind>,
    #[command(flatten)]
    files: DecoderFiles,
    /// Also draw each image beside its height map
    #[arg(long)]
    picture: bool,
}

/// Something to decode and the name of its output.
enum Source {
    Image(PathBuf),
    Video(PathBuf),
}

/// What all images share.
struct Job<'a> {
    decoder: &'a dyn TactileDecoder,
    sensor: &'a TactileSensor,
    output: &'a Path,
    picture: bool,
}

/// What came of the images so far.
#[derive(Default)]
struct Tally {
    decoded: usize,
    failed: usize,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let calibrated = Path::new(&args.sensor).extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let file = calibrated.then(|| read_sensor(&args.sensor)).transpose()?;
    let sensor = match &file {
        Some(file) => file.sensor.clone(),
        None => TactileSensor::preset(&args.sensor)?,
    };
    let sources = collect(&args.images)?;
    let no_contact = match (&args.background, file) {
        (Some(path), _) => decoders::read_no_contact(path, &sensor)?,
        (None, Some(file)) => NoContact::new(file.background, &sensor).with_context(|| args.sensor.clone())?,
        (None, None) => bail!("--background is needed: a no-contact image of this very sensor"),
    };
    let mut files = args.files.clone();
    if calibrated && files.calibration.is_none() {
        files.calibration = Some(PathBuf::from(&args.sensor));
    }
    let usual = if files.calibration.is_some() { DecoderKind::Calibrated } else { DecoderKind::Compact };
    let kind = args.decoder.unwrap_or(usual);
    args.files.idle(kind).iter().for_each(say::warn);
    let decoder = decoders::make(kind, no_contact, &sensor, &files)?;
    create_folder(&args.output)?;
    let job = Job { decoder: &*decoder, sensor: &sensor, output: &args.output, picture: args.picture };
    let mut tally = Tally::default();
    let images: Vec<(&String, &PathBuf)> = sources
        .iter()
        .filter_map(|(name, source)| if let Source::Image(path) = source { Some((name, path)) } else { None })
        .collect();
    let bar = LateBar::new(Some(images.len()), "images");
    let results: Vec<anyhow::Result<String>> = images
        .par_iter()
        .map(|(name, path)| {
            let said = read_color(path).map_err(anyhow::Error::from).and_then(|image| job.decode(&image, name));
            bar.step();
            said.with_context(|| format!("image {}", path.display()))
        })
        .collect();
    drop(bar);
    for said in results {
        tally.count(said);
    }
    for (name, source) in &sources {
        if let Source::Video(path) = source {
            job.decode_video(name, path, &mut tally);
        }
    }
    if tally.decoded == 0 {
        bail!("nothing was decoded ({} failed)", tally.failed);
    }
    Ok(if tally.failed > 0 { Outcome::Degraded } else { Outcome::Done })
}

impl Tally {
    /// Says what came of an image.
    fn count(&mut self, said: anyhow::Result<String>) {
        match said {
            Ok(line) => {
                println!("{line}");
                self.decoded += 1;
            }
            Err(error) => {
                eprintln!("palpate: {error:#}");
                self.failed += 1;
            }
        }
    }
}

impl Job<'_> {
    /// Decodes an image and writes what was asked for; returns a line on it.
    fn decode(&self, image: &Raster<[u8; 3]>, name: &str) -> anyhow::Result<String> {
        let contact = self.decoder.decode(image, self.sensor)?;
        let file = |end: &str| self.output.join(format!("{name}_{end}"));
        write_height_map_npy(file("height.npy"), &contact.height_map)?;
        write_mask(file("contact.png"), &contact.mask)?;
        if self.picture {
            write_color(file("picture.png"), &render_contact(image, &contact, self.sensor))?;
        }
        Ok(format!("{name}: {}", describe(&contact, self.sensor)))
    }

    /// Decodes all frames of a video, some at a time; a frame that fails does not stop the others.
    fn decode_video(&self, name: &str, path: &Path, tally: &mut Tally) {
        let mut frames = match Frames::open(path) {
            Ok(frames) => frames,
            Err(error) => return tally.count(Err(error)),
        };
        let bar = LateBar::new(None, "frames");
        let mut first = 0;
        loop {
            let chunk: Vec<_> = frames.by_ref().take(FRAMES_AT_ONCE).collect();
            if chunk.is_empty() {
                break;
            }
            let count = chunk.len();
            let said: Vec<_> = chunk
                .into_par_iter()
                .enumerate()
                .map(|(i, frame)| {
                    let number = first + i;
                    let said = frame.and_then(|frame| {
                        let said = self.decode(&frame, &format!("{name}_{number:06}"));
                        said.with_context(|| format!("frame {number} of {}", path.display()))
                    });
                    bar.step();
                    said
                })
                .collect();
            for said in said {
                tally.count(said);
            }
            first += count;
        }
    }
}

fn describe(contact: &Contact, sensor: &TactileSensor) -> String {
    let share = contact.contact_share();
    if share == 0.0 {
        return "no contact".to_owned();
    }
    let deepest = contact.indentation(sensor).as_slice().iter().copied().fold(0.0, f32::max);
    format!("contact on {:.1} % of the pad, {:.2} mm deep", 100.0 * share, 1e3 * deepest)
}

/// Images and videos by the name of their output: files as they are given, folders with what they hold.
fn collect(inputs: &[PathBuf]) -> anyhow::Result<BTreeMap<String, Source>> {
    let mut sources = BTreeMap::new();
    let mut add = |path: PathBuf| -> anyhow::Result<()> {
        let stem = path.file_stem().with_context(|| format!("'{}' names no file", path.display()))?;
        let name = stem.to_string_lossy().into_owned();
        let source = if has_extension(&path, &video::EXTENSIONS) { Source::Video(path) } else { Source::Image(path) };
        match sources.insert(name.clone(), source) {
            None => Ok(()),
            Some(_) => bail!("two images are called '{name}': their maps would overwrite each other"),
        }
    };
    for input in inputs {
        if !input.is_dir() {
            add(input.clone())?;
            continue;
        }
        let mut found = false;
        let entries = std::fs::read_dir(input).with_context(|| format!("reading the folder {}", input.display()))?;
        for entry in entries {
            let path = entry.with_context(|| format!("reading the folder {}", input.display()))?.path();
            if has_extension(&path, &["png", "jpg", "jpeg"]) || has_extension(&path, &video::EXTENSIONS) {
                add(path)?;
                found = true;
            }
        }
        if !found {
            bail!("the folder {} holds no image (.png, .jpg) and no video", input.display());
        }
    }
    Ok(sources)
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|e| extensions.contains(&e.to_string_lossy().to_lowercase().as_str()))
}
