//! How right are the accepted symmetries? Simulates scenes of meshes, estimates, and moves the true mesh by what was accepted.
//!
//! `cargo run --release --example symmetry_report -- [--views 3] [--touches 0,20] [--verbose] [--f1] MESH.ply...`
//!
//! The error of a hypothesis is the mean distance of the moved truth to the truth: right below 2.5 mm, bad from 4 mm on.
//!
//! `--f1` also fits the symmetries of the true mesh (1.5 mm; seconds an object) and tells precision, recall and F1 of the accepted ones by SymmetryNet's measure,
//! over thresholds of the confidence. What a true axis or centre implies (a plane that holds it) is right and is asked of nobody.

#[path = "../shared/counts.rs"]
mod counts;
mod f1;
#[path = "../shared/true_symmetry.rs"]
mod true_symmetry;

use counts::touch_counts;
use f1::Found;
use palpate::camera::{SegmentParams, segment_object};
use palpate::evidence::{Evidence, EvidenceParams};
use palpate::geometry::TriangleMesh;
use palpate::simulate::{SimulateParams, SimulatedScene, simulate_scene};
use palpate::symmetry::{EvidenceSearch, Hypothesis, SymmetryElement, SymmetryEstimator as _};
use palpate::tactile::{LiftParams, Patch, lift};
use std::error::Error;
use std::path::Path;
use std::time::Instant;
use true_symmetry::TrueSymmetry;

const RIGHT: f64 = 2.5e-3;
const BAD: f64 = 4e-3;

fn patches(scene: &SimulatedScene, touches: usize) -> Vec<Patch> {
    let Some(sensor) = &scene.scene.sensor else { return Vec::new() };
    let touch = |t: &palpate::tactile::Touch| {
        lift(t.contact.as_ref()?, sensor, &t.world_from_sensor, &LiftParams::default()).ok()
    };
    scene.scene.touches.iter().take(touches).filter_map(touch).collect()
}

fn describe(h: &Hypothesis, e: f64) -> String {
    let s = &h.score;
    let place = match &h.element {
        SymmetryElement::Reflection(p) => {
            format!("n {:+.3} {:+.3} {:+.3} d {:+.4}", p.normal.x, p.normal.y, p.normal.z, p.offset)
        }
        SymmetryElement::Axis { point: p, direction: d, .. } => {
            format!("d {:+.3} {:+.3} {:+.3} p {:+.3} {:+.3} {:+.3}", d.x, d.y, d.z, p.x, p.y, p.z)
        }
        SymmetryElement::Sphere { center: c } => format!("c {:+.3} {:+.3} {:+.3}", c.x, c.y, c.z),
    };
    format!(
        "    {:10} e {:6.2} mm  i {:.3} s {:.3} v {:.3} c {:.3} felt {:.3} neutral {:.2} confidence {:.2}  {place}  {:?}",
        h.element.kind(),
        e * 1e3,
        s.informative,
        s.support,
        s.violation,
        s.contradiction,
        s.felt_opposition,
        s.neutral,
        h.confidence,
        h.rejection
    )
}

#[derive(Default)]
struct Tally {
    runs: usize,
    right: usize,
    bad: usize,
    best: Vec<f64>,
    all: Vec<f64>,
    seconds: [f64; 2],
    found: Found,
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut views, mut counts, mut verbose, mut f1, mut files) = (3, vec![0, 20], false, false, Vec::new());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--views" => views = args.next().ok_or("--views needs a number")?.parse()?,
            "--touches" => counts = touch_counts(args.next())?,
            "--verbose" => verbose = true,
            "--f1" => f1 = true,
            _ => files.push(arg),
        }
    }
    let mut tallies: Vec<Tally> = counts.iter().map(|_| Tally::default()).collect();
    for file in &files {
        let name = Path::new(file).file_stem().and_then(|s| s.to_str()).unwrap_or("object").to_owned();
        let mesh: TriangleMesh = palpate::io::read_mesh(file)?;
        let mut elements: Option<Vec<SymmetryElement>> = None;
        for view in 0..views {
            let mut params = SimulateParams { view, ..SimulateParams::default() };
            params.touch.count = counts.iter().copied().max().unwrap_or(0);
            let scene = simulate_scene(&name, &mesh, &params)?;
            let truth = TrueSymmetry::new(&scene.truth, 600);
            // Every view of an object has it in the same place.
            if f1 && elements.is_none() {
                let found = f1::elements(&TrueSymmetry::new(&scene.truth, 100));
                println!("{name}: {}", found.iter().map(SymmetryElement::kind).collect::<Vec<_>>().join(", "));
                elements = Some(found);
            }
            let visible = segment_object(&scene.scene.frame, &SegmentParams::default())?;
            for (count, tally) in counts.iter().zip(&mut tallies) {
                let patches = patches(&scene, *count);
                let start = Instant::now();
                let evidence = Evidence::gather(&scene.scene.frame, &visible, &patches, &EvidenceParams::default())?;
                let gathered = start.elapsed().as_secs_f64();
                let symmetry = EvidenceSearch::default().estimate(&evidence);
                let seconds = start.elapsed().as_secs_f64() - gathered;
                let errors: Vec<f64> = symmetry.accepted.iter().map(|h| truth.error(&h.element)).collect();
                let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
                let bad = errors.iter().filter(|e| **e >= BAD).count();
                let flag = if best >= RIGHT {
                    "NONE RIGHT"
                } else if bad > 0 {
                    "BAD ACCEPTED"
                } else {
                    ""
                };
                println!(
                    "{name} view {view} touches {count}: accepted {} best {:.2} mm worst {:.2} mm; evidence {:.0} ms, search {:.0} ms {flag}",
                    errors.len(),
                    best * 1e3,
                    errors.iter().copied().fold(0.0, f64::max) * 1e3,
                    gathered * 1e3,
                    seconds * 1e3
                );
                if verbose {
                    symmetry.accepted.iter().zip(&errors).for_each(|(h, e)| println!("{}", describe(h, *e)));
                    let show = |h: &Hypothesis| println!("{}", describe(h, truth.error(&h.element)));
                    symmetry.rejected.iter().for_each(show);
                }
                if let Some(elements) = &elements {
                    tally.found.add(&symmetry.accepted, &truth, elements, RIGHT);
                }
                tally.runs += 1;
                tally.right += usize::from(best < RIGHT);
                tally.bad += usize::from(bad > 0);
                tally.best.push(best);
                tally.all.extend(errors);
                tally.seconds = [tally.seconds[0] + gathered, tally.seconds[1] + seconds];
            }
        }
    }
    for (count, mut t) in counts.iter().zip(tallies) {
        t.best.sort_by(f64::total_cmp);
        let median = t.best.get(t.best.len() / 2).copied().unwrap_or(f64::NAN);
        let mean = t.all.iter().sum::<f64>() / t.all.len() as f64;
        println!(
            "touches {count}: {} runs, right {}, with a bad one {}, median of the best {:.2} mm, mean of all accepted {:.2} mm, evidence {:.0} ms, search {:.0} ms",
            t.runs,
            t.right,
            t.bad,
            median * 1e3,
            mean * 1e3,
            t.seconds[0] / t.runs as f64 * 1e3,
            t.seconds[1] / t.runs as f64 * 1e3
        );
        if f1 {
            let [precision, recall, all] = t.found.from(0.0);
            let best = (0..100).map(|i| t.found.from(f64::from(i) / 100.0)[2]).fold(0.0, f64::max);
            println!(
                "    precision {precision:.3}, recall {recall:.3}, F1 {all:.3}; greatest over the confidence {best:.3}"
            );
        }
    }
    Ok(())
}
