use crate::{Outcome, commands};
use anyhow::Context as _;
use clap::{Parser, Subcommand};

/// The full 3D shape of an object from one RGB-D image and a few touches of a visuo-tactile fingertip.
///
/// Exit status: 0 done, 1 failed, 2 usage, 3 finished with losses (said on standard error).
#[derive(Parser)]
#[command(name = "palpate", version, propagate_version = true)]
pub(crate) struct Args {
    /// Worker threads, at most 512; 0 = one per core. The result does not depend on it.
    #[arg(long, global = true, default_value_t = 0, value_name = "N", value_parser = threads)]
    threads: usize,
    #[command(subcommand)]
    command: Command,
}

/// More threads than any machine of one user has cores; thousands of them freeze it.
const MOST_THREADS: usize = 512;

fn threads(text: &str) -> Result<usize, String> {
    let number = text.parse().map_err(|e| format!("{e}"))?;
    if number <= MOST_THREADS { Ok(number) } else { Err(format!("at most {MOST_THREADS} threads are started")) }
}

#[derive(Subcommand)]
enum Command {
    /// Make a scene folder from a depth image and what else is at hand
    Init(commands::init::Args),
    /// Say everything that is wrong or doubtful in a scene
    Check(commands::check::Args),
    /// One RGB-D frame and some touches in, a closed metric mesh out
    Reconstruct(commands::reconstruct::Args),
    /// Calibrate a camera, a gel, or where a sensor sits on the robot
    Calibrate(commands::calibrate::Args),
    /// Record touches from a tactile sensor into a scene
    Capture(commands::capture::Args),
    /// Make a scene from a recording or a data set of others
    Import(commands::import::Args),
    /// Depth and colour of two cameras in one raster
    Register(commands::register::Args),
    /// Simulate scenes with exact truth from meshes
    Simulate(commands::simulate::Args),
    /// Simulate tactile presses with truth, to train and test decoders
    Presses(commands::presses::Args),
    /// RGB-D frame to the object's points with normals, world frame
    Clean(commands::clean::Args),
    /// Mesh an oriented point cloud
    Surface(commands::surface::Args),
    /// Planes, axes and spheres of symmetry that the evidence supports
    Symmetry(commands::symmetry::Args),
    /// Where to touch next: reachable sensor poses, the most useful first
    NextTouch(commands::next_touch::Args),
    /// Play touches on known meshes by several policies: error against touches
    Explore(commands::explore::Args),
    /// Tactile images to height maps and contact masks
    Decode(commands::decode::Args),
    /// Distances, F-scores and volumetric IoU of a mesh against the truth
    Compare(commands::compare::Args),
    /// Ray-cast a picture of meshes or scenes
    Render(commands::render::Args),
    /// Clean up a mesh: repair, drop pieces, fill holes, smooth, decimate
    Mesh(commands::mesh::Args),
    /// Is a mesh closed, manifold, oriented; volume, area, inertia
    Inspect(commands::inspect::Args),
    /// Run every scene, touch count and method; tables and plots
    Benchmark(commands::benchmark::Args),
    /// Train a network that reads tactile images
    #[cfg(feature = "nn")]
    Train(commands::train::Args),
    /// Train networks: needs a build with the feature `nn`
    #[cfg(not(feature = "nn"))]
    #[command(hide = true)]
    Train(NotBuilt),
    /// Print the effective parameters
    Config(commands::config::Args),
}

/// Takes whatever the command would take.
#[cfg(not(feature = "nn"))]
#[derive(clap::Args)]
struct NotBuilt {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _any: Vec<String>,
}

impl Args {
    pub(crate) fn run(self) -> anyhow::Result<Outcome> {
        rayon::ThreadPoolBuilder::new().num_threads(self.threads).build_global().context("starting the thread pool")?;
        match self.command {
            Command::Init(args) => commands::init::run(args),
            Command::Check(args) => commands::check::run(args),
            Command::Reconstruct(args) => commands::reconstruct::run(args),
            Command::Calibrate(args) => commands::calibrate::run(args),
            Command::Capture(args) => commands::capture::run(args),
            Command::Import(args) => commands::import::run(args),
            Command::Register(args) => commands::register::run(args),
            Command::Simulate(args) => commands::simulate::run(args),
            Command::Presses(args) => commands::presses::run(args),
            Command::Clean(args) => commands::clean::run(args),
            Command::Surface(args) => commands::surface::run(args),
            Command::Symmetry(args) => commands::symmetry::run(args),
            Command::NextTouch(args) => commands::next_touch::run(args),
            Command::Explore(args) => commands::explore::run(args),
            Command::Decode(args) => commands::decode::run(args),
            Command::Compare(args) => commands::compare::run(args),
            Command::Render(args) => commands::render::run(args),
            Command::Mesh(args) => commands::mesh::run(args),
            Command::Inspect(args) => commands::inspect::run(args),
            Command::Benchmark(args) => commands::benchmark::run(args),
            #[cfg(feature = "nn")]
            Command::Train(args) => commands::train::run(args),
            #[cfg(not(feature = "nn"))]
            Command::Train(_) => {
                anyhow::bail!(
                    "this palpate was built without networks; build it with: cargo build --release --features nn"
                )
            }
            Command::Config(args) => commands::config::run(args),
        }
    }
}
