//! Touches that come one by one: close to a reconstruction with all of them, the very same once settled, and wary.

use palpate::evidence::Evidence;
use palpate::geometry::{Aabb, Bvh, KdTree, Point, Topology, TriangleMesh, Vector};
use palpate::metrics::{CompareParams, SurfaceSamples, TruthReference};
use palpate::pipeline::{
    Followed, Method, ReconstructError, ReconstructParams, Session, Stages, Update, Warning, reconstruct,
};
use palpate::scene::Scene;
use palpate::simulate::{SimulateParams, Solid, TouchParams, TouchReach, simulate_scene};
use palpate::symmetry::{Symmetry, SymmetryEstimator};
use palpate::tactile::Touch;

fn params() -> ReconstructParams {
    let mut params = ReconstructParams::default();
    params.implicit.spacing = 2e-3;
    params.implicit.dense_cells = 30_000;
    params
}

fn solid(name: &str) -> TriangleMesh {
    Solid::named(name).expect("listed").mesh(2e-5, 8e-3)
}

fn scene(mesh: &TriangleMesh, touches: usize) -> Scene {
    let reach = TouchReach::AboveSupport;
    let touch = TouchParams { count: touches, map_width: 60, reach, ..TouchParams::default() };
    simulate_scene("solid", mesh, &SimulateParams { touch, ..SimulateParams::default() }).expect("valid").scene
}

/// A session on the scene without its touches, and these.
fn begin(mut scene: Scene) -> (Session<'static>, Vec<Touch>) {
    let touches = std::mem::take(&mut scene.touches);
    (Session::start(scene, &params(), Stages::default()).expect("it is seen"), touches)
}

fn iou(a: &TriangleMesh, b: &TriangleMesh) -> f64 {
    let params = CompareParams { samples: 2000, ..CompareParams::default() };
    let compared = TruthReference::new(b, &params).expect("a surface").compare(a).expect("another");
    compared.volumetric_iou.expect("both are closed")
}

/// Mean distance of `full` from `mesh` within 3 mm of the points, metres.
fn off_around(points: &[Point], mesh: &TriangleMesh, full: &TriangleMesh) -> f64 {
    let (bvh, near) = (Bvh::new(mesh), KdTree::new(points));
    let samples = SurfaceSamples::draw(full, 20_000, 1).points;
    let close = samples.iter().filter(|p| near.nearest_n(p, 1).iter().any(|n| n.1 < 3e-3));
    let off: Vec<f64> = close.map(|p| bvh.closest_point(p).map_or(f64::INFINITY, |s| s.distance)).collect();
    assert!(off.len() > 100, "{} samples", off.len());
    off.iter().sum::<f64>() / off.len() as f64
}

#[test]
fn followed_touches_agree_with_a_full_reconstruction_and_settle_to_it() {
    let truth = solid("tabbed-box");
    let scene = scene(&truth, 5);
    let full = reconstruct(&scene, &params(), &Stages::default()).expect("it is seen");
    let (mut session, touches) = begin(scene);
    let untouched = session.reconstruction().mesh.clone();
    let updates: Vec<Update> = touches.into_iter().map(|t| session.add_touch(t).expect("taken in")).collect();
    assert!(updates.iter().enumerate().all(|(i, u)| u.touch == i));
    let local = |u: &&Update| matches!(u.followed, Followed::Locally) && !u.changed.is_empty();
    assert!(updates.iter().filter(local).count() >= 3, "{updates:?}");
    assert!(!session.is_settled());
    let followed = session.reconstruction().clone();
    assert!(Topology::of(&followed.mesh).is_closed());
    assert_eq!((followed.touches_used, followed.touches.len()), (5, 5));
    let knowledge = followed.knowledge.as_ref().expect("asked for");
    assert_eq!(knowledge.sigma.len(), followed.mesh.vertices.len());
    // What touches say of places far from them, by symmetries or through the coarse grids, is learnt when it is settled; around them it is followed.
    let (agree, before) = (iou(&followed.mesh, &full.mesh), iou(&untouched, &full.mesh));
    assert!(agree > before + 0.01, "IoU with the full one: {agree}; without touches {before}");
    let felt = &followed.felt.points;
    let (after, before) = (off_around(felt, &followed.mesh, &full.mesh), off_around(felt, &untouched, &full.mesh));
    assert!(after < 0.5 * before, "around the touches {after} m off the full one, {before} before");
    session.settle().expect("as before");
    assert!(session.is_settled() && session.reconstruction().mesh == full.mesh, "settled is the very same");
}

/// The symmetries of another reconstruction.
struct Same(Symmetry);

impl SymmetryEstimator for Same {
    fn estimate(&self, _: &Evidence) -> Symmetry {
        self.0.clone()
    }
}

