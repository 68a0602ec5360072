//! What each part of the method is worth: reconstructs scenes with truth, with every part taken away in turn; and what holds it back: `--only oracle`
//! gives it the symmetries of the truth, `--only "cells of"` finer cells.
//!
//! `cargo run --release --example ablation -- [--touches 0,20] [--only WORD] SCENE...`
//!
//! Prints the means over all scenes, and the change against the whole method: volumetric IoU, Chamfer mean in mm, and the scene that loses most.
//! Shells (bowls and plates, whose volume says little) are told apart by `--shells NAME,…`: their distances alone count.

#[path = "shared/counts.rs"]
mod counts;
#[path = "shared/true_symmetry.rs"]
mod true_symmetry;

use counts::touch_counts;
use palpate::io::{SceneFile, read_mesh, read_scene};
use palpate::metrics::{CompareParams, TruthReference};
use palpate::pipeline::{ReconstructParams, Stages, reconstruct};
use palpate::symmetry::{EvidenceSearch, Hypothesis, Score, Symmetry, SymmetryElement, SymmetryEstimator};
use rayon::prelude::*;
use std::error::Error;
use true_symmetry::TrueSymmetry;

/// Accepts nothing.
struct Nothing;

impl SymmetryEstimator for Nothing {
    fn estimate(&self, _: &palpate::evidence::Evidence) -> Symmetry {
        Symmetry::default()
    }
}

/// Candidates are fitted from no farther than this, metres.
const NEAR: f64 = 8e-3;
/// At most this many planes, as for the search.
const PLANES: usize = 4;

/// Fits the candidates of the evidence search to the true mesh and accepts those by which it lies on itself: an upper bound of what an estimator can give.
struct Oracle(TrueSymmetry);

impl SymmetryEstimator for Oracle {
    fn estimate(&self, evidence: &palpate::evidence::Evidence) -> Symmetry {
        let found = EvidenceSearch::default().estimate(evidence);
        let candidates = found.accepted.iter().chain(&found.rejected).map(|h| h.element);
        let near: Vec<SymmetryElement> = candidates.filter(|e| self.0.error(e) < NEAR).collect();
        let mut planes = 0;
        let mut accepted = Vec::new();
        for element in self.0.fitted(&near) {
            planes += usize::from(matches!(element, SymmetryElement::Reflection(_)));
            if planes <= PLANES {
                let score = Score { support: 1.0, informative: 1.0, ..Score::default() };
                accepted.push(Hypothesis { element, score, confidence: 1.0, covariance: None, rejection: None });
            }
        }
        Symmetry { accepted, rejected: Vec::new() }
    }
}

