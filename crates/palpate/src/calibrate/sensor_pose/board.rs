use super::SensorPoseError;
use super::solve::{Solved, minimise, moved_pose};
use crate::geometry::{Isometry, Vector};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion};

const LEAST: usize = 3;
const GOOD: usize = 30;
/// Turn between two hand poses that is needed, radians.
const LEAST_TURN: f64 = 0.1;

/// One record: where the hand was, and where the camera saw the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseRecord {
    /// The robot's hand.
    pub base_from_hand: Isometry,
    /// The target (board) in the camera.
    pub camera_from_target: Isometry,
}

/// A hand–eye calibration: A X = X B, and everything around it.
#[derive(Debug, Clone, PartialEq)]
pub struct HandEye {
    /// The pose sought: of the camera in the hand, or in the robot's base.
    pub pose: Isometry,
    /// Covariance of the pose: turn about its parent's axes (radians), then shift (metres).
    pub covariance: Matrix6<f64>,
    /// The target: in the base for a camera in the hand, in the hand for a standing camera.
    pub target: Isometry,
    /// Root mean square distance between the target's places by single records and the common one, metres.
    pub rms_translation: f64,
    /// The same of its turns, radians.
    pub rms_rotation: f64,
    /// Each record's distance, metres and radians.
    pub residuals: Vec<(f64, f64)>,
}

/// Finds where a camera sits from views of a target.
///
/// * `in_hand` – the camera moves with the hand and the target stands; otherwise the camera stands and the target is in the hand
///
/// Rotations first (a linear problem for the motions' axes, Park & Martin), then translations (linear), then all of it together by least
/// squares of the target's spread, turns weighed against shifts by what the start leaves of each.
///
/// # Errors
/// [`SensorPoseError`].
///
/// # References
/// Park & Martin, *Robot sensor calibration: solving AX = XB on the Euclidean group*, IEEE T-RA 10(5), 1994.
pub fn calibrate_on_board(records: &[PoseRecord], in_hand: bool) -> Result<HandEye, SensorPoseError> {
    if records.len() < LEAST {
        return Err(SensorPoseError::TooFew { found: records.len(), needed: LEAST, good: GOOD });
    }
    let finite = |p: &Isometry| p.translation.vector.iter().chain(p.rotation.coords.iter()).all(|v| v.is_finite());
    if let Some(record) = records.iter().position(|r| !finite(&r.base_from_hand) || !finite(&r.camera_from_target)) {
        return Err(SensorPoseError::NotFinite { record });
    }
    // A standing camera is one in the "hand" of a robot whose base is the hand.
    let hands: Vec<Isometry> =
        records.iter().map(|r| if in_hand { r.base_from_hand } else { r.base_from_hand.inverse() }).collect();
    let targets: Vec<Isometry> = records.iter().map(|r| r.camera_from_target).collect();
    let rotation = rotation(&hands, &targets)?;
    let translation = translation(&hands, &targets, &rotation)?;
    let start = Isometry::from_parts(Translation3::from(translation), rotation);
    refine(&hands, &targets, &start)
}

/// Pairs of motions: A of the hand, B of the target as the camera sees it, with A X = X B.
fn motions<'a>(hands: &'a [Isometry], targets: &'a [Isometry]) -> impl Iterator<Item = (Isometry, Isometry)> + 'a {
    let pairs = (0..hands.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    pairs.map(|(i, j)| (hands[i].inverse() * hands[j], targets[i] * targets[j].inverse()))
}

/// Axis-angle vectors a = R b: the turn that takes all b to all a.
fn rotation(hands: &[Isometry], targets: &[Isometry]) -> Result<UnitQuaternion<f64>, SensorPoseError> {
    let (mut correlation, mut spread, mut largest) = (Matrix3::zeros(), Matrix3::zeros(), 0.0f64);
    for (a, b) in motions(hands, targets) {
        let (a, b) = (a.rotation.scaled_axis(), b.rotation.scaled_axis());
        // Near half a turn the axis flips with the noise.
        if a.norm() > 3.0 || b.norm() > 3.0 {
            continue;
        }
        largest = largest.max(a.norm());
        correlation += a * b.transpose();
        spread += a * a.transpose();
    }
    if largest < LEAST_TURN {
        let what = format!("the hand turns by at most {:.1}°", largest.to_degrees());
        return Err(SensorPoseError::Degenerate { what });
    }
    let mut eigen: Vec<f64> = spread.symmetric_eigenvalues().iter().copied().collect();
    eigen.sort_by(f64::total_cmp);
    if eigen[1] < 1e-3 * eigen[2] {
        return Err(SensorPoseError::Degenerate { what: "all turns are about one axis".to_owned() });
    }
    let svd = correlation.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(SensorPoseError::Degenerate { what: "the turns cannot be compared".to_owned() });
    };
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector::new(1.0, 1.0, sign)) * v_t;
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

