use crate::Outcome;
use crate::decoders::{self, DecoderFiles, DecoderKind};
use crate::progress::StageClock;
use crate::report;
use anyhow::{Context as _, bail};
use palpate::geometry::PointCloud;
use palpate::io::{self, PropertyValues, SceneFile, VertexProperty};
use palpate::pipeline::{self, ColorBy, Method, ReconstructParams, Reconstruction, Stages, Surface, Warning};
use palpate::tactile::{NoContact, TactileDecoder, Touch};
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
    /// Mesh to write, world frame, metres: .ply, .obj, .stl or .glb.
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
    pick: Option<(f64, f64)>,
    /// The object is a shell (plate, bowl, cup) with a wall this thick: what nobody measured behind it is cut away.
    #[arg(long, value_name = "MM")]
    wall: Option<f64>,
    /// Use only the first N touches.
    #[arg(long, value_name = "N")]
    pub(super) max_touches: Option<usize>,
    /// Where height maps come from.
    #[arg(long, value_enum, default_value_t = DecoderArg::Auto)]
    decoder: DecoderArg,
    #[command(flatten)]
    decoder_files: DecoderFiles,
    /// JSON with timings, counts, symmetries, warnings and parameters; with several scenes one beside each mesh.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Folder for the clouds between the steps (visible, moved, removed, felt, fused), to look at in MeshLab.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Colour the vertices by their uncertainty, by what they rest on, or by the frame's image.
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
    /// Seen green, felt orange, guessed blue, extrapolated grey.
    Provenance,
    /// The image where it shows the surface, moved along where the surface was guessed.
    Image,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum DecoderArg {
    /// Recorded maps; where a touch has only an image, the gel's calibration if there is one (--calibration, or sensor.toml in
    /// the scene's folder), else the compact network.
    Auto,
    /// Recorded maps; images are ignored.
    Recorded,
    /// Images, by the compact network, also where maps are recorded.
    Compact,
    /// Images, by colour table and fast Poisson; needs --lookup-table.
    Lookup,
    /// Images, by the published network; needs --weights and a build with the feature `nn`.
    Fcrn,
    /// Images, by the gel's calibration: --calibration, or sensor.toml in the scene's folder.
    Calibrated,
}

impl DecoderArg {
    /// The decoder of images, if any.
    fn kind(self) -> Option<DecoderKind> {
        match self {
            Self::Recorded => None,
            Self::Auto | Self::Compact => Some(DecoderKind::Compact),
            Self::Lookup => Some(DecoderKind::Lookup),
            Self::Fcrn => Some(DecoderKind::Fcrn),
            Self::Calibrated => Some(DecoderKind::Calibrated),
        }
    }
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let params = effective_params(&args)?;
    if args.follow {
        return super::follow::run(&args, &params);
    }
    if args.scenes.len() == 1 {
        let (report, keep) = (args.report.as_deref(), args.keep.as_deref());
        return reconstruct_one(&args.scenes[0], &args.output, report, keep, &params, &args);
    }
    if args.output.extension().is_some_and(|e| ["ply", "obj", "stl", "glb"].contains(&&*e.to_string_lossy())) {
        bail!("{} scenes were given, so --output must be a folder, not '{}'", args.scenes.len(), args.output.display());
    }
    io::create_folder(&args.output)?;
    let names = scene_names(&args.scenes)?;
    let (mut degraded, mut failed) = (false, 0);
    for (scene, name) in args.scenes.iter().zip(&names) {
        let output = args.output.join(format!("{name}.ply"));
        let report = args.report.as_ref().map(|_| args.output.join(format!("{name}.json")));
        let keep = args.keep.as_ref().map(|keep| keep.join(name));
        // One bad scene does not cost the others.
        match reconstruct_one(scene, &output, report.as_deref(), keep.as_deref(), &params, &args) {
            Ok(outcome) => degraded |= matches!(outcome, Outcome::Degraded),
            Err(error) => {
                eprintln!("palpate: scene '{}': {error:#}", scene.display());
                failed += 1;
            }
        }
    }
    if failed == args.scenes.len() {
        bail!("none of the {failed} scenes could be reconstructed");
    }
    Ok(if degraded || failed > 0 { Outcome::Degraded } else { Outcome::Done })
}

