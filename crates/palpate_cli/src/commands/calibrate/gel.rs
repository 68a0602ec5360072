use super::boards::{images, name};
use crate::Outcome;
use crate::targets::{Targets, one_name};
use anyhow::{Context as _, bail, ensure};
use palpate::calibrate::gel::{
    GelCalibration, GelError, GelParams, MapKind, PitchSource, PressFault, Quality, agree, calibrate_gel, locate_ball,
    presses_apart, ruler_period,
};
use palpate::geometry::Raster;
use palpate::io::{read_color, write_sensor};
use palpate::tactile::{NoContact, RelaxedGel, TactileSensor, fill_markers, markers};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Radius error and share of the cap from which the user is warned.
const RADIUS_LIMIT: f64 = 0.10;
const RESIDUAL_LIMIT: f64 = 0.12;

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate calibrate gel presses/ --ball-radius 0.002 --background nothing.png --pixel-pitch 0.0000634 --output sensor.toml
  palpate calibrate gel presses/ --ball-radius 0.002 --background nothing.png --ruler screw.png --ruler-marks 0.001 --output sensor.toml

Five to ten presses of a ball, spread over the pad, each wholly inside it, half a millimetre deep; the background is the mean of twenty images without
contact. Presses of balls cannot tell the size of a pixel, whatever their sizes: slopes have no scale. Give the pitch, a press of a ruler or a
screw's thread, or two presses a known distance apart; all that are given must agree within 3 %.

sensor.toml (with its background beside it) is what `palpate decode --sensor` and `palpate reconstruct --calibration` take.

