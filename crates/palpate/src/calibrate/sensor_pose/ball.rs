use super::SensorPoseError;
use super::board::block;
use super::solve::{minimise, moved_pose};
use crate::geometry::{Isometry, Point, Vector};
use crate::tactile::{Contact, TactileSensor};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion};

const LEAST: usize = 6;
const GOOD: usize = 40;

/// One press of the ball: where the hand was, and where the ball's centre was by the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallContact {
    /// The robot's hand.
    pub base_from_hand: Isometry,
    /// The ball's centre in the sensor frame, metres: see [`ball_center`].
    pub center: Point,
}

/// Where a tactile sensor sits in the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct BallPoseCalibration {
    /// The sensor in the hand.
    pub hand_from_sensor: Isometry,
    /// Its covariance: turn about the hand's axes (radians), then shift (metres).
    pub covariance: Matrix6<f64>,
    /// The ball's centre in the base, metres.
    pub ball: Point,
    /// Root mean square distance of the single records' centres, metres.
    pub rms: f64,
    /// Each record's distance, metres.
    pub residuals: Vec<f64>,
}

/// The centre of a ball of known radius that a contact shows, sensor frame.
///
/// Fitted to the height map inside its mask with the radius kept (the gel's decoded curvature is less sure than the ball's
/// measured one). `None` for an empty mask.
///
/// * `radius` – of the ball, metres
pub fn ball_center(contact: &Contact, sensor: &TactileSensor, radius: f64) -> Option<Point> {
    let (rows, cols) = contact.height_map.shape();
    let points: Vec<Point> = contact
        .height_map
        .pixels()
        .filter(|&(row, col, _)| contact.mask[(row, col)])
        .map(|(row, col, &z)| {
            let (x, y) = sensor.pixel_position(row, col, rows, cols);
            Point::new(x, y, f64::from(z))
        })
        .filter(|p| p.z.is_finite())
        .collect();
    if points.len() < 10 {
        return None;
    }
    let lowest = points.iter().min_by(|a, b| a.z.total_cmp(&b.z))?;
    let mut center = lowest + Vector::new(0.0, 0.0, radius);
    for _ in 0..50 {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector::zeros());
        for p in &points {
            let arm = center - p;
            let distance = arm.norm();
            let row = arm / distance.max(1e-12);
            normal += row * row.transpose();
            right += row * (radius - distance);
        }
        let step = normal.cholesky()?.solve(&right);
        center += step;
        if step.norm() < 1e-10 {
            break;
        }
    }
    center.iter().all(|v| v.is_finite()).then_some(center)
}

/// Finds where a tactile sensor sits in the hand from presses of one standing ball from several sides.
///
/// R_i (R x_i + t) + t_i = c: linear in R, t and c. The centres x_i lie almost in a plane (the pad's), so R's third column comes from the
/// other two. Then least squares of the distances over the rotation, the shift and the ball together.
///
/// # Errors
/// [`SensorPoseError`].
pub fn calibrate_on_ball(records: &[BallContact]) -> Result<BallPoseCalibration, SensorPoseError> {
    if records.len() < LEAST {
        return Err(SensorPoseError::TooFew { found: records.len(), needed: LEAST, good: GOOD });
    }
    let finite = |r: &BallContact| {
        let p = &r.base_from_hand;
        let numbers = p.translation.vector.iter().chain(p.rotation.coords.iter()).chain(r.center.coords.iter());
        numbers.into_iter().all(|v| v.is_finite())
    };
    if let Some(record) = records.iter().position(|r| !finite(r)) {
        return Err(SensorPoseError::NotFinite { record });
    }
    let (start, ball) = start(records)?;
    let off = |pose: &Isometry, ball: &Point, i: usize| records[i].base_from_hand * pose * records[i].center - ball;
    let n = records.len();
    let solved = minimise(
        (start, ball),
        9,
        |(pose, ball), step| (moved_pose(pose, &step[..6]), ball + Vector::new(step[6], step[7], step[8])),
        |(pose, ball)| DVector::from_iterator(3 * n, (0..n).flat_map(|i| <[f64; 3]>::from(off(pose, ball, i)))),
    );
    let (pose, ball) = solved.state;
    let residuals: Vec<f64> = (0..n).map(|i| off(&pose, &ball, i).norm()).collect();
    let rms = (residuals.iter().map(|r| r * r).sum::<f64>() / n as f64).sqrt();
    if rms > 5e-3 {
        let record = (0..n).max_by(|&a, &b| residuals[a].total_cmp(&residuals[b])).unwrap_or(0);
        let worst = 1e3 * residuals[record];
        return Err(SensorPoseError::Inconsistent { rms: 1e3 * rms, unit: "mm", worst, record });
    }
    let cofactor = solved
        .cofactor
        .ok_or_else(|| SensorPoseError::Degenerate { what: "the normal equations are singular".to_owned() })?;
    let variance = solved.residuals.norm_squared() / ((3 * n) as f64 - 9.0);
    let covariance = block(&cofactor) * variance;
    let turn = (0..3).map(|i| covariance[(i, i)]).fold(0.0, f64::max).sqrt();
    if turn > 0.1 {
        let what = format!("the sensor's turn is known to {:.0}° only", turn.to_degrees());
        return Err(SensorPoseError::Degenerate { what });
    }
    Ok(BallPoseCalibration { hand_from_sensor: pose, covariance, ball, rms, residuals })
}

