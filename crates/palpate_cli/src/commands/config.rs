use crate::{Outcome, config};
use palpate::pipeline::ReconstructParams;
use std::path::PathBuf;

#[derive(clap::Args)]
#[command(
    after_help = "Example: palpate config > my.toml; edit it; palpate reconstruct SCENE --config my.toml --output OUT.ply"
)]
pub(crate) struct Args {
    /// A file to read first; what it does not set is printed with its default.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let params = match &args.config {
        Some(path) => config::read(path)?,
        None => ReconstructParams::default(),
    };
    print!("{}", config::to_toml(&params)?);
    Ok(Outcome::Done)
}
