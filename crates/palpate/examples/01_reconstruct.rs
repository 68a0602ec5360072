//! From one depth frame to a closed mesh, without and with touches, on an object that is not what its symmetry says.
//!
//! `cargo run --release --example 01_reconstruct`

use palpate::metrics::{CompareParams, compare};
use palpate::pipeline::{ReconstructParams, Stages, reconstruct};
use palpate::simulate::{SimulateParams, Solid, simulate_scene};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A scene with exact truth: what the camera recorded, and twelve presses of the fingertip.
    let solid = Solid::named("tabbed-box").ok_or("no such solid")?.mesh(1e-4, 5e-3);
    let mut simulate = SimulateParams::default();
    simulate.touch.count = 12;
    let made = simulate_scene("tabbed-box", &solid, &simulate)?;

    for touches in [0, 4, 12] {
        let params = ReconstructParams { max_touches: Some(touches), ..ReconstructParams::default() };
        let result = reconstruct(&made.scene, &params, &Stages::default())?;
        let score = compare(&result.mesh, &made.truth, &CompareParams::default())?;
        println!(
            "{touches:2} touches: {} symmetries, volumetric IoU {:.3}, Chamfer {:.2} mm",
            result.symmetry.accepted.len(),
            score.volumetric_iou.unwrap_or(f64::NAN),
            score.distances.chamfer_mean_mm
        );
    }
    Ok(())
}
