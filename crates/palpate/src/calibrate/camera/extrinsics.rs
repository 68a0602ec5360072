use super::bundle;
use super::calibration::{check_corners, fit_pose};
use super::{Board, BoardView, CalibrationError, Fixed};
use crate::camera::PinholeCamera;
use crate::geometry::{Isometry, Vector};
use nalgebra::{Matrix6, SMatrix, Translation3, UnitQuaternion, Vector6};

/// Error from which pairs of pictures are not of one mounting, pixels: cameras that were calibrated leave a few tenths, a wrong order of
/// the pictures tens.
const DISAGREE_PX: f64 = 3.0;

/// Where a board is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardPose {
    /// Its pose.
    pub camera_from_board: Isometry,
    /// Root mean square distance of its corners, pixels.
    pub rms: f64,
    /// Covariance of (rotation about the camera's axes, radians; translation, metres), for the corner noise that the fit left.
    pub covariance: Matrix6<f64>,
}

/// Where a board is, by a calibrated camera.
///
/// # Errors
/// [`CalibrationError::Corners`] or [`CalibrationError::NoPose`].
pub fn board_pose(camera: &PinholeCamera, board: &Board, view: &BoardView) -> Result<BoardPose, CalibrationError> {
    check_corners(board, std::slice::from_ref(view))?;
    let fit = fit_pose(camera, board, view, 0)?;
    let refined =
        bundle::refine(camera, vec![fit.camera_from_board], board, std::slice::from_ref(view), &Fixed::ALL.free(1.0));
    let variance = (refined.sum / (2.0 * board.len() as f64 - 6.0)).max(0.02f64.powi(2));
    let covariance = refined.pose_cofactors[0].ok_or(CalibrationError::NoPose { view: 0 })? * variance;
    Ok(BoardPose { camera_from_board: fit.camera_from_board, rms: fit.rms, covariance })
}

/// How two cameras are mounted.
#[derive(Debug, Clone, PartialEq)]
pub struct PairedExtrinsics {
    /// From the first camera's frame to the second's.
    pub second_from_first: Isometry,
    /// One standard deviation of the translation, metres, and of the rotation, radians, per axis.
    pub sigma: ([f64; 3], [f64; 3]),
    /// Root mean square distance over the corners of both, pixels.
    pub rms: f64,
    /// The same for each pair.
    pub pair_rms: Vec<f64>,
    /// Whether a pair contradicts most others: over three times the median, and over half a pixel.
    pub apart: Vec<bool>,
}

/// How two calibrated cameras are mounted, from boards that both saw at the same time: least squares of all corners over that
/// mounting and the boards' poses.
///
/// # Errors
/// [`CalibrationError`]: unpaired views, a board that looks the same turned by half, corners that determine no pose, or pairs that no
/// mounting fits.
pub fn paired_extrinsics(
    board: &Board,
    cameras: [&PinholeCamera; 2],
    first: &[BoardView],
    second: &[BoardView],
) -> Result<PairedExtrinsics, CalibrationError> {
    if first.len() != second.len() || first.is_empty() {
        return Err(CalibrationError::Unpaired { first: first.len(), second: second.len() });
    }
    if board.is_ambiguous() {
        return Err(CalibrationError::Ambiguous { cols: board.cols, rows: board.rows });
    }
    check_corners(board, first)?;
    check_corners(board, second)?;
    let mut boards = Vec::new();
    let mut mountings = Vec::new();
    for (i, (a, b)) in first.iter().zip(second).enumerate() {
        let (a, b) = (fit_pose(cameras[0], board, a, i)?, fit_pose(cameras[1], board, b, i)?);
        mountings.push(b.camera_from_board * a.camera_from_board.inverse());
        boards.push(a.camera_from_board);
    }
    let mut mounting = middle(&mountings);
    let mut system = System::assemble(board, cameras, first, second, &mounting, &boards);
    // Before the fit, which wrong pairs pull to themselves: how each agrees with the middle one's mounting.
    let before = system.rms_of_pairs(board);
    let mut damping = 1e-4;
    for _ in 0..100 {
        let Some((step, steps)) = system.solve(damping) else { break };
        let next = moved(&mounting, &step);
        let next_boards: Vec<Isometry> = boards.iter().zip(&steps).map(|(b, s)| moved(b, s)).collect();
        let then = System::assemble(board, cameras, first, second, &next, &next_boards);
        if then.sum <= system.sum {
            let done = system.sum - then.sum <= 1e-13 * system.sum;
            (mounting, boards, system, damping) = (next, next_boards, then, damping * 0.1);
            if done {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    let residuals = 4.0 * (first.len() * board.len()) as f64;
    let rms = (system.sum / (0.5 * residuals)).sqrt();
    // Written so that NaN fails too.
    if !(rms <= DISAGREE_PX) {
        let flags = apart(&before);
        let apart = (0..flags.len()).filter(|&i| flags[i]).collect();
        return Err(CalibrationError::PairsDisagree { pairs: first.len(), rms, limit: DISAGREE_PX, apart });
    }
    let variance = (system.sum / (residuals - 6.0 - 6.0 * first.len() as f64)).max(0.02f64.powi(2));
    let covariance =
        system.reduced(0.0).and_then(|(m, _)| m.try_inverse()).ok_or(CalibrationError::NoPose { view: 0 })? * variance;
    let sd = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    let pair_rms = system.rms_of_pairs(board);
    Ok(PairedExtrinsics {
        second_from_first: mounting,
        sigma: ([sd(3), sd(4), sd(5)], [sd(0), sd(1), sd(2)]),
        rms,
        apart: apart(&pair_rms),
        pair_rms,
    })
}

/// Whose error is over three times the median and over half a pixel. Two cannot tell which of them is wrong.
fn apart(rms: &[f64]) -> Vec<bool> {
    let mut sorted = rms.to_vec();
    sorted.sort_by(f64::total_cmp);
    let limit = (3.0 * sorted[sorted.len() / 2]).max(0.5);
    rms.iter().map(|&r| rms.len() > 2 && !(r <= limit)).collect()
}

/// The pose nearest to all in the middle of the list: the one with the least sum of turns to the others.
fn middle(poses: &[Isometry]) -> Isometry {
    let cost = |p: &Isometry| {
        let far =
            |q: &Isometry| p.rotation.angle_to(&q.rotation) + (p.translation.vector - q.translation.vector).norm();
        poses.iter().map(far).sum::<f64>()
    };
    let best = poses.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)));
    best.copied().unwrap_or_else(Isometry::identity)
}