Good: radius within 5 %, residual under 10 % of the cap. Exit status 1: no calibration; 3: some presses were left out (of the calibration or of
--held-out; a press that repeats another is), or the result is poor.")]
pub(crate) struct Args {
    /// Images of presses of a ball, or folders of them; what an earlier run wrote there is no press
    #[arg(required = true, value_name = "PRESS")]
    presses: Vec<PathBuf>,
    /// Radius of the ball, metres; or one for each press
    #[arg(long, required = true, value_delimiter = ',', value_name = "M")]
    ball_radius: Vec<f64>,
    /// No-contact image of the same sensor in the same light
    #[arg(short, long, value_name = "BG")]
    background: PathBuf,
    /// File for the sensor
    #[arg(short, long, value_name = "TOML")]
    output: PathBuf,
    /// Size of a pixel of the background on the gel, metres
    #[arg(long, value_name = "M")]
    pixel_pitch: Option<f64>,
    /// A press of something with evenly spaced marks: a ruler, a thread, a comb
    #[arg(long, value_name = "IMAGE", requires = "ruler_marks")]
    ruler: Option<PathBuf>,
    /// Distance from mark to mark, metres
    #[arg(long, value_name = "M", requires = "ruler")]
    ruler_marks: Option<f64>,
    /// Two presses and how far the robot moved between them, metres
    #[arg(long, num_args = 3, value_names = ["IMAGE", "IMAGE", "M"])]
    apart: Vec<String>,
    /// From colour to slope
    #[arg(long, value_enum, default_value_t = Map::Quadratic)]
    map: Map,
    /// The gel has printed dots: they are masked and filled in
    #[arg(long)]
    markers: bool,
    /// Presses that are not calibrated with, to measure the result on
    #[arg(long, num_args = 1.., value_name = "PRESS")]
    held_out: Vec<PathBuf>,
    /// Seed of the network
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Map {
    /// A quadratic in colours and place, closed form: five presses are enough
    Quadratic,
    /// Colour table of 50³ cells: each colour must have been seen
    Table,
    /// A network of 24 units
    Network,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let beside = beside(&args.output, "background.png");
    let own = [args.output.as_path(), &beside];
    let paths = images(&args.presses, &own)?;
    let held_out_paths = images(&args.held_out, &own)?;
    check_targets(&args, paths.iter().chain(&held_out_paths))?;
    let background = read_color(&args.background)?;
    let presses = read_presses(&paths, &args.ball_radius)?;
    let pitch = pitch(&args, &background)?;
    let map = match args.map {
        Map::Quadratic => MapKind::Quadratic,
        Map::Table => MapKind::Table,
        Map::Network => MapKind::Network,
    };
    let params = GelParams { pitch, map, markers: args.markers, seed: args.seed };
    let gel = match calibrate_gel(&presses, &background, &params) {
        Err(GelError::TooFewPresses { found, needed, left_out }) => {
            say_left_out(&paths, &paths, &left_out);
            bail!(GelError::TooFewPresses { found, needed, left_out: Vec::new() });
        }
        other => other.with_context(|| format!("background {}", args.background.display()))?,
    };
    say_left_out(&paths, &paths, &gel.left_out);
    let mut lost = !gel.left_out.is_empty();
    let held_out = if held_out_paths.is_empty() {
        None
    } else {
        let (quality, left_out) = match gel.measure(&read_presses(&held_out_paths, &args.ball_radius[..1])?) {
            Err(GelError::NothingToMeasure { left_out }) => {
                say_left_out(&held_out_paths, &paths, &left_out);
                bail!(GelError::NothingToMeasure { left_out });
            }
            other => other?,
        };
        say_left_out(&held_out_paths, &paths, &left_out);
        lost |= !left_out.is_empty();
        Some(quality)
    };
    write_sensor(&args.output, &gel, &table(&gel))?;
    if args.json {
        println!("{}", report(&gel, &paths, held_out.as_ref()));
    } else {
        say(&args.output, &gel, &paths, held_out.as_ref());
    }
    let quality = held_out.as_ref().unwrap_or(&gel.quality);
    let poor = quality.radius_error().abs() > RADIUS_LIMIT || quality.residual_share() > RESIDUAL_LIMIT;
    if poor {
        crate::say::warn(format!(
            "the result is poor (radius {:+.1} %, residual {:.1} % of the cap): more presses, spread over the pad? is the \
             ball's radius right?",
            100.0 * quality.radius_error(),
            100.0 * quality.residual_share()
        ));
    }
    Ok(if poor || lost { Outcome::Degraded } else { Outcome::Done })
}

fn read_presses(paths: &[PathBuf], radii: &[f64]) -> anyhow::Result<Vec<(Raster<[u8; 3]>, f64)>> {
    ensure!(
        radii.len() == 1 || radii.len() == paths.len(),
        "--ball-radius has {} values for {} presses; one for all or one for each is needed",
        radii.len(),
        paths.len()
    );
    paths.iter().enumerate().map(|(i, path)| Ok((read_color(path)?, radii[i % radii.len()]))).collect()
}

/// * `calibrated` – the presses that were calibrated with, whose numbers faults name
fn say_left_out(paths: &[PathBuf], calibrated: &[PathBuf], left_out: &[(usize, PressFault)]) {
    for (i, fault) in left_out {
        eprintln!("palpate: {}: {}", paths[*i].display(), reason(fault, calibrated));
    }
}

fn reason(fault: &PressFault, calibrated: &[PathBuf]) -> String {
    match fault {
        PressFault::Repeats { of } => {
            format!("the press repeats {}: the same contact circle proves nothing twice", calibrated[*of].display())
        }
        PressFault::CalibratedWith { of } => {
            format!("the press was calibrated with, as {}: nothing is measured on it", calibrated[*of].display())
        }
        other => other.to_string(),
    }
}

/// A file that belongs to a sensor: `sensor_background.png` to `sensor.toml`.
fn beside(sensor: &Path, end: &str) -> PathBuf {
    let stem = sensor.file_stem().map_or_else(|| "sensor".into(), |s| s.to_string_lossy());
    sensor.with_file_name(format!("{stem}_{end}"))
}

/// Nothing that is read is overwritten, and all that belongs to a sensor can be written.
fn check_targets<'a>(args: &'a Args, images: impl Iterator<Item = &'a PathBuf>) -> anyhow::Result<()> {
    let (background, table) = (beside(&args.output, "background.png"), beside(&args.output, "table"));
    let mut inputs: Vec<PathBuf> = images.chain(&args.ruler).cloned().collect();
    inputs.extend(args.apart.iter().take(2).map(PathBuf::from));
    // A calibration anew with its own background writes it as it was.
    if one_name(&background) != one_name(&args.background) {
        inputs.push(args.background.clone());
    }
    let mut targets = Targets::keep(inputs);
    targets.file(&args.output, "--output")?;
    targets.file(&background, "the background beside --output")?;
    if args.map == Map::Table {
        targets.files_in(&table, ["grad_mag.npy", "grad_dir.npy"].map(|name| (name, "the table beside --output")))?;
    }
    Ok(())
}

/// Every source of the pitch that was given.
fn pitch(args: &Args, background: &Raster<[u8; 3]>) -> anyhow::Result<f64> {
    let sensor = TactileSensor {
        model: "custom".to_owned(),
        width: background.cols(),
        height: background.rows(),
        // Not looked at where only shapes are.
        pixel_pitch: 5e-5,
        relaxed_gel: RelaxedGel::Flat,
    };
    let dots = args.markers.then(|| markers(background));
    let filled = dots.as_ref().map_or_else(|| background.clone(), |dots| fill_markers(background, dots));
    let mut sources = Vec::new();
    if let Some(pitch) = args.pixel_pitch {
        sources.push(PitchSource { name: "--pixel-pitch", pitch });
    }
    if args.ruler.is_none() && args.apart.is_empty() {
        return Ok(agree(&sources)?);
    }
    let no_contact = NoContact::new(filled, &sensor).with_context(|| args.background.display().to_string())?;
    if let (Some(path), Some(marks)) = (&args.ruler, args.ruler_marks) {
        ensure!(marks.is_finite() && marks > 0.0, "--ruler-marks {marks}: a finite number > 0 is needed");
        let image = read_color(path)?;
        let image = if args.markers { fill_markers(&image, &markers(&image)) } else { image };
        let difference = no_contact.difference(&image).with_context(|| path.display().to_string())?;
        let period = ruler_period(&difference).with_context(|| path.display().to_string())?;
        sources.push(PitchSource { name: "--ruler", pitch: marks / period });
    }
    if let [first, second, distance] = &args.apart[..] {
        let metres: f64 = distance.parse().ok().filter(|d: &f64| d.is_finite() && *d > 0.0).with_context(|| {
            format!("--apart {first} {second} {distance}: the third is a distance in metres, a number > 0")
        })?;
        let center = |path: &str| -> anyhow::Result<[f64; 2]> {
            let image = read_color(path)?;
            Ok(locate_ball(&image, &no_contact, dots.as_ref()).with_context(|| path.to_owned())?.center)
        };
        sources.push(PitchSource { name: "--apart", pitch: presses_apart(center(first)?, center(second)?, metres)? });
    }
    Ok(agree(&sources)?)
}

