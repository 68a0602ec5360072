//! `palpate import`: recordings and data sets of others to scene folders.

mod folders;
mod recording;

use crate::Outcome;
use crate::targets::Targets;
use anyhow::{bail, ensure};
use clap::Subcommand;
use palpate::io::{SceneToWrite, write_scene};
use palpate_recordings::Imported;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// MCAP file or rosbag2 folder (MCAP storage) of ROS 2
    Recording(recording::Args),
    /// A frame of a TUM RGB-D folder
    Tum(folders::TumArgs),
    /// A frame of a BOP scene folder
    Bop(folders::BopArgs),
    /// A cloud (.pcd, .ply, …) and the pose of the camera that saw it
    Cloud(folders::CloudArgs),
    /// An object of the real YCB-Sight (unverified: no sample was at hand)
    YcbSightReal(folders::YcbSightRealArgs),
}

/// Files of a scene that an import writes, whatever it is of.
const WRITTEN: [&str; 6] =
    ["scene.toml", "depth.png", "color.png", "mask.png", "touches/background.png", "touches/000.png"];
/// The farthest reading that 16 bits of a millimetre hold, metres.
const FARTHEST: f32 = 65.535;

/// Takes out readings that no depth image can hold: some drivers and clouds have a few far outside the room. Returns how many.
fn forget_far(imported: &mut Imported) -> usize {
    let depth = imported.scene.frame.depth.as_mut_slice();
    let far: Vec<&mut f32> = depth.iter_mut().filter(|z| **z > FARTHEST).collect();
    let count = far.len();
    for z in far {
        *z = f32::NAN;
    }
    count
}

/// Where the scene goes.
#[derive(clap::Args)]
struct Target {
    /// Scene folder to make
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Overwrite the scene that is already there
    #[arg(long)]
    force: bool,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    match args.what {
        What::Recording(args) => recording::run(args),
        What::Tum(args) => folders::tum(args),
        What::Bop(args) => folders::bop(args),
        What::Cloud(args) => folders::cloud(args),
        What::YcbSightReal(args) => folders::ycb_sight_real(args),
    }
}

impl Target {
    /// Says no before anything is read: to a scene that is there, to a place that is none, and to files among those to be read.
    fn check<'a>(&self, inputs: impl IntoIterator<Item = &'a PathBuf>) -> anyhow::Result<()> {
        let scene = self.output.join("scene.toml");
        ensure!(
            self.force || !scene.exists(),
            "{}: there is already a scene here; --force overwrites it",
            scene.display()
        );
        ensure!(!self.output.is_file(), "{} is a file; a folder is needed", self.output.display());
        if let Some(parent) = self.output.parent().filter(|p| !p.as_os_str().is_empty() && !p.is_dir()) {
            bail!("the folder {} for {} does not exist", parent.display(), self.output.display());
        }
        Targets::keep(inputs).files_in(&self.output, WRITTEN.map(|name| (name, "--output")))
    }

    /// Writes a scene that is complete, and says what was assumed.
    fn write(&self, mut imported: Imported, calibration: Option<&Path>) -> anyhow::Result<Outcome> {
        let far = forget_far(&mut imported);
        ensure!(
            imported.scene.frame.depth.as_slice().iter().any(|z| z.is_finite()),
            "every reading of the depth is over {FARTHEST} m: metres are needed, are these millimetres?"
        );
        let what = SceneToWrite {
            tactile_background: imported.tactile_background.as_ref(),
            ..SceneToWrite::new(&imported.scene)
        };
        write_scene(&self.output, &what)?;
        if let Some(path) = calibration {
            super::copy_calibration(path, &self.output)?;
        }
        for warning in &imported.warnings {
            crate::say::warn(warning);
        }
        let touches = imported.scene.touches.len();
        println!("{}: {touches} touches", self.output.join("scene.toml").display());
        if far > 0 {
            crate::say::warn(format!("{far} readings over {FARTHEST} m do not fit a depth image and were left out"));
        }
        Ok(if far > 0 { Outcome::Degraded } else { Outcome::Done })
    }
}
