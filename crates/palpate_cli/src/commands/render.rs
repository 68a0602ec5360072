use crate::{Outcome, say};
use anyhow::{Context as _, bail};
use palpate::camera::{SegmentParams, segment_object};
use palpate::geometry::{Isometry, PointCloud, TriangleMesh, Vector};
use palpate::io::{self, IoError, VertexValues};
use palpate::pipeline::{VertexProvenance, provenance_color, sigma_color};
use palpate::render::{Fit, Item, Look, Paint, Panel, Shape, View, palette, render_panels};
use palpate::scene::Scene;
use palpate::tactile::{LiftParams, lift};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "\
Examples:
  palpate render bottle.ply --output bottle.png
  palpate render prediction.ply truth.ply --output both.png --view 30,20 --labels
  palpate render parts/visible.ply parts/visible.ply+parts/moved.ply bottle.ply --output steps.png --caption seen,guessed,mesh

Colours by provenance: seen blue grey, felt green, guessed orange, extrapolated grey. A reconstruction's .ply says for each
vertex what it rests on; any other file by its name: visible*, seen*; felt*, touch*; moved*, mirrored*, guessed*; removed*
dark red; everything else light grey. By sigma: blue 0.2 mm and less, red 10 mm and more. A scene shows the object's visible points and what its recorded
touches felt. Faces seen from behind are darker and reddish, so that holes show.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Meshes (.ply .obj .off .stl), point clouds (.ply .pcd) or scene folders; one panel each, side by side. Join with `+`
    /// what belongs into one panel.
    #[arg(required = true, value_name = "MESH|CLOUD|SCENE")]
    inputs: Vec<String>,
    /// Picture to write (.png).
    #[arg(short, long, value_name = "PICTURE")]
    output: PathBuf,
    /// Side to look from: auto, front (from −y), side (from +x), top, camera (the first scene's), or AZIMUTH,ELEVATION in
    /// degrees (0,0 = front; azimuth counter-clockwise from above). auto: beside a scene's camera, else the broadest side.
    #[arg(long, default_value = "auto", value_parser = parse_side, allow_hyphen_values = true)]
    view: Side,
    /// Scene whose camera and up direction the views auto and camera take; by default the first scene among the inputs.
    #[arg(long, value_name = "SCENE")]
    view_of: Option<PathBuf>,
    /// Pixels of one panel.
    #[arg(long, default_value = "480x480", value_parser = parse_size, value_name = "WIDTHxHEIGHT")]
    size: (usize, usize),
    /// Whether all panels share one viewpoint.
    #[arg(long, value_enum, default_value_t = FitBy::Auto)]
    fit: FitBy,
    /// What the colour says.
    #[arg(long, value_enum, default_value_t = ColorBy::Provenance)]
    color_by: ColorBy,
    /// Write each panel's file name below it.
    #[arg(long)]
    labels: bool,
    /// Write this below the panels instead, one text per panel.
    #[arg(long, value_delimiter = ',', value_name = "TEXT,…")]
    caption: Vec<String>,
    /// Direction that is up in the picture, world frame; by default that of the first scene, else z.
    #[arg(long, value_parser = parse_direction, value_name = "X,Y,Z", allow_hyphen_values = true)]
    up: Option<Vector>,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum ColorBy {
    /// Seen, felt, guessed, extrapolated, meshed
    Provenance,
    /// How far a vertex may be off: the sigma_mm of a reconstruction's .ply
    Sigma,
    /// The outward normal as red, green, blue
    Normal,
    /// Light grey
    Plain,
    /// The colours stored in the file
    Own,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum FitBy {
    /// Shared where the inputs lie together and have about one size
    Auto,
    /// One viewpoint for all: place and size can be compared
    Shared,
    /// Each panel filled by what it shows
    Each,
}

#[derive(Clone, Copy)]
enum Side {
    Auto,
    Camera,
    Angles { azimuth: f64, elevation: f64 },
}

fn parse_numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    let numbers = numbers.map_err(|_| format!("'{text}' is not {N} numbers with commas between them"))?;
    let found = numbers.len();
    <[f64; N]>::try_from(numbers)
        .ok()
        .filter(|numbers| numbers.iter().all(|x| x.is_finite()))
        .ok_or_else(|| format!("{found} numbers; {N} finite ones are needed"))
}

fn parse_side(text: &str) -> Result<Side, String> {
    let at = |azimuth: f64, elevation: f64| Side::Angles {
        azimuth: azimuth.to_radians(),
        elevation: elevation.to_radians(),
    };
    match text {
        "auto" => Ok(Side::Auto),
        "camera" => Ok(Side::Camera),
        "front" => Ok(at(0.0, 0.0)),
        "side" => Ok(at(90.0, 0.0)),
        "top" => Ok(at(0.0, 90.0)),
        _ => parse_numbers(text)
            .map(|[azimuth, elevation]| at(azimuth, elevation))
            .map_err(|reason| format!("{reason}; or one of auto, front, side, top, camera")),
    }
}

