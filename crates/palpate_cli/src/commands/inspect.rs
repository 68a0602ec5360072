use crate::Outcome;
use palpate::geometry::{MassProperties, Topology, TriangleMesh, self_intersections, worst_aspect_ratio};
use palpate::io::read_mesh;
use serde::Serialize;
use std::path::PathBuf;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The mesh: .ply, .obj, .off, .stl
    mesh: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Everything `inspect` says; lengths in metres, inertia for 1 kg/m³.
#[derive(Serialize)]
struct Inspection {
    #[serde(flatten)]
    topology: Topology,
    closed: bool,
    edge_manifold: bool,
    vertex_manifold: bool,
    consistently_oriented: bool,
    watertight: bool,
    genus: Option<usize>,
    self_intersecting_pairs: usize,
    /// Longest side over the height on it, 1 for equal sides; absent if a face lies on a line.
    worst_aspect_ratio: Option<f64>,
    bounds_min: Option<[f64; 3]>,
    bounds_max: Option<[f64; 3]>,
    area_m2: f64,
    /// Absent unless the mesh is watertight.
    volume_m3: Option<f64>,
    centroid: Option<[f64; 3]>,
    /// Rows of the tensor about the centroid, at unit density.
    inertia_m5: Option<[[f64; 3]; 3]>,
}

impl Inspection {
    fn of(mesh: &TriangleMesh) -> Self {
        let topology = Topology::of(mesh);
        let mass = MassProperties::of(mesh);
        let watertight = topology.is_watertight();
        let bounds = mesh.bounds();
        Self {
            topology,
            closed: topology.is_closed(),
            edge_manifold: topology.is_edge_manifold(),
            vertex_manifold: topology.is_vertex_manifold(),
            consistently_oriented: topology.is_consistently_oriented(),
            watertight,
            genus: topology.genus(),
            self_intersecting_pairs: self_intersections(mesh).len(),
            worst_aspect_ratio: Some(worst_aspect_ratio(mesh)).filter(|r| r.is_finite()),
            bounds_min: bounds.map(|b| b.min.into()),
            bounds_max: bounds.map(|b| b.max.into()),
            area_m2: mass.area,
            volume_m3: watertight.then_some(mass.volume),
            centroid: watertight.then(|| mass.centroid.into()),
            inertia_m5: watertight.then(|| [0, 1, 2].map(|i| [0, 1, 2].map(|j| mass.inertia[(i, j)]))),
        }
    }

    fn print(&self) {
        let yes = |b: bool| if b { "yes" } else { "no" };
        let t = &self.topology;
        println!("vertices               {} ({} unused)", t.vertices, t.unused_vertices);
        println!("faces                  {} ({} degenerate)", t.faces, t.degenerate_faces);
        println!("edges                  {}", t.edges);
        println!("pieces                 {}", t.components);
        println!(
            "closed                 {} ({} boundary edges, {} holes)",
            yes(self.closed),
            t.boundary_edges,
            t.boundary_loops
        );
        println!(
            "edge-manifold          {} ({} edges of three faces or more)",
            yes(self.edge_manifold),
            t.non_manifold_edges
        );
        println!(
            "vertex-manifold        {} ({} vertices where pieces touch)",
            yes(self.vertex_manifold),
            t.non_manifold_vertices
        );
        println!("consistently oriented  {} ({} edges at odds)", yes(self.consistently_oriented), t.inconsistent_edges);
        println!("watertight             {}", yes(self.watertight));
        println!("genus                  {}", self.genus.map_or("not defined".into(), |g| g.to_string()));
        println!("crossing face pairs    {}", self.self_intersecting_pairs);
        println!(
            "worst aspect ratio     {}",
            self.worst_aspect_ratio.map_or("infinite".into(), |r| format!("{r:.1} (1: equal sides)"))
        );
        if let (Some(a), Some(b)) = (self.bounds_min, self.bounds_max) {
            let mm = |i: usize| 1e3 * (b[i] - a[i]);
            println!("size                   {:.3} × {:.3} × {:.3} mm", mm(0), mm(1), mm(2));
        }
        println!("area                   {:.3} cm²", 1e4 * self.area_m2);
        if let (Some(volume), Some([x, y, z]), Some(inertia)) = (self.volume_m3, self.centroid, self.inertia_m5) {
            println!("volume                 {:.3} cm³", 1e6 * volume);
            println!("centroid               ({x:.6}, {y:.6}, {z:.6}) m");
            println!(
                "inertia at 1 kg/m³     [{:.6e} {:.6e} {:.6e}] kg m²",
                inertia[0][0], inertia[0][1], inertia[0][2]
            );
            println!("                       [{:.6e} {:.6e} {:.6e}]", inertia[1][0], inertia[1][1], inertia[1][2]);
            println!("                       [{:.6e} {:.6e} {:.6e}]", inertia[2][0], inertia[2][1], inertia[2][2]);
        }
    }
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let mesh = read_mesh(&args.mesh)?;
    let inspection = Inspection::of(&mesh);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&inspection)?);
    } else {
        inspection.print();
    }
    Ok(Outcome::Done)
}
