//! Boards drawn with a known camera: what calibration finds must be what they were drawn with.

use palpate::calibrate::camera::{
    Board, BoardError, BoardSearch, BoardView, CalibrationError, Fixed, Outliers, calibrate_camera, find_board,
    paired_extrinsics,
};
use palpate::camera::PinholeCamera;
use palpate::geometry::{Isometry, Raster, Vector};
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};

const BOARD: Board = Board { cols: 8, rows: 5, square: 0.03 };

fn camera() -> PinholeCamera {
    let distortion = [-0.21, 0.09, 0.0012, -0.0008, -0.02];
    PinholeCamera { width: 400, height: 300, fx: 361.0, fy: 358.5, cx: 204.3, cy: 146.2, distortion }
}

/// How a picture is spoilt.
#[derive(Clone, Copy)]
struct Look {
    dark: f64,
    bright: f64,
    /// Standard deviations: blur in pixels, noise in grey levels.
    blur: f64,
    noise: f64,
    /// Share of the outer squares that is left where the board is cut; white paper goes on for 0.4 squares where it is 1.
    outer: f64,
}

const CLEAR: Look = Look { dark: 40.0, bright: 210.0, blur: 0.6, noise: 2.0, outer: 1.0 };

/// The board on a grey table, three by three rays a pixel.
fn picture(board: &Board, camera: &PinholeCamera, camera_from_board: &Isometry, look: Look, seed: u64) -> Raster<f32> {
    let board_from_camera = camera_from_board.inverse();
    let (w, h) = ((board.cols + 1) as f64 * board.square, (board.rows + 1) as f64 * board.square);
    let shade = |u: f64, v: f64| {
        let ray = board_from_camera.rotation * camera.ray(u, v);
        let origin = board_from_camera.translation.vector;
        let t = -origin.z / ray.z;
        let (x, y) = (origin.x + t * ray.x + board.square, origin.y + t * ray.y + board.square);
        let margin = if look.outer < 1.0 { (look.outer - 1.0) * board.square } else { 0.4 * board.square };
        if t < 0.0 || x < -margin || y < -margin || x > w + margin || y > h + margin {
            return 0.5 * (look.dark + look.bright);
        }
        // The square of the first corner, towards the others, is column 1 and row 1: dark.
        let dark = ((x / board.square).floor() + (y / board.square).floor()).rem_euclid(2.0) == 0.0;
        let inside = x >= 0.0 && y >= 0.0 && x < w && y < h;
        if inside && dark { look.dark } else { look.bright }
    };
    let sharp = Raster::par_from_fn(camera.height, camera.width, |row, col| {
        let part = |i: usize| (i as f64 - 1.0) / 3.0;
        (0..9).map(|i| shade(col as f64 + part(i % 3), row as f64 + part(i / 3))).sum::<f64>() / 9.0
    });
    let reach = (3.0 * look.blur).ceil() as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / look.blur).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let pass = |image: &Raster<f64>, down: bool| {
        Raster::par_from_fn(camera.height, camera.width, |row, col| {
            let clamp =
                |i: usize, k: usize, n: usize| (i as isize + k as isize - reach).clamp(0, n as isize - 1) as usize;
            let at = |k| if down { (clamp(row, k, camera.height), col) } else { (row, clamp(col, k, camera.width)) };
            weights.iter().enumerate().map(|(k, w)| w * image[at(k)]).sum::<f64>() / total
        })
    };
    let blurred = pass(&pass(&sharp, false), true);
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let normal = Normal::new(0.0, look.noise).expect("a sigma");
    blurred.map(|v| (v + normal.sample(&mut rng)).round().clamp(0.0, 255.0) as f32)
}

/// Poses of the board over a camera: its middle at a place in front, tilted about both axes and turned.
fn pose(board: &Board, [x, y, z]: [f64; 3], tilt: [f64; 3]) -> Isometry {
    let middle =
        Vector::new(0.5 * (board.cols - 1) as f64 * board.square, 0.5 * (board.rows - 1) as f64 * board.square, 0.0);
    let turned = Isometry::new(Vector::zeros(), Vector::from(tilt));
    Isometry::translation(x, y, z) * turned * Isometry::translation(-middle.x, -middle.y, 0.0)
}