/// (R_A − 1) t = R_X t_B − t_A over all motions.
fn translation(
    hands: &[Isometry],
    targets: &[Isometry],
    rotation: &UnitQuaternion<f64>,
) -> Result<Vector, SensorPoseError> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector::zeros());
    for (a, b) in motions(hands, targets) {
        let m = a.rotation.to_rotation_matrix().matrix() - Matrix3::identity();
        normal += m.transpose() * m;
        right += m.transpose() * (rotation * b.translation.vector - a.translation.vector);
    }
    let solved = normal.cholesky().map(|c| c.solve(&right));
    solved.ok_or_else(|| SensorPoseError::Degenerate { what: "the turns leave the shift open".to_owned() })
}

#[derive(Clone)]
struct State {
    pose: Isometry,
    target: Isometry,
}

fn refine(hands: &[Isometry], targets: &[Isometry], start: &Isometry) -> Result<HandEye, SensorPoseError> {
    let places: Vec<Isometry> = hands.iter().zip(targets).map(|(h, t)| h * start * t).collect();
    let start = State { pose: *start, target: mean(&places) };
    let off = |state: &State, i: usize| {
        // The difference as the camera sees it.
        let expected = (hands[i] * state.pose).inverse() * state.target;
        let turn = (expected.rotation.inverse() * targets[i].rotation).scaled_axis();
        (targets[i].translation.vector - expected.translation.vector, turn)
    };
    let n = hands.len();
    let spread = |state: &State| {
        let sums = (0..n)
            .map(|i| off(state, i))
            .fold((0.0, 0.0), |(t, r), (shift, turn)| (t + shift.norm_squared(), r + turn.norm_squared()));
        // Never weighed by a spread of nothing.
        ((sums.0 / (3.0 * n as f64)).sqrt().max(1e-7), (sums.1 / (3.0 * n as f64)).sqrt().max(1e-7))
    };
    let solve = |start: State, (shift_sigma, turn_sigma): (f64, f64)| -> Solved<State> {
        let moved = |s: &State, step: &[f64]| State {
            pose: moved_pose(&s.pose, &step[..6]),
            target: moved_pose(&s.target, &step[6..]),
        };
        let residuals = |s: &State| {
            let all = (0..n).flat_map(|i| {
                let (shift, turn) = off(s, i);
                let (shift, turn) = (shift / shift_sigma, turn / turn_sigma);
                [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]
            });
            DVector::from_iterator(6 * n, all)
        };
        minimise(start, 12, moved, residuals)
    };
    // Twice: the start's spread is not yet the noise.
    let first = solve(start.clone(), spread(&start)).state;
    let sigma = spread(&first);
    let solved = solve(first, sigma);
    let state = &solved.state;
    let residuals: Vec<(f64, f64)> =
        (0..n).map(|i| off(state, i)).map(|(shift, turn)| (shift.norm(), turn.norm())).collect();
    let rms = |pick: fn(&(f64, f64)) -> f64| (residuals.iter().map(pick).map(|v| v * v).sum::<f64>() / n as f64).sqrt();
    let (rms_translation, rms_rotation) = (rms(|r| r.0), rms(|r| r.1));
    if rms_translation > 0.05 || rms_rotation > 0.2 {
        let worst = (0..n).max_by(|&a, &b| residuals[a].0.total_cmp(&residuals[b].0)).unwrap_or(0);
        return Err(SensorPoseError::Inconsistent {
            rms: 1e3 * rms_translation,
            unit: "mm",
            worst: 1e3 * residuals[worst].0,
            record: worst,
        });
    }
    let cofactor = solved
        .cofactor
        .ok_or_else(|| SensorPoseError::Degenerate { what: "the normal equations are singular".to_owned() })?;
    let freedom = (6 * n) as f64 - 12.0;
    let variance = solved.residuals.norm_squared() / freedom.max(1.0);
    Ok(HandEye {
        pose: state.pose,
        covariance: block(&cofactor) * variance,
        target: state.target,
        rms_translation,
        rms_rotation,
        residuals,
    })
}

/// The upper left 6 × 6.
pub(super) fn block(matrix: &DMatrix<f64>) -> Matrix6<f64> {
    Matrix6::from_fn(|r, c| matrix[(r, c)])
}

