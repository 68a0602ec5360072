//! Where the refinement starts.

use super::homography::homography;
use super::{Board, BoardView, CalibrationError};
use crate::camera::PinholeCamera;
use crate::geometry::{Isometry, Vector};
use nalgebra::{Matrix2, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector2};

/// A camera without distortion, its principal point in the middle, from the homographies of the views: the images of the board's
/// x and y axes, and of its diagonals, are square to each other (Zhang 2000, eq. 3, for a known principal point).
pub(super) fn start_camera(board: &Board, views: &[BoardView], (width, height): (usize, usize)) -> PinholeCamera {
    let (cx, cy) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for h in views.iter().filter_map(|view| board_homography(board, view)) {
        let centre = Matrix3::new(1.0, 0.0, -cx, 0.0, 1.0, -cy, 0.0, 0.0, 1.0);
        let h = centre * h;
        let (x, y) = (h.column(0).into_owned(), h.column(1).into_owned());
        let (d, e) = (0.5 * (x + y), 0.5 * (x - y));
        for (a, b) in [(x.normalize(), y.normalize()), (d.normalize(), e.normalize())] {
            let row = Vector2::new(a.x * b.x, a.y * b.y);
            normal += row * row.transpose();
            right -= row * (a.z * b.z);
        }
    }
    let solved = normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right);
    let usual = width.max(height) as f64;
    let focal = |x: f64| Some(1.0 / x.abs().sqrt()).filter(|f| (0.2 * usual..20.0 * usual).contains(f));
    let (fx, fy) = match (focal(solved.x), focal(solved.y)) {
        (Some(fx), Some(fy)) if (0.5..2.0).contains(&(fx / fy)) => (fx, fy),
        (Some(f), _) | (_, Some(f)) => (f, f),
        _ => (usual, usual),
    };
    PinholeCamera { width, height, fx, fy, cx, cy, distortion: [0.0; 5] }
}

fn board_homography(board: &Board, view: &BoardView) -> Option<Matrix3<f64>> {
    let from: Vec<[f64; 2]> = (0..board.len()).map(|i| [board.point(i).x, board.point(i).y]).collect();
    homography(&from, &view.corners)
}

/// The board's pose from its homography, distortion undone first.
pub(super) fn start_pose(
    camera: &PinholeCamera,
    board: &Board,
    view: &BoardView,
    index: usize,
) -> Result<Isometry, CalibrationError> {
    pose(camera, board, view).ok_or(CalibrationError::NoPose { view: index })
}

fn pose(camera: &PinholeCamera, board: &Board, view: &BoardView) -> Option<Isometry> {
    let rays = view.corners.iter().map(|c| camera.ray(c[0], c[1])).map(|r| [r.x, r.y]).collect();
    let h = board_homography(board, &BoardView { corners: rays })?;
    let (x, y, t) = (h.column(0), h.column(1), h.column(2));
    let scale = 2.0 / (x.norm() + y.norm());
    let sign = if t.z < 0.0 { -1.0 } else { 1.0 };
    let (x, y, t): (Vector, Vector, Vector) = (x * scale * sign, y * scale * sign, t * scale * sign);
    let svd = Matrix3::from_columns(&[x, y, x.cross(&y)]).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    // A view from behind has a negative determinant.
    let proper = rotation.determinant() > 0.0 && t.z > 0.0 && rotation.iter().chain(t.iter()).all(|v| v.is_finite());
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    proper.then(|| Isometry::from_parts(Translation3::from(t), rotation))
}
