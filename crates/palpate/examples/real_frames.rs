//! Segments real RGB-D frames, compares with what is known of them and draws what was found: the tables and pictures of
//! `docs/real-frames.md`. Usage: `real_frames DATA [PICTURES]`, DATA holding `rgbd/NAME/{frame.json, …}`.

use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera, SegmentParams, Visible, segment_object};
use palpate::geometry::{Isometry, KdTree, Point, PointCloud, Raster, Vector};
use palpate::io;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Folder, and the pixel to pick.
const FRAMES: [(&str, Option<(f64, f64)>); 17] = [
    ("6dofgraspnet_mustard", None),
    ("6dofgraspnet_white_mug", None),
    ("6dofgraspnet_green_bowl", None),
    ("6dofgraspnet_cheezit", None),
    ("gqcnn_primesense_0", None),
    ("gqcnn_primesense_1", None),
    ("gqcnn_primesense_2", None),
    ("posecnn_demo_0", Some((235.0, 180.0))),
    ("posecnn_demo_0", Some((430.0, 160.0))),
    ("posecnn_demo_0", Some((530.0, 310.0))),
    ("posecnn_demo_0", Some((170.0, 380.0))),
    ("posecnn_demo_0", Some((375.0, 350.0))),
    ("posecnn_demo_1", Some((268.0, 216.0))),
    ("posecnn_demo_1", Some((345.0, 245.0))),
    ("posecnn_demo_1", Some((500.0, 230.0))),
    ("posecnn_demo_1", Some((365.0, 405.0))),
    ("posecnn_demo_1", Some((220.0, 375.0))),
];

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).map(PathBuf::from);
    let data = arguments.next().ok_or("usage: real_frames DATA [PICTURES]")?;
    let pictures = arguments.next();
    println!(
        "| frame | pick | pixels | points | support tilt ° | margin of border | time ms | against |\n|---|---|---|---|---|---|---|---|"
    );
    for (name, pick) in FRAMES {
        let folder = data.join("rgbd").join(name);
        let frame = read_frame(&folder)?;
        let params = SegmentParams { pick, ..SegmentParams::default() };
        let start = Instant::now();
        let result = segment_object(&frame, &params);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let label = pick.map_or_else(String::new, |(u, v)| format!("{u},{v}"));
        let visible = match result {
            Ok(visible) => visible,
            Err(error) => {
                println!("| {name} | {label} | failed: {error} |");
                continue;
            }
        };
        let cloud = visible.cloud(&frame);
        let tilt = visible.support.map_or(f64::NAN, |s| s.normal.z.abs().acos().to_degrees());
        println!(
            "| {name} | {label} | {} | {} | {tilt:.1} | {:.3} | {ms:.0} | {} |",
            visible.mask.as_slice().iter().filter(|m| **m).count(),
            cloud.len(),
            visible.border_share,
            comparison(&folder, &frame, &visible, &cloud)?
        );
        if let Some(pictures) = &pictures {
            std::fs::create_dir_all(pictures)?;
            let file = format!("{name}{}.png", pick.map_or_else(String::new, |(u, v)| format!("_{u}_{v}")));
            io::write_color(pictures.join(file), &picture(&frame, &visible, &cloud))?;
        }
    }
    Ok(())
}

fn read_frame(folder: &Path) -> Result<Frame, Box<dyn Error>> {
    let json: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(folder.join("frame.json"))?)?;
    let number = |key: &str| json[key].as_f64().ok_or_else(|| format!("{key} is missing"));
    let camera = PinholeCamera {
        width: number("width")? as usize,
        height: number("height")? as usize,
        fx: number("fx")?,
        fy: number("fy")?,
        cx: number("cx")?,
        cy: number("cy")?,
        distortion: [0.0; 5],
    };
    Ok(Frame {
        camera,
        world_from_camera: Isometry::identity(),
        depth: io::read_depth_png(folder.join("depth_0.1mm_u16.png"), 1e-4)?,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
        color: Some(io::read_color(folder.join("rgb.png"))?),
        mask: None,
        support: None,
    })
}

