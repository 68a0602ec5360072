//! `explore`: plays touches on known meshes with several policies, and says which is worth how much.

mod plot;
mod results;
mod summary;

use super::next_touch::{read_plan, read_reach};
use super::simulate::load;
use crate::Outcome;
use crate::progress::LateBar;
use crate::say;
use anyhow::{Context as _, bail, ensure};
use clap::ValueEnum;
use palpate::explore::{ExploreParams, NextTouchParams, Policy, Step, Trial};
use palpate::geometry::TriangleMesh;
use rayon::prelude::*;
use results::{Key, Results};
use std::path::PathBuf;
use std::sync::Mutex;

const EXAMPLES: &str = "\
Examples:
  palpate explore mug.ply --touches 5 --output mug
  palpate explore mug.ply can.ply --touches 10 --policy next-best,random --seed 0,1,2 --output both

Writes errors.csv, summary.md and touches.svg. A run that was interrupted goes on where it stopped.
`oracle` tries every candidate on the truth: a yardstick, not a policy.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Closed meshes in metres, z up, or primitive:NAME as in `simulate`
    #[arg(required = true, value_name = "MESH")]
    meshes: Vec<String>,
    /// Touches to make, misses included
    #[arg(long, default_value_t = 5, value_name = "N")]
    touches: usize,
    /// Policies
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [Name::NextBest, Name::Random, Name::Even], value_name = "POLICY,…")]
    policy: Vec<Name>,
    /// The view, as in `simulate`
    #[arg(long, default_value_t = 0, value_name = "K")]
    view: usize,
    /// Seeds of the view and of the candidates, one run each [default: the plan's, 0]
    #[arg(long, value_delimiter = ',', value_name = "N,…")]
    seed: Vec<u64>,
    /// Reachable poses offered at each step, the same number for every policy; the plan's `candidates` is for one list and not used
    /// [default: 20]
    #[arg(long, value_name = "N")]
    candidates: Option<usize>,
    /// Sensor: ycb-sight, gelsight-r15, gelsight-mini, digit [default: ycb-sight]
    #[arg(long, value_name = "PRESET")]
    sensor: Option<String>,
    /// What the arm can reach (TOML)
    #[arg(long, value_name = "FILE")]
    reach: Option<PathBuf>,
    /// Parameters of the plan and the reconstruction (TOML); `palpate config --plan` prints all of them. Flags win over the file; its
    /// `candidates` and `count` are those of `next-touch`
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Folder for errors.csv, summary.md and touches.svg
    #[arg(short, long, value_name = "DIR", default_value = "explore")]
    output: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Name {
    /// The largest expected gain
    NextBest,
    /// Any candidate
    Random,
    /// The farthest from all touches so far
    Even,
    /// Tries every candidate on the truth
    Oracle,
}

impl Name {
    fn policy(self) -> Policy {
        match self {
            Self::NextBest => Policy::NextBest,
            Self::Random => Policy::Random,
            Self::Even => Policy::Even,
            Self::Oracle => Policy::Oracle,
        }
    }
}

struct Job<'a> {
    object: &'a (String, TriangleMesh),
    key: Key,
    policy: Policy,
    seed: u64,
}

pub(crate) fn run(mut args: Args) -> anyhow::Result<Outcome> {
    ensure!(args.touches > 0, "--touches is 0; at least 1 touch must be made");
    let objects: Vec<(String, TriangleMesh)> = args.meshes.iter().map(|m| load(m)).collect::<Result<_, _>>()?;
    for (i, (name, _)) in objects.iter().enumerate() {
        if objects[..i].iter().any(|(other, _)| other == name) {
            bail!("two meshes are called '{name}': their rows could not be told apart");
        }
    }
    let mut base = ExploreParams { touches: args.touches, view: args.view, ..ExploreParams::default() };
    let plan = read_plan(args.config.as_ref())?;
    if args.seed.is_empty() {
        args.seed.push(plan.seed);
    }
    // Number and seed of one list are none of a loop: a run with another seed goes on in the same folder.
    let NextTouchParams { count, seed, .. } = NextTouchParams::default();
    base.plan = NextTouchParams { candidates: args.candidates.unwrap_or(base.plan.candidates), count, seed, ..plan };
    if let Some(sensor) = &args.sensor {
        base.plan.sensor.clone_from(sensor);
    }
    if let Some(path) = &args.reach {
        base.plan.reach = read_reach(path)?;
    }
    // Everything that a mesh or a parameter can be wrong in is said before anything is written.
    for (name, mesh) in &objects {
        Trial::new(name, mesh, &base).with_context(|| format!("exploring '{name}'"))?;
    }
    std::fs::create_dir_all(&args.output).with_context(|| format!("making the folder {}", args.output.display()))?;
    let conditions = serde_json::to_string(&base.plan)?;
    let results = Results::open(&args.output.join("errors.csv"), &conditions)?;
    let jobs: Vec<Job> = jobs(&args, &objects).into_iter().filter(|job| !results.holds(&job.key)).collect();
    let bar = LateBar::new(Some(jobs.len() * (args.touches + 1)), "reconstructions");
    let results = Mutex::new(results);
    jobs.par_iter().try_for_each(|job| -> anyhow::Result<()> {
        let params = ExploreParams { seed: job.seed, ..base.clone() };
        let steps = play(job, &params, &bar).with_context(|| format!("exploring '{}'", job.object.0))?;
        results.lock().expect("no thread panicked while it held the results").add(&job.key, &steps)
    })?;
    drop(bar);
    let results = results.into_inner().expect("no thread panicked while it held the results");
    let rows = results.rows();
    summary::write(&args.output.join("summary.md"), rows)?;
    plot::write(&args.output.join("touches.svg"), rows)?;
    print!("{}", summary::text(rows));
    println!("{}", args.output.join("errors.csv").display());
    let short = jobs.iter().any(|job| results.last(&job.key).is_some_and(|t| t < args.touches));
    if short {
        say::warn("some runs ended early: no other place could be reached");
        return Ok(Outcome::Degraded);
    }
    Ok(Outcome::Done)
}

fn jobs<'a>(args: &Args, objects: &'a [(String, TriangleMesh)]) -> Vec<Job<'a>> {
    let mut jobs = Vec::new();
    for &seed in &args.seed {
        for object in objects {
            for name in &args.policy {
                let policy = name.policy();
                let key = Key {
                    object: object.0.clone(),
                    view: args.view,
                    seed,
                    policy: policy.name().to_owned(),
                    asked: args.touches,
                };
                jobs.push(Job { object, key, policy, seed });
            }
        }
    }
    jobs
}

fn play(job: &Job, params: &ExploreParams, bar: &LateBar) -> anyhow::Result<Vec<Step>> {
    let trial = Trial::new(&job.object.0, &job.object.1, params)?;
    Ok(trial.run(job.policy, &|| bar.step())?)
}
