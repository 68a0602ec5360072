use crate::{Outcome, config};
use anyhow::Context as _;
use palpate::pipeline::ReconstructParams;
use std::path::PathBuf;

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate config > my.toml; edit it; palpate reconstruct SCENE --config my.toml --output OUT.ply
  palpate config --plan > plan.toml; edit it; palpate next-touch SCENE --config plan.toml")]
pub(crate) struct Args {
    /// The parameters of `next-touch` and `explore` instead of those of `reconstruct`.
    #[arg(long)]
    plan: bool,
    /// A file to read first; what it does not set is printed with its default.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    if args.plan {
        let plan = super::next_touch::read_plan(args.config.as_ref())?;
        print!("{}", toml::to_string(&plan).context("writing the parameters")?);
        return Ok(Outcome::Done);
    }
    let params = match &args.config {
        Some(path) => config::read(path)?,
        None => ReconstructParams::default(),
    };
    print!("{}", config::to_toml(&params)?);
    Ok(Outcome::Done)
}
