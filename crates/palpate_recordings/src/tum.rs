//! Folders of the TUM RGB-D benchmark: `depth.txt`, `rgb.txt`, `groundtruth.txt`; depth in 1/5000 m.

use crate::{ImportError, Imported};
use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use palpate::geometry::Isometry;
use palpate::io::{pose, read_color, read_depth_png, read_text};
use palpate::scene::{PoseSigma, Scene};
use std::path::Path;

/// Largest time between images, and between an image and a pose, that belong together, seconds.
const APART: f64 = 0.02;

/// A scene without touches from one frame.
///
/// * `time` – the depth image nearest to this stamp (seconds); `None` for the first
/// * `camera` – the benchmark lists one for each of its three
///
/// # Errors
/// [`ImportError`].
pub fn import_tum(folder: &Path, time: Option<f64>, camera: &PinholeCamera) -> Result<Imported, ImportError> {
    let depth_list = list(&folder.join("depth.txt"))?;
    let none = |file: &str| ImportError::Folder { path: folder.to_owned(), reason: format!("{file} lists nothing") };
    let first = depth_list.first().ok_or_else(|| none("depth.txt"))?;
    let wanted = time.unwrap_or(first.0);
    let (stamp, file) = nearest(&depth_list, wanted).ok_or_else(|| none("depth.txt"))?;
    if (stamp - wanted).abs() > APART {
        let reason = format!("depth.txt has nothing within {APART} s of {wanted}; the nearest is {stamp}");
        return Err(ImportError::Folder { path: folder.to_owned(), reason });
    }
    let word = |line: &str| line.split_whitespace().next().unwrap_or_default().to_owned();
    let depth_path = folder.join(word(file));
    let depth = read_depth_png(&depth_path, 1.0 / 5000.0)?;
    if (depth.cols(), depth.rows()) != (camera.width, camera.height) {
        let reason = format!(
            "{} is {}×{} px, the camera {}×{}",
            depth_path.display(),
            depth.cols(),
            depth.rows(),
            camera.width,
            camera.height
        );
        return Err(ImportError::Value(reason));
    }
    let mut warnings = Vec::new();
    let rgb = folder.join("rgb.txt");
    let color = if rgb.is_file() {
        match nearest(&list(&rgb)?, stamp) {
            Some((at, file)) if (at - stamp).abs() <= APART => Some(read_color(folder.join(word(file)))?),
            _ => {
                warnings.push(format!("rgb.txt has nothing within {APART} s of {stamp}: no colour"));
                None
            }
        }
    } else {
        None
    };
    let truth = folder.join("groundtruth.txt");
    let world_from_camera = if truth.is_file() {
        let poses = list(&truth)?;
        match nearest(&poses, stamp) {
            Some((at, line)) if (at - stamp).abs() <= APART => parse_pose(&truth, line)?,
            _ => {
                warnings.push(format!(
                    "groundtruth.txt has nothing within {APART} s of {stamp}: the world is the camera's frame"
                ));
                Isometry::identity()
            }
        }
    } else {
        warnings.push("there is no groundtruth.txt: the world is the camera's frame".to_owned());
        Isometry::identity()
    };
    let frame = Frame {
        camera: *camera,
        world_from_camera,
        depth,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
        color,
        mask: None,
        support: None,
    };
    let name = folder.file_name().map_or_else(|| "tum".to_owned(), |n| n.to_string_lossy().into_owned());
    let scene = Scene { name, frame, sensor: None, pose_sigma: PoseSigma::default(), touches: Vec::new() };
    Ok(Imported { scene, tactile_background: None, warnings })
}

/// Lines of a stamp and what follows it; `#` begins a remark.
fn list(path: &Path) -> Result<Vec<(f64, String)>, ImportError> {
    let text = read_text(path)?;
    let mut all = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let parsed = line.split_once(char::is_whitespace).and_then(|(stamp, rest)| Some((stamp.parse().ok()?, rest)));
        let Some((stamp, rest)) = parsed.filter(|p: &(f64, &str)| p.0.is_finite()) else {
            let reason = format!("line {}: '{line}' is no stamp and what belongs to it", i + 1);
            return Err(ImportError::Malformed { path: path.to_owned(), format: "list of the TUM benchmark", reason });
        };
        all.push((stamp, rest.to_owned()));
    }
    Ok(all)
}

fn nearest(list: &[(f64, String)], time: f64) -> Option<(f64, &str)> {
    let best = list.iter().min_by(|a, b| (a.0 - time).abs().total_cmp(&(b.0 - time).abs()))?;
    Some((best.0, &best.1))
}

fn parse_pose(path: &Path, line: &str) -> Result<Isometry, ImportError> {
    let wrong = |reason: String| ImportError::Malformed { path: path.to_owned(), format: "list of poses", reason };
    let numbers: Vec<f64> = line.split_whitespace().filter_map(|n| n.parse().ok()).collect();
    let [x, y, z, qx, qy, qz, qw] = numbers[..] else {
        return Err(wrong(format!("'{line}' is not tx ty tz qx qy qz qw")));
    };
    pose([x, y, z], [qx, qy, qz, qw]).map_err(wrong)
}
