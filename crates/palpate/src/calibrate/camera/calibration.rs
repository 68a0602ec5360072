use super::bundle::{self, Bundle};
use super::start::{start_camera, start_pose};
use super::{Board, BoardView, CalibrationError, Fixed};
use crate::camera::{CameraError, PinholeCamera};
use crate::geometry::{Isometry, Vector};

/// Views needed.
const LEAST_VIEWS: usize = 3;
/// Mean shift of the corners under which two views are the same, pixels.
const REPEATED_PX: f64 = 0.5;
/// Corner noise that is assumed at least, pixels: a small residual of few views proves nothing.
const LEAST_NOISE_PX: f64 = 0.05;
/// Relative standard deviation of a focal length from which the views are ill-conditioned.
const FOCAL_LIMIT: f64 = 0.02;
/// The same of the principal point, as a share of the image's width.
const CENTRE_LIMIT: f64 = 0.03;
/// Angle between the boards' normals that is needed, degrees.
const TILT_LIMIT: f64 = 8.0;

/// What to do with views that fit badly.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Outliers {
    /// Name them.
    #[default]
    Keep,
    /// Name them and calibrate without them.
    Drop,
}

/// One standard deviation of each parameter, pixels for the first four.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CameraSigma {
    /// Of fx.
    pub fx: f64,
    /// Of fy.
    pub fy: f64,
    /// Of cx.
    pub cx: f64,
    /// Of cy.
    pub cy: f64,
    /// Of k1 k2 p1 p2 k3.
    pub distortion: [f64; 5],
}

/// A view after calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibratedView {
    /// Where the board was.
    pub camera_from_board: Isometry,
    /// Root mean square distance of its corners, pixels.
    pub rms: f64,
    /// Largest distance, pixels.
    pub worst: f64,
    /// Whether it fits far worse than the others.
    pub outlier: bool,
    /// Whether it was used: it repeats no other, and outliers were not dropped.
    pub used: bool,
}

/// A calibrated camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraCalibration {
    /// The camera.
    pub camera: PinholeCamera,
    /// How sure its parameters are; 0 where fixed.
    pub sigma: CameraSigma,
    /// Root mean square distance over all corners used, pixels.
    pub rms: f64,
    /// Each view, in the order given.
    pub views: Vec<CalibratedView>,
    /// Largest angle between two boards' normals, degrees.
    pub tilts: f64,
    /// Whether k3 was kept though it was not fixed: with it the distortion folds the image over itself.
    pub kept_k3: bool,
}

/// Calibrates a camera from boards in at least three different views.
///
/// * `size` – width and height of the images
/// * `start` – a camera to start from; fixed parameters keep its values
///
/// # Errors
/// [`CalibrationError`]; views that do not determine the camera are an error, not a guess.
pub fn calibrate_camera(
    board: &Board,
    views: &[BoardView],
    size: (usize, usize),
    fixed: Fixed,
    start: Option<&PinholeCamera>,
    outliers: Outliers,
) -> Result<CameraCalibration, CalibrationError> {
    check_corners(board, views)?;
    let mut used = different(views);
    enough(&used)?;
    let problem = Problem { board, views, size, start };
    let (mut found, mut solved) = problem.solve_unfolded(&used, fixed)?;
    let flags = outlying(&found.camera, board, views)?;
    if outliers == Outliers::Drop && flags.iter().zip(&used).any(|(flag, used)| *flag && *used) {
        used.iter_mut().zip(&flags).for_each(|(used, flag)| *used &= !flag);
        enough(&used)?;
        (found, solved) = problem.solve_unfolded(&used, fixed)?;
    }
    let mut calibrated = Vec::with_capacity(views.len());
    for (i, view) in views.iter().enumerate() {
        let fit = fit_pose(&found.camera, board, view, i)?;
        calibrated.push(CalibratedView { outlier: flags[i], used: used[i], ..fit });
    }
    let tilts = tilts(calibrated.iter().filter(|v| v.used).map(|v| v.camera_from_board));
    let corners = (used.iter().filter(|u| **u).count() * board.len()) as f64;
    let sigma = deviations(&found, solved, corners);
    check_conditions(&found.camera, sigma, tilts)?;
    let rms = (found.sum / corners).sqrt();
    let (sigma, kept_k3) = (sigma.unwrap_or_default(), solved.k3 && !fixed.k3);
    Ok(CameraCalibration { camera: found.camera, sigma, rms, views: calibrated, tilts, kept_k3 })
}

