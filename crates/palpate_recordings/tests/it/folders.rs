//! Folders of data sets, made as their descriptions say.

use palpate::camera::PinholeCamera;
use palpate::geometry::{Isometry, Point, Raster, Vector};
use palpate::io::{write_color, write_depth_png, write_mask, write_npy};
use palpate_recordings::{BopFrame, import_bop, import_cloud, import_tum, import_ycb_sight_real};
use std::path::Path;
use tempfile::TempDir;

const CAMERA: PinholeCamera =
    PinholeCamera { width: 16, height: 12, fx: 20.0, fy: 20.0, cx: 7.5, cy: 5.5, distortion: [0.0; 5] };

fn put(folder: &Path, file: &str, text: &str) {
    let path = folder.join(file);
    std::fs::create_dir_all(path.parent().expect("a parent")).expect("made");
    std::fs::write(path, text).expect("written");
}

fn depth() -> Raster<f32> {
    Raster::from_fn(12, 16, |r, c| 0.5 + 0.01 * r as f32 + 0.002 * c as f32)
}

fn tum() -> TempDir {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path();
    put(path, "depth.txt", "# depth maps\n1.000 depth/a.png\n2.000 depth/b.png\n");
    put(path, "rgb.txt", "# colour\n1.010 rgb/a.png\n");
    put(path, "groundtruth.txt", "# poses\n1.005 0.1 0.2 0.3 0 0 0 1\n2.001 0.4 0.5 0.6 1 0 0 0\n");
    for part in ["depth", "rgb"] {
        std::fs::create_dir_all(path.join(part)).expect("made");
    }
    write_depth_png(path.join("depth/a.png"), &depth(), 1.0 / 5000.0).expect("written");
    write_depth_png(path.join("depth/b.png"), &depth(), 1.0 / 5000.0).expect("written");
    write_color(path.join("rgb/a.png"), &Raster::filled(12, 16, [9, 8, 7])).expect("written");
    folder
}

#[test]
fn a_frame_of_tum_is_read_in_fifth_millimetres() {
    let folder = tum();
    let first = import_tum(folder.path(), None, &CAMERA).expect("a frame");
    let frame = &first.scene.frame;
    assert!((frame.depth[(3, 4)] - depth()[(3, 4)]).abs() < 2e-4, "{}", frame.depth[(3, 4)]);
    assert_eq!(frame.color.as_ref().expect("near enough")[(0, 0)], [9, 8, 7]);
    assert_eq!(frame.world_from_camera.translation.vector, Vector::new(0.1, 0.2, 0.3));
    let second = import_tum(folder.path(), Some(2.0), &CAMERA).expect("a frame");
    assert!(second.scene.frame.color.is_none() && second.warnings[0].contains("rgb.txt has nothing within"));
    std::fs::rename(folder.path().join("groundtruth.txt"), folder.path().join("lost.txt")).expect("there");
    let lost = import_tum(folder.path(), None, &CAMERA).expect("a frame");
    assert_eq!(lost.warnings, ["there is no groundtruth.txt: the world is the camera's frame"]);
    std::fs::rename(folder.path().join("lost.txt"), folder.path().join("groundtruth.txt")).expect("there");
    let fails = |time| import_tum(folder.path(), Some(time), &CAMERA).expect_err("no such frame").to_string();
    assert!(fails(3.0).contains("nothing within 0.02 s of 3; the nearest is 2"), "{}", fails(3.0));
    put(folder.path(), "depth.txt", "now depth/a.png\n");
    assert!(fails(1.0).contains("line 1: 'now depth/a.png'"), "{}", fails(1.0));
    let other = PinholeCamera { width: 640, ..CAMERA };
    put(folder.path(), "depth.txt", "1.0 depth/a.png\n");
    let size = import_tum(folder.path(), None, &other).expect_err("another camera").to_string();
    assert!(size.contains("a.png is 16×12 px, the camera 640×12"), "{size}");
}