/// Against the data set's own object mask (`IoU`) or its segmented cloud (mean distances both ways).
fn comparison(folder: &Path, frame: &Frame, visible: &Visible, cloud: &PointCloud) -> Result<String, Box<dyn Error>> {
    if folder.join("mask_object.png").exists() {
        let truth = io::read_mask(folder.join("mask_object.png"))?;
        let pairs = || visible.mask.as_slice().iter().zip(truth.as_slice());
        let both = pairs().filter(|(a, b)| **a && **b).count() as f64;
        let either = pairs().filter(|(a, b)| **a || **b).count() as f64;
        let recall = both / truth.as_slice().iter().filter(|t| **t).count() as f64;
        return Ok(format!("mask: IoU {:.3}, recall {recall:.3}", both / either));
    }
    if folder.join("object_pc.ply").exists() {
        let truth = io::read_cloud(folder.join("object_pc.ply"))?;
        let mean = |from: &[Point], to: &[Point]| {
            let tree = KdTree::new(to);
            from.iter().filter_map(|p| tree.nearest(p)).map(|f| f.1).sum::<f64>() / from.len() as f64 * 1e3
        };
        let height = |points: &[Point]| {
            let plane = visible.support.expect("a table");
            let mut h: Vec<f64> = points.iter().map(|p| plane.signed_distance(p) * 1e3).collect();
            h.sort_by(f64::total_cmp);
            (h[h.len() / 100], h[h.len() - 1 - h.len() / 100])
        };
        let _ = frame;
        return Ok(format!(
            "object_pc: {:.2} mm to it, {:.2} mm from it; heights {:.1?} mm, theirs {:.1?}",
            mean(&cloud.points, &truth.points),
            mean(&truth.points, &cloud.points),
            height(&cloud.points),
            height(&truth.points)
        ));
    }
    Ok(String::new())
}

/// Left: what every pixel was taken for. Right: the cleaned cloud from another side.
fn picture(frame: &Frame, visible: &Visible, cloud: &PointCloud) -> Raster<[u8; 3]> {
    let left = classified(frame, visible);
    let right = from_the_side(frame, visible, cloud);
    Raster::from_fn(240, 640, |row, col| if col < 320 { left[(2 * row, 2 * col)] } else { right[(row, col - 320)] })
}

fn classified(frame: &Frame, visible: &Visible) -> Raster<[u8; 3]> {
    let points = frame.unproject();
    Raster::from_fn(frame.camera.height, frame.camera.width, |row, col| {
        let p = points[(row, col)];
        let n = visible.normals[(row, col)];
        if n != [0.0; 3] {
            n.map(|c| (127.5 - 127.5 * c) as u8)
        } else if visible.mask[(row, col)] {
            [255, 255, 0]
        } else if p.z.is_nan() {
            [0, 0, 0]
        } else {
            match visible.support.map(|s| s.signed_distance(&p)) {
                Some(h) if h.abs() < 0.01 => [70, 70, 70],
                Some(h) if h > 0.0 => [40, 40, 90],
                _ => [30, 30, 30],
            }
        }
    })
}

/// Orthographic splats seen from the object's side, table up; brightness follows the normal, the line is the support plane.
fn from_the_side(frame: &Frame, visible: &Visible, cloud: &PointCloud) -> Raster<[u8; 3]> {
    let mut image = Raster::filled(240, 320, [255u8; 3]);
    let (Some(bounds), Some(normals)) = (cloud.bounds(), &cloud.normals) else { return image };
    let up = visible.support.map_or(-Vector::y(), |s| s.normal.into_inner());
    let towards_camera = frame.world_from_camera.translation.vector - bounds.center().coords;
    let flat = (towards_camera - up * up.dot(&towards_camera)).try_normalize(1e-6).unwrap_or_else(Vector::x);
    // Look from 70° to the left of the camera, level with the table.
    let side = up.cross(&flat);
    let toward = flat * 70.0_f64.to_radians().cos() + side * 70.0_f64.to_radians().sin();
    let right = up.cross(&toward);
    let scale = 200.0 / bounds.diagonal();
    let mut depth = Raster::filled(240, 320, f64::NEG_INFINITY);
    let place = |p: &Point| {
        let d = p - bounds.center();
        (120.0 - scale * d.dot(&up), 160.0 + scale * d.dot(&right), d.dot(&toward))
    };
    if let Some(support) = visible.support {
        let row = place(&(bounds.center() - up * support.signed_distance(&bounds.center()))).0;
        for col in 0..320 {
            if (0.0..239.0).contains(&row) {
                image[(row as usize, col)] = [160, 110, 60];
            }
        }
    }
    for (p, n) in cloud.points.iter().zip(normals) {
        let (row, col, near) = place(p);
        for (r, c) in
            [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)].map(|(r, c)| ((row + r) as usize, (col + c) as usize))
        {
            if r < 240 && c < 320 && near > depth[(r, c)] {
                depth[(r, c)] = near;
                let light = n.dot(&(toward + up * 0.5).normalize()).abs();
                let [red, green, blue] = [n.x, n.y, n.z].map(|c| 127.5 - 60.0 * c);
                image[(r, c)] = [red, green, blue].map(|c| (c * (0.35 + 0.65 * light)).clamp(0.0, 255.0) as u8);
            }
        }
    }
    image
}
