use crate::Outcome;
use anyhow::Context as _;
use palpate::geometry::Topology;
use palpate::io::{read_cloud, write_mesh};
use palpate::surface::{
    BallPivotingParams, ImplicitParams, PoissonParams, ball_pivoting, fill_holes, implicit_surface, screened_poisson,
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
    /// Octree depth of Poisson; larger is finer; default: cells a little larger than the spacing of the points
    #[arg(long, value_name = "D", conflicts_with = "radius")]
    depth: Option<u32>,
    /// Ball radii, metres, any number; default 1.5, 2.5, 4 and 6 times the spacing of the points
    #[arg(long, value_name = "R", num_args = 1..)]
    radius: Vec<f64>,
    /// Close the holes that the balls leave
    #[arg(long)]
    fill_holes: bool,
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

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let cloud = read_cloud(&args.cloud)?;
    let meshing = || format!("meshing {}", args.cloud.display());
    let mut mesh = match args.method {
        Method::BallPivoting => {
            let radii = (!args.radius.is_empty()).then(|| args.radius.clone());
            ball_pivoting(&cloud, &BallPivotingParams { radii, ..Default::default() }).with_context(meshing)?
        }
        Method::Poisson => {
            let params = PoissonParams { depth: args.depth, ..Default::default() };
            screened_poisson(&cloud, None, &params).with_context(meshing)?.mesh
        }
        Method::Implicit => implicit_surface(&cloud, &ImplicitParams::default()).with_context(meshing)?,
    };
    if args.fill_holes {
        mesh = fill_holes(&mesh);
    }
    let topology = Topology::of(&mesh);
    write_mesh(&args.output, &mesh)?;
    eprintln!(
        "{}: {} vertices, {} faces, {}",
        args.output.display(),
        mesh.vertices.len(),
        mesh.faces.len(),
        if topology.is_watertight() {
            "watertight".to_owned()
        } else {
            format!("open: {} boundary edges in {} holes", topology.boundary_edges, topology.boundary_loops)
        }
    );
    Ok(Outcome::Done)
}
