//! Laws that hold for every input: mirrors, lenses, frames and threads.

use super::workshop;
use palpate::camera::PinholeCamera;
use palpate::geometry::{Isometry, Plane, Point, Vector};
use palpate::metrics::{CompareParams, compare};
use proptest::prelude::*;

fn vector(limit: f64) -> impl Strategy<Value = Vector> {
    (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| Vector::new(x, y, z))
}

fn plane() -> impl Strategy<Value = Plane> {
    (vector(1.0), vector(0.5)).prop_filter_map("a direction", |(normal, point)| Plane::new(normal, &Point::from(point)))
}

proptest! {
    #[test]
    fn mirroring_twice_changes_nothing(plane in plane(), p in vector(2.0), v in vector(2.0)) {
        let p = Point::from(p);
        let image = plane.reflect_point(&p);
        prop_assert!((plane.reflect_point(&image) - p).norm() < 1e-12);
        prop_assert!((plane.reflect_vector(&plane.reflect_vector(&v)) - v).norm() < 1e-12);
        prop_assert!((plane.signed_distance(&image) + plane.signed_distance(&p)).abs() < 1e-12);
        prop_assert!((plane.reflect_vector(&v).norm() - v.norm()).abs() < 1e-12);
    }

    #[test]
    fn a_moved_plane_mirrors_moved_points(plane in plane(), p in vector(2.0), t in vector(1.0), r in vector(3.0)) {
        let (p, a_from_b) = (Point::from(p), Isometry::new(t, r));
        let moved = plane.transformed(&a_from_b).reflect_point(&(a_from_b * p));
        prop_assert!((moved - a_from_b * plane.reflect_point(&p)).norm() < 1e-12);
    }

    #[test]
    fn projecting_an_unprojected_pixel_gives_the_pixel(
        u in 0.0..639.0, v in 0.0..479.0, z in 0.2..3.0,
        k1 in -0.1..0.1, k2 in -0.02..0.02, p1 in -0.002..0.002, p2 in -0.002..0.002,
    ) {
        let distortion = [k1, k2, p1, p2, 0.0];
        let camera = PinholeCamera { width: 640, height: 480, fx: 554.3, fy: 551.0, cx: 322.0, cy: 236.5, distortion };
        let (u2, v2) = camera.project(&Point::from(camera.ray(u, v) * z)).expect("it lies in front");
        prop_assert!((u2 - u).hypot(v2 - v) < 1e-5, "({u}, {v}) became ({u2}, {v2})");
    }
}

#[test]
fn a_moved_scene_gives_the_moved_mesh() {
    let made = workshop::tabbed_box(4);
    let new_from_old = Isometry::new(Vector::new(0.4, -0.2, 0.3), Vector::new(0.5, -0.8, 1.1));
    let (scene, plane) = (workshop::moved(&made.scene, &new_from_old), made.plane.transformed(&new_from_old));
    for method in workshop::METHODS {
        let expected = workshop::mesh(method, &made.scene, &made.plane).transformed(&new_from_old);
        let params = CompareParams { samples: 4000, iou_lines: 1000, ..CompareParams::default() };
        let difference = compare(&workshop::mesh(method, &scene, &plane), &expected, &params).expect("both have area");
        // Cells lie along the world's axes, so the vertices are not the same; the surface is, to a quarter of a cell.
        let mean = difference.distances.chamfer_mean_mm;
        assert!(mean < 0.5, "{method:?}: {mean} mm apart");
    }
}

#[test]
fn the_same_bytes_with_one_and_two_threads() {
    let made = workshop::tabbed_box(2);
    for method in workshop::METHODS {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of threads");
            pool.install(|| workshop::mesh(method, &made.scene, &made.plane))
        };
        assert!(with(1) == with(2), "{method:?}");
    }
}
