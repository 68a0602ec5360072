//! The object's visible side out of rendered frames whose answer is known.

use palpate::camera::{
    Background, CameraError, DepthNoise, Frame, PinholeCamera, SegmentError, SegmentParams, Visible, segment_object,
};
use palpate::geometry::{Isometry, Plane, Point, Raster, Vector};
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;

const RADIUS: f64 = 0.04;
const SIGMA: f64 = 1e-3;

/// A camera 0.6 m from the world origin, 40° above the table z = 0.
fn camera() -> (PinholeCamera, Isometry) {
    let camera =
        PinholeCamera { width: 320, height: 240, fx: 450.0, fy: 450.0, cx: 159.5, cy: 119.5, distortion: [0.0; 5] };
    let eye = Point::new(0.6 * 40.0_f64.to_radians().cos(), 0.0, 0.6 * 40.0_f64.to_radians().sin());
    // OpenCV's camera looks along +z with y down: look_at of a target with "up" pointing down.
    let camera_from_world = Isometry::look_at_lh(&eye, &Point::origin(), &-Vector::z());
    let flip = camera_from_world.rotation * Vector::z();
    assert!(flip.y < 0.0, "the world's up is up in the image");
    (camera, camera_from_world.inverse())
}

/// Renders balls resting on the table (`x`, `y` of each) with noise; `table` false leaves the rest without a reading.
fn render(balls: &[(f64, f64)], table: bool) -> Frame {
    let (camera, world_from_camera) = camera();
    let (mut rng, noise) = (Pcg64Mcg::seed_from_u64(11), Normal::new(0.0, SIGMA).expect("finite"));
    let eye = world_from_camera * Point::origin();
    let depth = Raster::from_fn(camera.height, camera.width, |row, col| {
        let ray = world_from_camera * camera.ray(col as f64, row as f64);
        let mut z = if table && ray.z < 0.0 { -eye.z / ray.z } else { f64::INFINITY };
        for &(x, y) in balls {
            let to_eye = eye - Point::new(x, y, RADIUS);
            let (a, b, c) = (ray.norm_squared(), ray.dot(&to_eye), to_eye.norm_squared() - RADIUS * RADIUS);
            if b * b > a * c {
                z = z.min((-b - (b * b - a * c).sqrt()) / a);
            }
        }
        if z.is_finite() && z < 3.0 { (z + noise.sample(&mut rng)) as f32 } else { f32::NAN }
    });
    Frame {
        camera,
        world_from_camera,
        depth,
        background: if table { Background::Unknown } else { Background::Absent },
        noise: DepthNoise { sigma: SIGMA, sigma_quadratic: 0.0 },
        color: None,
        mask: None,
        support: None,
    }
}

/// Every point within 2.5 mm of the ball at (x, y), normals within 25° but for few; returns the number of points.
fn assert_ball(frame: &Frame, visible: &Visible, (x, y): (f64, f64)) -> usize {
    let cloud = visible.cloud(frame);
    let normals = cloud.normals.as_ref().expect("normals");
    let center = Point::new(x, y, RADIUS);
    let off: Vec<f64> = cloud.points.iter().map(|p| ((p - center).norm() - RADIUS).abs()).collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    assert!(mean < 4e-4, "mean distance to the ball {mean}");
    assert!(off.iter().filter(|d| **d > 2.5e-3).count() * 100 < off.len(), "points off the ball");
    let skewed = cloud.points.iter().zip(normals).filter(|(p, n)| n.dot(&((*p - center) / RADIUS)) < 0.9).count();
    assert!(skewed * 20 < off.len(), "{skewed} of {} normals skewed", off.len());
    off.len()
}

fn pixels(mask: &Raster<bool>) -> usize {
    mask.as_slice().iter().filter(|m| **m).count()
}

#[test]
fn a_ball_on_a_table_with_nothing_given() {
    let frame = render(&[(0.0, 0.0)], true);
    let visible = segment_object(&frame, &SegmentParams::default()).expect("a ball");
    // π (R f / d)² of a ball whose centre is 0.575 m away: 3080 pixels.
    let count = assert_ball(&frame, &visible, (0.0, 0.0));
    assert!((2700..3150).contains(&count), "{count} points");
    let support = visible.support.expect("a table");
    assert!((support.normal.into_inner() - Vector::z()).norm() < 5e-3, "normal {}", support.normal.into_inner());
    assert!(support.offset.abs() < 1e-3 && visible.border_share == 0.0);
}

#[test]
fn the_result_does_not_depend_on_the_world_frame_being_known() {
    let known = render(&[(0.0, 0.0)], true);
    let camera_frame = Frame { world_from_camera: Isometry::identity(), ..known.clone() };
    let (a, b) = [&known, &camera_frame].map(|f| segment_object(f, &SegmentParams::default()).expect("a ball")).into();
    assert!(pixels(&a.mask).abs_diff(pixels(&b.mask)) < 20);
    let moved = b.support.expect("a table").transformed(&known.world_from_camera);
    assert!((moved.normal.into_inner() - Vector::z()).norm() < 5e-3, "up is the side of the camera");
}

