//! Segments real RGB-D frames, compares with what is known of them and draws what was found: the tables and pictures of
//! `docs/real-frames.md`. Usage: `real_frames DATA [PICTURES]`, DATA holding `rgbd/NAME/{frame.json, …}`.

use palpate::camera::{
    Background, CleanCloud, DepthNoise, Frame, PinholeCamera, SegmentParams, Visible, clean_cloud, segment_object,
};
use palpate::geometry::{Isometry, KdTree, Plane, Point, PointCloud, Raster, Vector};
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
        "| frame | pick | pixels | points | support tilt ° | border share | time ms | against |\n|---|---|---|---|---|---|---|---|"
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
            comparison(&folder, &visible, &cloud)?
        );
        if let Some(pictures) = &pictures {
            std::fs::create_dir_all(pictures)?;
            let file = format!("{name}{}.png", pick.map_or_else(String::new, |(u, v)| format!("_{u}_{v}")));
            io::write_color(pictures.join(file), &picture(&frame, &visible, &cloud))?;
        }
    }
    clouds(&data.join("clouds"), pictures.as_deref())
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
fn comparison(folder: &Path, visible: &Visible, cloud: &PointCloud) -> Result<String, Box<dyn Error>> {
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
    let eye = frame.world_from_camera * Point::origin();
    side_by_side(&classified(frame, visible), &from_the_side(&eye, visible.support, cloud), 2)
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

/// Orthographic splats, table up, the line is the support plane; from 70° beside the sensor's direction.
fn from_the_side(eye: &Point, support: Option<Plane>, cloud: &PointCloud) -> Raster<[u8; 3]> {
    let Some(bounds) = cloud.bounds() else { return Raster::filled(240, 320, [255; 3]) };
    let up = support.map_or(-Vector::y(), |s| s.normal.into_inner());
    let to_eye = eye - bounds.center();
    let flat = (to_eye - up * up.dot(&to_eye)).try_normalize(1e-6).unwrap_or_else(Vector::x);
    let toward = flat * 70.0_f64.to_radians().cos() + up.cross(&flat) * 70.0_f64.to_radians().sin();
    let mut image = Raster::filled(240, 320, [255; 3]);
    let view = View { center: bounds.center(), up, toward, scale: 200.0 / bounds.diagonal() };
    if let Some(support) = support {
        let row = view.place(&(view.center - up * support.signed_distance(&view.center))).0;
        for col in 0..320 {
            if (0.0..239.0).contains(&row) {
                image[(row as usize, col)] = [160, 110, 60];
            }
        }
    }
    view.splat(&mut image, cloud);
    image
}

/// An orthographic camera.
struct View {
    center: Point,
    up: Vector,
    toward: Vector,
    /// Pixels per metre.
    scale: f64,
}

impl View {
    fn place(&self, p: &Point) -> (f64, f64, f64) {
        let d = p - self.center;
        let right = self.up.cross(&self.toward);
        (120.0 - self.scale * d.dot(&self.up), 160.0 + self.scale * d.dot(&right), d.dot(&self.toward))
    }

    /// Colour and brightness follow the normal; points without one are grey.
    fn splat(&self, image: &mut Raster<[u8; 3]>, cloud: &PointCloud) {
        let mut nearest = Raster::filled(240, 320, f64::NEG_INFINITY);
        let light_from = (self.toward + self.up * 0.5).normalize();
        for (i, p) in cloud.points.iter().enumerate() {
            let (row, col, near) = self.place(p);
            let color = cloud.normals.as_ref().map_or([190; 3], |normals| {
                let n = normals[i];
                let light = 0.35 + 0.65 * n.dot(&light_from).abs();
                [n.x, n.y, n.z].map(|c| ((127.5 - 60.0 * c) * light).clamp(0.0, 255.0) as u8)
            });
            for (r, c) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)].map(|(r, c)| (row + r, col + c)) {
                if (0.0..240.0).contains(&r) && (0.0..320.0).contains(&c) && near > nearest[(r as usize, c as usize)] {
                    nearest[(r as usize, c as usize)] = near;
                    image[(r as usize, c as usize)] = color;
                }
            }
        }
    }
}

/// The PCD clouds: left the whole cloud in grey with the object on it as the sensor sees it, right the object from the side.
fn clouds(folder: &Path, pictures: Option<&Path>) -> Result<(), Box<dyn Error>> {
    println!("\n| cloud | points | finite | kept | support | time ms |\n|---|---|---|---|---|---|");
    for name in ["table_scene_mug_stereo_textured", "rosindustrial_table", "milk_color", "bun0"] {
        let all = io::read_cloud(folder.join(name).with_extension("pcd"))?;
        let eye = Point::origin();
        let start = Instant::now();
        let clean = clean_cloud(&all, &eye, &SegmentParams::default());
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let finite = all.filtered(|i| all.points[i].iter().all(|c| c.is_finite()));
        match clean {
            Err(error) => println!("| {name} | {} | {} | failed: {error} | | |", all.len(), finite.len()),
            Ok(clean) => {
                let support = clean.support.map_or("none".to_owned(), |s| format!("{:.2?}", s.normal.as_slice()));
                println!("| {name} | {} | {} | {} | {support} | {ms:.0} |", all.len(), finite.len(), clean.cloud.len());
                if let Some(pictures) = pictures {
                    let left = from_the_sensor(&eye, &finite, &clean);
                    let right = from_the_side(&eye, clean.support, &clean.cloud);
                    io::write_color(pictures.join(format!("{name}.png")), &side_by_side(&left, &right, 1))?;
                }
            }
        }
    }
    Ok(())
}

fn from_the_sensor(eye: &Point, all: &PointCloud, clean: &CleanCloud) -> Raster<[u8; 3]> {
    let mut image = Raster::filled(240, 320, [0; 3]);
    let Some(bounds) = clean.cloud.bounds() else { return image };
    let toward = (eye - bounds.center()).normalize();
    let up = clean.support.map_or(-Vector::y(), |s| s.normal.into_inner());
    let up = (up - toward * toward.dot(&up)).normalize();
    let view = View { center: bounds.center(), up, toward, scale: 90.0 / bounds.diagonal() };
    view.splat(&mut image, &PointCloud { normals: None, ..all.clone() });
    view.splat(&mut image, &clean.cloud);
    image
}

fn side_by_side(left: &Raster<[u8; 3]>, right: &Raster<[u8; 3]>, shrink: usize) -> Raster<[u8; 3]> {
    Raster::from_fn(
        240,
        640,
        |row, col| {
            if col < 320 { left[(shrink * row, shrink * col)] } else { right[(row, col - 320)] }
        },
    )
}
