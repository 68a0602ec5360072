use crate::Outcome;
use crate::targets::Targets;
use anyhow::ensure;
use palpate::camera::{PinholeCamera, register_color, register_depth, undistort_color, undistort_depth};
use palpate::io::{
    CameraFile, create_folder, read_camera, read_color, read_depth_png, read_extrinsics, write_camera, write_color,
    write_depth_png,
};
use std::path::PathBuf;

#[derive(clap::Args)]
#[command(after_help = "Example:
  palpate register --depth depth.png --color color.png --depth-camera infrared.toml --color-camera color.toml \\
    --extrinsics extrinsics.toml --output registered

Writes depth.png, color.png and camera.toml of one raster: that of the depth camera, or with --to color that of the colour camera. depth.png keeps the
unit of the depth image: where --metres-per-unit was given, `palpate init` needs it too. Then:
  palpate init --depth registered/depth.png --color registered/color.png --intrinsics registered/camera.toml --output SCENE")]
pub(crate) struct Args {
    /// Depth image, 16-bit PNG
    #[arg(long, value_name = "PNG")]
    depth: PathBuf,
    /// Colour image
    #[arg(long, value_name = "IMAGE")]
    color: PathBuf,
    /// The depth camera
    #[arg(long, value_name = "TOML")]
    depth_camera: PathBuf,
    /// The colour camera
    #[arg(long, value_name = "TOML")]
    color_camera: PathBuf,
    /// How the two are mounted (`palpate calibrate extrinsics`)
    #[arg(long, value_name = "TOML")]
    extrinsics: PathBuf,
    /// Metres per unit of the depth image
    #[arg(long, default_value_t = 0.001, value_name = "M")]
    metres_per_unit: f64,
    /// In whose raster
    #[arg(long, value_enum, default_value_t = To::Depth)]
    to: To,
    /// Also take the lens's distortion out of that raster
    #[arg(long)]
    undistort: bool,
    /// Folder for the results; made if it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum To {
    /// The depth camera's: every reading as it was
    Depth,
    /// The colour camera's: every colour as it was
    Color,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    ensure!(
        args.metres_per_unit.is_finite() && args.metres_per_unit > 0.0,
        "--metres-per-unit {}: a finite number > 0 is needed",
        args.metres_per_unit
    );
    let mut targets =
        Targets::keep([&args.depth, &args.color, &args.depth_camera, &args.color_camera, &args.extrinsics]);
    targets.files_in(&args.output, ["depth.png", "color.png", "camera.toml"].map(|name| (name, "--output")))?;
    let (depth_file, color_file) = (read_camera(&args.depth_camera)?, read_camera(&args.color_camera)?);
    let mounting = read_extrinsics(&args.extrinsics)?;
    let depth = read_depth_png(&args.depth, args.metres_per_unit)?;
    let color = read_color(&args.color)?;
    let fits = |path: &PathBuf, cols: usize, rows: usize, camera: &PinholeCamera| {
        ensure!(
            (cols, rows) == (camera.width, camera.height),
            "{} is {cols}×{rows} px, its camera {}×{}",
            path.display(),
            camera.width,
            camera.height
        );
        Ok(())
    };
    fits(&args.depth, depth.cols(), depth.rows(), &depth_file.camera)?;
    fits(&args.color, color.cols(), color.rows(), &color_file.camera)?;
    let (depth, color, camera, pose) = match args.to {
        To::Depth => {
            let color = register_color(&color, &color_file.camera, &depth, &depth_file.camera, &mounting);
            let pose = depth_file
                .world_from_camera
                .or_else(|| color_file.world_from_camera.map(|world_from_color| world_from_color * mounting));
            (depth, color, depth_file.camera, pose)
        }
        To::Color => {
            let depth = register_depth(&depth, &depth_file.camera, &color_file.camera, &mounting);
            let pose = color_file
                .world_from_camera
                .or_else(|| depth_file.world_from_camera.map(|world_from_depth| world_from_depth * mounting.inverse()));
            (depth, color, color_file.camera, pose)
        }
    };
    let (depth, color, camera) = if args.undistort {
        let (flat, ideal) = undistort_depth(&depth, &camera);
        (flat, undistort_color(&color, &camera).0, ideal)
    } else {
        (depth, color, camera)
    };
    create_folder(&args.output)?;
    write_depth_png(args.output.join("depth.png"), &depth, args.metres_per_unit)?;
    write_color(args.output.join("color.png"), &color)?;
    let file = CameraFile { camera, world_from_camera: pose };
    write_camera(args.output.join("camera.toml"), &file, &toml::Table::new())?;
    let readings = depth.as_slice().iter().filter(|z| z.is_finite()).count();
    println!("{}: {readings} readings of {}", args.output.display(), depth.as_slice().len());
    // Depth keeps its unit; taken for another, the object would be ten times as large.
    let unit = if args.metres_per_unit == 0.001 {
        String::new()
    } else {
        format!(" --metres-per-unit {}", args.metres_per_unit)
    };
    let folder = args.output.display();
    println!(
        "next: palpate init --depth {folder}/depth.png --color {folder}/color.png --intrinsics {folder}/camera.toml{unit} --output SCENE"
    );
    Ok(Outcome::Done)
}