fn poses() -> Vec<Isometry> {
    [
        ([0.0, 0.0, 0.5], [0.0, 0.0, 0.0]),
        ([0.05, 0.03, 0.5], [0.5, 0.1, 0.1]),
        ([-0.06, 0.03, 0.5], [-0.5, 0.2, -0.2]),
        ([0.05, -0.04, 0.45], [0.1, 0.55, 0.3]),
        ([-0.05, -0.04, 0.45], [0.0, -0.55, 0.0]),
        ([0.02, 0.03, 0.42], [0.4, 0.4, 1.4]),
        ([-0.08, 0.05, 0.5], [-0.4, 0.4, 3.0]),
        // Into the corners of the image, where the lens bends most.
        ([0.10, 0.085, 0.42], [0.3, -0.3, 0.0]),
        ([-0.10, 0.085, 0.42], [0.3, 0.3, 0.05]),
        ([0.10, -0.085, 0.42], [-0.3, -0.3, -0.05]),
        ([-0.10, -0.085, 0.42], [-0.3, 0.3, 3.1]),
    ]
    .map(|(at, tilt)| pose(&BOARD, at, tilt))
    .to_vec()
}

/// Largest distance of a view's corners to where they were drawn.
fn worst(view: &BoardView, board: &Board, camera: &PinholeCamera, camera_from_board: &Isometry) -> f64 {
    let off = (0..board.len()).map(|i| {
        let (u, v) = camera.project(&(camera_from_board * board.point(i))).expect("in front");
        (view.corners[i][0] - u).hypot(view.corners[i][1] - v)
    });
    off.fold(0.0, f64::max)
}

fn find(image: &Raster<f32>) -> BoardView {
    find_board(image, &BOARD, &BoardSearch::default()).expect("a board in view")
}

#[test]
fn drawn_boards_give_the_camera_that_drew_them() {
    let camera = camera();
    let mut views = Vec::new();
    for (i, pose) in poses().iter().enumerate() {
        let view = find(&picture(&BOARD, &camera, pose, CLEAR, i as u64));
        let off = worst(&view, &BOARD, &camera, pose);
        // Also says that the first corner is the first, whatever the turn. Bent edges pull the corners at the lens's rim.
        assert!(off < 0.4, "view {i}: {off} px");
        views.push(view);
    }
    let found =
        calibrate_camera(&BOARD, &views, (400, 300), Fixed::default(), None, Outliers::Keep).expect("tilted views");
    println!("rms {:.3} px, {:?}, {:?}", found.rms, found.camera, found.sigma);
    let pairs = [
        (found.camera.fx, camera.fx, found.sigma.fx),
        (found.camera.fy, camera.fy, found.sigma.fy),
        (found.camera.cx, camera.cx, found.sigma.cx),
        (found.camera.cy, camera.cy, found.sigma.cy),
    ];
    for (ours, truth, sigma) in pairs {
        assert!((ours - truth).abs() < 0.01 * truth && (ours - truth).abs() < 5.0 * sigma, "{ours} {truth} ± {sigma}");
    }
    assert!(found.rms < 0.12, "{}", found.rms);
}

#[test]
fn dim_noisy_and_blurred_boards_are_found() {
    let camera = camera();
    let looks = [
        // Infrared with the projector covered: dark, noisy.
        Look { dark: 6.0, bright: 30.0, blur: 0.8, noise: 3.0, ..CLEAR },
        Look { dark: 60.0, bright: 90.0, blur: 1.0, noise: 4.0, ..CLEAR },
        Look { blur: 2.5, noise: 3.0, ..CLEAR },
    ];
    for (i, look) in looks.into_iter().enumerate() {
        for (j, pose) in poses().iter().enumerate().step_by(3) {
            let image = picture(&BOARD, &camera, pose, look, j as u64);
            let view = find_board(&image, &BOARD, &BoardSearch::default())
                .unwrap_or_else(|e| panic!("look {i}, view {j}: {e}"));
            let off = worst(&view, &BOARD, &camera, pose);
            assert!(off < 1.5, "look {i}, view {j}: {off} px");
        }
    }
}

/// As OpenCV's sample board: the outer squares are cut to half. A window of fixed size reaches over the edge and takes it for the corner.
#[test]
fn the_edge_of_a_board_does_not_pull_its_outer_corners() {
    let camera = camera();
    let cut = Look { outer: 0.55, ..CLEAR };
    let mut fixed_is_worse = 0;
    for (i, pose) in poses().iter().enumerate().take(7) {
        let image = picture(&BOARD, &camera, pose, cut, i as u64);
        let off = worst(&find(&image), &BOARD, &camera, pose);
        assert!(off < 0.3, "view {i}: {off} px");
        let fixed = find_board(&image, &BOARD, &BoardSearch { window: Some(11) }).expect("a board in view");
        fixed_is_worse += usize::from(worst(&fixed, &BOARD, &camera, pose) > 2.0 * off);
    }
    assert!(fixed_is_worse >= 5, "only in {fixed_is_worse} of 7 views does a window of 11 px reach the edge");
}

