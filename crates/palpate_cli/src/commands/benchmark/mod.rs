//! Measurements over whole data sets.

mod dataset;
mod plots;
mod reconstructor;
mod results;
mod shape;
mod summary;

use crate::Outcome;

#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Reconstruct every scene by every method after so many touches; compare with the truth
    Shape(shape::Args),
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    match args.what {
        What::Shape(args) => shape::run(args),
    }
}