/// What is taken away, and how.
type Part = (&'static str, fn(&mut ReconstructParams));

const PARTS: &[Part] = &[
    ("nothing (the whole method)", |_| {}),
    ("symmetry", |_| {}),
    ("rejection by opposition", |p| {
        (p.symmetry.plane_ratio, p.symmetry.axis_ratio, p.symmetry.slack) = (1.0, 1.0, 1.0);
        (p.symmetry.felt_opposition, p.symmetry.axis_felt_opposition) = (1.0, 1.0);
    }),
    ("contact with the support", |p| (p.symmetry.resting_slack, p.symmetry.resting_ratio) = (0.0, 0.0)),
    ("vessels are open above", |p| p.symmetry.hollowness = 1.0),
    ("low weight of copies", |p| p.orbit.weight = 1.0),
    ("their normals count more", |p| p.orbit.orientation = 1.0),
    ("correction of copies by touches", |p| p.orbit.correct = false),
    ("far sides", |p| p.orbit.far_sides = false),
    ("trial of touches", |p| p.touches.judge = false),
    ("refinement of poses", |p| p.touches.refine = false),
    ("free space in the fusion", |p| p.implicit.free_weight = 0.0),
    ("winding prior", |p| {
        (p.implicit.prior.winding_weight, p.implicit.prior.winding_sure_weight) = (0.0, 0.0);
    }),
    ("what winding is sure of", |p| p.implicit.prior.winding_sure_weight = 0.0),
    ("hull prior", |p| p.implicit.prior.hull_weight = 0.0),
    ("narrow band (dense cells alone)", |p| {
        (p.implicit.spacing, p.implicit.shell.spacing) = (0.01, 0.01);
    }),
    ("finer cells and less smoothness for shells", |p| p.implicit.shell.pairs = 2.0),
    ("touches weigh more", |p| p.weight.most = 1.0),
    ("denoising of depth", |p| p.segment.smooth.radius = 1),
    ("oracle: symmetries of the truth", |_| {}),
    ("cells of 0.7 mm", |p| (p.implicit.spacing, p.implicit.shell.spacing) = (0.7e-3, 0.5e-3)),
];

struct Case {
    name: String,
    scene: SceneFile,
    reference: TruthReference,
    oracle: Oracle,
}

struct Run {
    iou: f64,
    chamfer: f64,
}

fn run(Case { scene, reference, oracle, .. }: &Case, touches: usize, part: &Part) -> Option<Run> {
    let mut params =
        ReconstructParams { max_touches: Some(touches), uncertainty: false, ..ReconstructParams::default() };
    part.1(&mut params);
    let estimator: Option<&dyn SymmetryEstimator> = match part.0 {
        "symmetry" => Some(&Nothing),
        name if name.starts_with("oracle") => Some(oracle),
        _ => None,
    };
    let made = reconstruct(&scene.scene, &params, &Stages { symmetry: estimator, ..Stages::default() });
    let made = made.inspect_err(|error| eprintln!("{} without {}: {error}", scene.scene.name, part.0)).ok()?;
    let judged = reference.compare(&made.mesh).ok()?;
    Some(Run { iou: judged.volumetric_iou.unwrap_or(0.0), chamfer: judged.distances.chamfer_mean_mm })
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut counts, mut only, mut shells, mut folders) = (vec![0, 20], String::new(), Vec::new(), Vec::new());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--touches" => counts = touch_counts(args.next())?,
            "--only" => only = args.next().ok_or("--only needs a word")?,
            "--shells" => shells = args.next().ok_or("--shells needs names")?.split(',').map(String::from).collect(),
            _ => folders.push(arg),
        }
    }
    let scenes: Vec<Case> = folders
        .iter()
        .map(|folder| {
            let scene = read_scene(folder)?;
            let truth = read_mesh(scene.truth.as_ref().ok_or_else(|| format!("{folder}: no truth"))?)?;
            let reference =
                TruthReference::new(&truth, &CompareParams { samples: 30_000, ..CompareParams::default() })?;
            let name = folder.rsplit('/').next().unwrap_or(folder).to_owned();
            Ok(Case { name, scene, reference, oracle: Oracle(TrueSymmetry::new(&truth, 100)) })
        })
        .collect::<Result<_, Box<dyn Error>>>()?;
    println!(
        "| taken away | touches | IoU | Chamfer, mm | shells: Chamfer, mm | loses most |\n|---|---|---|---|---|---|"
    );
    let mut whole: Vec<Vec<Option<Run>>> = Vec::new();
    for part in PARTS.iter().enumerate().filter(|(i, p)| *i == 0 || p.0.contains(&only)).map(|(_, p)| p) {
        for (c, &touches) in counts.iter().enumerate() {
            let runs: Vec<Option<Run>> = scenes.par_iter().map(|s| run(s, touches, part)).collect();
            if whole.len() == c {
                whole.push(runs);
                row(part.0, touches, &scenes, &whole[c], None, &shells);
            } else {
                row(part.0, touches, &scenes, &runs, Some(&whole[c]), &shells);
            }
        }
    }
    Ok(())
}

/// A row of means over the scenes, or of their changes. A failed run counts as IoU 0 and is left out of distances.
fn row(
    name: &str,
    touches: usize,
    scenes: &[Case],
    runs: &[Option<Run>],
    whole: Option<&Vec<Option<Run>>>,
    shells: &[String],
) {
    let is_shell = |i: usize| shells.iter().any(|s| scenes[i].name.contains(s));
    let iou = |r: &Option<Run>| r.as_ref().map_or(0.0, |r| r.iou);
    let value = |i: usize, f: fn(&Run) -> f64| {
        let own = runs[i].as_ref().map(f)?;
        Some(own - whole.map_or(Some(0.0), |w| w[i].as_ref().map(f))?)
    };
    let mean = |shell: bool, f: fn(&Run) -> f64| {
        let of: Vec<f64> = (0..runs.len()).filter(|&i| is_shell(i) == shell).filter_map(|i| value(i, f)).collect();
        of.iter().sum::<f64>() / of.len().max(1) as f64
    };
    let bodies: Vec<usize> = (0..runs.len()).filter(|&i| !is_shell(i)).collect();
    let change = |i: usize| iou(&runs[i]) - whole.map_or(0.0, |w| iou(&w[i]));
    let mean_iou = bodies.iter().map(|&i| change(i)).sum::<f64>() / bodies.len().max(1) as f64;
    let worst = bodies.iter().copied().min_by(|&a, &b| change(a).total_cmp(&change(b)));
    let worst = worst.map_or(String::new(), |i| format!("{} {:+.3}", scenes[i].name, change(i)));
    let (chamfer, of_shells) = (mean(false, |r| r.chamfer), mean(true, |r| r.chamfer));
    if whole.is_some() {
        println!("| {name} | {touches} | {mean_iou:+.4} | {chamfer:+.3} | {of_shells:+.2} | {worst} |");
    } else {
        println!("| {name} | {touches} | {mean_iou:.4} | {chamfer:.3} | {of_shells:.2} | |");
    }
}
