//! `palpate import`: recordings and data sets of others to scene folders.

mod folders;
mod recording;

use crate::Outcome;
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
    /// Says no before anything is read.
    fn check(&self) -> anyhow::Result<()> {
        let scene = self.output.join("scene.toml");
        ensure!(
            self.force || !scene.exists(),
            "{}: there is already a scene here; --force overwrites it",
            scene.display()
        );
        ensure!(!self.output.is_file(), "{} is a file; a folder is needed", self.output.display());
        match self.output.parent().filter(|p| !p.as_os_str().is_empty() && !p.is_dir()) {
            Some(parent) => bail!("the folder {} for {} does not exist", parent.display(), self.output.display()),
            None => Ok(()),
        }
    }

    /// Writes a scene that is complete, and says what was assumed.
    fn write(&self, imported: &Imported, calibration: Option<&Path>) -> anyhow::Result<Outcome> {
        let what = SceneToWrite {
            tactile_background: imported.tactile_background.as_ref(),
            ..SceneToWrite::new(&imported.scene)
        };
        write_scene(&self.output, &what)?;
        if let Some(path) = calibration {
            super::copy_calibration(path, &self.output)?;
        }
        for warning in &imported.warnings {
            eprintln!("palpate: warning: {warning}");
        }
        let touches = imported.scene.touches.len();
        println!("{}: {touches} touches", self.output.join("scene.toml").display());
        Ok(Outcome::Done)
    }
}
