//! The real subset of YCB-Sight, **unverified**: written from descriptions of the release and of the loaders of others; no sample was at hand.
//!
//! Expected: `gelsight/gelsight_<i>_<stamp>.jpg`, even i without and odd i with contact; `pc/*.npy`, N × 3, metres, camera frame;
//! `robot.csv`, whose lines end with x, y, z, qx, qy, qz, qw of the gripper (world frame) for each image; `tf.json` with `world2azure` and
//! `gripper2gelsight` as x, y, z, qx, qy, qz, qw.

use crate::cloud::project;
use crate::{ImportError, Imported};
use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use palpate::geometry::{Isometry, Point};
use palpate::io::{pose, read_color, read_npy, read_text};
use palpate::scene::{PoseSigma, Scene};
use palpate::tactile::{TactileSensor, Touch};
use std::path::{Path, PathBuf};

/// A scene with its touches.
///
/// * `camera` – into whose raster the cloud is put
///
/// # Errors
/// [`ImportError`].
pub fn import_ycb_sight_real(folder: &Path, camera: &PinholeCamera) -> Result<Imported, ImportError> {
    let fault = |reason: String| ImportError::Folder { path: folder.to_owned(), reason };
    let tf_path = folder.join("tf.json");
    let tf: serde_json::Value = serde_json::from_str(&read_text(&tf_path)?).map_err(|e| ImportError::Malformed {
        path: tf_path.clone(),
        format: "tf.json",
        reason: e.to_string(),
    })?;
    let transform = |key: &str| -> Result<Isometry, ImportError> {
        let wrong = |reason: String| ImportError::Malformed { path: tf_path.clone(), format: "tf.json", reason };
        let numbers: Vec<f64> = serde_json::from_value(tf.get(key).cloned().unwrap_or_default())
            .map_err(|_| wrong(format!("'{key}' must be the list x, y, z, qx, qy, qz, qw")))?;
        seven(&numbers).map_err(|e| wrong(format!("'{key}': {e}")))
    };
    let (world_from_camera, gripper_from_sensor) = (transform("world2azure")?, transform("gripper2gelsight")?);
    let cloud_path = sorted(&folder.join("pc"), "npy")?.into_iter().next();
    let cloud_path = cloud_path.ok_or_else(|| fault("pc/ holds no .npy".to_owned()))?;
    let cloud = read_npy(&cloud_path)?;
    if cloud.shape.len() != 2 || cloud.shape[1] != 3 {
        return Err(ImportError::Value(format!(
            "{}: the shape is {:?}; (N, 3) is needed",
            cloud_path.display(),
            cloud.shape
        )));
    }
    let points: Vec<Point> =
        cloud.values.chunks_exact(3).map(|p| Point::new(p[0], p[1], p[2])).filter(|p| p.z.is_finite()).collect();
    let (depth, _, seen) = project(&points, None, camera, &Isometry::identity());
    if seen == 0 {
        return Err(ImportError::Value(format!("{}: no point is in the camera's view", cloud_path.display())));
    }
    let poses = robot(&folder.join("robot.csv"))?;
    let images = sorted(&folder.join("gelsight"), "jpg")?;
    let mut numbered: Vec<(usize, PathBuf)> = Vec::new();
    for path in images {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.split('_').nth(1).and_then(|n| n.parse().ok());
        numbered
            .push((number.ok_or_else(|| fault(format!("gelsight/{stem}.jpg is not gelsight_<i>_<stamp>.jpg")))?, path));
    }
    numbered.sort();
    let mut touches = Vec::new();
    for (number, path) in numbered.iter().filter(|(n, _)| !n.is_multiple_of(2)) {
        let gripper = poses.get(*number).ok_or_else(|| fault(format!("robot.csv has no pose for image {number}")))?;
        touches.push(Touch {
            contact: None,
            image: Some(read_color(path)?),
            world_from_sensor: gripper * gripper_from_sensor,
        });
    }
    let background =
        numbered.iter().find(|(n, _)| n.is_multiple_of(2)).map(|(_, path)| read_color(path)).transpose()?;
    let frame = Frame {
        camera: *camera,
        world_from_camera,
        depth,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
        color: None,
        mask: None,
        support: None,
    };
    let name = folder.file_name().map_or_else(|| "ycb-sight".to_owned(), |n| n.to_string_lossy().into_owned());
    let sensor = TactileSensor::preset("ycb-sight").ok();
    let scene = Scene { name, frame, sensor, pose_sigma: PoseSigma::default(), touches };
    let warnings = vec![
        "the reader of the real YCB-Sight is unverified: no sample of it was at hand when it was written".to_owned(),
    ];
    Ok(Imported { scene, tactile_background: background, warnings })
}

fn seven(numbers: &[f64]) -> Result<Isometry, String> {
    match numbers[..] {
        [x, y, z, qx, qy, qz, qw] => pose([x, y, z], [qx, qy, qz, qw]),
        _ => Err(format!("{} numbers; x, y, z, qx, qy, qz, qw are needed", numbers.len())),
    }
}

fn sorted(folder: &Path, extension: &str) -> Result<Vec<PathBuf>, ImportError> {
    let read = |source| ImportError::Read { path: folder.to_owned(), source };
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension)) {
            all.push(path);
        }
    }
    all.sort();
    Ok(all)
}

/// The last seven numbers of each line; a line of words is a heading.
fn robot(path: &Path) -> Result<Vec<Isometry>, ImportError> {
    let mut poses = Vec::new();
    for (i, line) in read_text(path)?.lines().enumerate() {
        let fields: Vec<Option<f64>> = line.split(',').map(|f| f.trim().parse().ok()).collect();
        let last: Option<Vec<f64>> = fields.iter().rev().take(7).rev().copied().collect();
        match last.filter(|l| l.len() == 7) {
            Some(numbers) => poses.push(seven(&numbers).map_err(|e| ImportError::Malformed {
                path: path.to_owned(),
                format: "robot.csv",
                reason: format!("line {}: {e}", i + 1),
            })?),
            None if poses.is_empty() || line.trim().is_empty() => {}
            None => {
                let reason = format!("line {} does not end with seven numbers", i + 1);
                return Err(ImportError::Malformed { path: path.to_owned(), format: "robot.csv", reason });
            }
        }
    }
    Ok(poses)
}
