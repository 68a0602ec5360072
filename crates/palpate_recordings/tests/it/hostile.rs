//! Clouds and compressed images as no driver should send them: an error that names the topic, never a panic or a wrong scene.

use crate::bag::{Cdr, write};
use crate::recording::spec;
use palpate::geometry::Raster;
use palpate::io::{write_color, write_depth_png, write_jpeg};
use palpate_recordings::{ImportError, Imported, RecordingSpec, TouchSource, import_recording};
use std::path::Path;

const FRAME: &str = "camera";

/// `sensor_msgs/msg/PointCloud2` of 2 × 1 points: (0, 0, 0.5) and (0.1, 0, 0.6).
struct Cloud {
    big: bool,
    size: [u32; 2],
    fields: Vec<(&'static str, u32, u8)>,
    point_step: u32,
    row_step: u32,
    data: Vec<u8>,
}

impl Cloud {
    fn new() -> Self {
        let data = [0.0f32, 0.0, 0.5, 0.1, 0.0, 0.6].iter().flat_map(|v| v.to_le_bytes()).collect();
        let fields = vec![("x", 0, 7), ("y", 4, 7), ("z", 8, 7)];
        Self { big: false, size: [1, 2], fields, point_step: 12, row_step: 24, data }
    }

    fn message(&self) -> Vec<u8> {
        let mut cdr = Cdr::new(self.big, 0, FRAME).u32(self.size[0]).u32(self.size[1]).u32(self.fields.len() as u32);
        for (name, offset, kind) in &self.fields {
            cdr = cdr.text(name).u32(*offset).u8(*kind).u32(1);
        }
        cdr.u8(u8::from(self.big)).u32(self.point_step).u32(self.row_step).bytes(&self.data).u8(1).done()
    }
}

/// `sensor_msgs/msg/CameraInfo` of 32 × 24 px, f = 20, principal point (15, 12).
fn info() -> Vec<u8> {
    let numbers = |cdr: Cdr, values: &[f64]| values.iter().fold(cdr, |cdr, v| cdr.f64(*v));
    let cdr = Cdr::new(false, 0, FRAME).u32(24).u32(32).text("plumb_bob").u32(0);
    let cdr = numbers(cdr, &[20.0, 0.0, 15.0, 0.0, 20.0, 12.0, 0.0, 0.0, 1.0]);
    let cdr = numbers(cdr, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    numbers(cdr, &[20.0, 0.0, 15.0, 0.0, 0.0, 20.0, 12.0, 0.0, 0.0, 0.0, 1.0, 0.0]).done()
}

/// `tf2_msgs/msg/TFMessage`: the camera 1 m above the world's origin.
fn tf() -> Vec<u8> {
    let one = |cdr: Cdr, values: [f64; 7]| values.iter().fold(cdr, |cdr, v| cdr.f64(*v));
    // A sequence of one, whose header is written by hand for its place in the message.
    let cdr = Cdr::sequence_of_one().u32(100).u32(0).text("world").text(FRAME);
    one(cdr, [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]).done()
}

/// The scene of one depth message and, perhaps, one colour image.
fn import(kind: &str, depth: Vec<u8>, color: Option<(&str, Vec<u8>)>) -> Result<Imported, ImportError> {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("bag.mcap");
    let mut all = vec![
        ("/tf_static", "tf2_msgs/msg/TFMessage", "cdr", tf()),
        ("/i", "sensor_msgs/msg/CameraInfo", "cdr", info()),
    ];
    all.push(("/d", kind, "cdr", depth));
    let has_color = color.is_some();
    if let Some((kind, data)) = color {
        all.push(("/c", kind, "cdr", data));
    }
    write(&path, &all);
    import_recording(&wanted(&path, has_color))
}

fn wanted(path: &Path, color: bool) -> RecordingSpec {
    RecordingSpec {
        depth: "/d".into(),
        info: "/i".into(),
        color: color.then(|| "/c".into()),
        tactile: None,
        touches: TouchSource::EveryContact,
        sensor_frame: None,
        sensor: None,
        ..spec(path)
    }
}

const CLOUD: &str = "sensor_msgs/msg/PointCloud2";
const PACKED: &str = "sensor_msgs/msg/CompressedImage";

fn cloud(change: impl Fn(&mut Cloud)) -> Result<Imported, ImportError> {
    let mut cloud = Cloud::new();
    change(&mut cloud);
    import(CLOUD, cloud.message(), None)
}

#[test]
fn a_cloud_is_read_in_either_byte_order_and_as_doubles() {
    let is_right = |imported: Imported| {
        let depth = &imported.scene.frame.depth;
        // 0.1 m to the right at 0.6 m: 3.3 px.
        assert_eq!((depth[(12, 15)], depth[(12, 18)]), (0.5, 0.6));
        assert_eq!(depth.as_slice().iter().filter(|z| z.is_finite()).count(), 2);
    };
    is_right(cloud(|_| ()).expect("sound"));
    is_right(
        cloud(|c| {
            c.big = true;
            c.data.chunks_exact_mut(4).for_each(<[u8]>::reverse);
        })
        .expect("sound"),
    );
    is_right(
        cloud(|c| {
            // Doubles, padded, one row below the other, the rest of each row unused, a point that is none.
            let points = [[0.0f64, 0.0, 0.5], [0.1, 0.0, 0.6], [f64::NAN; 3]];
            c.data = points.iter().flat_map(|p| p.iter().flat_map(|v| v.to_le_bytes()).chain([7; 16])).collect();
            c.fields = vec![("z", 16, 8), ("x", 0, 8), ("y", 8, 8)];
            (c.size, c.point_step, c.row_step) = ([3, 1], 24, 40);
        })
        .expect("sound"),
    );
}

#[test]
fn a_cloud_that_lies_about_itself_is_an_error() {
    let fails = |change: &dyn Fn(&mut Cloud), text: &str| {
        let error = cloud(change).expect_err(text).to_string();
        assert!(error.contains("topic '/d'") && error.contains(text), "'{text}' is missing in: {error}");
    };
    fails(&|c| c.point_step = 8, "2×1 points of 8 bytes do not fit 24 bytes");
    fails(&|c| c.point_step = 0, "points of 0 bytes do not fit");
    fails(&|c| c.row_step = 23, "do not fit 24 bytes");
    fails(&|c| c.size = [2, 2], "2×2 points of 12 bytes do not fit 24 bytes");
    fails(&|c| c.data.truncate(20), "do not fit 20 bytes");
    fails(&|c| c.fields[2].1 = u32::MAX, "do not fit");
    fails(&|c| (c.size, c.point_step, c.row_step) = ([u32::MAX; 2], u32::MAX, u32::MAX), "do not fit");
    fails(&|c| c.fields[0].0 = "range", "the cloud has no field 'x'");
    fails(&|c| c.fields.clear(), "the cloud has no field 'x'");
    fails(&|c| c.fields[1].2 = 5, "field 'y' is of datatype 5; 7 (float32) or 8 (float64) is needed");
    // Four thousand million rows of nothing are not walked through.
    fails(
        &|c| (c.size, c.row_step, c.data) = ([u32::MAX, 0], 0, Vec::new()),
        "a cloud of 0×4294967295 points is empty",
    );
    // Wholly behind the camera.
    fails(&|c| c.data = [0.0f32, 0.0, -0.5].repeat(2).iter().flat_map(|v| v.to_le_bytes()).collect(), "every pixel");
    let message = Cloud::new().message();
    for end in 0..message.len() - 1 {
        assert!(import(CLOUD, message[..end].to_vec(), None).is_err(), "cut at {end} of {}", message.len());
    }
}

/// The file that a writer makes.
fn file(write: impl Fn(&Path)) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("x");
    write(&path);
    std::fs::read(path).expect("written")
}

fn packed(format: &str, data: &[u8]) -> Vec<u8> {
    Cdr::new(false, 0, FRAME).text(format).bytes(data).done()
}

#[test]
fn compressed_images_that_are_torn_or_of_another_kind_are_errors() {
    let depth = Raster::from_fn(24, 32, |r, c| 0.5 + 0.001 * (r + c) as f32);
    let png = file(|path| write_depth_png(path, &depth, 0.001).expect("written"));
    let picture = Raster::from_fn(24, 32, |r, c| [8 * r as u8, 8 * c as u8, 90]);
    let jpeg = file(|path| write_jpeg(path, &picture, 95).expect("written"));
    let color =
        |data: &[u8]| import(PACKED, packed("16UC1; png compressed ", &png), Some((PACKED, packed("jpeg", data))));
    let good = color(&jpeg).expect("sound").scene.frame;
    assert!((good.depth[(3, 4)] - depth[(3, 4)]).abs() < 6e-4);
    let [r, g, _] = good.color.expect("sent")[(20, 3)];
    assert!(r.abs_diff(160) < 12 && g.abs_diff(24) < 12, "{r} {g}");
    let fails = |result: Result<Imported, ImportError>, topic: &str, text: &str| {
        let error = result.expect_err(text).to_string();
        assert!(error.contains(topic) && error.contains(text), "'{text}' is missing in: {error}");
    };
    fails(color(&jpeg[..jpeg.len() / 3]), "topic '/c'", "format 'jpeg'");
    fails(color(b""), "topic '/c'", "format 'jpeg'");
    fails(color(b"GIF89a"), "topic '/c'", "format 'jpeg'");
    let mut headless = jpeg.clone();
    headless[2..40].fill(0xff);
    fails(color(&headless), "topic '/c'", "format 'jpeg'");
    let small = file(|path| write_color(path, &Raster::filled(10, 20, [9; 3])).expect("written"));
    fails(color(&small), "topic '/c'", "20×10 px, the camera of '/i' 32×24");
    let only_depth = |format: &str, data: &[u8]| import(PACKED, packed(format, data), None);
    fails(only_depth("16UC1; png compressed ", &png[..png.len() / 2]), "topic '/d'", "");
    fails(only_depth("16UC1; png compressed ", &png[..6]), "topic '/d'", "");
    fails(only_depth("jpeg", &jpeg), "topic '/d'", "format 'jpeg' is not a PNG; 16UC1 as PNG is needed");
    let inverse = [&[0u8; 12][..], &png].concat();
    fails(only_depth("32FC1; compressedDepth png", &inverse), "topic '/d'", "stores inverse depth");
    fails(only_depth("16UC1; compressedDepth rvl", &[0; 40]), "topic '/d'", "is not a PNG");
    // Every byte of the messages turned: an error or another picture, never a panic.
    for message in [packed("jpeg", &jpeg), packed("png", &png)] {
        for at in (0..message.len()).filter(|at| *at < 60 || at.is_multiple_of(13)) {
            let mut bad = message.clone();
            bad[at] ^= 0xff;
            let _ = import(PACKED, packed("png", &png), Some((PACKED, bad.clone())));
            let _ = import(PACKED, bad, None);
        }
    }
}

#[test]
fn messages_that_are_not_cdr_or_of_no_known_type_are_named() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("bag.mcap");
    let run = |kind: &str, encoding: &str, info_encoding: &str| {
        let all = [
            ("/tf_static", "tf2_msgs/msg/TFMessage", "cdr", tf()),
            ("/i", "sensor_msgs/msg/CameraInfo", info_encoding, info()),
            ("/d", kind, encoding, Cloud::new().message()),
        ];
        write(&path, &all);
        import_recording(&wanted(&path, false))
    };
    run(CLOUD, "cdr", "cdr").expect("sound");
    let error = |kind, encoding, info| run(kind, encoding, info).expect_err("wrong").to_string();
    assert_eq!(error(CLOUD, "json", "cdr"), "topic '/d' is encoded as 'json'; 'cdr' is needed");
    assert_eq!(error(CLOUD, "cdr", "protobuf"), "topic '/i' is encoded as 'protobuf'; 'cdr' is needed");
    let unknown = error("my_msgs/msg/Scan", "cdr", "cdr");
    assert!(unknown.contains("topic '/d' is of type 'my_msgs/msg/Scan'; sensor_msgs/msg/Image, Comp"), "{unknown}");
}
