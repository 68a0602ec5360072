//! What do inexact and wrong touch poses cost? Disturbs the poses of recorded scenes and reconstructs with and without refinement.
//!
//! `cargo run --release --example touch_trust -- [--touches 20] [--seeds 1] [--only NAME,..] SCENE...`
//!
//! Conditions: exact poses; 1 mm and 2° per axis; 1 mm and 5.7° per axis; one touch in ten 20 mm off in a random direction. Each but the first
//! also without refinement and rejection. Prints volumetric IoU, mean Chamfer distance, touches left out and the largest share of time.

use palpate::geometry::{Isometry, Vector};
use palpate::io::{read_mesh, read_scene};
use palpate::metrics::{CompareParams, TruthReference};
use palpate::pipeline::{ReconstructParams, Stages, Warning, reconstruct};
use palpate::scene::{PoseSigma, Scene};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use std::error::Error;

/// A disturbance of the touches.
#[derive(Clone, Copy)]
struct Condition {
    name: &'static str,
    millimetres: f64,
    degrees: f64,
    /// One touch in this many is moved 20 mm; 0 = none.
    one_wrong_in: usize,
    /// Whether touches are refined and judged.
    trusting: bool,
}

const CONDITIONS: [Condition; 9] = [
    Condition { name: "exact", millimetres: 0.0, degrees: 0.0, one_wrong_in: 0, trusting: true },
    Condition { name: "exact-judged", millimetres: 0.0, degrees: 0.0, one_wrong_in: 0, trusting: false },
    Condition { name: "2deg-raw", millimetres: 1.0, degrees: 2.0, one_wrong_in: 0, trusting: true },
    Condition { name: "2deg", millimetres: 1.0, degrees: 2.0, one_wrong_in: 0, trusting: false },
    Condition { name: "5.7deg-raw", millimetres: 1.0, degrees: 5.7, one_wrong_in: 0, trusting: true },
    Condition { name: "5.7deg", millimetres: 1.0, degrees: 5.7, one_wrong_in: 0, trusting: false },
    Condition { name: "wrong-raw", millimetres: 0.0, degrees: 0.0, one_wrong_in: 10, trusting: true },
    Condition { name: "wrong", millimetres: 0.0, degrees: 0.0, one_wrong_in: 10, trusting: false },
    Condition { name: "wrong-2deg", millimetres: 1.0, degrees: 2.0, one_wrong_in: 10, trusting: false },
];

/// Disturbs the touches of a scene; returns which ones are wrong.
fn disturb(scene: &mut Scene, condition: &Condition, seed: u64) -> Vec<usize> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let sigma = PoseSigma { translation: condition.millimetres * 1e-3, rotation: condition.degrees.to_radians() };
    scene.pose_sigma = sigma;
    let mut wrong = Vec::new();
    let phase = rng.random_range(0..condition.one_wrong_in.max(1));
    for (i, touch) in scene.touches.iter_mut().enumerate() {
        let mut normal = || rng.sample::<f64, _>(StandardNormal);
        let mut draw = |s: f64| Vector::new(normal(), normal(), normal()) * s;
        let (t, r) = (draw(sigma.translation), draw(sigma.rotation));
        touch.world_from_sensor *= Isometry::new(t, r);
        if condition.one_wrong_in > 0 && i % condition.one_wrong_in == phase {
            let off = draw(1.0).normalize() * 20e-3;
            touch.world_from_sensor.translation.vector += off;
            wrong.push(i);
        }
    }
    wrong
}

/// How far a pose is off: millimetres along the press, degrees of tilt, and the first in σ.
fn off(exact: &Isometry, pose: &Isometry, sigma: f64) -> [f64; 3] {
    let press = exact * Vector::z();
    let along = (pose.translation.vector - exact.translation.vector).dot(&press);
    let tilt = (pose * Vector::z()).dot(&press).clamp(-1.0, 1.0).acos();
    [1e3 * along, tilt.to_degrees(), along / sigma]
}

