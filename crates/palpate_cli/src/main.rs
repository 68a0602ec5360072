//! `palpate`: the command line. Parsing, files and messages; every computation is in the library.

mod args;
mod commands;
mod config;
mod decoders;
mod progress;
mod report;
mod say;
mod targets;
mod video;

use clap::Parser as _;
use std::process::ExitCode;

/// How a command ended when it did not fail.
pub(crate) enum Outcome {
    /// Everything asked for was done.
    Done,
    /// Finished with losses, already said on standard error.
    Degraded,
}

fn main() -> ExitCode {
    // A reader that has seen enough, like `head`, ends us quietly.
    sigpipe::reset();
    let args = args::Args::parse();
    match args.run() {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Degraded) => ExitCode::from(3),
        Err(error) => {
            eprintln!("palpate: {error:#}");
            ExitCode::FAILURE
        }
    }
}
