use super::mesh::{CleanUp, report};
use crate::Outcome;
use anyhow::Context as _;
use palpate::geometry::{PointCloud, TriangleMesh};
use palpate::io::{check_mesh_output, read_cloud, write_mesh};
use palpate::surface::{
    BallPivotingParams, Boundary, ImplicitParams, PoissonParams, ball_pivoting, implicit_surface, screened_poisson,
};
use std::path::PathBuf;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The cloud with outward normals: .ply or .pcd
    cloud: PathBuf,
    /// The mesh: .ply, .obj, .stl or .glb
    #[arg(short, long, value_name = "OUT.ply")]
    output: PathBuf,
    /// How to mesh
    #[arg(long, value_enum)]
    method: Method,
    #[command(flatten)]
    poisson: PoissonArgs,
    #[command(flatten)]
    balls: BallArgs,
    #[command(flatten)]
    implicit: ImplicitArgs,
    #[command(flatten)]
    clean_up: CleanUp,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Method {
    /// Screened Poisson: smooth and closed
    Poisson,
    /// Ball pivoting: through the points, open where there are none
    BallPivoting,
    /// The implicit function of the fused method
    Implicit,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Poisson")]
struct PoissonArgs {
    /// Octree depth; larger is finer; default: from the spacing and the noise of the points
    #[arg(long, value_name = "D", conflicts_with_all = ["radius", "project"])]
    depth: Option<u32>,
    /// Standard deviation of the points along their normals, metres; default: read from the points
    #[arg(long, value_name = "SIGMA")]
    noise: Option<f64>,
    /// Weight of the points against their normals; default: from the noise
    #[arg(long, value_name = "ALPHA")]
    screening: Option<f64>,
    /// Let an open surface run on to the border of its domain, where it is capped, instead of closing it before
    #[arg(long)]
    neumann: bool,
    /// Cut away what lies where the points are sparser than this share of their usual density; opens the mesh
    #[arg(long, value_name = "SHARE")]
    trim: Option<f64>,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Ball pivoting")]
struct BallArgs {
    /// Ball radii, metres, any number; default 1.5, 2.5, 4 and 6 times the spacing of the points
    #[arg(long, value_name = "R", num_args = 1..)]
    radius: Vec<f64>,
    /// Rounds of moving the points onto the surface of their neighbours first; 0 leaves them as they are; default: one if their noise is near their spacing
    #[arg(long, value_name = "ROUNDS")]
    project: Option<u32>,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Implicit")]
struct ImplicitArgs {
    /// Edge of the finest cells, metres; larger is smoother and faster; default: from the spacing and the noise of the points
    #[arg(long, value_name = "METRES", conflicts_with_all = ["depth", "radius", "project"])]
    cell: Option<f64>,
}

impl Args {
    fn mesh(&self, cloud: &PointCloud) -> anyhow::Result<TriangleMesh> {
        Ok(match self.method {
            Method::BallPivoting => {
                let radii = (!self.balls.radius.is_empty()).then(|| self.balls.radius.clone());
                let params = BallPivotingParams { radii, project: self.balls.project, ..Default::default() };
                ball_pivoting(cloud, &params)?
            }
            Method::Poisson => self.poisson(cloud)?,
            Method::Implicit => implicit_surface(cloud, self.implicit.cell, &ImplicitParams::of_cloud())?,
        })
    }

    fn poisson(&self, cloud: &PointCloud) -> anyhow::Result<TriangleMesh> {
        let flags = &self.poisson;
        let params = PoissonParams {
            depth: flags.depth,
            noise: flags.noise,
            screening: flags.screening,
            boundary: if flags.neumann { Boundary::Neumann } else { Boundary::Dirichlet },
            trim: flags.trim.unwrap_or(0.0),
            ..Default::default()
        };
        let surface = screened_poisson(cloud, None, &params)?;
        eprintln!(
            "poisson: depth {}, cells of {:.3} mm, noise {:.3} mm, screening {:.1}",
            surface.depth,
            1e3 * surface.cell,
            1e3 * surface.noise,
            surface.screening
        );
        if surface.trimmed_faces > 0 {
            eprintln!("poisson: {} faces trimmed away: the mesh is open", surface.trimmed_faces);
        }
        Ok(surface.mesh)
    }
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    // A wrong output path must not cost the user the run.
    check_mesh_output(&args.output)?;
    let cloud = read_cloud(&args.cloud)?;
    let mesh = args.mesh(&cloud).with_context(|| format!("meshing {}", args.cloud.display()))?;
    let mesh = args.clean_up.apply(mesh);
    anyhow::ensure!(!mesh.is_empty(), "{}: no face is left", args.cloud.display());
    write_mesh(&args.output, &mesh)?;
    report(&args.output, &mesh);
    Ok(Outcome::Done)
}
