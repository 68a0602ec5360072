//! Measurements over whole data sets.

mod dataset;
mod plots;
mod reconstructor;
mod results;
mod row_file;
mod shape;
mod summary;
mod tactile;

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
    /// Decode tactile images with known truth by every decoder; compare height maps and masks
    Tactile(tactile::Args),
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    match args.what {
        What::Shape(args) => shape::run(args),
        What::Tactile(args) => tactile::run(args),
    }
}