fn moved(pose: &Isometry, step: &Vector6<f64>) -> Isometry {
    let turn = UnitQuaternion::from_scaled_axis(Vector::new(step[0], step[1], step[2]));
    let shift = Vector::new(step[3], step[4], step[5]);
    Isometry::from_parts(Translation3::from(pose.translation.vector + shift), turn * pose.rotation)
}

/// Normal equations over the mounting and each board's pose.
struct System {
    common: Matrix6<f64>,
    right: Vector6<f64>,
    boards: Vec<(Matrix6<f64>, Matrix6<f64>, Vector6<f64>)>,
    pair_sums: Vec<f64>,
    sum: f64,
}

impl System {
    fn assemble(
        board: &Board,
        cameras: [&PinholeCamera; 2],
        first: &[BoardView],
        second: &[BoardView],
        mounting: &Isometry,
        boards: &[Isometry],
    ) -> Self {
        let mut system = Self {
            common: Matrix6::zeros(),
            right: Vector6::zeros(),
            boards: Vec::new(),
            pair_sums: Vec::new(),
            sum: 0.0,
        };
        for ((a, b), pose) in first.iter().zip(second).zip(boards) {
            let (mut own, mut coupling, mut own_right) = (Matrix6::zeros(), Matrix6::zeros(), Vector6::zeros());
            let mut sum = 0.0;
            for i in 0..board.len() {
                let turned = pose.rotation * board.point(i).coords;
                let p = turned + pose.translation.vector;
                let by_board = by_pose(&turned);
                if let Some((pixel, by_point, _)) = cameras[0].project_with_jacobians(&p.into()) {
                    let residual = nalgebra::Vector2::new(a.corners[i][0] - pixel[0], a.corners[i][1] - pixel[1]);
                    let j = by_point * by_board;
                    sum += residual.norm_squared();
                    own += j.transpose() * j;
                    own_right += j.transpose() * residual;
                } else {
                    sum = f64::INFINITY;
                }
                let across = mounting.rotation * p;
                let q = across + mounting.translation.vector;
                if let Some((pixel, by_point, _)) = cameras[1].project_with_jacobians(&q.into()) {
                    let residual = nalgebra::Vector2::new(b.corners[i][0] - pixel[0], b.corners[i][1] - pixel[1]);
                    let j = by_point * mounting.rotation.to_rotation_matrix().matrix() * by_board;
                    let m = by_point * by_pose(&across);
                    sum += residual.norm_squared();
                    own += j.transpose() * j;
                    own_right += j.transpose() * residual;
                    coupling += j.transpose() * m;
                    system.common += m.transpose() * m;
                    system.right += m.transpose() * residual;
                } else {
                    sum = f64::INFINITY;
                }
            }
            system.boards.push((own, coupling, own_right));
            system.pair_sums.push(sum);
            system.sum += sum;
        }
        system
    }

    /// Root mean square distance of the corners of each pair, pixels.
    fn rms_of_pairs(&self, board: &Board) -> Vec<f64> {
        let corners = 2.0 * board.len() as f64;
        self.pair_sums.iter().map(|sum| (sum / corners).sqrt()).collect()
    }

    fn reduced(&self, damping: f64) -> Option<(Matrix6<f64>, Vector6<f64>)> {
        let (mut matrix, mut right) = (damped(&self.common, damping), self.right);
        for (own, coupling, own_right) in &self.boards {
            let product = coupling.transpose() * damped(own, damping).try_inverse()?;
            matrix -= product * coupling;
            right -= product * own_right;
        }
        Some((matrix, right))
    }

    fn solve(&self, damping: f64) -> Option<(Vector6<f64>, Vec<Vector6<f64>>)> {
        let (matrix, right) = self.reduced(damping)?;
        let step = matrix.try_inverse()? * right;
        let own = self.boards.iter().map(|(own, coupling, own_right)| {
            Some(damped(own, damping).try_inverse()? * (own_right - coupling * step))
        });
        Some((step, own.collect::<Option<_>>()?))
    }
}

fn damped(matrix: &Matrix6<f64>, damping: f64) -> Matrix6<f64> {
    let mut matrix = *matrix;
    (0..6).for_each(|i| matrix[(i, i)] *= 1.0 + damping);
    matrix
}

/// How a point moves with a pose: by turn × point, and by the shift.
fn by_pose(turned: &Vector) -> SMatrix<f64, 3, 6> {
    let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
    jacobian.fixed_columns_mut::<3>(0).copy_from(&-turned.cross_matrix());
    jacobian.fixed_columns_mut::<3>(3).fill_with_identity();
    jacobian
}
