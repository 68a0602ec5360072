//! What the tests of whole reconstructions share: a small simulated scene and the way from it to a mesh.

use palpate::evidence::{Evidence, EvidenceParams};
use palpate::geometry::{Isometry, Plane, Point, TriangleMesh, Vector};
use palpate::pipeline::{Method, ReconstructParams, Stages, Surface, reconstruct};
use palpate::scene::Scene;
use palpate::simulate::{CameraParams, SimulateParams, Solid, TouchParams, simulate_scene};
use palpate::surface::ImplicitParams;
use palpate::symmetry::{Hypothesis, Score, Symmetry, SymmetryElement, SymmetryEstimator};
use palpate::tactile::{LiftParams, Patch, lift};

pub(super) struct Made {
    pub(super) scene: Scene,
    pub(super) truth: TriangleMesh,
    /// The box's mirror plane, to which the tab on its far side does not keep.
    pub(super) plane: Plane,
}

/// A box with a tab that the camera does not see, at a quarter of the usual resolution.
pub(super) fn tabbed_box(touches: usize) -> Made {
    let mesh = Solid::TabbedBox.mesh(1e-4, 0.01);
    let camera = CameraParams { width: 320, height: 240, focal: 400.0, ..CameraParams::default() };
    let simulate = |seed, count| {
        let touch = TouchParams { count, map_width: 160, candidates: 800, ..TouchParams::default() };
        let params = SimulateParams { seed, camera: camera.clone(), touch, ..SimulateParams::default() };
        simulate_scene("tabbed-box", &mesh, &params).expect("the solid is graspable")
    };
    let looks_away_from_the_tab = |seed: &u64| simulate(*seed, 0).scene.frame.world_from_camera.translation.x > 0.5;
    let seed = (0..64).find(looks_away_from_the_tab).expect("one of 64 random views looks along −x");
    let made = simulate(seed, touches);
    // The middle of the box: its extent without the tab.
    let right = made.truth.bounds().expect("a solid has corners").max.x;
    let plane = Plane::new(Vector::x(), &Point::new(right - 0.025, 0.0, 0.0)).expect("x is a direction");
    Made { scene: made.scene, truth: made.truth, plane }
}

/// The scene with its world moved.
pub(super) fn moved(scene: &Scene, new_from_old: &Isometry) -> Scene {
    let mut scene = scene.clone();
    let frame = &mut scene.frame;
    frame.world_from_camera = new_from_old * frame.world_from_camera;
    frame.support = frame.support.map(|plane| plane.transformed(new_from_old));
    for touch in &mut scene.touches {
        touch.world_from_sensor = new_from_old * touch.world_from_sensor;
    }
    scene
}

pub(super) fn patches(scene: &Scene) -> Vec<Patch> {
    let sensor = scene.sensor.as_ref();
    let lifted = scene.touches.iter().map(|touch| {
        let contact = touch.contact.as_ref().expect("simulated touches are recorded");
        let sensor = sensor.expect("a scene with touches has a sensor");
        lift(contact, sensor, &touch.world_from_sensor, &LiftParams::default()).expect("the contact is sound")
    });
    lifted.collect()
}

/// An estimator that is told the answer, so that these tests are about what is done with it.
struct Told(Plane);

impl SymmetryEstimator for Told {
    fn estimate(&self, _: &Evidence) -> Symmetry {
        let score = Score { support: 0.5, informative: 0.5, ..Score::default() };
        let element = SymmetryElement::Reflection(self.0);
        let told = Hypothesis { element, score, confidence: 1.0, covariance: None, rejection: None };
        Symmetry { accepted: vec![told], rejected: Vec::new() }
    }
}

pub(super) const METHODS: [Method; 2] = [Method::Paper, Method::Fused];

/// The mesh by a method that takes the object to be symmetric in `plane`, coarse enough to be quick.
pub(super) fn mesh(method: Method, scene: &Scene, plane: &Plane) -> TriangleMesh {
    let params = ReconstructParams {
        method,
        surface: (method == Method::Paper).then_some(Surface::BallPivoting),
        evidence: EvidenceParams { grid_cells: 60, ..EvidenceParams::default() },
        implicit: ImplicitParams { spacing: 2e-3, dense_cells: 30_000, ..ImplicitParams::default() },
        ..ReconstructParams::default()
    };
    let told = Told(*plane);
    let stages = Stages { symmetry: Some(&told), ..Stages::default() };
    reconstruct(scene, &params, &stages).expect("the object is seen").mesh
}
