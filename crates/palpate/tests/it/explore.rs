//! Where to touch next: only reachable poses, gains in order, the same answer twice, and errors that say what is wrong.

use palpate::explore::{
    ApproachCone, ExploreError, ExploreParams, HalfSpace, NextTouchParams, Planner, Policy, Reach, Trial, Workspace,
    next_touches,
};
use palpate::geometry::{Point, TriangleMesh, Vector};
use palpate::metrics::CompareParams;
use palpate::pipeline::{Stages, reconstruct};
use palpate::scene::Scene;
use palpate::simulate::{SimulateParams, Solid, TouchParams, simulate_scene};

fn block() -> TriangleMesh {
    Solid::named("tabbed-box").expect("listed").mesh(2e-5, 8e-3)
}

fn scene() -> Scene {
    let params =
        SimulateParams { touch: TouchParams { count: 1, map_width: 40, ..Default::default() }, ..Default::default() };
    simulate_scene("block", &block(), &params).expect("valid").scene
}

fn plan(count: usize) -> NextTouchParams {
    let mut params = NextTouchParams { count, candidates: 30, ..Default::default() };
    params.reconstruct.implicit.spacing = 4e-3;
    params.reconstruct.implicit.dense_cells = 10_000;
    params
}

fn message(scene: &Scene, params: &NextTouchParams) -> String {
    next_touches(scene, params, &Stages::default()).expect_err("refused").to_string()
}

#[test]
fn proposals_are_reachable_in_order_of_gain_and_the_same_twice() {
    let (scene, params) = (scene(), plan(4));
    let touches = next_touches(&scene, &params, &Stages::default()).expect("a block on a table");
    assert_eq!(touches.len(), 4);
    let (w, h) = scene.sensor.as_ref().expect("there is one").pad_size();
    for touch in &touches {
        for (x, y, z) in [-0.5, 0.5]
            .iter()
            .flat_map(|x| [-0.5, 0.5].iter().flat_map(move |y| [-params.approach, 0.0].map(|z| (x * w, y * h, z))))
        {
            let corner = touch.world_from_sensor() * Point::new(x, y, z);
            assert!(corner.z >= -1e-9, "a corner of the fingertip lies at {corner}");
        }
        // The press goes against the surface, and the expected contact is where it aims.
        assert!((touch.world_from_sensor() * Vector::z()).dot(&touch.candidate.normal) < -0.99);
        assert!(touch.candidate.footprint.iter().all(|p| (p - touch.candidate.point).norm() < 0.02));
        assert!(!touch.why().is_empty());
    }
    let gains: Vec<f64> = touches.iter().map(|t| t.gain.mean_distance).collect();
    assert!(gains.iter().all(|g| *g > 0.0) && gains.windows(2).all(|g| g[0] >= g[1]), "{gains:?}");
    let again = next_touches(&scene, &params, &Stages::default()).expect("the same");
    for (a, b) in touches.iter().zip(&again) {
        assert_eq!((a.world_from_sensor(), a.gain), (b.world_from_sensor(), b.gain));
    }
    // What was chosen first is taken as known: no second touch in its place.
    for (i, a) in touches.iter().enumerate() {
        assert!(touches[..i].iter().all(|b| (a.candidate.point - b.candidate.point).norm() > 0.5 * h.min(w)));
    }
}

#[test]
fn the_hidden_side_is_proposed_before_the_seen_one() {
    let scene = scene();
    let best = &next_touches(&scene, &plan(1), &Stages::default()).expect("a block on a table")[0];
    let view = scene.frame.world_from_camera.translation.vector - best.candidate.point.coords;
    assert!(best.candidate.normal.dot(&view.normalize()) < 0.3, "the first touch is on the side that is seen");
}

#[test]
fn the_reach_is_kept() {
    let scene = scene();
    let mut params = plan(3);
    params.reach = Reach {
        approach: Some(ApproachCone { direction: [0.0, 0.0, -1.0], max_angle_deg: 60.0 }),
        keep_in: vec![HalfSpace { normal: [0.0, 2.0, 0.0], offset: -0.05 }],
        ..Reach::default()
    };
    for touch in next_touches(&scene, &params, &Stages::default()).expect("from above") {
        let press = touch.world_from_sensor() * Vector::z();
        assert!(-press.z >= 60.0f64.to_radians().cos() - 1e-9, "{press}");
        assert!((touch.world_from_sensor() * Point::origin()).y >= -0.05);
    }
    params.reach.workspace = Some(Workspace { min: [5.0, 5.0, 5.0], max: [6.0, 6.0, 6.0] });
    let said = message(&scene, &params);
    assert!(said.starts_with("no reachable pose") && said.contains("are out of reach"), "{said}");
}

