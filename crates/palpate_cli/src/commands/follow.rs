//! `reconstruct --follow`: the mesh keeps up with touches while they are made.

use super::reconstruct::{Args, write_result};
use super::symmetry::reason;
use crate::{Outcome, say};
use anyhow::{Context as _, ensure};
use palpate::io::{self, SceneChange, SceneFile, SceneFollower};
use palpate::pipeline::{Followed, ReconstructParams, Session, Stages, Update, Warning};
use palpate::tactile::{TactileDecoder, Touch};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Time between two looks at the scene's file.
const LOOK: Duration = Duration::from_millis(20);

/// What one scene's end asks for.
enum End {
    /// All touches that were asked for are in.
    Enough,
    /// The scene was written anew.
    Rewritten(Box<SceneFile>),
}

/// * `output` – the mesh of the one scene, and its folder if that is to be made
pub(super) fn run(
    args: &Args,
    (made, output): (Option<&PathBuf>, &Path),
    params: &ReconstructParams,
) -> anyhow::Result<Outcome> {
    let folder = &args.scenes[0];
    ensure!(args.settle >= 0.0, "--settle is {}; seconds ≥ 0 are needed, or inf", args.settle);
    let (mut file, mut follower) = SceneFollower::open(folder)?;
    made.map_or(Ok(()), io::create_folder)?;
    loop {
        // Which touches will come is not known.
        let decoder = args.decoder.of_scene(&mut file, folder, true)?;
        super::clean::warn_of_unused_pick(args.pick, &mut file);
        file.warnings.iter().for_each(say::warn);
        let mut run = Run::begin(file, (args, output), params, decoder.as_deref())?;
        match run.follow(&mut follower)? {
            End::Enough => return Ok(if run.lossy() { Outcome::Degraded } else { Outcome::Done }),
            End::Rewritten(new) => {
                println!("the scene was changed: starting again");
                file = *new;
            }
        }
    }
}

struct Run<'a> {
    session: Session<'a>,
    args: &'a Args,
    output: &'a Path,
    touches: usize,
    /// A touch could not be read or decoded.
    lost: bool,
}

impl<'a> Run<'a> {
    fn begin(
        file: SceneFile,
        (args, output): (&'a Args, &'a Path),
        params: &ReconstructParams,
        decoder: Option<&'a dyn TactileDecoder>,
    ) -> anyhow::Result<Self> {
        let begun = Instant::now();
        let touches = file.scene.touches.len();
        let session = Session::start(file.scene, params, Stages { decoder, ..Stages::default() })?;
        let run = Self { session, args, output, touches, lost: false };
        run.write()?;
        run.session.reconstruction().warnings.iter().for_each(say::warn);
        println!("{}: {}, {}", output.display(), say::count(touches, "touch", "touches"), run.state(begun));
        Ok(run)
    }

    /// Takes in touches as they come.
    fn follow(&mut self, follower: &mut SceneFollower) -> anyhow::Result<End> {
        let mut last = Instant::now();
        loop {
            let enough = self.args.max_touches.is_some_and(|n| self.touches >= n);
            if !self.session.is_settled() && (last.elapsed().as_secs_f64() >= self.args.settle || enough) {
                self.settle()?;
            }
            if enough {
                return Ok(End::Enough);
            }
            match follower.poll() {
                Ok(SceneChange::Touches(touches)) => {
                    for touch in touches {
                        self.take(touch)?;
                    }
                    last = Instant::now();
                }
                Ok(SceneChange::Rewritten(file)) => return Ok(End::Rewritten(file)),
                Ok(_) => std::thread::sleep(LOOK),
                Err(error) => {
                    eprintln!("palpate: {:#}", anyhow::Error::from(error));
                    self.lost = true;
                    std::thread::sleep(50 * LOOK);
                }
            }
        }
    }

    fn take(&mut self, mut touch: Touch) -> anyhow::Result<()> {
        if self.args.max_touches.is_some_and(|n| self.touches >= n) {
            return Ok(());
        }
        let begun = Instant::now();
        self.args.decoder.drop_unwanted_maps(&mut touch);
        let number = self.touches;
        self.touches += 1;
        match self.session.add_touch(touch) {
            Ok(update) => {
                let solved = begun.elapsed();
                self.write()?;
                println!("touch {number}: {}", self.line(&update, solved, begun));
            }
            Err(error) => {
                self.lost = true;
                eprintln!("palpate: touch {number}: {:#}", anyhow::Error::from(error));
            }
        }
        Ok(())
    }

    fn settle(&mut self) -> anyhow::Result<()> {
        // Never asked for.
        if self.args.settle.is_infinite() {
            return Ok(());
        }
        let begun = Instant::now();
        self.session.settle().context("starting again with all touches")?;
        self.write()?;
        println!("settled: {}", self.state(begun));
        Ok(())
    }

    fn line(&self, update: &Update, solved: Duration, begun: Instant) -> String {
        let how = match &update.followed {
            Followed::Locally if update.changed.is_empty() => "it agrees with the mesh".to_owned(),
            Followed::Locally => format!("{} places changed", update.changed.len()),
            Followed::LeftOut { reason } => format!("left out: {reason}"),
            Followed::Contradicted { rejection, .. } => {
                format!("an accepted symmetry no longer holds, {}: started again", reason(*rejection))
            }
            Followed::AgainstTouch { touch } => format!("it speaks against touch {touch}: started again"),
            Followed::Outgrown => "the object is much larger than was thought: started again".to_owned(),
            _ => "started again".to_owned(),
        };
        format!("{:.0} ms to the mesh, {}; {how}", 1e3 * solved.as_secs_f64(), self.state(begun))
    }

    fn state(&self, begun: Instant) -> String {
        let mesh = &self.session.reconstruction().mesh;
        let volume = mesh.volume() * 1e6;
        format!("{} faces, {volume:.1} cm³, {:.0} ms", mesh.faces.len(), 1e3 * begun.elapsed().as_secs_f64())
    }

    fn write(&self) -> anyhow::Result<()> {
        write_result(self.output, self.session.reconstruction())
    }

    fn lossy(&self) -> bool {
        self.lost || self.session.reconstruction().warnings.iter().any(Warning::is_loss)
    }
}
