//! Scene folders of the BOP benchmark: `scene_camera.json`, `depth/`, `rgb/`, `mask_visib/`, `scene_gt.json`; millimetres.

use crate::{ImportError, Imported};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera};
use palpate::geometry::Isometry;
use palpate::io::{read_color, read_depth_png, read_mask, read_text};
use palpate::scene::{PoseSigma, Scene};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Which frame and which object.
#[derive(Debug, Clone, Copy, Default)]
pub struct BopFrame {
    /// Number of the image.
    pub image: u32,
    /// Which of the objects listed for it has the mask; `None` for no mask.
    pub object: Option<usize>,
}

#[derive(Deserialize)]
struct Camera {
    #[serde(rename = "cam_K")]
    k: [f64; 9],
    #[serde(default = "one")]
    depth_scale: f64,
    #[serde(rename = "cam_R_w2c")]
    rotation: Option<[f64; 9]>,
    #[serde(rename = "cam_t_w2c")]
    translation: Option<[f64; 3]>,
}

fn one() -> f64 {
    1.0
}

/// A scene without touches from one image.
///
/// # Errors
/// [`ImportError`].
pub fn import_bop(folder: &Path, frame: BopFrame) -> Result<Imported, ImportError> {
    let list = folder.join("scene_camera.json");
    let cameras: BTreeMap<String, Camera> = serde_json::from_str(&read_text(&list)?).map_err(|e| {
        ImportError::Malformed { path: list.clone(), format: "scene_camera.json", reason: e.to_string() }
    })?;
    let key = frame.image.to_string();
    let camera = cameras.get(&key).ok_or_else(|| {
        let known: Vec<&str> = cameras.keys().take(8).map(String::as_str).collect();
        ImportError::Value(format!("{} has no image {key}; there are {}, …", list.display(), known.join(", ")))
    })?;
    let file = |part: &str, stem: &str| {
        let found = ["png", "jpg", "tif"].map(|e| folder.join(part).join(format!("{stem}.{e}")));
        found.into_iter().find(|p| p.is_file())
    };
    let stem = format!("{:06}", frame.image);
    let missing =
        |part: &str| ImportError::Folder { path: folder.to_owned(), reason: format!("{part}/{stem}.png is missing") };
    let depth_path: PathBuf = file("depth", &stem).ok_or_else(|| missing("depth"))?;
    // Depth in units of depth_scale millimetres.
    let depth = read_depth_png(&depth_path, camera.depth_scale * 1e-3)?;
    let color = file("rgb", &stem).map(read_color).transpose()?;
    let mask = match frame.object {
        None => None,
        Some(object) => {
            let stem = format!("{:06}_{object:06}", frame.image);
            let path = file("mask_visib", &stem).or_else(|| file("mask", &stem));
            Some(read_mask(path.ok_or_else(|| {
                let reason = format!("mask_visib/{stem}.png is missing: is there an object {object} in image {key}?");
                ImportError::Folder { path: folder.to_owned(), reason }
            })?)?)
        }
    };
    let [fx, _, cx, _, fy, cy, ..] = camera.k;
    let pinhole = PinholeCamera { width: depth.cols(), height: depth.rows(), fx, fy, cx, cy, distortion: [0.0; 5] };
    pinhole.validate().map_err(|e| ImportError::Value(format!("{}: image {key}: {e}", list.display())))?;
    let mut warnings = Vec::new();
    let world_from_camera = if let (Some(r), Some(t)) = (camera.rotation, camera.translation) {
        let rotation = Rotation3::from_matrix_eps(&Matrix3::from_row_slice(&r), 1e-12, 100, Rotation3::identity());
        let t = Translation3::new(t[0] * 1e-3, t[1] * 1e-3, t[2] * 1e-3);
        Isometry::from_parts(t, UnitQuaternion::from_rotation_matrix(&rotation)).inverse()
    } else {
        warnings.push(format!(
            "scene_camera.json has no cam_R_w2c and cam_t_w2c of image {key}: the world is the camera's frame"
        ));
        Isometry::identity()
    };
    let frame = Frame {
        camera: pinhole,
        world_from_camera,
        depth,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
        color,
        mask,
        support: None,
    };
    frame.validate().map_err(|e| ImportError::Value(format!("{}: image {key}: {e}", folder.display())))?;
    let name = folder.file_name().map_or_else(|| "bop".to_owned(), |n| format!("{}_{stem}", n.to_string_lossy()));
    let scene = Scene { name, frame, sensor: None, pose_sigma: PoseSigma::default(), touches: Vec::new() };
    Ok(Imported { scene, tactile_background: None, warnings })
}
