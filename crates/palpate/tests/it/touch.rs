//! The invariant that catches every frame mistake: what touches prove of a solid lies on that solid.

use palpate::geometry::{Point, Vector};
use palpate::simulate::{CameraParams, SimulateParams, Solid, TouchParams, simulate_scene};
use palpate::tactile::{LiftParams, Patch, lift};

/// Patches of all touches of a simulated solid, world frame.
fn patches(name: &str, solid: Solid, sensor: &str, map_width: usize) -> Vec<Patch> {
    let params = SimulateParams {
        // A small image: only the touches are looked at.
        camera: CameraParams { width: 32, height: 24, focal: 20.0, ..CameraParams::default() },
        touch: TouchParams { count: 6, sensor: sensor.to_owned(), map_width, ..TouchParams::default() },
        ..SimulateParams::default()
    };
    let scene = simulate_scene(name, &solid.mesh(3e-6, 4e-3), &params).expect("valid").scene;
    assert_eq!(scene.touches.len(), 6, "{name}: too few touches");
    let sensor = scene.sensor.expect("touches have a sensor");
    let lifted = scene.touches.iter().map(|touch| {
        let contact = touch.contact.as_ref().expect("simulated touches are recorded");
        lift(contact, &sensor, &touch.world_from_sensor, &LiftParams::default()).expect("contact")
    });
    lifted.collect()
}

/// Outward normal by central differences of the signed distance.
fn gradient(solid: Solid, p: &Point) -> Vector {
    let h = 2e-5;
    let d = |e: Vector| solid.signed_distance(&(p + e * h)) - solid.signed_distance(&(p - e * h));
    Vector::new(d(Vector::x()), d(Vector::y()), d(Vector::z())) / (2.0 * h)
}

/// The solid where [`simulate_scene`] places it: its box centred over the origin.
fn placed(solid: Solid, p: &Point) -> Point {
    let c = solid.mesh(1e-3, 1.0).bounds().expect("not empty").center();
    p + Vector::new(c.x, c.y, 0.0)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn check(name: &str, sensor: &str, map_width: usize) {
    let solid = Solid::named(name).expect("listed");
    let (mut distances, mut angles) = (Vec::new(), Vec::new());
    for patch in patches(name, solid, sensor, map_width) {
        for (p, n) in patch.points.iter().zip(&patch.normals) {
            let p = placed(solid, p);
            distances.push(solid.signed_distance(&p).abs());
            angles.push(n.dot(&gradient(solid, &p).normalize()).clamp(-1.0, 1.0).acos().to_degrees());
        }
        for p in &patch.clearance {
            let d = solid.signed_distance(&placed(solid, p));
            assert!(d > -0.1e-3, "{name}, {sensor}: clearance {d} m inside the object");
        }
    }
    let worst = distances.iter().copied().fold(0.0, f64::max);
    let middle = median(&mut distances);
    assert!(distances.len() > 300, "{name}, {sensor}: only {} points", distances.len());
    assert!(middle < 0.02e-3, "{name}, {sensor}: median distance {middle} m");
    assert!(worst < 0.1e-3, "{name}, {sensor}: largest distance {worst} m");
    let angle = median(&mut angles);
    assert!(angle < 1.0, "{name}, {sensor}: median normal error {angle} degrees");
}

#[test]
fn touch_points_lie_on_flat_solids() {
    for name in ["cube", "prism", "pyramid", "bracket", "tabbed-box"] {
        check(name, "ycb-sight", 320);
    }
}

#[test]
fn touch_points_lie_on_curved_solids() {
    for name in ["sphere", "cylinder", "capsule", "torus"] {
        check(name, "ycb-sight", 320);
    }
}

#[test]
fn touch_points_of_flat_gels_and_other_resolutions_lie_on_the_solid() {
    check("capsule", "gelsight-mini", 320);
    check("capsule", "gelsight-r15", 240);
    check("capsule", "digit", 120);
    check("torus", "ycb-sight", 160);
}