fn table(gel: &GelCalibration) -> toml::Table {
    let rounded = |v: f64| toml::Value::Float((v * 1e5).round() / 1e5);
    let mut table = toml::Table::new();
    table.insert("presses".into(), (gel.used.len() as i64).into());
    table.insert("ball_radius".into(), gel.presses[0].ball_radius.into());
    table.insert("left_one_out_radius_error".into(), rounded(gel.quality.radius_error()));
    table.insert("left_one_out_radius_error_size".into(), rounded(gel.quality.radius_error_size()));
    table.insert("left_one_out_residual_mm".into(), rounded(1e3 * gel.quality.residual()));
    table.insert("left_one_out_residual_share_of_cap".into(), rounded(gel.quality.residual_share()));
    table
}

fn summary(quality: &Quality) -> serde_json::Value {
    json!({
        "presses": quality.presses.iter().flatten().count(),
        "radius_error": quality.radius_error(),
        "radius_error_size": quality.radius_error_size(),
        "residual_mm": 1e3 * quality.residual(),
        "residual_share_of_cap": quality.residual_share(),
        "within_5_percent": quality.within(0.05),
        "within_10_percent": quality.within(0.1),
    })
}

fn report(gel: &GelCalibration, paths: &[PathBuf], held_out: Option<&Quality>) -> serde_json::Value {
    let presses: Vec<_> = gel
        .used
        .iter()
        .zip(&gel.presses)
        .zip(&gel.quality.presses)
        .map(|((i, press), quality)| {
            json!({
                "image": paths[*i],
                "center_px": press.ball.center,
                "contact_radius_px": press.ball.contact_radius,
                "radius_mm": quality.map(|q| 1e3 * q.radius),
                "residual_mm": quality.map(|q| 1e3 * q.residual),
            })
        })
        .collect();
    json!({
        "pixel_pitch": gel.sensor.pixel_pitch,
        "map": gel.map.kind().name(),
        "presses": presses,
        "mean_cap_mm": 1e3 * mean_cap(gel),
        "left_out": gel.left_out.iter().map(|(i, f)| json!({ "image": paths[*i], "reason": reason(f, paths) })).collect::<Vec<_>>(),
        "left_one_out": summary(&gel.quality),
        "held_out": held_out.map(summary),
    })
}

/// How deep the balls are in their contact circles, on average, metres.
fn mean_cap(gel: &GelCalibration) -> f64 {
    gel.presses.iter().map(|p| p.cap(gel.sensor.pixel_pitch)).sum::<f64>() / gel.presses.len() as f64
}

fn say(output: &Path, gel: &GelCalibration, paths: &[PathBuf], held_out: Option<&Quality>) {
    println!("press: contact circle; ball decoded without it");
    for ((i, press), quality) in gel.used.iter().zip(&gel.presses).zip(&gel.quality.presses) {
        let b = &press.ball;
        let decoded = quality.map_or("no sphere".to_owned(), |q| {
            format!(
                "radius {:.3} mm ({:+.1} %), residual {:.3} mm",
                1e3 * q.radius,
                100.0 * q.radius_error(),
                1e3 * q.residual
            )
        });
        println!(
            "{}: {:.1} px at ({:.1}, {:.1}); {decoded}",
            name(&paths[*i]),
            b.contact_radius,
            b.center[0],
            b.center[1]
        );
    }
    let line = |what: &str, q: &Quality| {
        println!(
            "{what}: {} presses, radius {:+.1} % ({:.1} % a press, {} within 5 %), residual {:.3} mm, {:.1} % of the cap",
            q.presses.iter().flatten().count(),
            100.0 * q.radius_error(),
            100.0 * q.radius_error_size(),
            q.within(0.05),
            1e3 * q.residual(),
            100.0 * q.residual_share()
        );
    };
    line("each press by the others", &gel.quality);
    if let Some(quality) = held_out {
        line("held out", quality);
    }
    // Nothing else tells a wrong radius: slopes of another ball fit as well.
    println!(
        "by their contact circles the balls were pressed {:.2} mm deep on average: is that so? If it was deeper, --ball-radius may be a diameter",
        1e3 * mean_cap(gel)
    );
    println!("{}: {:.5} mm a pixel, map {}", output.display(), 1e3 * gel.sensor.pixel_pitch, gel.map.kind().name());
}
