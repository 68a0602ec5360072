//! Does σ mean anything? Reconstructs scenes with known truth and compares each vertex's σ with its true distance to the truth.
//!
//! `cargo run --release --example uncertainty_report -- [--touches 0,5,20] [--csv TERMS.csv] [--stride N] SCENE...`
//!
//! For every run and for all together: Spearman's rank correlation of σ and |error|, share of errors in the 90 % interval (1.645 σ) and the
//! factor by which σ is too small. `--csv` writes what σ was made of, every `--stride`-th vertex, for calibration.

#[path = "shared/counts.rs"]
mod counts;

use counts::touch_counts;
use palpate::geometry::Bvh;
use palpate::io::{read_mesh, read_scene};
use palpate::metrics::Calibration;
use palpate::pipeline::{ReconstructParams, Stages, VertexKnowledge, VertexProvenance, reconstruct};
use std::error::Error;
use std::fmt::Write as _;

const KINDS: [(&str, VertexProvenance); 4] = [
    ("seen", VertexProvenance::Seen),
    ("felt", VertexProvenance::Felt),
    ("guessed", VertexProvenance::Guessed),
    ("extrapolated", VertexProvenance::Extrapolated),
];

/// σ, |error| and provenance of vertices, one weight each.
#[derive(Default)]
struct Pairs {
    sigmas: Vec<f64>,
    errors: Vec<f64>,
    kinds: Vec<VertexProvenance>,
}

impl Pairs {
    fn line(&self, name: &str) -> String {
        let mut line = format!("{name:40} ");
        match Calibration::new(&self.sigmas, &self.errors) {
            Some(c) => {
                let _ = write!(
                    line,
                    "n {:7} spearman {:+.3} in 90 % {:.3} in σ {:.3} factor {:.2}",
                    c.count, c.spearman, c.coverage_90, c.coverage_68, c.ratio_90
                );
            }
            None => line.push_str("too few vertices"),
        }
        for (kind, provenance) in KINDS {
            let of = |v: &[f64]| -> Vec<f64> {
                v.iter().zip(&self.kinds).filter(|(_, k)| **k == provenance).map(|(x, _)| *x).collect()
            };
            let (s, e) = (of(&self.sigmas), of(&self.errors));
            if let Some(c) = Calibration::new(&s, &e) {
                let share = c.count as f64 / self.sigmas.len() as f64;
                let _ = write!(line, " | {kind} {:.2}: {:+.2} {:.3}", share, c.spearman, c.coverage_90);
            }
        }
        line
    }

    fn append(&mut self, other: &Self) {
        self.sigmas.extend_from_slice(&other.sigmas);
        self.errors.extend_from_slice(&other.errors);
        self.kinds.extend_from_slice(&other.kinds);
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut counts, mut csv, mut stride, mut folders) = (vec![0, 5, 20], None, 10, Vec::new());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--touches" => counts = touch_counts(args.next())?,
            "--csv" => csv = Some(args.next().ok_or("--csv needs a file")?),
            "--stride" => stride = args.next().ok_or("--stride needs a number")?.parse()?,
            _ => folders.push(arg),
        }
    }
    let mut table = String::from(
        "scene,touches,error,measured_distance,measured_sigma,measured_offset,felt,guess_distance,guess_offset,guess_lever,guess_miss,bend,room\n",
    );
    let mut totals: Vec<Pairs> = counts.iter().map(|_| Pairs::default()).collect();
    let mut runs = Vec::new();
    for folder in &folders {
        let file = read_scene(folder)?;
        let truth = Bvh::new(&read_mesh(file.truth.ok_or("the scene has no truth")?)?);
        for (count, total) in counts.iter().zip(&mut totals) {
            let params = ReconstructParams { max_touches: Some(*count), ..ReconstructParams::default() };
            let result = reconstruct(&file.scene, &params, &Stages::default())?;
            let Some(VertexKnowledge { sigma, provenance, terms }) = &result.knowledge else { continue };
            let mut pairs = Pairs::default();
            for i in (0..sigma.len()).step_by(stride) {
                let Some(nearest) = truth.closest_point(&result.mesh.vertices[i]) else { continue };
                pairs.sigmas.push(sigma[i]);
                pairs.errors.push(nearest.distance);
                pairs.kinds.push(provenance[i]);
                let t = &terms[i];
                let _ = writeln!(
                    table,
                    "{},{count},{:.7},{:.6},{:.7},{:.7},{},{:.6},{:.7},{:.7},{:.7},{:.7},{:.6}",
                    file.scene.name,
                    nearest.distance,
                    t.measured_distance,
                    t.measured_sigma,
                    t.measured_offset,
                    u8::from(t.felt),
                    t.guess_distance,
                    t.guess_offset,
                    t.guess_lever,
                    t.guess_miss,
                    t.bend,
                    t.room
                );
            }
            println!("{}", pairs.line(&format!("{} touches {count}", file.scene.name)));
            runs.extend(Calibration::new(&pairs.sigmas, &pairs.errors).map(|c| (*count, c)));
            total.append(&pairs);
        }
    }
    let mut all = Pairs::default();
    for (count, total) in counts.iter().zip(&totals) {
        println!("{}", total.line(&format!("all, touches {count}")));
        all.append(total);
    }
    println!("{}", all.line("all"));
    let mean = |f: fn(&Calibration) -> f64| runs.iter().map(|(_, c)| f(c)).sum::<f64>() / runs.len().max(1) as f64;
    println!(
        "mean of {} runs: spearman {:+.3}, in 90 % {:.3}",
        runs.len(),
        mean(|c| c.spearman),
        mean(|c| c.coverage_90)
    );
    if let Some(path) = csv {
        palpate::io::write_text(path, &table)?;
    }
    Ok(())
}