fn hash(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut touches, mut seeds, mut only, mut folders) = (20, 1u64, Vec::<String>::new(), Vec::new());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--touches" => touches = args.next().ok_or("--touches needs a number")?.parse()?,
            "--seeds" => seeds = args.next().ok_or("--seeds needs a number")?.parse()?,
            "--only" => only = args.next().ok_or("--only needs names")?.split(',').map(str::to_owned).collect(),
            _ => folders.push(arg),
        }
    }
    let conditions: Vec<&Condition> =
        CONDITIONS.iter().filter(|c| only.is_empty() || only.iter().any(|n| n == c.name)).collect();
    let mut sums = vec![[0.0f64; 6]; conditions.len()];
    for folder in &folders {
        let file = read_scene(folder)?;
        let truth = read_mesh(file.truth.ok_or("the scene has no truth")?)?;
        let compare = CompareParams { samples: 20_000, ..CompareParams::default() };
        let truth = TruthReference::new(&truth, &compare)?;
        for seed in 0..seeds {
            for (condition, sum) in conditions.iter().zip(&mut sums) {
                let mut scene = file.scene.clone();
                scene.touches.truncate(touches);
                let seed = hash(&scene.name) ^ seed;
                let wrong = disturb(&mut scene, condition, seed);
                let mut params = ReconstructParams::default();
                params.touches.refine = !condition.trusting;
                params.touches.judge = !condition.trusting;
                let result = reconstruct(&scene, &params, &Stages::default())?;
                let c = truth.compare(&result.mesh)?;
                let mut caught = 0;
                let mut falsely = 0;
                for warning in &result.warnings {
                    if let Warning::TouchLeftOut { touch, reason } = warning {
                        let right = wrong.contains(touch);
                        caught += usize::from(right);
                        falsely += usize::from(!right);
                        if !right {
                            println!("    {} {} left out falsely: touch {touch}: {reason}", scene.name, condition.name);
                        }
                    }
                }
                let exact = |t: usize| file.scene.touches[t].world_from_sensor;
                let stated: Vec<[f64; 3]> = result
                    .touches
                    .iter()
                    .map(|t| off(&exact(t.touch), &scene.touches[t.touch].world_from_sensor, f64::INFINITY))
                    .collect();
                let used: Vec<[f64; 3]> = result
                    .touches
                    .iter()
                    .map(|t| off(&exact(t.touch), &t.world_from_sensor, t.covariance[(5, 5)].sqrt()))
                    .collect();
                let rms = |v: &[[f64; 3]], k: usize| {
                    (v.iter().map(|x| x[k] * x[k]).sum::<f64>() / v.len().max(1) as f64).sqrt()
                };
                println!(
                    "    along the press {:.2} -> {:.2} mm, tilt {:.2} -> {:.2} deg, error/sigma {:.2}, accepted {}",
                    rms(&stated, 0),
                    rms(&used, 0),
                    rms(&stated, 1),
                    rms(&used, 1),
                    rms(&used, 2),
                    result.symmetry.accepted.iter().map(|h| h.element.kind()).collect::<Vec<_>>().join(" ")
                );
                let iou = c.volumetric_iou.unwrap_or(f64::NAN);
                println!(
                    "{:28} {:12} IoU {:.4} cdm {:.3} wrong {} caught {caught} falsely {falsely}",
                    scene.name,
                    condition.name,
                    iou,
                    c.distances.chamfer_mean_mm,
                    wrong.len(),
                );
                let row = [iou, c.distances.chamfer_mean_mm, wrong.len() as f64, caught as f64, falsely as f64, 1.0];
                for (s, x) in sum.iter_mut().zip(row) {
                    *s += x;
                }
            }
        }
    }
    for (condition, s) in conditions.iter().zip(&sums) {
        let n = s[5].max(1.0);
        println!(
            "mean {:12} IoU {:.4} cdm {:.3} wrong {} caught {} falsely {} of {n}",
            condition.name,
            s[0] / n,
            s[1] / n,
            s[2],
            s[3],
            s[4]
        );
    }
    Ok(())
}