/// Where the outer squares are cut to half, the ends of the dark ones along the edge look like corners: they are none, as nothing follows them.
#[test]
fn the_edge_of_a_cut_board_is_no_row_of_corners() {
    let camera = camera();
    // A search that finds nothing tries everything: three views are enough.
    for outer in [0.45, 0.55] {
        for (i, pose) in poses().iter().enumerate().step_by(5) {
            let image = picture(&BOARD, &camera, pose, Look { outer, ..CLEAR }, i as u64);
            find(&image);
            for (cols, rows) in [(8, 6), (9, 5)] {
                let found = find_board(&image, &Board { cols, rows, ..BOARD }, &BoardSearch::default());
                let error = found.map(drop).expect_err("a line too many");
                let known = matches!(error, BoardError::Edge { .. } | BoardError::NotFound { .. });
                assert!(known, "{outer}, view {i}: {error}");
            }
        }
    }
}

#[test]
fn what_is_no_board_or_another_one_says_so() {
    let camera = camera();
    let image = picture(&BOARD, &camera, &poses()[0], CLEAR, 0);
    let search = BoardSearch::default();
    let fail = |image: &Raster<f32>, board: Board| find_board(image, &board, &search).expect_err("not that board");
    let larger = fail(&image, Board { cols: 9, rows: 6, ..BOARD }).to_string();
    assert!(larger.contains("no board of 9×6 inner corners") && larger.contains("has 8×5"), "{larger}");
    let smaller = fail(&image, Board { cols: 6, rows: 5, ..BOARD });
    assert!(matches!(smaller, BoardError::Larger { found: (7.., 5), .. }), "{smaller}");
    let flat = fail(&Raster::filled(300, 400, 90.0), BOARD);
    assert!(matches!(flat, BoardError::NoContrast { .. }), "{flat}");
    let none = fail(&Raster::filled(300, 400, f32::NAN), BOARD);
    assert!(matches!(none, BoardError::NoContrast { .. }), "{none}");
    assert!(matches!(fail(&Raster::filled(8, 8, 0.0), BOARD), BoardError::Size { .. }));
    assert!(matches!(fail(&image, Board { square: 25.0, ..BOARD }), BoardError::Description { field: "square", .. }));
    assert!(matches!(fail(&image, Board { cols: 2, ..BOARD }), BoardError::Description { field: "columns", .. }));
    let mut state = 7u32;
    let noise = Raster::from_fn(300, 400, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as f32
    });
    assert!(matches!(fail(&noise, BOARD), BoardError::NotFound { .. }));
    // Cut by the border.
    let out = pose(&BOARD, [0.2, 0.0, 0.5], [0.0; 3]);
    assert!(matches!(fail(&picture(&BOARD, &camera, &out, CLEAR, 1), BOARD), BoardError::NotFound { .. }));
}

/// Exact corners.
fn ideal(camera: &PinholeCamera, camera_from_board: &Isometry) -> BoardView {
    let corner = |i: usize| camera.project(&(camera_from_board * BOARD.point(i))).expect("in front");
    BoardView { corners: (0..BOARD.len()).map(corner).map(|(u, v)| [u, v]).collect() }
}

fn calibrated(views: &[BoardView], fixed: Fixed, outliers: Outliers) -> Result<PinholeCamera, CalibrationError> {
    calibrate_camera(&BOARD, views, (400, 300), fixed, None, outliers).map(|c| c.camera)
}

#[test]
fn exact_corners_give_the_exact_camera() {
    let views: Vec<BoardView> = poses().iter().map(|p| ideal(&camera(), p)).collect();
    let found = calibrated(&views, Fixed::default(), Outliers::Keep).expect("tilted views");
    assert!((found.fx - camera().fx).abs() < 1e-4 && (found.cy - camera().cy).abs() < 1e-4, "{found:?}");
    (0..5).for_each(|i| assert!((found.distortion[i] - camera().distortion[i]).abs() < 1e-5, "{found:?}"));
}