fn parse_size(text: &str) -> Result<(usize, usize), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let (width, height): (usize, usize) = sides.ok_or("not WIDTHxHEIGHT, such as 640x480")?;
    let fits = (8..=8192).contains(&width) && (8..=8192).contains(&height);
    if fits { Ok((width, height)) } else { Err("each side must be 8 to 8192 pixels".into()) }
}

fn parse_direction(text: &str) -> Result<Vector, String> {
    let direction = Vector::from(parse_numbers::<3>(text)?);
    if direction.norm() > 0.0 { Ok(direction) } else { Err("the zero vector has no direction".into()) }
}

/// What a file holds.
enum Loaded {
    Mesh(TriangleMesh),
    Cloud(PointCloud),
}

/// Something to draw and the colour of where it comes from.
struct Part {
    shape: Loaded,
    provenance: [u8; 3],
    /// The shape's colours are those asked for.
    painted: bool,
}

impl Part {
    fn item(&self, color_by: ColorBy) -> Item<'_> {
        let shape = match &self.shape {
            Loaded::Mesh(mesh) => Shape::Mesh(mesh),
            Loaded::Cloud(cloud) => Shape::Cloud(cloud),
        };
        let paint = match color_by {
            _ if self.painted => Paint::Own(self.provenance),
            ColorBy::Provenance => Paint::Plain(self.provenance),
            ColorBy::Normal => Paint::Normal,
            ColorBy::Plain | ColorBy::Sigma => Paint::Plain(palette::MESH),
            ColorBy::Own => Paint::Own(self.provenance),
        };
        Item { shape, paint }
    }
}

fn provenance_of(name: &str) -> [u8; 3] {
    let starts = |prefixes: &[&str]| prefixes.iter().any(|p| name.starts_with(p));
    if starts(&["visible", "seen"]) {
        palette::SEEN
    } else if starts(&["moved", "mirrored", "guessed"]) {
        palette::GUESSED
    } else if starts(&["felt", "touch"]) {
        palette::FELT
    } else if starts(&["removed"]) {
        palette::REMOVED
    } else {
        palette::MESH
    }
}

/// The files of one panel: the whole text if there is such a file, else what `+` joins.
fn split_input(input: &str) -> Vec<&Path> {
    if Path::new(input).exists() { vec![Path::new(input)] } else { input.split('+').map(Path::new).collect() }
}

/// What a scene says about where to look from.
struct SceneView {
    world_from_camera: Isometry,
    up: Vector,
}

/// The visible points and the felt patches; without an object that stands out, every reading.
fn load_scene(path: &Path) -> anyhow::Result<(Vec<Part>, SceneView)> {
    let file = io::read_scene(path)?;
    file.warnings.iter().for_each(say::warn);
    let Scene { frame, sensor, touches, .. } = &file.scene;
    let mut support = frame.support;
    let seen = match segment_object(frame, &SegmentParams::default()) {
        Ok(visible) => {
            support = visible.support;
            visible.cloud(frame)
        }
        Err(error) => {
            say::warn(format!("{}: {error}; every reading is drawn", path.display()));
            let points = frame.unproject();
            let points = points.as_slice().iter().filter(|p| p.z.is_finite()).map(|p| frame.world_from_camera * p);
            PointCloud { points: points.collect(), ..PointCloud::default() }
        }
    };
    let mut parts = vec![Part { shape: Loaded::Cloud(seen), provenance: palette::SEEN, painted: false }];
    for (number, touch) in touches.iter().enumerate() {
        let (Some(sensor), Some(contact)) = (sensor, &touch.contact) else { continue };
        match lift(contact, sensor, &touch.world_from_sensor, &LiftParams::default()) {
            Ok(patch) => {
                let felt = PointCloud { points: patch.points, normals: Some(patch.normals), colors: None };
                parts.push(Part { shape: Loaded::Cloud(felt), provenance: palette::FELT, painted: false });
            }
            Err(error) => say::warn(format!("{}: touch {number} is not drawn: {error}", path.display())),
        }
    }
    // A scene without poses is in the camera's frame, where up is against y.
    let unposed = frame.world_from_camera == Isometry::identity();
    let up = support.map_or(if unposed { -Vector::y() } else { Vector::z() }, |plane| plane.normal.into_inner());
    Ok((parts, SceneView { world_from_camera: frame.world_from_camera, up }))
}

/// Colours of the vertices by what the file says of them, if it does.
fn vertex_colors(values: &VertexValues, color_by: ColorBy) -> Option<Vec<[u8; 3]>> {
    match color_by {
        ColorBy::Provenance => {
            let color = |n: &u8| VertexProvenance::from_number(*n).map_or(palette::MESH, provenance_color);
            Some(values.provenance.as_ref()?.iter().map(color).collect())
        }
        ColorBy::Sigma => Some(values.sigma_mm.as_ref()?.iter().map(|s| sigma_color(1e-3 * f64::from(*s))).collect()),
        _ => None,
    }
}

