//! Bad recordings: never a crash, and the reconstruction says what it does not know.

use palpate::camera::{Frame, PinholeCamera};
use palpate::geometry::{Raster, Topology};
use palpate::pipeline::{ReconstructParams, Reconstruction, Stages, VertexProvenance, Warning, reconstruct};
use palpate::scene::Scene;
use palpate::simulate::{SimulateParams, Solid, simulate_scene};
use palpate::surface::ImplicitParams;

/// Coarse enough for a debug build.
fn params() -> ReconstructParams {
    let implicit = ImplicitParams { spacing: 3e-3, dense_cells: 15_000, ..ImplicitParams::default() };
    ReconstructParams { implicit, ..ReconstructParams::default() }
}

fn scene(solid: &str, change: impl Fn(&mut SimulateParams)) -> Scene {
    let mut simulate = SimulateParams::default();
    simulate.touch.count = 4;
    simulate.touch.map_width = 80;
    simulate.touch.candidates = 300;
    change(&mut simulate);
    let mesh = Solid::named(solid).expect("listed").mesh(2e-5, 4e-3);
    simulate_scene(solid, &mesh, &simulate).expect("valid").scene
}

fn whole(result: &Reconstruction) {
    assert!(Topology::of(&result.mesh).is_closed());
    let knowledge = result.knowledge.as_ref().expect("asked for");
    assert_eq!(knowledge.sigma.len(), result.mesh.vertices.len());
    assert_eq!(knowledge.provenance.len(), result.mesh.vertices.len());
    assert!(knowledge.sigma.iter().all(|s| s.is_finite() && *s > 0.0));
}

fn cropped<T: Copy>(raster: &Raster<T>, first: usize, cols: usize) -> Raster<T> {
    Raster::from_fn(raster.rows(), cols, |row, col| raster[(row, first + col)])
}

/// The right half of the object leaves the image.
fn half_out_of_view(frame: &Frame) -> Frame {
    let mask = frame.mask.as_ref().expect("simulated with a mask");
    let columns: Vec<usize> = mask.pixels().filter(|(_, _, m)| **m).map(|(_, col, _)| col).collect();
    let middle = (columns.iter().min().expect("seen") + columns.iter().max().expect("seen")) / 2;
    Frame {
        camera: PinholeCamera { width: middle, ..frame.camera },
        depth: cropped(&frame.depth, 0, middle),
        mask: Some(cropped(mask, 0, middle)),
        color: None,
        ..frame.clone()
    }
}

#[test]
fn dropouts_and_three_millimetres_of_noise_still_give_a_closed_mesh() {
    let scene = scene("cylinder", |p| {
        p.camera.dropout = 0.1;
        p.camera.sigma = 3e-3;
    });
    let result = reconstruct(&scene, &params(), &Stages::default()).expect("noise is no error");
    whole(&result);
}

#[test]
fn an_object_half_out_of_view_is_said_to_be_cut() {
    let whole_scene = scene("prism", |_| {});
    let scene = Scene { frame: half_out_of_view(&whole_scene.frame), touches: Vec::new(), ..whole_scene };
    let result = reconstruct(&scene, &params(), &Stages::default()).expect("half an object is no error");
    whole(&result);
    assert!(result.warnings.iter().any(|w| matches!(w, Warning::CutByBorder { share } if *share > 0.01)));
}

#[test]
fn without_a_support_plane_the_bottom_is_said_to_be_guessed() {
    let mut scene = scene("cylinder", |_| {});
    let known = reconstruct(&scene, &params(), &Stages::default()).expect("sound");
    assert!(!known.warnings.contains(&Warning::NoSupport));
    scene.frame.support = None;
    let result = reconstruct(&scene, &params(), &Stages::default()).expect("no support is no error");
    whole(&result);
    assert!(result.warnings.contains(&Warning::NoSupport) && !Warning::NoSupport.is_loss(), "{:?}", result.warnings);
}

#[test]
fn touched_vertices_are_felt_and_surer_than_those_that_nothing_is_known_of() {
    let result = reconstruct(&scene("prism", |_| {}), &params(), &Stages::default()).expect("sound");
    let knowledge = result.knowledge.as_ref().expect("asked for");
    let median = |kind: VertexProvenance| {
        let mut s: Vec<f64> =
            knowledge.sigma.iter().zip(&knowledge.provenance).filter(|(_, p)| **p == kind).map(|(s, _)| *s).collect();
        s.sort_by(f64::total_cmp);
        s.get(s.len() / 2).copied()
    };
    let (felt, seen) = (median(VertexProvenance::Felt), median(VertexProvenance::Seen));
    let unsure = [VertexProvenance::Guessed, VertexProvenance::Extrapolated].into_iter().filter_map(median);
    let unsure = unsure.fold(0.0, f64::max);
    assert!(unsure > 1.5 * felt.expect("four touches"), "{felt:?} {unsure}");
    assert!(unsure > 1.5 * seen.expect("the camera saw it"), "{seen:?} {unsure}");
}

#[test]
fn a_touch_20_mm_off_in_the_open_is_left_out_by_name_and_exact_ones_are_not() {
    let mut scene = scene("prism", |p| p.touch.count = 8);
    let exact = reconstruct(&scene, &params(), &Stages::default()).expect("sound");
    assert!(exact.warnings.iter().all(|w| !matches!(w, Warning::TouchLeftOut { .. })), "{:?}", exact.warnings);
    assert_eq!(exact.touches_used, 8);
    // Towards the camera: into space that it looks through.
    let eye = scene.frame.world_from_camera.translation.vector;
    let pose = &mut scene.touches[3].world_from_sensor;
    pose.translation.vector += (eye - pose.translation.vector).normalize() * 20e-3;
    let result = reconstruct(&scene, &params(), &Stages::default()).expect("a wrong touch is no error");
    let out: Vec<usize> = result
        .warnings
        .iter()
        .filter_map(|w| if let Warning::TouchLeftOut { touch, .. } = w { Some(*touch) } else { None })
        .collect();
    assert_eq!((out, result.touches_used), (vec![3], 7));
    assert!(result.warnings.iter().any(Warning::is_loss));
    assert!(result.touches.iter().all(|t| t.touch != 3));
}

#[test]
fn refined_poses_do_not_depend_on_the_number_of_threads() {
    let scene = scene("prism", |p| {
        p.touch.pose_sigma_translation = 1e-3;
        p.touch.pose_sigma_rotation = 0.03;
    });
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
        pool.install(|| reconstruct(&scene, &params(), &Stages::default()).expect("sound"))
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.touches, three.touches);
    assert_eq!(one.mesh, three.mesh);
    assert!(one.touches.iter().any(|t| t.world_from_sensor != scene.touches[t.touch].world_from_sensor), "none moved");
    assert_eq!(one.knowledge, three.knowledge);
}