/// Folder names, which become file names; two of the same would overwrite one another.
fn scene_names(scenes: &[PathBuf]) -> anyhow::Result<Vec<String>> {
    let mut names: Vec<String> = Vec::with_capacity(scenes.len());
    for scene in scenes {
        let whole = scene.canonicalize().unwrap_or_else(|_| scene.clone());
        let name = whole.file_name().with_context(|| format!("'{}' has no folder name", scene.display()))?;
        let name = name.to_string_lossy().into_owned();
        if names.contains(&name) {
            bail!("two scenes are called '{name}': their meshes would overwrite each other");
        }
        names.push(name);
    }
    Ok(names)
}

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
        params.implicit.shell.wall = Some(1e-3 * wall);
    }
    params.max_touches = args.max_touches.or(params.max_touches);
    params.seed = args.seed.unwrap_or(params.seed);
    Ok(params)
}

fn reconstruct_one(
    folder: &Path,
    output: &Path,
    report: Option<&Path>,
    keep: Option<&Path>,
    params: &ReconstructParams,
    args: &Args,
) -> anyhow::Result<Outcome> {
    // A wrong output path must not cost the user the run.
    io::check_mesh_output(output)?;
    if let Some(report) = report {
        io::check_writable(report)?;
    }
    if let Some(keep) = keep {
        io::create_folder(keep)?;
    }
    let clock = StageClock::start();
    clock.begin("read");
    let mut file = read_input(folder, params.seed)?;
    let decoder = decoder(&mut file, folder, args)?;
    for warning in &file.warnings {
        clock.say(&format!("warning: {warning}"));
    }
    let stages =
        Stages { decoder: decoder.as_deref(), on_stage: Some(&|stage| clock.begin(stage)), ..Stages::default() };
    let result = pipeline::reconstruct(&file.scene, params, &stages)?;
    clock.begin("write");
    write_result(output, &result)?;
    if let Some(keep) = keep {
        keep_steps(keep, &result, params)?;
    }
    let timings = clock.finish();
    for warning in &result.warnings {
        eprintln!("warning: {warning}");
    }
    if let Some(path) = report {
        let json = report::reconstruction(&file, &result, params, &timings);
        report::write_json(path, &json)?;
    }
    println!("{}", report::one_line(output, &result, &timings));
    Ok(if result.warnings.iter().any(Warning::is_loss) { Outcome::Degraded } else { Outcome::Done })
}

/// Recorded maps beside an image go where the images were asked for.
pub(super) fn drop_unwanted_maps(touch: &mut Touch, args: &Args) {
    let images = args.decoder.kind().is_some() && args.decoder != DecoderArg::Auto;
    if images && touch.image.is_some() {
        touch.contact = None;
    }
}

/// The decoder of the scene's tactile images, if any is to be decoded. Recorded maps beside images are dropped where the images
/// were asked for.
pub(super) fn decoder(
    file: &mut SceneFile,
    folder: &Path,
    args: &Args,
) -> anyhow::Result<Option<Box<dyn TactileDecoder>>> {
    let Some(kind) = args.decoder.kind() else { return Ok(None) };
    file.scene.touches.iter_mut().for_each(|touch| drop_unwanted_maps(touch, args));
    let with_image = |touch: &Touch| touch.contact.is_none() && touch.image.is_some();
    // Which touches will come is not known.
    let needed = file.scene.touches.iter().any(with_image) || (args.follow && file.tactile_background.is_some());
    let Some(sensor) = file.scene.sensor.as_ref().filter(|_| needed) else { return Ok(None) };
    let background = file.tactile_background.clone().with_context(|| {
        format!("scene '{}': [sensor] background (the no-contact image) is needed to decode images", file.scene.name)
    })?;
    let no_contact = NoContact::new(background, sensor).context("[sensor] background")?;
    let mut files = args.decoder_files.clone();
    let beside = if folder.is_file() { folder.with_file_name("sensor.toml") } else { folder.join("sensor.toml") };
    if files.calibration.is_none() && beside.is_file() {
        files.calibration = Some(beside);
    }
    let calibrated = args.decoder == DecoderArg::Auto && files.calibration.is_some();
    let kind = if calibrated { DecoderKind::Calibrated } else { kind };
    decoders::make(kind, no_contact, sensor, &files).map(Some)
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
    io::create_folder(folder)?;
    let clouds: [(&str, &PointCloud); 5] = [
        ("visible", &result.visible),
        ("moved", &result.moved),
        ("removed", &result.removed),
        ("felt", &result.felt),
        ("fused", &result.joined),
    ];
    for (name, cloud) in clouds {
        io::write_cloud(folder.join(name).with_extension("ply"), cloud)?;
    }
    write_result(&folder.join("mesh.ply"), result)?;
    io::write_text(folder.join("params.toml"), &crate::config::to_toml(params)?)?;
    Ok(())
}
