//! Camera and board poses together, by Levenberg–Marquardt with the poses eliminated (Schur complement).

use super::{Board, BoardView};
use crate::camera::PinholeCamera;
use crate::geometry::{Isometry, Vector};
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix6, SMatrix, Translation3, UnitQuaternion, Vector6};

/// Steps before giving up.
const STEPS: usize = 200;

/// What the refinement found.
pub(super) struct Bundle {
    pub(super) camera: PinholeCamera,
    pub(super) poses: Vec<Isometry>,
    /// Sum of squared residuals, pixels².
    pub(super) sum: f64,
    pub(super) converged: bool,
    pub(super) steps: usize,
    /// Inverse normal matrix of the free intrinsic parameters; `None` if it is singular.
    pub(super) intrinsic_cofactor: Option<DMatrix<f64>>,
    /// The same of each view's pose (rotation, translation), the camera taken as known.
    pub(super) pose_cofactors: Vec<Option<Matrix6<f64>>>,
}

/// Normal equations: intrinsic block, and for each view its own block, coupling and right side.
struct Normal {
    intrinsic: DMatrix<f64>,
    right: DVector<f64>,
    views: Vec<(Matrix6<f64>, DMatrix<f64>, Vector6<f64>)>,
    sum: f64,
}

pub(super) fn refine(
    start: &PinholeCamera,
    poses: Vec<Isometry>,
    board: &Board,
    views: &[BoardView],
    free: &DMatrix<f64>,
) -> Bundle {
    let (mut camera, mut poses) = (*start, poses);
    let mut normal = assemble(&camera, &poses, board, views, free);
    let (mut damping, mut converged, mut steps) = (1e-3, false, 0);
    while steps < STEPS && !converged {
        steps += 1;
        let Some((intrinsic_step, pose_steps)) = solve(&normal, damping) else {
            damping *= 10.0;
            if damping > 1e12 {
                break;
            }
            continue;
        };
        let next_camera = moved(&camera, &(free * &intrinsic_step));
        let next_poses: Vec<Isometry> = poses.iter().zip(&pose_steps).map(|(p, s)| moved_pose(p, s)).collect();
        let next = assemble(&next_camera, &next_poses, board, views, free);
        // Written so that NaN fails too.
        if next.sum <= normal.sum {
            converged = normal.sum - next.sum <= 1e-13 * normal.sum.max(1e-20);
            (camera, poses, normal) = (next_camera, next_poses, next);
            damping = (damping * 0.1).max(1e-12);
        } else {
            damping *= 10.0;
            // No smaller step is better: this is the least there is.
            converged = damping > 1e10 && normal.sum.is_finite();
        }
    }
    let intrinsic_cofactor = reduced(&normal, 0.0).and_then(|(s, _)| invert(&s));
    let pose_cofactors = normal.views.iter().map(|(own, ..)| own.try_inverse()).collect();
    Bundle { camera, poses, sum: normal.sum, converged, steps, intrinsic_cofactor, pose_cofactors }
}

/// Inverse of a symmetric positive matrix, scaled to a unit diagonal first.
fn invert(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = matrix.nrows();
    let scale = DVector::from_fn(n, |i, _| 1.0 / matrix[(i, i)].sqrt());
    if !scale.iter().all(|s| s.is_finite()) {
        return None;
    }
    let scaled = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] * scale[i] * scale[j]);
    let inverse = scaled.cholesky()?.inverse();
    Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]))
}

fn moved(camera: &PinholeCamera, step: &DVector<f64>) -> PinholeCamera {
    let mut next = *camera;
    next.fx += step[0];
    next.fy += step[1];
    next.cx += step[2];
    next.cy += step[3];
    (0..5).for_each(|i| next.distortion[i] += step[4 + i]);
    next
}

fn moved_pose(pose: &Isometry, step: &Vector6<f64>) -> Isometry {
    let turn = UnitQuaternion::from_scaled_axis(Vector::new(step[0], step[1], step[2]));
    let shift = Vector::new(step[3], step[4], step[5]);
    Isometry::from_parts(Translation3::from(pose.translation.vector + shift), turn * pose.rotation)
}

fn assemble(
    camera: &PinholeCamera,
    poses: &[Isometry],
    board: &Board,
    views: &[BoardView],
    free: &DMatrix<f64>,
) -> Normal {
    let n = free.ncols();
    let (mut intrinsic, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let (mut blocks, mut sum) = (Vec::with_capacity(views.len()), 0.0);
    for (pose, view) in poses.iter().zip(views) {
        let (mut all, mut all_right) = (SMatrix::<f64, 9, 9>::zeros(), SMatrix::<f64, 9, 1>::zeros());
        let (mut own, mut coupling, mut own_right) =
            (Matrix6::zeros(), SMatrix::<f64, 6, 9>::zeros(), Vector6::zeros());
        for (i, corner) in view.corners.iter().enumerate() {
            let turned = pose.rotation * board.point(i).coords;
            let p = turned + pose.translation.vector;
            let Some((pixel, by_point, by_camera)) = camera.project_with_jacobians(&p.into()) else {
                sum = f64::INFINITY;
                continue;
            };
            let residual = nalgebra::Vector2::new(corner[0] - pixel[0], corner[1] - pixel[1]);
            sum += residual.norm_squared();
            // Turning the board moves its point by step × turned.
            let by_turn = Matrix2x3::from(by_point * -turned.cross_matrix());
            let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
            by_pose.fixed_columns_mut::<3>(0).copy_from(&by_turn);
            by_pose.fixed_columns_mut::<3>(3).copy_from(&by_point);
            own += by_pose.transpose() * by_pose;
            coupling += by_pose.transpose() * by_camera;
            own_right += by_pose.transpose() * residual;
            all += by_camera.transpose() * by_camera;
            all_right += by_camera.transpose() * residual;
        }
        let all = DMatrix::from_column_slice(9, 9, all.as_slice());
        intrinsic += free.transpose() * all * free;
        right += free.transpose() * DVector::from_column_slice(all_right.as_slice());
        blocks.push((own, DMatrix::from_column_slice(6, 9, coupling.as_slice()) * free, own_right));
    }
    Normal { intrinsic, right, views: blocks, sum }
}

/// The intrinsic block with the poses eliminated.
fn reduced(normal: &Normal, damping: f64) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let (mut matrix, mut right) = (normal.intrinsic.clone(), normal.right.clone());
    (0..matrix.nrows()).for_each(|i| matrix[(i, i)] *= 1.0 + damping);
    for (own, coupling, own_right) in &normal.views {
        let inverse = damped(own, damping).try_inverse()?;
        let inverse = DMatrix::from_column_slice(6, 6, inverse.as_slice());
        let product = coupling.transpose() * inverse;
        matrix -= &product * coupling;
        right -= product * DVector::from_column_slice(own_right.as_slice());
    }
    Some((matrix, right))
}

fn damped(own: &Matrix6<f64>, damping: f64) -> Matrix6<f64> {
    let mut own = *own;
    (0..6).for_each(|i| own[(i, i)] *= 1.0 + damping);
    own
}

fn solve(normal: &Normal, damping: f64) -> Option<(DVector<f64>, Vec<Vector6<f64>>)> {
    let (matrix, right) = reduced(normal, damping)?;
    let step = if matrix.nrows() == 0 { right } else { invert(&matrix)? * right };
    let mut poses = Vec::with_capacity(normal.views.len());
    for (own, coupling, own_right) in &normal.views {
        let less = coupling * &step;
        let right = own_right - Vector6::from_column_slice(less.as_slice());
        poses.push(damped(own, damping).try_inverse()? * right);
    }
    Some((step, poses))
}
