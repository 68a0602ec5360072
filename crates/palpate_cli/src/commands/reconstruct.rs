use crate::Outcome;
use crate::decoders::TouchDecoder;
use crate::progress::StageClock;
use crate::targets::{Targets, one_name};
use crate::{report, say};
use anyhow::{Context as _, bail};
use palpate::geometry::PointCloud;
use palpate::io::{self, PropertyValues, SceneFile, VertexProperty};
use palpate::pipeline::{self, ColorBy, Method, ReconstructParams, Reconstruction, Stages, Surface, Warning};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
#[command(after_help = "Examples:
  palpate reconstruct samples/mustard_bottle --output bottle.ply
  palpate reconstruct scene --output mug.glb --pick 320,240 --report mug.json --keep mug_steps
  palpate reconstruct plate --output plate.ply --wall 2
  palpate reconstruct scenes/* --output meshes/ --method paper --surface ball-pivoting
  palpate reconstruct scene --output mug.ply --follow

Exit status 3: a mesh was written, but something was lost on the way (a touch left out, the object cut by the image border).")]
pub(crate) struct Args {
    /// Scene folders (see `palpate init`) or objects of the YCB-Sight set; several make OUT a folder.
    #[arg(required = true, value_name = "SCENE")]
    pub(super) scenes: Vec<PathBuf>,
    /// Mesh to write, world frame, metres: .ply, .obj, .stl or .glb; or a folder for it.
    #[arg(short, long, value_name = "OUT")]
    pub(super) output: PathBuf,
    /// fused = ours, weighs all evidence; paper = the published method.
    #[arg(long, value_enum)]
    method: Option<MethodArg>,
    /// Surface; default implicit for fused, poisson for paper.
    #[arg(long, value_enum)]
    surface: Option<SurfaceArg>,
    /// Pixel on the object, when the scene has no mask and several things stand on the table.
    #[arg(long, value_name = "U,V", value_parser = super::clean::pixel)]
    pub(super) pick: Option<(f64, f64)>,
    /// The object is a shell (plate, bowl, cup) with a wall this thick: what nobody measured behind it is cut away.
    #[arg(long, value_name = "MM")]
    wall: Option<f64>,
    /// Use only the first N touches.
    #[arg(long, value_name = "N")]
    pub(super) max_touches: Option<usize>,
    #[command(flatten)]
    pub(super) decoder: TouchDecoder,
    /// JSON with timings, counts, symmetries, warnings and parameters; with several scenes one beside each mesh.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Folder for the clouds between the steps (visible, moved, removed, felt, fused), to look at in MeshLab.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Colour the vertices by their uncertainty, by what they rest on, or by the frame's image (method 'fused'; not in .stl).
    #[arg(long, value_enum)]
    color: Option<ColorArg>,
    /// Seed of everything random; the same seed gives the same bytes.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Parameters as TOML; `palpate config` prints all of them. Flags win over the file.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Stay, and write the mesh anew after each touch that is added to the scene (`palpate capture` adds them). Ends after
    /// --max-touches if given.
    #[arg(long, conflicts_with_all = ["report", "keep", "method", "surface"])]
    follow: bool,
    /// With --follow: start again with all touches once none has come for this long, seconds; inf = never.
    #[arg(long, value_name = "S", default_value_t = 1.0, requires = "follow")]
    pub(super) settle: f64,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum MethodArg {
    Fused,
    Paper,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum SurfaceArg {
    Implicit,
    Poisson,
    BallPivoting,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum ColorArg {
    /// No colours.
    None,
    /// Blue: 0.2 mm and less; red: 10 mm and more.
    Sigma,
    /// Seen blue grey, felt green, guessed orange, extrapolated grey.
    Provenance,
    /// The image where it shows the surface, moved along where the surface was guessed.
    Image,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let params = effective_params(&args)?;
    if args.follow && args.scenes.len() > 1 {
        bail!("--follow takes one scene; {} were given", args.scenes.len());
    }
    let jobs = jobs(&args)?;
    for job in &jobs {
        check_colors(&job.output, &params)?;
    }
    // A wrong output path must not cost the user the run.
    check_targets(&jobs, args.config.as_ref())?;
    if let [job] = &jobs[..] {
        if args.follow {
            return super::follow::run(&args, (job.folder, &job.output), &params);
        }
        return reconstruct_one(job, &params, &args);
    }
    let (mut degraded, mut failed) = (false, 0);
    for job in &jobs {
        // One bad scene does not cost the others.
        match reconstruct_one(job, &params, &args) {
            Ok(outcome) => degraded |= matches!(outcome, Outcome::Degraded),
            Err(error) => {
                eprintln!("palpate: scene '{}': {error:#}", job.scene.display());
                failed += 1;
            }
        }
    }
    if failed == jobs.len() {
        bail!("none of the {failed} scenes could be reconstructed");
    }
    Ok(if degraded || failed > 0 { Outcome::Degraded } else { Outcome::Done })
}

/// A scene and the files that are made of it.
struct Job<'a> {
    scene: &'a Path,
    /// Where the output lies, if that was given as a folder; made once the scene has been read.
    folder: Option<&'a PathBuf>,
    output: PathBuf,
    report: Option<PathBuf>,
    keep: Option<PathBuf>,
}

/// One job a scene.
fn jobs<'a>(args: &'a Args) -> anyhow::Result<Vec<Job<'a>>> {
    let output = &args.output;
    let one = args.scenes.len() == 1;
    let is_folder = output.is_dir() || output.to_string_lossy().ends_with(std::path::is_separator);
    if one && !is_folder {
        let (report, keep) = (args.report.clone(), args.keep.clone());
        return Ok(vec![Job { scene: &args.scenes[0], folder: None, output: output.clone(), report, keep }]);
    }
    if !is_folder && output.extension().is_some_and(|e| ["ply", "obj", "stl", "glb"].contains(&&*e.to_string_lossy())) {
        bail!("{} scenes were given, so --output must be a folder, not '{}'", args.scenes.len(), output.display());
    }
    let names = scene_names(&args.scenes)?;
    let job = |(scene, name): (&'a PathBuf, &String)| Job {
        scene,
        folder: Some(output),
        output: output.join(format!("{name}.ply")),
        report: args.report.as_ref().map(|r| if one { r.clone() } else { output.join(format!("{name}.json")) }),
        keep: args.keep.as_ref().map(|keep| if one { keep.clone() } else { keep.join(name) }),
    };
    Ok(args.scenes.iter().zip(&names).map(job).collect())
}

/// Colours that the file cannot hold are refused before the work.
fn check_colors(output: &Path, params: &ReconstructParams) -> anyhow::Result<()> {
    let stl = output.extension().is_some_and(|e| e.eq_ignore_ascii_case("stl"));
    if stl && params.color != ColorBy::None {
        bail!("'{}': an .stl holds no colours; .ply, .obj and .glb do", output.display());
    }
    Ok(())
}

/// Folder names, which become file names; two of the same would overwrite one another.
fn scene_names(scenes: &[PathBuf]) -> anyhow::Result<Vec<String>> {
    let mut names: Vec<String> = Vec::with_capacity(scenes.len());
    for scene in scenes {
        let whole = scene.canonicalize().unwrap_or_else(|_| scene.clone());
        let file = whole.is_file() || whole.ends_with("scene.toml");
        let folder = if file { whole.parent().unwrap_or(&whole) } else { &whole };
        let name = folder.file_name().with_context(|| format!("'{}' has no folder name", scene.display()))?;
        let name = name.to_string_lossy().into_owned();
        if names.contains(&name) {
            bail!("two scenes are called '{name}': their meshes would overwrite each other");
        }
        names.push(name);
    }
    Ok(names)
}

/// Thinner than any wall that a depth camera sees: a wall in metres.
const THINNEST_WALL_MM: f64 = 0.1;

fn effective_params(args: &Args) -> anyhow::Result<ReconstructParams> {
    let mut params = match &args.config {
        Some(path) => crate::config::read(path)?,
        None => ReconstructParams::default(),
    };
    match args.method {
        Some(MethodArg::Fused) => params.method = Method::Fused,
        Some(MethodArg::Paper) => params.method = Method::Paper,
        None => {}
    }
    match args.surface {
        Some(SurfaceArg::Implicit) => params.surface = Some(Surface::Implicit),
        Some(SurfaceArg::Poisson) => params.surface = Some(Surface::Poisson),
        Some(SurfaceArg::BallPivoting) => params.surface = Some(Surface::BallPivoting),
        None => {}
    }
    match args.color {
        Some(ColorArg::None) => params.color = ColorBy::None,
        Some(ColorArg::Sigma) => params.color = ColorBy::Sigma,
        Some(ColorArg::Provenance) => params.color = ColorBy::Provenance,
        Some(ColorArg::Image) => params.color = ColorBy::Image,
        None => {}
    }
    if let Some(pick) = args.pick {
        params.segment.pick = Some(pick);
    }
    if let Some(wall) = args.wall {
        if !(wall >= THINNEST_WALL_MM) {
            bail!("--wall {wall}: at least {THINNEST_WALL_MM} mm is needed; it is in millimetres, so 2 mm is 2");
        }
        params.implicit.shell.wall = Some(1e-3 * wall);
    }
    params.max_touches = args.max_touches.or(params.max_touches);
    params.seed = args.seed.unwrap_or(params.seed);
    Ok(params)
}

fn reconstruct_one(job: &Job, params: &ReconstructParams, args: &Args) -> anyhow::Result<Outcome> {
    let clock = StageClock::start();
    clock.begin("read");
    let mut file = read_input(job.scene, params.seed)?;
    for folder in job.folder.into_iter().chain(&job.keep) {
        io::create_folder(folder)?;
    }
    let decoder = args.decoder.of_scene(&mut file, job.scene, false)?;
    super::clean::warn_of_unused_pick(args.pick, &mut file);
    for warning in &file.warnings {
        clock.warn(warning);
    }
    let stages =
        Stages { decoder: decoder.as_deref(), on_stage: Some(&|stage| clock.begin(stage)), ..Stages::default() };
    let result = pipeline::reconstruct(&file.scene, params, &stages)?;
    clock.begin("write");
    // The mesh comes after what may fail beside it.
    if let Some(keep) = &job.keep {
        keep_steps(keep, &result, params)?;
    }
    write_result(&job.output, &result)?;
    let timings = clock.finish();
    for warning in &result.warnings {
        say::warn(warning);
    }
    if let Some(path) = &job.report {
        let json = report::reconstruction(&file, &result, params, &timings);
        report::write_json(path, &json)?;
    }
    println!("{}", report::one_line(&job.output, &result, &timings));
    Ok(if result.warnings.iter().any(Warning::is_loss) { Outcome::Degraded } else { Outcome::Done })
}

/// Clouds that --keep writes.
const STEPS: [&str; 5] = ["visible", "moved", "removed", "felt", "fused"];

/// What belongs to a scene in its own folder, under names that are always the same.
const OF_A_SCENE: [&str; 4] = ["scene.toml", "pose.txt", "sensor.toml", "truth.ply"];

/// Sees that every file of every job can be written, none is written twice, and none is read.
fn check_targets(jobs: &[Job], config: Option<&PathBuf>) -> anyhow::Result<()> {
    let of_scene = |job: &Job| -> Vec<PathBuf> {
        let folder = if job.scene.is_file() { job.scene.parent().unwrap_or(Path::new("")) } else { job.scene };
        let files = OF_A_SCENE.iter().map(|name| folder.join(name)).filter(|path| path.is_file());
        files.chain(job.scene.is_file().then(|| job.scene.to_owned())).collect()
    };
    let mut targets = Targets::keep(jobs.iter().flat_map(of_scene).chain(config.cloned()));
    for job in jobs {
        job.check(&mut targets)?;
    }
    Ok(())
}

impl Job<'_> {
    fn check(&self, targets: &mut Targets) -> anyhow::Result<()> {
        let add = |targets: &mut Targets, path: &Path, flag: &str| match (&self.folder, path.file_name()) {
            // Not made yet.
            (Some(folder), Some(name)) if path.parent() == Some(folder.as_path()) => {
                targets.files_in(folder, [(name.to_string_lossy(), flag)])
            }
            _ => targets.file(path, flag),
        };
        add(targets, &self.output, "--output")?;
        if self.folder.is_none() {
            io::check_mesh_output(&self.output)?;
        }
        if let Some(report) = &self.report {
            add(targets, report, "--report")?;
        }
        if let Some(keep) = &self.keep {
            let clouds = STEPS.iter().map(|name| format!("{name}.ply"));
            // The mesh may be the output itself: it is the same.
            let mesh = (one_name(&keep.join("mesh.ply")) != one_name(&self.output)).then(|| "mesh.ply".to_owned());
            let files = clouds.chain(mesh).chain(["params.toml".to_owned()]);
            targets.files_in(keep, files.map(|name| (name, "--keep")))?;
        }
        Ok(())
    }
}

/// A scene folder, or an object in the YCB-Sight layout (told by its `pose.txt`).
fn read_input(folder: &Path, seed: u64) -> anyhow::Result<SceneFile> {
    if !folder.join("pose.txt").is_file() {
        return Ok(io::read_scene(folder)?);
    }
    let file = io::read_ycb_sight(folder)?;
    Ok(SceneFile {
        tactile_background: file.object.tactile_background.clone(),
        scene: file.object.into_scene(seed),
        truth: None,
        warnings: file.warnings,
    })
}

/// The mesh; as PLY with σ (millimetres) and provenance of each vertex where they are known.
pub(super) fn write_result(path: &Path, result: &Reconstruction) -> anyhow::Result<()> {
    let Some(knowledge) = &result.knowledge else { return Ok(io::write_mesh(path, &result.mesh)?) };
    let sigma: Vec<f32> = knowledge.sigma.iter().map(|s| (1e3 * s) as f32).collect();
    let provenance: Vec<u8> = knowledge.provenance.iter().map(|p| *p as u8).collect();
    let properties = [
        VertexProperty { name: "sigma_mm", values: PropertyValues::Float(&sigma) },
        VertexProperty { name: "provenance", values: PropertyValues::Uchar(&provenance) },
    ];
    Ok(io::write_mesh_with(path, &result.mesh, &properties)?)
}

/// The clouds between the steps, and the effective parameters.
fn keep_steps(folder: &Path, result: &Reconstruction, params: &ReconstructParams) -> anyhow::Result<()> {
    let clouds: [&PointCloud; 5] = [&result.visible, &result.moved, &result.removed, &result.felt, &result.joined];
    for (name, cloud) in STEPS.iter().zip(clouds) {
        io::write_cloud(folder.join(name).with_extension("ply"), cloud)?;
    }
    write_result(&folder.join("mesh.ply"), result)?;
    io::write_text(folder.join("params.toml"), &crate::config::to_toml(params)?)?;
    Ok(())
}