fn load_file(path: &Path, color_by: ColorBy) -> anyhow::Result<Vec<Part>> {
    let stem = path.file_stem().map(|s| s.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let provenance = provenance_of(&stem);
    let mut painted = false;
    let shape = match io::read_mesh_with(path) {
        Ok((mut mesh, values)) => {
            if let Some(colors) = vertex_colors(&values, color_by) {
                mesh.colors = Some(colors);
                painted = true;
            }
            Loaded::Mesh(mesh)
        }
        Err(IoError::NoFaces { .. } | IoError::Extension { .. }) => Loaded::Cloud(io::read_cloud(path)?),
        Err(error) => return Err(error.into()),
    };
    if color_by == ColorBy::Sigma && !painted {
        say::warn(format!("{}: no sigma_mm is in it; it is drawn plain", path.display()));
    }
    Ok(vec![Part { shape, provenance, painted }])
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    if args.output.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
        bail!("{}: the picture's name must end in .png", args.output.display());
    }
    if !args.caption.is_empty() && args.caption.len() != args.inputs.len() {
        bail!("{} captions for {} panels; one each is needed", args.caption.len(), args.inputs.len());
    }
    let mut loaded: Vec<Vec<Part>> = Vec::new();
    let mut scene_view = args.view_of.as_deref().map(load_scene).transpose()?.map(|(_, view)| view);
    for input in &args.inputs {
        let mut parts = Vec::new();
        for path in split_input(input) {
            if path.is_dir() || path.extension().is_some_and(|e| e == "toml") {
                let (more, view) = load_scene(path)?;
                parts.extend(more);
                scene_view.get_or_insert(view);
            } else {
                parts.extend(load_file(path, args.color_by)?);
            }
        }
        loaded.push(parts);
    }
    let panels: Vec<Panel> = loaded
        .iter()
        .enumerate()
        .map(|(k, parts)| Panel {
            items: parts.iter().map(|part| part.item(args.color_by)).collect(),
            caption: caption(&args, k),
        })
        .collect();
    let up = args.up.or(scene_view.as_ref().map(|v| v.up)).unwrap_or_else(Vector::z);
    let view = match (args.view, scene_view) {
        (Side::Auto, None) => View { look: Look::Auto, up },
        (Side::Auto, Some(scene)) => View::beside(&scene.world_from_camera, up),
        (Side::Angles { azimuth, elevation }, _) => View { look: Look::From { azimuth, elevation }, up },
        (Side::Camera, Some(SceneView { world_from_camera, .. })) => {
            View { look: Look::Along { world_from_camera }, up }
        }
        (Side::Camera, None) => bail!("--view camera needs a scene folder among the inputs, or --view-of SCENE"),
    };
    let fit = match args.fit {
        FitBy::Auto => Fit::Auto,
        FitBy::Shared => Fit::Shared,
        FitBy::Each => Fit::Each,
    };
    let picture = render_panels(&panels, &view, fit, args.size).context("there is nothing to draw")?;
    io::write_color(&args.output, &picture)?;
    Ok(Outcome::Done)
}

fn caption(args: &Args, panel: usize) -> String {
    if let Some(text) = args.caption.get(panel) {
        return text.clone();
    }
    if !args.labels {
        return String::new();
    }
    let name = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    split_input(&args.inputs[panel]).into_iter().map(name).collect::<Vec<_>>().join(" + ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_and_sizes_are_read_as_documented() {
        assert!(
            matches!(parse_side("top"), Ok(Side::Angles { elevation, .. }) if (elevation - std::f64::consts::FRAC_PI_2).abs() < 1e-4)
        );
        assert!(
            matches!(parse_side("-90,30"), Ok(Side::Angles { azimuth, .. }) if (azimuth + std::f64::consts::FRAC_PI_2).abs() < 1e-4)
        );
        assert!(parse_side("behind").is_err() && parse_side("1,2,3").is_err() && parse_side("nan,0").is_err());
        assert_eq!(parse_size("640x480"), Ok((640, 480)));
        assert!(parse_size("640").is_err() && parse_size("0x480").is_err() && parse_size("100000x8").is_err());
        assert!(parse_direction("0,0,0").is_err());
    }

    #[test]
    fn provenance_follows_the_file_name() {
        assert_eq!(provenance_of("visible"), palette::SEEN);
        assert_eq!(provenance_of("moved_3"), palette::GUESSED);
        assert_eq!(provenance_of("felt"), palette::FELT);
        assert_eq!(provenance_of("mustard_bottle"), palette::MESH);
    }
}
