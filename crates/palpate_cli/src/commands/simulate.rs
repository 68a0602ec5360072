use crate::progress::progress_bar;
use crate::{Outcome, say};
use anyhow::{Context as _, bail};
use palpate::geometry::TriangleMesh;
use palpate::io::{SceneToWrite, read_mesh, write_mesh, write_scene, write_ycb_sight};
use palpate::simulate::{
    SimulateParams, Solid, TactileImages, TouchParams, TouchReach, simulate_scene, simulate_ycb_sight,
};
use palpate::tactile::TactileSensor;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Meshes in metres, z up (.ply, .obj, .off, .stl), or solids with exact truth: primitive:cube, prism, pyramid, sphere,
    /// cylinder, capsule, torus, bracket, tabbed-box
    #[arg(required = true, value_name = "MESH")]
    meshes: Vec<String>,
    /// Folder for the scenes; made if it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Views of each object: 30°, 42°, 55° high, azimuth drawn by the seed
    #[arg(long, default_value_t = 1, value_name = "V", value_parser = clap::value_parser!(u16).range(1..))]
    views: u16,
    /// Simulate this view only
    #[arg(long, value_name = "K", conflicts_with = "views")]
    view: Option<u16>,
    /// Touches of each scene; the first of a larger number are the same
    #[arg(long, default_value_t = 20, value_name = "N")]
    touches: usize,
    /// Which sides are touched: all, as in the YCB-Sight set, or what a robot reaches above the support
    #[arg(long, value_enum, default_value_t = Reach::Whole)]
    reach: Reach,
    /// Sensor: ycb-sight, gelsight-r15, gelsight-mini, digit
    #[arg(long, default_value = "ycb-sight", value_name = "PRESET")]
    sensor: String,
    /// Seed of everything random
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// scene: one folder per view. ycb-sight: one per object, 60 touches all round at 640×480, one depth cloud
    #[arg(long, value_enum, default_value_t = Layout::Scene)]
    layout: Layout,
    /// 1σ per axis of the recorded touch poses: millimetres, degrees
    #[arg(long, value_name = "MM,DEG", value_parser = parse_pose_noise, default_value = "0,0")]
    pose_noise: (f64, f64),
    /// Width of the height maps, pixels; default 320, or the sensor's own if that is less
    #[arg(long, value_name = "PX")]
    map_width: Option<usize>,
    /// Tactile images, written beside the maps as JPEG with the no-contact image
    #[arg(long, value_enum, default_value_t = Images::Plain)]
    tactile_images: Images,
    /// 1σ of the depth noise, millimetres
    #[arg(long, default_value_t = 1.0, value_name = "MM")]
    depth_noise: f64,
    /// Share of the object's pixels without a reading
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    dropout: f64,
    /// Leave out the object's mask
    #[arg(long)]
    no_mask: bool,
    /// Make scenes anew that are already there
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Layout {
    Scene,
    YcbSight,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Reach {
    /// The whole surface, the underside too
    Whole,
    /// Pad and sensor stay above the support plane: never the underside
    AboveSupport,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Images {
    /// Maps only
    None,
    /// Colours of the gel's slopes, as in YCB-Sight
    Plain,
    /// With the shadows that the rim of the contact casts
    Shadows,
    /// With shadows and moving marker dots
    Markers,
}

impl Job {
    /// Where its scene goes.
    fn folder(&self, args: &Args, objects: &[(String, TriangleMesh)]) -> PathBuf {
        let name = &objects[self.object].0;
        args.output.join(match args.layout {
            Layout::Scene => format!("{name}_view{}", self.view),
            Layout::YcbSight => name.clone(),
        })
    }
}

/// Refuses to overwrite a scene; with `force` removes it and its touches, of which there may be more than will be made.
fn make_room(folder: &Path, force: bool) -> anyhow::Result<()> {
    let heads: Vec<PathBuf> =
        ["scene.toml", "pose.txt"].map(|file| folder.join(file)).into_iter().filter(|path| path.exists()).collect();
    if heads.is_empty() {
        return Ok(());
    }
    if !force {
        bail!("{}: there is already a scene here; --force makes it anew", folder.display());
    }
    let remove = |path: &Path| std::fs::remove_file(path).with_context(|| format!("removing {}", path.display()));
    // First: a scene that names touches which are gone is worse than none.
    heads.iter().try_for_each(|path| remove(path))?;
    for (part, digits, ends) in TOUCH_FILES {
        let Ok(files) = std::fs::read_dir(folder.join(part)) else { continue };
        for entry in files {
            let path = entry?.path();
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let number = ends.iter().find_map(|end| name.strip_suffix(end)).unwrap_or_default();
            if number.len() >= digits && number.bytes().all(|b| b.is_ascii_digit()) && path.is_file() {
                remove(&path)?;
            }
        }
    }
    Ok(())
}

/// Files of touches: folder, digits of the number that a name begins with, and what follows it.
const TOUCH_FILES: [(&str, usize, &[&str]); 4] = [
    ("touches", 3, &["_height.npy", "_contact.png", ".png", ".jpg"]),
    ("gelsight", 1, &[".jpg"]),
    ("gt_height_map", 1, &[".npy"]),
    ("gt_contact_mask", 1, &[".npy"]),
];

/// Quality of the tactile images: that of YCB-Sight.
const JPEG_QUALITY: u8 = 95;

fn parse_pose_noise(text: &str) -> Result<(f64, f64), String> {
    let (mm, deg) = text.split_once(',').ok_or("two numbers are needed: MM,DEG")?;
    let number = |s: &str| {
        let value = s.trim().parse::<f64>().map_err(|e| format!("'{s}': {e}"))?;
        if value.is_finite() && value >= 0.0 { Ok(value) } else { Err(format!("'{s}' must be at least 0")) }
    };
    Ok((number(mm)?, number(deg)?))
}

/// One folder to write.
struct Job {
    object: usize,
    view: usize,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let objects: Vec<(String, TriangleMesh)> = args.meshes.iter().map(|m| load(m)).collect::<Result<_, _>>()?;
    for (i, (name, _)) in objects.iter().enumerate() {
        if objects[..i].iter().any(|(other, _)| other == name) {
            bail!("two meshes are called '{name}': their scenes would overwrite each other");
        }
    }
    let params = args.params();
    params.validate()?;
    std::fs::create_dir_all(&args.output).with_context(|| format!("making the folder {}", args.output.display()))?;
    let views = match (args.layout, args.view) {
        (Layout::YcbSight, _) => 0..1,
        (Layout::Scene, Some(k)) => usize::from(k)..usize::from(k) + 1,
        (Layout::Scene, None) => 0..usize::from(args.views),
    };
    let jobs: Vec<Job> =
        (0..objects.len()).flat_map(|object| views.clone().map(move |view| Job { object, view })).collect();
    for job in &jobs {
        make_room(&job.folder(&args, &objects), args.force)?;
    }
    let bar = progress_bar(jobs.len(), "{bar:40} {pos}/{len} scenes, {eta} left");
    let losses: Vec<Option<String>> = jobs
        .par_iter()
        .map(|job| {
            let (name, mesh) = &objects[job.object];
            let loss = match args.layout {
                Layout::Scene => scene(name, mesh, &SimulateParams { view: job.view, ..params.clone() }, &args.output),
                Layout::YcbSight => ycb_sight(name, mesh, &params, &args.output),
            };
            bar.inc(1);
            loss.with_context(|| format!("simulating '{name}'"))
        })
        .collect::<anyhow::Result<_>>()?;
    bar.finish_and_clear();
    println!("{} in {}", say::count(jobs.len(), "scene", "scenes"), args.output.display());
    let mut outcome = Outcome::Done;
    for loss in losses.into_iter().flatten() {
        say::warn(loss);
        outcome = Outcome::Degraded;
    }
    Ok(outcome)
}

impl Args {
    fn params(&self) -> SimulateParams {
        let mut params = SimulateParams { seed: self.seed, ..SimulateParams::default() };
        params.camera.sigma = self.depth_noise * 1e-3;
        params.camera.dropout = self.dropout;
        params.camera.with_mask = !self.no_mask;
        params.touch = TouchParams {
            count: self.touches,
            sensor: self.sensor.clone(),
            map_width: self
                .map_width
                .unwrap_or_else(|| TactileSensor::preset(&self.sensor).map_or(320, |sensor| sensor.width.min(320))),
            candidates: params.touch.candidates.max(self.touches),
            reach: match self.reach {
                Reach::Whole => TouchReach::Whole,
                Reach::AboveSupport => TouchReach::AboveSupport,
            },
            images: match self.tactile_images {
                Images::None => TactileImages::None,
                Images::Plain => TactileImages::Plain,
                Images::Shadows => TactileImages::Shadows,
                Images::Markers => TactileImages::Markers,
            },
            pose_sigma_translation: self.pose_noise.0 * 1e-3,
            pose_sigma_rotation: self.pose_noise.1.to_radians(),
            ..params.touch
        };
        params
    }
}

/// Name and mesh of a file or a solid.
pub(super) fn load(mesh: &str) -> anyhow::Result<(String, TriangleMesh)> {
    let Some(name) = mesh.strip_prefix("primitive:") else {
        let path = Path::new(mesh);
        let name = path.file_stem().with_context(|| format!("'{mesh}' names no file"))?;
        return Ok((name.to_string_lossy().into_owned(), read_mesh(path)?));
    };
    let solid = Solid::named(name)
        .with_context(|| format!("no solid is called '{name}'; known: {}", Solid::NAMES.join(", ")))?;
    // Chords within 5 µm, faces of a few millimetres: finer than any sensor, small enough to write.
    Ok((name.to_owned(), solid.mesh(5e-6, 3e-3)))
}

/// Writes a scene folder; returns what was lost.
fn scene(name: &str, mesh: &TriangleMesh, params: &SimulateParams, output: &Path) -> anyhow::Result<Option<String>> {
    let made = simulate_scene(name, mesh, params)?;
    let what = SceneToWrite {
        truth: Some(&made.truth),
        tactile_background: made.tactile_background.as_ref(),
        jpeg_quality: Some(JPEG_QUALITY),
        ..SceneToWrite::new(&made.scene)
    };
    write_scene(output.join(&made.scene.name), &what)?;
    let (found, asked) = (made.scene.touches.len(), params.touch.count);
    Ok((found < asked)
        .then(|| format!("{}: {found} touches of {asked}; no other place can be reached", made.scene.name)))
}

/// Writes a folder in the YCB-Sight layout; returns what was lost.
fn ycb_sight(
    name: &str,
    mesh: &TriangleMesh,
    params: &SimulateParams,
    output: &Path,
) -> anyhow::Result<Option<String>> {
    let made = simulate_ycb_sight(name, mesh, params.seed, &params.touch)?;
    let folder = output.join(name);
    write_ycb_sight(&folder, &made)?;
    write_mesh(folder.join("truth.ply"), mesh)?;
    let found = made.touches.len();
    Ok((found < 60).then(|| format!("{name}: {found} touches of 60; no other place can be pressed")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_made_by_removing_touches_and_nothing_else() {
        let touches = ["touches/000_height.npy", "touches/1000_contact.png", "touches/002.jpg", "gelsight/99.jpg"];
        let maps = ["gt_height_map/0.npy", "gt_contact_mask/61.npy"];
        let others = ["touches/2024_notes.txt", "touches/000_notes.png", "touches/7.png", "gelsight/a.jpg", "7.npy"];
        for head in ["scene.toml", "pose.txt"] {
            let folder = tempfile::tempdir().expect("a folder");
            let at = |name: &str| folder.path().join(name);
            for name in touches.iter().chain(&maps).chain(&others).chain(&[head]) {
                std::fs::create_dir_all(at(name).parent().expect("a folder")).expect("made");
                std::fs::write(at(name), "").expect("written");
            }
            make_room(folder.path(), false).expect_err("there is a scene");
            assert!(at(head).exists() && at(touches[0]).exists());
            make_room(folder.path(), true).expect("removed");
            assert!(touches.iter().chain(&maps).chain(&[head]).all(|name| !at(name).exists()));
            assert!(others.iter().all(|name| at(name).exists()));
        }
    }
}