#[test]
fn bad_parameters_name_the_field_the_value_and_the_rule() {
    let scene = scene();
    assert_eq!(message(&scene, &plan(0)), "count is 0; it must be at least 1");
    let with = |reach: Reach| message(&scene, &NextTouchParams { reach, ..plan(1) });
    let cone = ApproachCone { direction: [0.0; 3], max_angle_deg: 60.0 };
    assert!(with(Reach { approach: Some(cone), ..Reach::default() }).contains("reach.approach.direction is 0"));
    let cone = ApproachCone { direction: [0.0, 0.0, 1.0], max_angle_deg: f64::NAN };
    assert!(with(Reach { approach: Some(cone), ..Reach::default() }).contains("max_angle_deg is NaN"));
    assert!(with(Reach { support_clearance: -1.0, ..Reach::default() }).contains("reach.support_clearance is -1"));
    let half = HalfSpace { normal: [f64::INFINITY, 0.0, 0.0], offset: 0.0 };
    assert!(with(Reach { keep_in: vec![half], ..Reach::default() }).contains("reach.keep_in"));
    let turned = Workspace { min: [1.0; 3], max: [0.0; 3] };
    assert!(with(Reach { workspace: Some(turned), ..Reach::default() }).contains("reach.workspace is 1"));
    let mut params = plan(1);
    params.belief.growth = f64::NAN;
    assert!(message(&scene, &params).contains("belief.growth is NaN"));
}

#[test]
fn without_a_support_plane_it_must_be_stated() {
    let mut scene = scene();
    scene.frame.support = None;
    let error = next_touches(&scene, &plan(1), &Stages::default()).expect_err("no plane is stated or seen");
    assert!(matches!(error, ExploreError::NoSupport), "{error}");
    for reach in [
        Reach { no_support: true, ..Reach::default() },
        Reach { support: Some(HalfSpace { normal: [0.0, 0.0, 1.0], offset: 0.0 }), ..Reach::default() },
    ] {
        let params = NextTouchParams { reach, ..plan(1) };
        assert_eq!(next_touches(&scene, &params, &Stages::default()).expect("stated").len(), 1);
    }
}

#[test]
fn a_guarded_move_finds_the_surface_or_misses() {
    let (scene, params) = (scene(), plan(1));
    let planner = Planner::new(&scene, &params).expect("a block on a table");
    let mesh = reconstruct(&scene, &params.reconstruct, &Stages::default()).expect("a block").mesh;
    let candidates = planner.candidates(&mesh, 6, 1, &[]).expect("six places");
    let shifted = |by: f64| {
        let c = &candidates[0];
        let by = -c.normal * by;
        mesh.transformed(&palpate::geometry::Isometry::translation(by.x, by.y, by.z))
    };
    // The surface lies 8 mm before or behind the place aimed at: the move stops there.
    for by in [-8e-3, 8e-3] {
        let pressed = planner.guarded_press(&shifted(by), &candidates[0], 40).expect("within the approach");
        let travelled =
            (pressed.world_from_sensor.translation.vector - candidates[0].point.coords).dot(&-candidates[0].normal);
        assert!((travelled - by - params.press.depth).abs() < 1.5e-3, "{by}: {travelled}");
    }
    assert!(planner.guarded_press(&shifted(0.5), &candidates[0], 40).is_err(), "nothing is there");
    // What was missed is not offered again.
    let missed: Vec<Point> = candidates.iter().map(|c| c.point).collect();
    let other = planner.candidates(&mesh, 6, 1, &missed).expect("other places");
    assert!(other.iter().all(|o| missed.iter().all(|m| (o.point - m).norm() > 5e-3)));
}

fn trial_params() -> ExploreParams {
    let mut params = ExploreParams {
        touches: 1,
        map_width: 40,
        plan: NextTouchParams { candidates: 4, ..plan(1) },
        compare: CompareParams { samples: 2000, iou_lines: 1024, ..CompareParams::default() },
        ..ExploreParams::default()
    };
    params.plan.belief.rejected = 0;
    params
}

#[test]
fn all_policies_start_alike_and_none_beats_the_oracle_by_one_touch() {
    let (mesh, params) = (block(), trial_params());
    let trial = Trial::new("block", &mesh, &params).expect("closed");
    let runs: Vec<_> = Policy::ALL.iter().map(|p| trial.run(*p, &|| ()).expect("it plays")).collect();
    let error = |run: usize, step: usize| runs[run][step].comparison.distances.chamfer_mean_mm;
    for run in 0..4 {
        assert_eq!(runs[run].len(), 2);
        assert_eq!(error(run, 0).to_bits(), error(0, 0).to_bits());
        // The same candidates are offered in the first step.
        assert!(error(run, 1) >= error(3, 1), "policy {} is better than trying them all", Policy::ALL[run].name());
        assert_eq!(runs[run][1].touches, 1);
    }
    let again = trial.run(Policy::NextBest, &|| ()).expect("the same");
    assert_eq!(again[1].comparison, runs[0][1].comparison);
    assert_eq!(again[1].world_from_sensor, runs[0][1].world_from_sensor);
}

#[test]
fn open_meshes_and_no_touches_are_refused() {
    let mut open = block();
    open.faces.pop();
    let params = trial_params();
    let said = Trial::new("lid", &open, &params).err().expect("open").to_string();
    assert!(said.starts_with("mesh 'lid' is not closed (3 boundary edges)"), "{said}");
    let none = ExploreParams { touches: 0, ..trial_params() };
    assert!(Trial::new("block", &block(), &none).err().expect("none").to_string().starts_with("touches is 0"));
}
