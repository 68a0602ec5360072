use crate::Outcome;
use crate::decoders::TouchDecoder;
use crate::progress::StageClock;
use crate::say;
use anyhow::{Context as _, ensure};
use palpate::explore::{NextTouch, NextTouchParams, Reach, next_touches};
use palpate::geometry::Isometry;
use palpate::io;
use palpate::pipeline::Stages;
use serde_json::{Value, json};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  palpate next-touch scene --count 3
  palpate next-touch scene --count 5 --reach reach.toml --json

`gain` is the expected decrease of the mesh's mean distance from the truth; each next touch is rated as if the earlier ones were made.
The reach file (docs/next-touch.md) states what the arm can do: support, half-spaces, workspace box, cone of approach.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Scene folder
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Touches to propose [default: 1]
    #[arg(long, value_name = "K")]
    count: Option<usize>,
    /// What the arm can reach (TOML)
    #[arg(long, value_name = "FILE")]
    reach: Option<PathBuf>,
    /// Print one JSON object instead of a table
    #[arg(long)]
    json: bool,
    /// A pixel on the object, where the scene has no mask
    #[arg(long, value_name = "U,V", value_parser = super::clean::pixel)]
    pick: Option<(f64, f64)>,
    #[command(flatten)]
    decoder: TouchDecoder,
    /// Sensor, where the scene has none: ycb-sight, gelsight-r15, gelsight-mini, digit [default: ycb-sight]
    #[arg(long, value_name = "PRESET")]
    sensor: Option<String>,
    /// Poses to choose from [default: 200]
    #[arg(long, value_name = "N")]
    candidates: Option<usize>,
    /// Parameters of the plan (TOML); `palpate config --plan` prints all of them. Flags win over the file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Seed of the candidates and of the reconstruction [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

impl Args {
    fn params(&self) -> anyhow::Result<NextTouchParams> {
        let mut params = read_plan(self.config.as_ref())?;
        params.count = self.count.unwrap_or(params.count);
        ensure!(self.count != Some(0), "--count is 0; at least 1 touch must be asked for");
        params.candidates = self.candidates.unwrap_or(params.candidates);
        if let Some(seed) = self.seed {
            (params.seed, params.reconstruct.seed) = (seed, seed);
        }
        if let Some(sensor) = &self.sensor {
            params.sensor.clone_from(sensor);
        }
        if let Some(path) = &self.reach {
            params.reach = read_reach(path)?;
        }
        params.reconstruct.segment.pick = self.pick.or(params.reconstruct.segment.pick);
        Ok(params)
    }
}

/// The plan's parameters from a file, or the defaults.
pub(super) fn read_plan(path: Option<&PathBuf>) -> anyhow::Result<NextTouchParams> {
    let Some(path) = path else { return Ok(NextTouchParams::default()) };
    let text = io::read_text(path)?;
    toml::from_str(&text).with_context(|| format!("reading the parameters in '{}'", path.display()))
}

/// What the arm can reach, from a file.
pub(super) fn read_reach(path: &PathBuf) -> anyhow::Result<Reach> {
    let text = io::read_text(path)?;
    let reach: Reach = toml::from_str(&text).with_context(|| format!("reading the reach in '{}'", path.display()))?;
    reach.validate().with_context(|| format!("reading the reach in '{}'", path.display()))?;
    Ok(reach)
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let params = args.params()?;
    let mut file = io::read_scene(&args.scene).with_context(|| format!("reading {}", args.scene.display()))?;
    let decoder = args.decoder.of_scene(&mut file, &args.scene, false)?;
    super::clean::warn_of_unused_pick(args.pick, &mut file);
    file.warnings.iter().for_each(say::warn);
    let clock = StageClock::start();
    let on_stage = |stage| clock.begin(stage);
    let stages = Stages { decoder: decoder.as_deref(), on_stage: Some(&on_stage), ..Stages::default() };
    let touches = next_touches(&file.scene, &params, &stages).context("seeking the next touch")?;
    clock.finish();
    if args.json {
        let list: Vec<Value> = touches.iter().enumerate().map(|(i, t)| entry(i + 1, t)).collect();
        let report = json!({ "scene": file.scene.name, "touches_in_scene": file.scene.touches.len(), "touches": list });
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print_table(&touches);
    }
    if touches.len() < params.count {
        let found = say::count(touches.len(), "touch", "touches");
        say::warn(format!("{found} of {}; no other reachable place promises anything", params.count));
        return Ok(Outcome::Degraded);
    }
    Ok(Outcome::Done)
}

fn pose(world_from_sensor: &Isometry) -> Value {
    let q = world_from_sensor.rotation.coords;
    json!({ "translation": world_from_sensor.translation.vector.as_slice(), "quaternion_xyzw": [q.x, q.y, q.z, q.w] })
}

fn entry(rank: usize, touch: &NextTouch) -> Value {
    json!({
        "rank": rank,
        "world_from_sensor": pose(touch.world_from_sensor()),
        "world_from_aim": pose(&touch.candidate.world_from_aim),
        "point": touch.candidate.point.coords.as_slice(),
        "normal": touch.candidate.normal.as_slice(),
        "expected_gain_mm": 1e3 * touch.gain.mean_distance,
        "resolved_area_cm2": 1e4 * touch.gain.area,
        "sigma_mm": 1e3 * touch.gain.sigma,
        "disagreement_mm": 1e3 * touch.gain.disagreement,
        "from_measured_mm": 1e3 * touch.from_measured,
        "why": touch.why(),
    })
}

fn print_table(touches: &[NextTouch]) {
    println!("rank  gain mm  area cm²  point, mm (world)      press direction        why");
    for (i, touch) in touches.iter().enumerate() {
        let (p, d) = (touch.candidate.point * 1e3, -touch.candidate.normal);
        println!(
            "{:>4}  {:>7.3}  {:>8.1}  {:>6.0} {:>6.0} {:>6.0}   {:>6.2} {:>6.2} {:>6.2}   {}",
            i + 1,
            1e3 * touch.gain.mean_distance,
            1e4 * touch.gain.area,
            p.x,
            p.y,
            p.z,
            d.x,
            d.y,
            d.z,
            touch.why()
        );
    }
}
