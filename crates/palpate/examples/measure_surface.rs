//! Meshes a cloud and prints what it took: CPU and wall seconds inside the call, peak memory, and what came out.
//!
//! ```text
//! measure_surface CLOUD poisson|ball-pivoting|implicit [--depth D] [--radius R]... [--cell C] [--threads N] [--repeats N] [--out MESH] [--set FIELD=VALUE]...
//! ```
//!
//! One JSON object on standard output, metres and seconds. CPU and memory are Linux's own counts (`/proc`).

#[path = "shared/cpu.rs"]
mod cpu;

use cpu::cpu_seconds;
use palpate::geometry::{PointCloud, Topology, TriangleMesh};
use palpate::io::{read_cloud, write_mesh};
use palpate::surface::{
    BallPivotingParams, ImplicitParams, PoissonParams, ball_pivoting, implicit_surface, screened_poisson,
};
use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

#[derive(Default)]
struct Args {
    cloud: PathBuf,
    method: String,
    depth: Option<u32>,
    radii: Vec<f64>,
    cell: Option<f64>,
    threads: usize,
    repeats: usize,
    out: Option<PathBuf>,
    /// Fields of the parameters to override, as TOML lines.
    set: Vec<String>,
}

fn parse() -> Result<Args, Box<dyn Error>> {
    let mut args = Args { threads: 1, repeats: 1, ..Args::default() };
    let mut words = std::env::args().skip(1);
    args.cloud = words.next().ok_or("no CLOUD given")?.into();
    args.method = words.next().ok_or("no method given")?;
    while let Some(flag) = words.next() {
        let value = words.next().ok_or_else(|| format!("{flag} needs a value"))?;
        match flag.as_str() {
            "--depth" => args.depth = Some(value.parse()?),
            "--radius" => args.radii.push(value.parse()?),
            "--cell" => args.cell = Some(value.parse()?),
            "--threads" => args.threads = value.parse()?,
            "--repeats" => args.repeats = value.parse()?,
            "--set" => args.set.push(value),
            "--out" => args.out = Some(value.into()),
            _ => return Err(format!("unknown flag {flag}").into()),
        }
    }
    Ok(args)
}

/// Mesh, depth and cell where there is one.
type Made = (TriangleMesh, Option<(u32, f64, f64, f64)>);

fn mesh(cloud: &PointCloud, args: &Args) -> Result<Made, Box<dyn Error>> {
    match args.method.as_str() {
        "poisson" => {
            let mut params: PoissonParams = toml::from_str(&args.set.join("\n"))?;
            params.depth = args.depth.or(params.depth);
            let surface = screened_poisson(cloud, None, &params)?;
            Ok((surface.mesh, Some((surface.depth, surface.cell, surface.noise, surface.screening))))
        }
        "ball-pivoting" => {
            let radii = (!args.radii.is_empty()).then(|| args.radii.clone());
            let mut params: BallPivotingParams = toml::from_str(&args.set.join("\n"))?;
            params.radii = radii.or(params.radii);
            Ok((ball_pivoting(cloud, &params)?, None))
        }
        "implicit" => {
            let mut params = toml::Table::try_from(ImplicitParams::of_cloud())?;
            params.extend(toml::from_str::<toml::Table>(&args.set.join("\n"))?);
            let params: ImplicitParams = params.try_into()?;
            Ok((implicit_surface(cloud, args.cell, &params)?, None))
        }
        other => Err(format!("unknown method {other}").into()),
    }
}

/// A line of `/proc/self/status` in MB.
fn memory(name: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|l| l.starts_with(name)).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1024.0
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = parse()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build()?;
    let cloud = read_cloud(&args.cloud)?;
    let before = memory("VmRSS");
    let (mut cpu, mut wall, mut made): (Vec<f64>, Vec<f64>, Made) =
        (Vec::new(), Vec::new(), (TriangleMesh::default(), None));
    for _ in 0..args.repeats {
        let (cpu_start, start) = (cpu_seconds(), Instant::now());
        made = pool.install(|| mesh(&cloud, &args).map_err(|e| e.to_string()))?;
        cpu.push(cpu_seconds() - cpu_start);
        wall.push(start.elapsed().as_secs_f64());
    }
    let peak = memory("VmHWM");
    let topology = Topology::of(&made.0);
    let report = serde_json::json!({
        "points": cloud.len(),
        "cpu_s": cpu,
        "wall_s": wall,
        "peak_mb": peak,
        "before_mb": before,
        "triangles": made.0.faces.len(),
        "chosen": made.1,
        "closed": topology.is_watertight(),
        "edge_manifold": topology.is_edge_manifold(),
        "vertex_manifold": topology.is_vertex_manifold(),
        "open_edges": topology.boundary_edges,
        "components": topology.components,
    });
    println!("{report}");
    if let Some(out) = &args.out {
        write_mesh(out, &made.0)?;
    }
    Ok(())
}