#[test]
fn a_frame_of_bop_is_read_in_its_units() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path();
    let camera = r#"{"0": {"cam_K": [20.0, 0.0, 7.5, 0.0, 20.0, 5.5, 0.0, 0.0, 1.0], "depth_scale": 0.1,
        "cam_R_w2c": [1, 0, 0, 0, -1, 0, 0, 0, -1], "cam_t_w2c": [0.0, 0.0, 700.0]}}"#;
    put(path, "scene_camera.json", camera);
    for part in ["depth", "rgb", "mask_visib"] {
        std::fs::create_dir_all(path.join(part)).expect("made");
    }
    write_depth_png(path.join("depth/000000.png"), &depth(), 1e-4).expect("written");
    write_color(path.join("rgb/000000.png"), &Raster::filled(12, 16, [9, 8, 7])).expect("written");
    write_mask(path.join("mask_visib/000000_000001.png"), &Raster::from_fn(12, 16, |r, _| r > 5)).expect("written");
    let imported = import_bop(path, BopFrame { image: 0, object: Some(1) }).expect("a frame");
    let frame = &imported.scene.frame;
    assert!((frame.depth[(3, 4)] - depth()[(3, 4)]).abs() < 1e-4);
    assert!((frame.world_from_camera.translation.vector - Vector::new(0.0, 0.0, 0.7)).norm() < 1e-12);
    assert!(frame.mask.as_ref().expect("asked for")[(6, 0)]);
    let fails = |image, object| import_bop(path, BopFrame { image, object }).expect_err("wrong").to_string();
    assert!(fails(7, None).contains("has no image 7; there are 0"), "{}", fails(7, None));
    assert!(fails(0, Some(3)).contains("mask_visib/000000_000003.png is missing"), "{}", fails(0, Some(3)));
    assert!(imported.warnings.is_empty());
    put(
        path,
        "scene_camera.json",
        r#"{"0": {"cam_K": [20.0, 0.0, 7.5, 0.0, 20.0, 5.5, 0.0, 0.0, 1.0], "depth_scale": 0.1}}"#,
    );
    let nowhere = import_bop(path, BopFrame { image: 0, object: None }).expect("a frame");
    assert!(nowhere.warnings[0].contains("no cam_R_w2c and cam_t_w2c of image 0: the world is the camera's frame"));
    put(path, "scene_camera.json", "{\"0\": {}}");
    assert!(fails(0, None).contains("cam_K"), "{}", fails(0, None));
}

#[test]
fn a_cloud_falls_on_the_pixels_of_a_camera() {
    let pose = Isometry::translation(0.0, 0.0, -0.2);
    let points =
        [Point::new(0.0, 0.0, 0.3), Point::new(0.0, 0.0, 0.4), Point::new(0.05, 0.0, 0.3), Point::new(9.0, 0.0, 0.3)];
    let colors = [[1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]];
    let imported = import_cloud("cloud", &points, Some(&colors), &CAMERA, &pose).expect("in view");
    let frame = &imported.scene.frame;
    // (7.5, 5.5) rounds up; the nearer of two points counts.
    assert_eq!((frame.depth[(6, 8)], frame.color.as_ref().expect("coloured")[(6, 8)]), (0.5, [1, 0, 0]));
    assert!(frame.depth[(6, 10)].is_finite());
    assert!(imported.warnings.iter().any(|w| w.contains("1 of 4 points are outside")), "{:?}", imported.warnings);
    let behind = import_cloud("cloud", &points, None, &CAMERA, &Isometry::translation(0.0, 0.0, 5.0));
    assert!(behind.expect_err("behind").to_string().contains("none of the cloud's 4 points"));
}

/// Made from descriptions of the release; no sample of it was at hand, so this proves only that reader and description agree.
#[test]
fn the_real_ycb_sight_as_described_unverified() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path();
    let tf = r#"{"world2azure": [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], "world2object": [0, 0, 0, 0, 0, 0, 1],
        "gripper2gelsight": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]}"#;
    put(path, "tf.json", tf);
    put(
        path,
        "robot.csv",
        "t,x,y,z,qx,qy,qz,qw\n0,0.1,0,0.5,0,0,0,1\n1,0.2,0,0.5,1,0,0,0\n2,0.3,0,0.5,0,0,0,1\n3,0.4,0,0.5,0,0,0,1\n",
    );
    for part in ["gelsight", "pc"] {
        std::fs::create_dir_all(path.join(part)).expect("made");
    }
    for i in 0..4u8 {
        let image = Raster::filled(48, 64, [10 * i, 90, 90]);
        palpate::io::write_jpeg(path.join(format!("gelsight/gelsight_{i}_17{i}.jpg")), &image, 95).expect("written");
    }
    write_npy(path.join("pc/pc_0_17.npy"), &[2, 3], &[0.0, 0.0, 0.9, 0.05, 0.0, 0.9]).expect("written");
    let imported = import_ycb_sight_real(path, &CAMERA).expect("as described");
    let touches = &imported.scene.touches;
    assert_eq!(touches.len(), 2, "odd images are contacts");
    assert!((touches[0].world_from_sensor.translation.vector - Vector::new(0.2, 0.0, 0.4)).norm() < 1e-12);
    assert!(imported.warnings[0].contains("unverified"));
    std::fs::remove_file(path.join("tf.json")).expect("there");
    assert!(import_ycb_sight_real(path, &CAMERA).expect_err("no tf").to_string().contains("tf.json"));
}
