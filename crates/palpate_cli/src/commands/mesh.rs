use crate::{Outcome, say};
use palpate::geometry::{
    Topology, TriangleMesh, decimated, drop_small_pieces, largest_piece, repaired, taubin_smoothed,
};
use palpate::io::{check_mesh_output, read_mesh_with, write_mesh_with};
use palpate::surface::fill_holes;
use std::path::{Path, PathBuf};

/// Clean up a mesh: repair, drop pieces, fill holes, smooth, decimate
///
/// The steps asked for are done in that order. Of a reconstruction's .ply, `sigma_mm` and `provenance` stay where no vertex is moved
/// or made.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The mesh: .ply, .obj, .off, .stl
    mesh: PathBuf,
    /// The cleaned mesh: .ply, .obj, .stl or .glb
    #[arg(short, long, value_name = "OUT.ply")]
    output: PathBuf,
    #[command(flatten)]
    clean_up: CleanUp,
}

/// What `mesh` and `surface` do to a mesh.
#[derive(clap::Args)]
#[command(next_help_heading = "Clean-up")]
pub(crate) struct CleanUp {
    /// Merge vertices at one position; drop degenerate and duplicate faces and unused vertices
    #[arg(long)]
    repair: bool,
    /// Drop pieces with less than this share (0 to 1) of the whole area
    #[arg(long, value_name = "SHARE", value_parser = share, conflicts_with = "largest")]
    drop_small: Option<f64>,
    /// Keep only the piece with the largest area
    #[arg(long)]
    largest: bool,
    /// Close every hole
    #[arg(long)]
    fill_holes: bool,
    /// Rounds of Taubin smoothing, which keeps the volume; 10 removes noise of an edge length
    #[arg(long, value_name = "ROUNDS", default_value_t = 0, hide_default_value = true)]
    smooth: usize,
    /// Simplify to at most this many faces (quadric error; a closed mesh stays closed)
    #[arg(long, value_name = "FACES")]
    decimate: Option<usize>,
}

fn share(text: &str) -> Result<f64, String> {
    let valid = text.parse().ok().filter(|s: &f64| (0.0..=1.0).contains(s));
    valid.ok_or_else(|| format!("'{text}' is not a share from 0 to 1"))
}

impl CleanUp {
    /// Does what was asked for; says on standard error what a repair found.
    pub(crate) fn apply(&self, mut mesh: TriangleMesh) -> TriangleMesh {
        if self.repair {
            let found;
            (mesh, found) = repaired(&mesh);
            eprintln!(
                "repaired: {} vertices merged, {} degenerate and {} duplicate faces and {} unused vertices dropped",
                found.merged_vertices, found.degenerate_faces, found.duplicate_faces, found.unused_vertices
            );
        }
        if let Some(share) = self.drop_small {
            mesh = drop_small_pieces(&mesh, share);
        }
        if self.largest {
            mesh = largest_piece(&mesh);
        }
        if self.fill_holes {
            mesh = fill_holes(&mesh);
        }
        if self.smooth > 0 {
            mesh = taubin_smoothed(&mesh, self.smooth);
        }
        if let Some(faces) = self.decimate {
            mesh = decimated(&mesh, faces);
        }
        mesh
    }
}

/// Says on standard error what was written.
pub(crate) fn report(path: &Path, mesh: &TriangleMesh) {
    let topology = Topology::of(mesh);
    let state = if topology.is_watertight() {
        "watertight".to_owned()
    } else {
        format!("open: {} boundary edges in {} holes", topology.boundary_edges, topology.boundary_loops)
    };
    eprintln!("{}: {} vertices, {} faces, {state}", path.display(), mesh.vertices.len(), mesh.faces.len());
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    // A wrong output path must not cost the user the run.
    check_mesh_output(&args.output)?;
    let (before, values) = read_mesh_with(&args.mesh)?;
    let mesh = args.clean_up.apply(before.clone());
    anyhow::ensure!(!mesh.is_empty(), "{}: no face is left", args.mesh.display());
    let is_ply = args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply"));
    let carried = values.carried(&before, &mesh);
    if !values.is_empty() && (carried.is_none() || !is_ply) {
        let why = if is_ply { "vertices were moved or made" } else { "only a .ply holds them" };
        say::warn(format!("{}: without sigma_mm and provenance: {why}", args.output.display()));
    }
    write_mesh_with(&args.output, &mesh, &carried.unwrap_or_default().properties())?;
    report(&args.output, &mesh);
    Ok(Outcome::Done)
}
