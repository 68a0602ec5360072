//! What surface methods make of bad clouds of many objects: a Markdown table of failures, soundness and errors.
//!
//! ```text
//! robustness_table POINTS MESH...
//! ```
//!
//! The longest side of every object is scaled to 200 mm. Errors are mean distances of 10,000 samples of the surface to the truth's triangles, in mm at
//! that size; the scaled clouds are measured at their own scale.

use palpate::geometry::{Bvh, Point, PointCloud, Topology, TriangleMesh, Vector};
use palpate::io::read_mesh;
use palpate::metrics::SurfaceSamples;
use palpate::surface::{BallPivotingParams, PoissonParams, SurfaceError, ball_pivoting, screened_poisson};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use std::error::Error;

/// What is done to a cloud.
#[derive(Clone, Copy)]
enum Harm {
    None,
    /// Position noise a axis, metres.
    Noise(f64),
    /// One point in ten anywhere in the box.
    Outliers,
    /// The 30 % nearest a point of the surface are missing.
    Hole,
    /// Every point twice and a tenth of them five times.
    Duplicates,
    /// Unit of length.
    Scale(f64),
    /// The normals of the 10 % nearest a point of the surface are turned over.
    FlippedPatch,
}

const HARMS: [(&str, Harm); 10] = [
    ("noise-free", Harm::None),
    ("noise 0.3 mm", Harm::Noise(3e-4)),
    ("noise 1 mm", Harm::Noise(1e-3)),
    ("10 % outliers", Harm::Outliers),
    ("30 % missing", Harm::Hole),
    ("duplicates", Harm::Duplicates),
    ("micrometres", Harm::Scale(1e-6)),
    ("metres as mm", Harm::Scale(1e3)),
    ("kilometres", Harm::Scale(1e6)),
    ("10 % flipped", Harm::FlippedPatch),
];

fn cloud(mesh: &TriangleMesh, count: usize) -> PointCloud {
    let samples = SurfaceSamples::draw(mesh, count, 0);
    let normals = samples.faces.iter().map(|&f| mesh.face_normal(f)).collect();
    PointCloud { points: samples.points, normals: Some(normals), colors: None }
}

/// Indices of the share of points nearest the first.
fn nearest_share(cloud: &PointCloud, share: f64) -> Vec<bool> {
    let from = cloud.points[0];
    let distance = |p: &Point| (p - from).norm();
    let mut sorted: Vec<f64> = cloud.points.iter().map(distance).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let limit = sorted[(share * sorted.len() as f64) as usize];
    cloud.points.iter().map(|p| distance(p) < limit).collect()
}

fn harmed(clean: &PointCloud, harm: Harm) -> PointCloud {
    let mut cloud = clean.clone();
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    match harm {
        Harm::None => {}
        Harm::Noise(sigma) => {
            let noise = Normal::new(0.0, sigma).expect("finite");
            cloud.points.iter_mut().for_each(|p| *p += Vector::from_fn(|_, _| noise.sample(&mut rng)));
        }
        Harm::Outliers => {
            for p in cloud.points.iter_mut().step_by(10) {
                *p = Point::from(Vector::from_fn(|_, _| rng.random_range(-0.1..0.1)));
            }
        }
        Harm::Hole => {
            let missing = nearest_share(clean, 0.3);
            cloud = clean.filtered(|i| !missing[i]);
        }
        Harm::Duplicates => {
            cloud.append(clean);
            for _ in 0..3 {
                cloud.append(&clean.filtered(|i| i % 10 == 0));
            }
        }
        Harm::Scale(unit) => cloud.points.iter_mut().for_each(|p| *p = Point::from(p.coords * unit)),
        Harm::FlippedPatch => {
            let turned = nearest_share(clean, 0.1);
            for (n, _) in cloud.normals.iter_mut().flatten().zip(turned).filter(|(_, t)| *t) {
                *n = -*n;
            }
        }
    }
    cloud
}

/// What came of one method on one kind of harm, over the objects.
#[derive(Default)]
struct Tally {
    runs: usize,
    errors: Vec<String>,
    not_finite: usize,
    closed: usize,
    manifold: usize,
    distances: Vec<f64>,
}

impl Tally {
    fn add(&mut self, result: Result<TriangleMesh, SurfaceError>, truth: &Bvh, unit: f64) {
        self.runs += 1;
        let mesh = match result {
            Ok(mesh) => mesh,
            Err(error) => return self.errors.push(error.to_string()),
        };
        if !mesh.vertices.iter().all(|v| v.iter().all(|c| c.is_finite())) {
            self.not_finite += 1;
            return;
        }
        let topology = Topology::of(&mesh);
        self.closed += usize::from(topology.is_watertight());
        self.manifold += usize::from(topology.is_vertex_manifold() && topology.is_consistently_oriented());
        let points = SurfaceSamples::draw(&mesh, 10_000, 2).points;
        let far = |p: &Point| truth.closest_point(&Point::from(p.coords / unit)).map_or(f64::NAN, |c| c.distance);
        let mean = points.iter().map(far).sum::<f64>() / points.len().max(1) as f64;
        self.distances.push(1e3 * mean);
    }

    fn row(&mut self, name: &str) -> String {
        self.distances.sort_unstable_by(f64::total_cmp);
        let at = |q: f64| {
            let last = self.distances.len().saturating_sub(1);
            self.distances.get((q * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
        };
        format!(
            "| {name} | {} | {} | {} | {} | {} | {:.3} | {:.3} |",
            self.runs,
            self.errors.len(),
            self.not_finite,
            self.closed,
            self.manifold,
            at(0.5),
            at(1.0)
        )
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let count: usize = words.next().ok_or("no POINTS given")?.parse()?;
    let mut tallies: Vec<[Tally; 2]> = HARMS.iter().map(|_| [Tally::default(), Tally::default()]).collect();
    for path in words {
        let mut truth = read_mesh(std::path::Path::new(&path))?;
        let bounds = truth.bounds().ok_or("a mesh without vertices")?;
        let (centre, scale) = (bounds.center(), 0.2 / bounds.size().max());
        truth.vertices.iter_mut().for_each(|v| *v = Point::from((*v - centre) * scale));
        let (clean, tree) = (cloud(&truth, count), Bvh::new(&truth));
        for ((_, harm), [poisson, balls]) in HARMS.iter().zip(&mut tallies) {
            let cloud = harmed(&clean, *harm);
            let unit = if let Harm::Scale(unit) = harm { *unit } else { 1.0 };
            poisson.add(screened_poisson(&cloud, None, &PoissonParams::default()).map(|s| s.mesh), &tree, unit);
            balls.add(ball_pivoting(&cloud, &BallPivotingParams::default()), &tree, unit);
        }
    }
    println!("| method, cloud | runs | errors | NaN | closed | manifold, oriented | median mm | worst mm |");
    println!("|---|---|---|---|---|---|---|---|");
    for (method, name) in ["Poisson", "ball pivoting"].iter().enumerate() {
        for ((harm, _), tally) in HARMS.iter().zip(&mut tallies) {
            println!("{}", tally[method].row(&format!("{name}, {harm}")));
        }
    }
    for ((harm, _), tally) in HARMS.iter().zip(&tallies) {
        tally.iter().flat_map(|t| &t.errors).for_each(|error| eprintln!("{harm}: {error}"));
    }
    Ok(())
}