#[test]
fn views_that_do_not_determine_the_camera_are_errors() {
    let keep = |views: &[BoardView]| calibrated(views, Fixed::default(), Outliers::Keep).expect_err("not determined");
    let one = ideal(&camera(), &poses()[1]);
    let few = keep(std::slice::from_ref(&one)).to_string();
    assert!(few.contains("1 different views of the board (0 repeat others); at least 3"), "{few}");
    let repeated = keep(&vec![one.clone(); 6]).to_string();
    assert!(repeated.contains("1 different views of the board (5 repeat others)"), "{repeated}");
    // Shifted, nearer and farther, turned in their plane, but never tilted; noise as real corners have.
    let mut rng = rand_pcg::Pcg64::seed_from_u64(3);
    let noise = Normal::new(0.0, 0.1).expect("a sigma");
    let mut noisy = |mut view: BoardView| {
        view.corners.iter_mut().flatten().for_each(|v| *v += noise.sample(&mut rng));
        view
    };
    let parallel: Vec<BoardView> = (0..8)
        .map(|i| {
            let f = f64::from(i);
            let at = [0.01 * f - 0.04, 0.03 - 0.008 * f, 0.45 + 0.02 * f];
            noisy(ideal(&camera(), &pose(&BOARD, at, [0.01 * f, 0.3, 0.2 * f])))
        })
        .collect();
    let parallel_error = keep(&parallel);
    assert!(matches!(parallel_error, CalibrationError::IllConditioned { .. }), "{parallel_error}");
    let frontal: Vec<BoardView> = (0..8)
        .map(|i| {
            noisy(ideal(
                &camera(),
                &pose(&BOARD, [0.01 * f64::from(i) - 0.04, 0.0, 0.5], [0.0, 0.01 * f64::from(i), 0.0]),
            ))
        })
        .collect();
    let frontal_error = keep(&frontal);
    assert!(matches!(frontal_error, CalibrationError::IllConditioned { .. }), "{frontal_error}");
    let short = BoardView { corners: one.corners[..7].to_vec() };
    assert_eq!(keep(&[one, short]), CalibrationError::Corners { view: 1, found: 7, needed: 40 });
}

/// Corners with noise of so many pixels.
fn noisy(view: BoardView, sigma: f64, rng: &mut rand_pcg::Pcg64) -> BoardView {
    let noise = Normal::new(0.0, sigma).expect("a sigma");
    let moved = |c: [f64; 2]| c.map(|v| v + noise.sample(rng));
    BoardView { corners: view.corners.into_iter().map(moved).collect() }
}

/// Four tilted boards near the middle of the image tell the camera, but not k3: left free it runs off until the lens folds the image's corners
/// over, and the whole set would be refused.
#[test]
fn views_that_do_not_tell_k3_are_used_without_it() {
    let mut kept = 0;
    for seed in 0..30 {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let views: Vec<BoardView> = poses()[1..5].iter().map(|p| noisy(ideal(&camera(), p), 0.2, &mut rng)).collect();
        let found = calibrate_camera(&BOARD, &views, (400, 300), Fixed::default(), None, Outliers::Keep);
        let found = found.unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        found.camera.validate().expect("usable all over the image");
        assert!((found.camera.fx / camera().fx - 1.0).abs() < 0.02, "seed {seed}: {:?}", found.camera);
        if found.kept_k3 {
            kept += 1;
            assert_eq!((found.camera.distortion[4], found.sigma.distortion[4]), (0.0, 0.0));
            let fixed = Fixed { k3: true, ..Fixed::default() };
            let by_hand = calibrate_camera(&BOARD, &views, (400, 300), fixed, None, Outliers::Keep).expect("the same");
            assert!(by_hand.camera == found.camera && !by_hand.kept_k3);
        }
    }
    println!("k3 was kept in {kept} of 30 sets");
    assert!(kept >= 3, "{kept}");
}

/// Of parallel boards the lens found folds as well; what is to be done is to tilt them.
#[test]
fn nearly_parallel_boards_are_called_so_whatever_lens_they_give() {
    for tilt in [1.0f64, 4.0] {
        for seed in 0..10 {
            let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
            let views: Vec<BoardView> = (0..5)
                .map(|i| {
                    let f = f64::from(i) - 2.0;
                    let turns = [0.2 * tilt.to_radians() * f, -0.1 * tilt.to_radians() * f, 0.02 * f];
                    let at = [0.03 * f, 0.02 * f, 0.45 + 0.02 * f];
                    noisy(ideal(&camera(), &pose(&BOARD, at, turns)), 0.15, &mut rng)
                })
                .collect();
            let error = calibrated(&views, Fixed::default(), Outliers::Keep).expect_err("parallel");
            assert!(matches!(error, CalibrationError::IllConditioned { .. }), "{tilt}°, seed {seed}: {error}");
        }
    }
}