#[test]
fn one_more_touch_agrees_with_a_full_reconstruction() {
    // Symmetries, corrections of the copies and far sides learn of a touch when it is settled only: here both sides have the same
    // symmetries, and go without the others.
    let mut params = params();
    (params.orbit.correct, params.orbit.far_sides) = (false, false);
    for (name, touches) in [("tabbed-box", 4), ("tabbed-box", 6), ("cylinder", 3)] {
        let scene = scene(&solid(name), touches);
        let full = reconstruct(&scene, &params, &Stages::default()).expect("it is seen");
        let same = Same(full.symmetry);
        let mut known = scene;
        let last = known.touches.pop().expect("there are some");
        let stages = Stages { symmetry: Some(&same), ..Stages::default() };
        let mut session = Session::start(known, &params, stages).expect("it is seen");
        let before = session.reconstruction().mesh.clone();
        let update = session.add_touch(last).expect("taken in");
        assert!(matches!(update.followed, Followed::Locally), "{update:?}");
        let (agree, stale) = (iou(&session.reconstruction().mesh, &full.mesh), iou(&before, &full.mesh));
        assert!(agree > 0.98 && agree >= stale, "{name}: IoU with the full one {agree}, before the touch {stale}");
    }
}

#[test]
fn what_a_touch_does_not_reach_stays_as_it_is() {
    let (mut session, touches) = begin(scene(&solid("tabbed-box"), 4));
    for touch in touches {
        let before = session.reconstruction().mesh.clone();
        let update = session.add_touch(touch).expect("taken in");
        if !matches!(update.followed, Followed::Locally) {
            continue;
        }
        let outside = |p: &&Point| !update.changed.iter().any(|b: &Aabb| b.inflated(1e-9).contains(p));
        let far = |mesh: &TriangleMesh| mesh.vertices.iter().filter(outside).copied().collect::<Vec<_>>();
        assert_eq!(far(&session.reconstruction().mesh), far(&before));
    }
}

#[test]
fn the_same_touches_give_the_same_mesh_whatever_the_number_of_threads() {
    let scene = scene(&solid("cylinder"), 3);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let (mut session, touches) = begin(scene.clone());
            for touch in touches {
                session.add_touch(touch).expect("taken in");
            }
            session.reconstruction().clone()
        })
    };
    let (one, two) = (run(1), run(3));
    assert!(one.mesh == two.mesh && one.knowledge == two.knowledge);
}

#[test]
fn a_touch_that_contradicts_a_symmetry_starts_again() {
    let mut plain = scene(&solid("cube"), 12);
    let camera = plain.frame.world_from_camera.translation.vector;
    let touches = std::mem::take(&mut plain.touches);
    let mut session = Session::start(plain, &params(), Stages::default()).expect("it is seen");
    assert!(!session.reconstruction().symmetry.accepted.is_empty(), "a box has planes");
    // The hidden faces stand 8 mm farther out than the seen ones promise: the same touches, each moved out along its press.
    let hidden = touches.into_iter().filter(|t| {
        let press = t.world_from_sensor * Vector::z();
        press.z.abs() < 0.5 && press.dot(&camera) > 0.0
    });
    let mut followed = Vec::new();
    for mut touch in hidden {
        let press = touch.world_from_sensor * Vector::z();
        touch.world_from_sensor.translation.vector -= press * 8e-3;
        let update = session.add_touch(touch).expect("taken in");
        followed.push(update.followed);
        if matches!(followed.last(), Some(Followed::Contradicted { .. })) {
            assert!(session.is_settled(), "it was started again");
            return;
        }
    }
    panic!("nothing contradicts the planes: {followed:?}");
}

#[test]
fn a_touch_in_the_open_and_an_empty_one_are_left_out() {
    let (mut session, touches) = begin(scene(&solid("tabbed-box"), 2));
    let before = session.reconstruction().mesh.clone();
    let mut open = touches[0].clone();
    open.world_from_sensor.translation.vector += Vector::new(0.0, 0.0, 0.08);
    let mut empty = touches[1].clone();
    empty.contact.as_mut().expect("recorded").mask.as_mut_slice().fill(false);
    for (number, touch) in [open, empty].into_iter().enumerate() {
        let update = session.add_touch(touch).expect("left out");
        assert!(matches!(update.followed, Followed::LeftOut { .. }) && update.touch == number, "{update:?}");
    }
    let left_out = |w: &&Warning| matches!(w, Warning::TouchLeftOut { .. });
    assert_eq!(session.reconstruction().warnings.iter().filter(left_out).count(), 2);
    assert!(session.reconstruction().mesh == before && session.reconstruction().touches_used == 0);
    // It goes on.
    let update = session.add_touch(touches[0].clone()).expect("taken in");
    assert!(matches!(update.followed, Followed::Locally) && update.touch == 2);
}

#[test]
fn what_cannot_be_followed_is_refused_and_a_bad_touch_changes_nothing() {
    let scene = scene(&solid("tabbed-box"), 1);
    let paper = ReconstructParams { method: Method::Paper, ..params() };
    let error = Session::start(scene.clone(), &paper, Stages::default()).err().expect("no field to follow");
    assert!(matches!(error, ReconstructError::NotIncremental) && error.to_string().contains("'fused'"), "{error}");
    let (mut session, touches) = begin(scene);
    let before = session.reconstruction().mesh.clone();
    let nothing = Touch { contact: None, image: None, ..touches[0].clone() };
    let error = session.add_touch(nothing).expect_err("nothing was recorded");
    assert!(matches!(error, ReconstructError::Decode { touch: 0, .. }), "{error}");
    assert!(session.reconstruction().mesh == before);
    assert_eq!(session.add_touch(touches[0].clone()).expect("taken in").touch, 0);
}