#[test]
fn an_object_alone_in_the_depth_image() {
    let mut frame = render(&[(0.0, 0.0)], false);
    let alone = segment_object(&frame, &SegmentParams::default()).expect("a ball");
    let count = assert_ball(&frame, &alone, (0.0, 0.0));
    assert!(alone.support.is_none());
    frame.support = Plane::new(Vector::z(), &Point::origin());
    frame.mask = Some(frame.depth.map(|z| z.is_finite()));
    let given = segment_object(&frame, &SegmentParams::default()).expect("a ball");
    assert!(given.support == frame.support && Some(&given.mask) == frame.mask.as_ref());
    assert!(assert_ball(&frame, &given, (0.0, 0.0)).abs_diff(count) < 20);
    frame.mask = None;
    let unmasked = segment_object(&frame, &SegmentParams::default()).expect("a ball");
    assert!(
        assert_ball(&frame, &unmasked, (0.0, 0.0)).abs_diff(count) < 20,
        "the foot of a rendered object is no table"
    );
}

#[test]
fn a_mask_that_bleeds_onto_the_table_still_gives_the_ball() {
    let mut frame = render(&[(0.0, 0.0)], true);
    let exact = segment_object(&frame, &SegmentParams::default()).expect("a ball");
    let grown = Raster::from_fn(240, 320, |row, col| {
        (-3..=3).any(|dr| (-3..=3).any(|dc| exact.mask.at(row as isize + dr, col as isize + dc) == Some(&true)))
    });
    frame.mask = Some(grown);
    let visible = segment_object(&frame, &SegmentParams::default()).expect("a ball");
    assert!(visible.support.is_some());
    let cloud = visible.cloud(&frame);
    let off =
        cloud.points.iter().filter(|p| ((*p - Point::new(0.0, 0.0, RADIUS)).norm() - RADIUS).abs() > 4e-3).count();
    assert!(off * 5 < cloud.len(), "{off} of {} points are table", cloud.len());
}

#[test]
fn the_pick_chooses_and_the_centre_is_the_default() {
    let balls = [(0.0, 0.02), (0.0, -0.09)];
    let frame = render(&balls, true);
    let (camera, world_from_camera) = camera();
    let central = segment_object(&frame, &SegmentParams::default()).expect("the central ball");
    assert_ball(&frame, &central, balls[0]);
    let other = world_from_camera.inverse() * Point::new(0.0, -0.09, RADIUS);
    let params = SegmentParams { pick: camera.project(&other), ..SegmentParams::default() };
    let picked = segment_object(&frame, &params).expect("the picked ball");
    assert_ball(&frame, &picked, balls[1]);
    let beside = SegmentParams { pick: Some((20.0, 200.0)), ..SegmentParams::default() };
    assert!(matches!(segment_object(&frame, &beside), Err(SegmentError::PickMissed { u: 20.0, v: 200.0, .. })));
    let outside = SegmentParams { pick: Some((320.0, 10.0)), ..SegmentParams::default() };
    assert!(matches!(segment_object(&frame, &outside), Err(SegmentError::PickOutside { width: 320, height: 240, .. })));
}

#[test]
fn an_object_cut_by_the_border_says_so() {
    let (camera, world_from_camera) = camera();
    let y = (0..200).map(|i| f64::from(i) * 2e-3).find(|&y| {
        let p = world_from_camera.inverse() * Point::new(0.0, y, RADIUS);
        camera.project(&p).is_none_or(|(u, _)| !(5.0..315.0).contains(&u))
    });
    let frame = render(&[(0.0, y.expect("some ball is at the border"))], true);
    let visible = segment_object(&frame, &SegmentParams::default()).expect("half a ball");
    assert!(visible.border_share > 0.2, "border share {}", visible.border_share);
}

#[test]
fn frames_without_an_object_are_errors() {
    let params = SegmentParams::default();
    let empty = render(&[], true);
    let error = segment_object(&empty, &params).expect_err("an empty table");
    assert!(matches!(error, SegmentError::NoObject { needed: 200, .. }), "{error}");
    let blind = Frame { depth: empty.depth.map(|_| f32::NAN), ..empty.clone() };
    let error = segment_object(&blind, &params).expect_err("no reading");
    assert_eq!(error, SegmentError::Camera(CameraError::NoReading { pixels: 320 * 240 }));
    let mut dot = render(&[(0.0, 0.0)], false);
    let few = Raster::from_fn(240, 320, |row, col| row.abs_diff(110) < 4 && col.abs_diff(160) < 4);
    dot.mask = Some(few);
    let error = segment_object(&dot, &params).expect_err("49 pixels");
    assert!(matches!(error, SegmentError::TooFewPoints { found: 49, needed: 200, .. }), "{error}");
    let wrong = SegmentParams { link_pixels: 0, ..params };
    assert!(matches!(segment_object(&empty, &wrong), Err(SegmentError::Params { field: "link_pixels", .. })));
}

#[test]
fn same_bytes_for_any_thread_count() {
    let frame = render(&[(0.0, 0.0)], true);
    let [one, two] = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| segment_object(&frame, &SegmentParams::default()).expect("a ball"))
    });
    let bits = |v: &Visible| v.depth.as_slice().iter().map(|z| z.to_bits()).collect::<Vec<_>>();
    assert!(bits(&one) == bits(&two) && one.normals == two.normals && one.support == two.support);
}
