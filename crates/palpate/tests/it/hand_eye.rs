//! Hand–eye calibration from corners as a camera sees them, with exact truth.

use palpate::calibrate::camera::{Board, BoardView, board_pose};
use palpate::calibrate::sensor_pose::{PoseRecord, calibrate_on_board};
use palpate::camera::PinholeCamera;
use palpate::geometry::{Isometry, Vector};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};

const BOARD: Board = Board { cols: 9, rows: 6, square: 0.025 };
const CAMERA: PinholeCamera = PinholeCamera {
    width: 640,
    height: 480,
    fx: 532.8,
    fy: 533.0,
    cx: 321.8,
    cy: 238.1,
    distortion: [-0.28, 0.04, 0.0011, -0.0003, 0.127],
};

/// Thirty views of a board by a camera in the hand (or of a board in the hand): corners with 0.1 px of noise per axis, the robot with
/// 0.03 mm and 0.003° (its repeatability) per axis.
fn records(truth: &Isometry, in_hand: bool, seed: u64) -> Vec<PoseRecord> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let normal = Normal::new(0.0, 1.0).expect("a sigma of 1");
    let middle = Isometry::translation(-0.1, -0.0625, 0.0);
    let mut records = Vec::new();
    while records.len() < 30 {
        let mut within = |half: f64| rng.random_range(-half..half);
        // The board in front of the camera, tilted to all sides.
        let at = Isometry::translation(within(0.05), within(0.04), 0.42 + within(0.08));
        let camera_from_board =
            at * Isometry::new(Vector::zeros(), Vector::new(within(0.6), within(0.6), within(1.2))) * middle;
        // The board in the base (or, for a standing camera, in the hand).
        let target = Isometry::new(Vector::new(0.5, 0.1, 0.02), Vector::new(0.1, 0.2, 0.7));
        let hand = if in_hand {
            target * camera_from_board.inverse() * truth.inverse()
        } else {
            truth * camera_from_board * target.inverse()
        };
        let corners: Option<Vec<[f64; 2]>> = (0..BOARD.len())
            .map(|i| CAMERA.project(&(camera_from_board * BOARD.point(i))).filter(|&(u, v)| CAMERA.contains(u, v)))
            .map(|p| p.map(|(u, v)| [u, v]))
            .collect();
        let Some(mut corners) = corners else { continue };
        let mut noise = |sigma: f64| sigma * normal.sample(&mut rng);
        corners.iter_mut().flatten().for_each(|v| *v += noise(0.1));
        let shake = Isometry::new(
            Vector::new(noise(3e-5), noise(3e-5), noise(3e-5)),
            Vector::new(noise(5e-5), noise(5e-5), noise(5e-5)),
        );
        let seen = board_pose(&CAMERA, &BOARD, &BoardView { corners }).expect("a board in view");
        records.push(PoseRecord { base_from_hand: hand * shake, camera_from_target: seen.camera_from_board });
    }
    records
}

#[test]
fn a_camera_on_a_robot_is_found_within_a_fifth_of_a_millimetre_and_degree() {
    for in_hand in [true, false] {
        let truth = if in_hand {
            Isometry::new(Vector::new(0.031, -0.052, 0.081), Vector::new(0.1, -0.3, 1.4))
        } else {
            Isometry::new(Vector::new(0.9, 0.1, 0.7), Vector::new(-1.9, 0.4, 0.3))
        };
        let mut worst = (0.0f64, 0.0f64);
        for seed in 0..10 {
            let found = calibrate_on_board(&records(&truth, in_hand, seed), in_hand).expect("good motions");
            let shift = 1e3 * (found.pose.translation.vector - truth.translation.vector).norm();
            let turn = found.pose.rotation.angle_to(&truth.rotation).to_degrees();
            worst = (worst.0.max(shift), worst.1.max(turn));
        }
        println!("in hand {in_hand}: worst of ten {:.3} mm, {:.4}°", worst.0, worst.1);
        assert!(worst.0 < 0.2 && worst.1 < 0.2, "in hand {in_hand}: {worst:?}");
    }
}
