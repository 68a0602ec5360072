//! What the project claims: where the object is not what its symmetry says, touches put it right.

use super::workshop::{self, Made};
use palpate::geometry::{Bvh, Point, TriangleMesh};
use palpate::metrics::{CompareParams, Viewpoint, compare};
use palpate::pipeline::Method;
use palpate::scene::Scene;

/// Mean distance on the side that the camera does not see, mm.
fn hidden_error(made: &Made, mesh: &TriangleMesh) -> f64 {
    let frame = &made.scene.frame;
    let viewpoint = Viewpoint { camera: frame.camera, world_from_camera: frame.world_from_camera };
    let params =
        CompareParams { samples: 4000, iou_lines: 1000, viewpoint: Some(viewpoint), ..CompareParams::default() };
    let comparison = compare(mesh, &made.truth, &params).expect("both have area");
    let hidden = comparison.hidden.and_then(|h| h.distances).expect("the far side is hidden");
    hidden.chamfer_mean_mm
}

/// The scene as if it had never been touched.
fn untouched(scene: &Scene) -> Scene {
    Scene { touches: Vec::new(), ..scene.clone() }
}

#[test]
fn touches_lower_the_error_of_the_hidden_side_and_a_contradicted_guess_loses() {
    let made = workshop::tabbed_box(12);
    let felt: Vec<Point> = workshop::patches(&made.scene).into_iter().flat_map(|patch| patch.points).collect();
    for method in workshop::METHODS {
        let guess = workshop::mesh(method, &untouched(&made.scene), &made.plane);
        let mesh = workshop::mesh(method, &made.scene, &made.plane);
        let (before, after) = (hidden_error(&made, &guess), hidden_error(&made, &mesh));
        // The published method deletes guesses along rays only, so most of a wrong mirror image survives its touches.
        let wanted = if method == Method::Fused { 0.8 } else { 1.0 };
        assert!(after < wanted * before, "{method:?}: {before} mm without touches, {after} mm with twelve");
        if method != Method::Fused {
            continue;
        }

        let (guess, mesh) = (Bvh::new(&guess), Bvh::new(&mesh));
        let distance = |surface: &Bvh, p| surface.closest_point(p).expect("a surface").distance;
        let contradicting: Vec<&Point> = felt.iter().filter(|p| distance(&guess, p) > 0.005).collect();
        assert!(contradicting.len() > 20, "{method:?}: {} felt points contradict the guess", contradicting.len());
        let mean = contradicting.iter().map(|p| distance(&mesh, p)).sum::<f64>() / contradicting.len() as f64;
        assert!(mean < 0.001, "{method:?}: the mesh passes {mean} m from where the object was felt");
    }
}