fn valid(camera: &PinholeCamera) -> Result<(), CalibrationError> {
    camera.validate().map_err(|error| match error {
        CameraError::NotInvertible { u, v, .. } => CalibrationError::Folded { u, v },
        other => CalibrationError::Camera(other),
    })
}

/// What is to be solved, whichever views are used and whatever is fixed.
#[derive(Clone, Copy)]
struct Problem<'a> {
    board: &'a Board,
    views: &'a [BoardView],
    size: (usize, usize),
    start: Option<&'a PinholeCamera>,
}

impl Problem<'_> {
    /// [`Self::solve`], and again with k3 kept if the lens found folds the image over itself: of few views k3 is the term that runs off. Also
    /// what was fixed in the end.
    fn solve_unfolded(&self, used: &[bool], mut fixed: Fixed) -> Result<(Bundle, Fixed), CalibrationError> {
        let mut found = self.solve(used, fixed)?;
        if !fixed.k3 && valid(&found.camera).is_err() {
            fixed.k3 = true;
            found = self.solve(used, fixed)?;
        }
        if let Err(error) = valid(&found.camera) {
            // Views that determine nothing give a lens that cannot be, too: then that is the reason.
            let corners = (found.poses.len() * self.board.len()) as f64;
            check_conditions(&found.camera, deviations(&found, fixed, corners), tilts(found.poses.iter().copied()))?;
            return Err(error);
        }
        Ok((found, fixed))
    }

    fn solve(&self, used: &[bool], fixed: Fixed) -> Result<Bundle, CalibrationError> {
        let Self { board, views, size, start } = *self;
        let chosen: Vec<BoardView> = views.iter().zip(used).filter(|(_, u)| **u).map(|(v, _)| v.clone()).collect();
        let index: Vec<usize> = (0..views.len()).filter(|&i| used[i]).collect();
        let mut camera = start.copied().unwrap_or_else(|| start_camera(board, &chosen, size));
        (camera.width, camera.height) = size;
        if start.is_none() && fixed.aspect {
            camera.fy = camera.fx;
        }
        let poses =
            chosen.iter().zip(&index).map(|(v, &i)| start_pose(&camera, board, v, i)).collect::<Result<_, _>>()?;
        let found = bundle::refine(&camera, poses, board, &chosen, &fixed.free(camera.fy / camera.fx));
        let rms = (found.sum / (chosen.len() * board.len()) as f64).sqrt();
        // A bad start can run off: distances of boards and focal length grow together without end.
        let usual = size.0.max(size.1) as f64;
        let sane = (0.1 * usual..50.0 * usual).contains(&found.camera.fx) && found.camera.fy > 0.0 && rms.is_finite();
        if !sane {
            let what = format!("the focal length runs off to {:.0} px", found.camera.fx);
            return Err(CalibrationError::IllConditioned { what, tilts: tilts(found.poses.iter().copied()) });
        }
        if !found.converged && rms > 1.0 {
            return Err(CalibrationError::NotConverged { rms, steps: found.steps });
        }
        Ok(found)
    }
}

pub(super) fn check_corners(board: &Board, views: &[BoardView]) -> Result<(), CalibrationError> {
    let needed = board.len();
    match views.iter().position(|v| v.corners.len() != needed) {
        Some(view) => Err(CalibrationError::Corners { view, found: views[view].corners.len(), needed }),
        None => Ok(()),
    }
}

fn enough(used: &[bool]) -> Result<(), CalibrationError> {
    let found = used.iter().filter(|u| **u).count();
    let error = CalibrationError::TooFewViews { found, repeated: used.len() - found, needed: LEAST_VIEWS };
    if found < LEAST_VIEWS { Err(error) } else { Ok(()) }
}