#[test]
fn an_outlier_is_named_and_can_be_dropped() {
    let mut views: Vec<BoardView> = poses().iter().map(|p| ideal(&camera(), p)).collect();
    // A picture taken while the board moved: sheared.
    views[3].corners.iter_mut().for_each(|c| c[0] += 0.04 * c[1]);
    views[3].corners[7][1] += 6.0;
    let run = |outliers| {
        calibrate_camera(&BOARD, &views, (400, 300), Fixed::default(), None, outliers).expect("the others are good")
    };
    let kept = run(Outliers::Keep);
    assert!(kept.views[3].outlier && kept.views[3].used && kept.rms > 0.2, "{kept:?}");
    let dropped = run(Outliers::Drop);
    assert!(!dropped.views[3].used && dropped.rms < 1e-3, "{}", dropped.rms);
    assert!((dropped.camera.fx - camera().fx).abs() < 0.01);
}

#[test]
fn fixed_parameters_keep_their_values() {
    let simple = PinholeCamera { fy: 361.0, cx: 199.5, cy: 149.5, distortion: [-0.2, 0.0, 0.0, 0.0, 0.0], ..camera() };
    let views: Vec<BoardView> = poses().iter().map(|p| ideal(&simple, p)).collect();
    let fixed = Fixed { aspect: true, principal_point: true, k2: true, tangential: true, k3: true, ..Fixed::default() };
    let found = calibrated(&views, fixed, Outliers::Keep).expect("tilted views");
    assert_eq!(found.fx, found.fy);
    assert_eq!((found.cx, found.cy), (199.5, 149.5));
    assert_eq!(found.distortion[1..], [0.0; 4]);
    assert!((found.fx - 361.0).abs() < 1e-3 && (found.distortion[0] + 0.2).abs() < 1e-5, "{found:?}");
}

#[test]
fn boards_seen_by_two_cameras_give_their_mounting() {
    let color = PinholeCamera { fx: 390.0, fy: 391.0, distortion: [0.1, -0.2, 0.0, 0.001, 0.0], ..camera() };
    let mounting = Isometry::new(Vector::new(-0.025, 0.001, 0.003), Vector::new(0.01, 0.02, -0.005));
    let mut rng = rand_pcg::Pcg64::seed_from_u64(5);
    let noise = Normal::new(0.0, 0.1).expect("a sigma");
    let mut noisy = |mut view: BoardView| {
        view.corners.iter_mut().flatten().for_each(|v| *v += noise.sample(&mut rng));
        view
    };
    let first: Vec<BoardView> = poses().iter().map(|p| noisy(ideal(&camera(), p))).collect();
    let second: Vec<BoardView> = poses().iter().map(|p| noisy(ideal(&color, &(mounting * p)))).collect();
    let found = paired_extrinsics(&BOARD, [&camera(), &color], &first, &second).expect("eleven pairs");
    let off = (found.second_from_first.translation.vector - mounting.translation.vector).norm();
    let turn = found.second_from_first.rotation.angle_to(&mounting.rotation).to_degrees();
    println!("{:.3} mm, {turn:.4}°, sigma {:?}", 1e3 * off, found.sigma);
    assert!(off < 3e-4 && turn < 0.05, "{off} {turn}");
    let predicted = found.sigma.0.iter().map(|s| s * s).sum::<f64>().sqrt();
    assert!(off < 5.0 * predicted, "{off} ± {predicted}");
    let unpaired = paired_extrinsics(&BOARD, [&camera(), &color], &first, &second[1..]).expect_err("one is missing");
    assert_eq!(unpaired, CalibrationError::Unpaired { first: 11, second: 10 });
    assert!(found.apart.iter().all(|apart| !apart), "{:?}", found.pair_rms);
    // Each with the next one's partner; two exchanged; a board that moved by a few pixels in between.
    let shifted = [&second[1..], &second[..1]].concat();
    let error = paired_extrinsics(&BOARD, [&camera(), &color], &first, &shifted).expect_err("not one fits");
    assert!(matches!(error, CalibrationError::PairsDisagree { pairs: 11, .. }), "{error}");
    let mut exchanged = second.clone();
    exchanged.swap(2, 5);
    let error = paired_extrinsics(&BOARD, [&camera(), &color], &first, &exchanged).expect_err("two do not fit");
    assert!(matches!(&error, CalibrationError::PairsDisagree { apart, .. } if *apart == [2, 5]), "{error}");
    let mut moved = second.clone();
    moved[4].corners.iter_mut().for_each(|c| c[0] += 4.0);
    let found = paired_extrinsics(&BOARD, [&camera(), &color], &first, &moved).expect("nearly all fit");
    assert_eq!((0..11).filter(|&i| found.apart[i]).collect::<Vec<_>>(), [4], "{:?}", found.pair_rms);
}