fn start(records: &[BallContact]) -> Result<(Isometry, Point), SensorPoseError> {
    // Unknowns: columns 1 and 2 of R, the shift with the mean depth (t + R z̄), and c.
    let depth = records.iter().map(|r| r.center.z).sum::<f64>() / records.len() as f64;
    let mut rows = DMatrix::<f64>::zeros(3 * records.len(), 12);
    let mut right = DVector::<f64>::zeros(3 * records.len());
    for (i, r) in records.iter().enumerate() {
        let turn = r.base_from_hand.rotation.to_rotation_matrix().into_inner();
        rows.view_mut((3 * i, 0), (3, 3)).copy_from(&(turn * r.center.x));
        rows.view_mut((3 * i, 3), (3, 3)).copy_from(&(turn * r.center.y));
        rows.view_mut((3 * i, 6), (3, 3)).copy_from(&turn);
        rows.view_mut((3 * i, 9), (3, 3)).copy_from(&-Matrix3::identity());
        right.rows_mut(3 * i, 3).copy_from(&-r.base_from_hand.translation.vector);
    }
    // Centres are millimetres, turns about one: scaled, so that the smallest singular value means something.
    let scale = records.iter().map(|r| r.center.x.hypot(r.center.y)).fold(0.0, f64::max);
    if scale < 1e-4 {
        return Err(SensorPoseError::Degenerate { what: "all contacts are at the same place of the pad".to_owned() });
    }
    rows.columns_mut(0, 6).scale_mut(1.0 / scale);
    let svd = rows.svd(true, true);
    if svd.singular_values.min() < 1e-3 * svd.singular_values.max() {
        let what = "the hand turns too little, or the contacts are on one line of the pad".to_owned();
        return Err(SensorPoseError::Degenerate { what });
    }
    let solved = svd.solve(&right, 0.0).map_err(|e| SensorPoseError::Degenerate { what: e.to_owned() })?;
    let part = |i: usize| Vector::new(solved[i], solved[i + 1], solved[i + 2]);
    let (x, y) = (part(0) / scale, part(3) / scale);
    let svd = Matrix3::from_columns(&[x, y, x.cross(&y)]).svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(SensorPoseError::Degenerate { what: "the contacts cannot be compared".to_owned() });
    };
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector::new(1.0, 1.0, sign)) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let shift = part(6) - rotation * Vector::new(0.0, 0.0, depth);
    Ok((Isometry::from_parts(Translation3::from(shift), rotation), Point::from(part(9))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Raster;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_distr::{Distribution as _, Normal};

    const RADIUS: f64 = 0.006;

    /// Presses of a ball by a pad of 18 × 14 mm from all sides, the centres with noise in the pad's plane and in depth, metres.
    fn records(noise: (f64, f64), count: usize, seed: u64) -> (Isometry, Vec<BallContact>) {
        let truth = Isometry::new(Vector::new(0.01, -0.02, 0.12), Vector::new(0.2, 0.1, -0.8));
        let ball = Point::new(0.45, 0.05, 0.3);
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let normal = Normal::new(0.0, 1.0).expect("a sigma of 1");
        let records = (0..count)
            .map(|_| {
                let mut within = |half: f64| rng.random_range(-half..half);
                let center = Point::new(within(0.007), within(0.005), RADIUS - 0.0006 + within(0.0003));
                let turn = Vector::new(within(0.8), within(0.8), within(1.5));
                let rotation = UnitQuaternion::from_scaled_axis(turn);
                // The hand goes where the ball is at that place of the pad.
                let shift = ball.coords - rotation * (truth * center).coords;
                let base_from_hand = Isometry::from_parts(Translation3::from(shift), rotation);
                let mut off = |sigma: f64| sigma * normal.sample(&mut rng);
                let seen = center + Vector::new(off(noise.0), off(noise.0), off(noise.1));
                BallContact { base_from_hand, center: seen }
            })
            .collect();
        (truth, records)
    }

    fn off(found: &Isometry, truth: &Isometry) -> (f64, f64) {
        let shift = (found.translation.vector - truth.translation.vector).norm();
        (1e3 * shift, found.rotation.angle_to(&truth.rotation).to_degrees())
    }

    #[test]
    fn exact_contacts_give_the_exact_pose() {
        let (truth, records) = records((0.0, 0.0), 8, 1);
        let found = calibrate_on_ball(&records).expect("good presses");
        let (mm, degrees) = off(&found.hand_from_sensor, &truth);
        assert!(mm < 1e-5 && degrees < 1e-4, "{mm} mm {degrees}°");
        assert!((found.ball - Point::new(0.45, 0.05, 0.3)).norm() < 1e-8);
    }

    #[test]
    fn noisy_contacts_give_it_within_a_fifth_of_a_millimetre_and_degree() {
        // A third of a pixel of 0.06 mm along the pad and as much in depth, the robot's repeatability in it.
        let (mut worst, mut sums) = ((0.0f64, 0.0f64), (0.0, 0.0));
        for seed in 0..20 {
            let (truth, records) = records((2e-5, 2e-5), 40, seed);
            let found = calibrate_on_ball(&records).expect("good presses");
            let (mm, degrees) = off(&found.hand_from_sensor, &truth);
            worst = (worst.0.max(mm), worst.1.max(degrees));
            sums.0 += mm * mm;
            sums.1 += 1e6 * (3..6).map(|i| found.covariance[(i, i)]).sum::<f64>();
        }
        let ratio: f64 = (sums.0 / sums.1).sqrt();
        println!("worst of 20: {:.3} mm, {:.3}°; scatter over predicted {ratio:.2}", worst.0, worst.1);
        assert!(worst.0 < 0.2 && worst.1 < 0.2, "{worst:?}");
        assert!((0.6..1.6).contains(&ratio), "{ratio}");
    }

    #[test]
    fn presses_that_determine_nothing_are_errors() {
        let (_, records) = records((0.0, 0.0), 10, 2);
        assert!(matches!(calibrate_on_ball(&records[..3]), Err(SensorPoseError::TooFew { found: 3, .. })));
        let same = vec![records[0]; 10];
        assert!(matches!(calibrate_on_ball(&same), Err(SensorPoseError::Degenerate { .. })));
        let mut moved = records;
        moved[4].base_from_hand.translation.vector.x += 0.1;
        let error = calibrate_on_ball(&moved).expect_err("one is wrong").to_string();
        assert!(error.contains("contradict") && error.contains("record 4"), "{error}");
    }

    #[test]
    fn a_balls_centre_is_found_in_its_contact() {
        let sensor = TactileSensor::preset("gelsight-mini").expect("listed");
        let center = Point::new(0.0012, -0.0007, RADIUS - 0.0008);
        let surface = |row: usize, col: usize| {
            let (x, y) = sensor.pixel_position(row, col, 240, 320);
            let r2 = (x - center.x).powi(2) + (y - center.y).powi(2);
            if r2 < RADIUS * RADIUS { center.z - (RADIUS * RADIUS - r2).sqrt() } else { 1.0 }
        };
        let height_map = Raster::from_fn(240, 320, |r, c| surface(r, c).min(0.0) as f32);
        let mask = height_map.map(|z| *z < -0.0002);
        let found = ball_center(&Contact { height_map, mask }, &sensor, RADIUS).expect("a ball");
        assert!((found - center).norm() < 1e-6, "{found}");
        let nothing = Contact { height_map: Raster::filled(8, 8, 0.0), mask: Raster::filled(8, 8, false) };
        assert_eq!(ball_center(&nothing, &sensor, RADIUS), None);
    }
}
