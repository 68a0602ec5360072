use crate::{ImportError, Imported};
use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use palpate::geometry::{Isometry, Point, Raster};
use palpate::scene::{PoseSigma, Scene};

/// A scene from a cloud without a raster: each point falls on its pixel of a camera that looked from the given pose, the nearest counts.
///
/// Pixels between points have no reading, and no reading means that nothing is known. Choose a camera no finer than the cloud.
///
/// * `points` – world frame, metres, with colours if there are some
///
/// # Errors
/// [`ImportError::Value`] if no point is in view.
pub fn import_cloud(
    name: &str,
    points: &[Point],
    colors: Option<&[[u8; 3]]>,
    camera: &PinholeCamera,
    world_from_camera: &Isometry,
) -> Result<Imported, ImportError> {
    camera.validate().map_err(|e| ImportError::Value(e.to_string()))?;
    let (depth, color, seen) = project(points, colors, camera, &world_from_camera.inverse());
    if seen == 0 {
        let reason = format!(
            "none of the cloud's {} points is in the camera's view; is the pose world_from_camera?",
            points.len()
        );
        return Err(ImportError::Value(reason));
    }
    let mut warnings = Vec::new();
    let readings = depth.as_slice().iter().filter(|z| z.is_finite()).count();
    if readings * 20 < depth.as_slice().len() {
        warnings.push(format!(
            "{readings} of {} pixels have a reading: a coarser camera would fit this cloud",
            depth.as_slice().len()
        ));
    }
    if seen < points.len() {
        warnings.push(format!("{} of {} points are outside the camera's view", points.len() - seen, points.len()));
    }
    let frame = Frame {
        camera: *camera,
        world_from_camera: *world_from_camera,
        depth,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
        color,
        mask: None,
        support: None,
    };
    let scene =
        Scene { name: name.to_owned(), frame, sensor: None, pose_sigma: PoseSigma::default(), touches: Vec::new() };
    Ok(Imported { scene, tactile_background: None, warnings })
}

/// Depth and colours of the nearest points, and how many points are in view.
pub(crate) fn project(
    points: &[Point],
    colors: Option<&[[u8; 3]]>,
    camera: &PinholeCamera,
    camera_from_world: &Isometry,
) -> (Raster<f32>, Option<Raster<[u8; 3]>>, usize) {
    let mut depth = Raster::filled(camera.height, camera.width, f32::NAN);
    let mut picture = colors.map(|_| Raster::filled(camera.height, camera.width, [0; 3]));
    let mut seen = 0;
    for (i, point) in points.iter().enumerate() {
        let p = camera_from_world * point;
        let Some((u, v)) = camera.project(&p).filter(|&(u, v)| camera.contains(u, v)) else { continue };
        seen += 1;
        let at = (v.round().max(0.0) as usize, u.round().max(0.0) as usize);
        let old = depth[at];
        if old.is_nan() || p.z < f64::from(old) {
            depth[at] = p.z as f32;
            if let (Some(picture), Some(colors)) = (&mut picture, colors) {
                picture[at] = colors[i];
            }
        }
    }
    (depth, picture, seen)
}