/// Mean shift and the turn nearest to all.
fn mean(poses: &[Isometry]) -> Isometry {
    let shift = poses.iter().map(|p| p.translation.vector).sum::<Vector>() / poses.len() as f64;
    let first = poses[0].rotation;
    let turn = poses.iter().map(|p| (p.rotation * first.inverse()).scaled_axis()).sum::<Vector>() / poses.len() as f64;
    Isometry::from_parts(Translation3::from(shift), UnitQuaternion::from_scaled_axis(turn) * first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;
    use rand_distr::{Distribution as _, Normal};

    /// Hand poses over a board, the true pose, and records with noise (metres, radians).
    fn records(in_hand: bool, noise: (f64, f64), seed: u64) -> (Isometry, Vec<PoseRecord>) {
        let pose = if in_hand {
            Isometry::new(Vector::new(0.031, -0.052, 0.081), Vector::new(0.1, -0.3, 1.4))
        } else {
            Isometry::new(Vector::new(0.9, 0.1, 0.7), Vector::new(-1.9, 0.4, 0.3))
        };
        let target = Isometry::new(Vector::new(0.1, -0.05, 0.2), Vector::new(0.4, 0.1, 0.2));
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let normal = Normal::new(0.0, 1.0).expect("a sigma of 1");
        let mut three = |scale: f64| {
            let v: [f64; 3] = std::array::from_fn(|_| normal.sample(&mut rng));
            Vector::from(v) * scale
        };
        let records = (0..15)
            .map(|_| {
                let base_from_hand = Isometry::new(Vector::new(0.4, 0.0, 0.5) + three(0.1), three(0.4));
                let exact = if in_hand {
                    (base_from_hand * pose).inverse() * target
                } else {
                    pose.inverse() * base_from_hand * target
                };
                let turn = UnitQuaternion::from_scaled_axis(three(noise.1));
                let shift = exact.translation.vector + three(noise.0);
                let seen = Isometry::from_parts(Translation3::from(shift), turn * exact.rotation);
                PoseRecord { base_from_hand, camera_from_target: seen }
            })
            .collect();
        (pose, records)
    }

    fn off(found: &Isometry, truth: &Isometry) -> (f64, f64) {
        let shift = (found.translation.vector - truth.translation.vector).norm();
        (1e3 * shift, found.rotation.angle_to(&truth.rotation).to_degrees())
    }

    #[test]
    fn exact_records_give_the_exact_pose() {
        for in_hand in [true, false] {
            let (truth, records) = records(in_hand, (0.0, 0.0), 1);
            let found = calibrate_on_board(&records, in_hand).expect("good motions");
            let (mm, degrees) = off(&found.pose, &truth);
            assert!(mm < 1e-5 && degrees < 1e-5, "{in_hand}: {mm} mm {degrees}°");
        }
    }

    #[test]
    fn noisy_records_give_it_within_a_fifth_of_a_millimetre_and_the_covariance_says_how_well() {
        // 0.2 mm and 0.05° per axis: a board of 54 corners at half a metre, 0.1 px.
        let (mut sum, mut expected, mut worst) = (0.0, 0.0, (0.0f64, 0.0f64));
        for seed in 0..20 {
            for in_hand in [true, false] {
                let (truth, records) = records(in_hand, (2e-4, 0.05f64.to_radians()), seed);
                let found = calibrate_on_board(&records, in_hand).expect("good motions");
                let (mm, degrees) = off(&found.pose, &truth);
                worst = (worst.0.max(mm), worst.1.max(degrees));
                if in_hand {
                    sum += mm * mm;
                    expected += 1e6 * (3..6).map(|i| found.covariance[(i, i)]).sum::<f64>();
                }
            }
        }
        let ratio = (sum / expected).sqrt();
        println!("worst of 40: {:.3} mm, {:.3}°; scatter over predicted {ratio:.2}", worst.0, worst.1);
        assert!(worst.1 < 0.2, "{worst:?}");
        // The standing camera is a metre away: 0.05° of turn are a millimetre there, so its shift is judged at the hand's camera only.
        let hand_worst = (0..20)
            .map(|seed| {
                let (truth, records) = records(true, (2e-4, 0.05f64.to_radians()), seed);
                off(&calibrate_on_board(&records, true).expect("good motions").pose, &truth).0
            })
            .fold(0.0, f64::max);
        assert!(hand_worst < 0.3, "{hand_worst}");
        assert!((0.6..1.6).contains(&ratio), "{ratio}");
    }

    #[test]
    fn motions_that_determine_nothing_are_errors() {
        let (_, records) = records(true, (0.0, 0.0), 1);
        let few = calibrate_on_board(&records[..2], true).expect_err("two").to_string();
        assert!(few.contains("2 records; at least 3"), "{few}");
        let still: Vec<PoseRecord> = vec![records[0]; 5];
        let error = calibrate_on_board(&still, true).expect_err("no turn").to_string();
        assert!(error.contains("the hand turns by at most 0.0°"), "{error}");
        let one_axis: Vec<PoseRecord> = (0..6)
            .map(|i| {
                let base_from_hand =
                    Isometry::new(Vector::new(0.1 * f64::from(i), 0.0, 0.3), Vector::new(0.0, 0.0, 0.3 * f64::from(i)));
                PoseRecord { base_from_hand, camera_from_target: base_from_hand.inverse() }
            })
            .collect();
        let error = calibrate_on_board(&one_axis, true).expect_err("one axis").to_string();
        assert!(error.contains("about one axis"), "{error}");
        let mut mixed = records.clone();
        (0..7).for_each(|i| mixed[i].camera_from_target = records[14 - i].camera_from_target);
        let error = calibrate_on_board(&mixed, true).expect_err("mixed up").to_string();
        assert!(error.contains("contradict"), "{error}");
        let mut nan = records;
        nan[3].base_from_hand.translation.vector.x = f64::NAN;
        assert_eq!(calibrate_on_board(&nan, true), Err(SensorPoseError::NotFinite { record: 3 }));
    }
}