/// Whether each view differs from those before it.
fn different(views: &[BoardView]) -> Vec<bool> {
    let apart = |a: &BoardView, b: &BoardView| {
        let pairs = a.corners.iter().zip(&b.corners);
        pairs.map(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1])).sum::<f64>() / a.corners.len() as f64
    };
    (0..views.len()).map(|i| (0..i).all(|j| apart(&views[i], &views[j]) >= REPEATED_PX)).collect()
}

/// A view's pose with this camera.
pub(super) fn fit_pose(
    camera: &PinholeCamera,
    board: &Board,
    view: &BoardView,
    index: usize,
) -> Result<CalibratedView, CalibrationError> {
    let start = start_pose(camera, board, view, index)?;
    let found = bundle::refine(camera, vec![start], board, std::slice::from_ref(view), &Fixed::ALL.free(1.0));
    let pose = found.poses[0];
    let off = view.corners.iter().enumerate().map(|(i, corner)| {
        let projected = camera.project(&(pose * board.point(i)));
        projected.map_or(f64::INFINITY, |(u, v)| (corner[0] - u).hypot(corner[1] - v))
    });
    let worst = off.fold(0.0, f64::max);
    let rms = (found.sum / board.len() as f64).sqrt();
    Ok(CalibratedView { camera_from_board: pose, rms, worst, outlier: false, used: true })
}

/// Views whose error is over three times the median and over half a pixel.
fn outlying(camera: &PinholeCamera, board: &Board, views: &[BoardView]) -> Result<Vec<bool>, CalibrationError> {
    let fits: Vec<f64> = views
        .iter()
        .enumerate()
        .map(|(i, view)| fit_pose(camera, board, view, i).map(|fit| fit.rms))
        .collect::<Result<_, _>>()?;
    let mut sorted = fits.clone();
    sorted.sort_by(f64::total_cmp);
    let limit = (3.0 * sorted[sorted.len() / 2]).max(0.5);
    Ok(fits.iter().map(|&rms| !(rms <= limit)).collect())
}

/// Largest angle between two boards' normals, degrees.
fn tilts(poses: impl Iterator<Item = Isometry>) -> f64 {
    let normals: Vec<Vector> = poses.map(|p| p.rotation * Vector::z()).collect();
    let mut largest = 0.0f64;
    for (i, a) in normals.iter().enumerate() {
        for b in &normals[..i] {
            largest = largest.max(a.dot(b).clamp(-1.0, 1.0).acos());
        }
    }
    largest.to_degrees()
}

fn deviations(found: &Bundle, fixed: Fixed, corners: f64) -> Option<CameraSigma> {
    let free = fixed.free(found.camera.fy / found.camera.fx);
    if free.ncols() == 0 {
        return Some(CameraSigma::default());
    }
    let unknown = free.ncols() as f64 + 6.0 * found.poses.len() as f64;
    let variance = (found.sum / (2.0 * corners - unknown).max(1.0)).max(LEAST_NOISE_PX.powi(2));
    let covariance = &free * found.intrinsic_cofactor.as_ref()? * free.transpose() * variance;
    let sd = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    let distortion = std::array::from_fn(|i| sd(4 + i));
    Some(CameraSigma { fx: sd(0), fy: sd(1), cx: sd(2), cy: sd(3), distortion })
}

fn check_conditions(camera: &PinholeCamera, sigma: Option<CameraSigma>, tilts: f64) -> Result<(), CalibrationError> {
    let bad = |what: String| Err(CalibrationError::IllConditioned { what, tilts });
    let Some(sigma) = sigma else { return bad("the normal equations are singular".to_owned()) };
    for (name, value, sd) in [("fx", camera.fx, sigma.fx), ("fy", camera.fy, sigma.fy)] {
        // Written so that NaN fails too.
        if !(sd <= FOCAL_LIMIT * value) {
            return bad(format!("{name} is {value:.0} ± {sd:.0} px"));
        }
    }
    for (name, value, sd) in [("cx", camera.cx, sigma.cx), ("cy", camera.cy, sigma.cy)] {
        if !(sd <= CENTRE_LIMIT * camera.width as f64) {
            return bad(format!("{name} is {value:.0} ± {sd:.0} px"));
        }
    }
    if tilts < TILT_LIMIT && sigma.fx > 0.0 {
        return bad("the boards are nearly parallel".to_owned());
    }
    Ok(())
}
