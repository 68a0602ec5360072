//! Rendered images against Taxim's published ones, and each convention turned over to see that it matters.
//! Data: `../shared/data/taxim`, or the folder `PALPATE_DATA` names.

use crate::optics::{numbers, picture, taxim};
use palpate::geometry::Raster;
use palpate::tactile::TactileSensor;
use palpate::tactile::optics::{PhotometricTable, TactileOptics};
use std::path::Path;

const BINS: usize = 125;
const WIDTH: usize = 640;
const PRESSES: [&str; 2] = ["square", "cylinder6"];

fn sensor() -> TactileSensor {
    TactileSensor::preset("ycb-sight").expect("listed")
}

/// z of the gel, metres, of a published height map (pixels, growing into the gel).
fn height_map(folder: &Path, name: &str) -> Raster<f32> {
    let pixels = numbers(&folder.join(format!("golden/{name}_height.npy")));
    let pitch = sensor().pixel_pitch;
    Raster::from_vec(480, 640, pixels.iter().map(|h| (-h * pitch) as f32).collect()).expect("480 × 640")
}

/// Taxim's table in this crate's order, cell (i, j) taken from where `from` says.
fn table(folder: &Path, from: impl Fn(usize) -> usize) -> PhotometricTable {
    let source = numbers(&folder.join("polycalib_default_gelsight_grad_rgb.npy"));
    let w = WIDTH as f64;
    let units = [w * w, w * w, w * w, w, w, 1.0];
    let mut values = Vec::new();
    for i in 0..BINS {
        for j in 0..BINS {
            for channel in [2, 1, 0] {
                let start = ((channel * BINS + i) * BINS + from(j)) * 6;
                values.extend((0..6).map(|t| (source[start + t] * units[t]) as f32));
            }
        }
    }
    PhotometricTable::new(BINS, WIDTH, &values).expect("a complete table")
}

/// RMSE, grey levels, of the difference between the two presses: the unpublished background is in both and cancels.
fn error(folder: &Path, optics: &TactileOptics, sign: f32, reverse: bool) -> f64 {
    let rendered = PRESSES.map(|n| optics.render(&height_map(folder, n).map(|z| z * sign)).expect("its size"));
    let golden = PRESSES.map(|n| picture(&folder.join(format!("golden/{n}_sim.jpg"))));
    let mut sum = 0.0;
    for (row, col, [blue, green, red]) in golden[0].pixels() {
        let other = golden[1][(row, col)];
        let change = [red - other[2], green - other[1], blue - other[0]];
        let (a, b) = (rendered[0][(row, col)], rendered[1][(row, col)]);
        for k in 0..3 {
            let from = if reverse { 2 - k } else { k };
            sum += (f64::from(a[from]) - f64::from(b[from]) - change[k]).powi(2);
        }
    }
    (sum / (3.0 * 480.0 * 640.0)).sqrt()
}

#[test]
fn presses_look_as_published_and_no_other_convention_does() {
    let Some(folder) = taxim("presses_look_as_published_and_no_other_convention_does") else { return };
    let shipped = TactileOptics::preset(&sensor()).expect("has a table");
    let right = error(&folder, &shipped, 1.0, false);
    println!("difference of the published images: RMSE {right:.3} grey levels");
    // JPEG at quality 95, four times in this difference, costs 0.9 alone.
    assert!(right <= 1.5, "{right}");
    let grey = Raster::filled(480, 640, [128; 3]);
    let with =
        |from: &dyn Fn(usize) -> usize| TactileOptics::new(sensor(), table(&folder, from), &grey).expect("consistent");
    let same = error(&folder, &with(&|j| j), 1.0, false);
    assert!((same - right).abs() < 0.1, "the shipped float16 table: {right}, the original: {same}");
    // atan2(column, row) instead of atan2(row, column) is π/2 minus the angle: a quarter of the bins.
    let exchanged = error(&folder, &with(&|j| (155 - j) % 124), 1.0, false);
    let channels = error(&folder, &shipped, 1.0, true);
    let sign = error(&folder, &shipped, -1.0, false);
    println!("wrong: channels {channels:.1}, direction {exchanged:.1}, sign {sign:.1}");
    for (what, wrong) in [("channel order", channels), ("direction", exchanged), ("sign", sign)] {
        assert!(wrong > 5.0, "{what}: {wrong}");
    }
}
