//! Calibration of a gel: that presses of balls do not tell the size of a pixel, and real gels (`../shared/data/tactile`, or the
//! folder `PALPATE_DATA` names).

use palpate::calibrate::gel::{GelError, GelParams, MapKind, Quality, calibrate_gel};
use palpate::geometry::Raster;
use palpate::io::read_color;
use std::path::{Path, PathBuf};

type Image = Raster<[u8; 3]>;

fn light(row: usize, col: usize) -> [f64; 3] {
    [70.0 + 0.1 * col as f64, 90.0 + 0.15 * row as f64, 120.0 - 0.05 * col as f64]
}

/// A ball of so many pixels pressed to two thirds of its radius.
fn press([x, y]: [f64; 2], ball: f64) -> Image {
    let (contact, skirt) = (0.68 * ball, 1.12 * ball);
    Raster::from_fn(240, 320, |row, col| {
        let (dx, dy) = (col as f64 - x, row as f64 - y);
        let r = dx.hypot(dy).max(1e-9);
        let steepest = contact / (ball * ball - contact * contact).sqrt();
        let slope = if r < contact {
            r / (ball * ball - r * r).sqrt()
        } else {
            steepest * ((skirt - r) / (skirt - contact)).clamp(0.0, 1.0)
        };
        // Matt: as bright as its normal is turned.
        let tilt = slope / (1.0 + slope * slope).sqrt();
        let (gx, gy) = (-tilt * dx / r, -tilt * dy / r);
        let gain = [0.6 * gx + 0.2 * gy + 0.1 * gx * gx, 0.5 * gy, 0.3 * gy - 0.5 * gx];
        let light = light(row, col);
        std::array::from_fn(|k| (light[k] * (1.0 + gain[k])).round() as u8)
    })
}

/// Two sizes of balls, at three pitches: what is left is the same each time, so nothing in it can tell the right one.
#[test]
fn no_press_of_balls_tells_the_size_of_a_pixel() {
    let background = Raster::from_fn(240, 320, |r, c| light(r, c).map(|v| v.round() as u8));
    let places = [[90.0, 80.0], [230.0, 80.0], [160.0, 120.0], [90.0, 160.0], [230.0, 160.0], [160.0, 90.0]];
    // 2 and 2.8 mm at 0.08 mm a pixel.
    let presses: Vec<(Image, f64)> = places
        .iter()
        .enumerate()
        .map(
            |(i, &place)| if i.is_multiple_of(2) { (press(place, 25.0), 0.0020) } else { (press(place, 35.0), 0.0028) },
        )
        .collect();
    let quality = |pitch: f64| {
        let params = GelParams { pitch, map: MapKind::Quadratic, markers: false, seed: 0 };
        calibrate_gel(&presses, &background, &params).expect("clear presses").quality
    };
    let right = quality(8e-5);
    println!("0.08 mm: radius {:+.4}, residual {:.4} of the cap", right.radius_error(), right.residual_share());
    for wrong in [6.34e-5, 8.8e-5] {
        let q = quality(wrong);
        println!("{wrong}: radius {:+.4}, residual {:.4} of the cap", q.radius_error(), q.residual_share());
        assert!(q.radius_error().abs() < 0.05 && q.residual_share() < 0.05, "a wrong pitch would have shown");
    }
    assert!(right.radius_error().abs() < 0.04);
}

fn folder(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let data = std::env::var_os("PALPATE_DATA").map_or_else(beside, PathBuf::from).join("tactile").join(name);
    if !data.is_dir() {
        eprintln!("SKIPPED: calibration of a real gel: ../shared/data/tactile/{name} is absent");
    }
    data.is_dir().then_some(data)
}

fn say(what: &str, q: &Quality) {
    println!(
        "{what}: {} presses, radius {:+.4} (a press {:.4}, {} within 5 %), residual {:.4} mm, {:.4} of the cap",
        q.presses.len(),
        q.radius_error(),
        q.radius_error_size(),
        q.within(0.05),
        1e3 * q.residual(),
        q.residual_share()
    );
}

#[test]
fn ten_presses_of_a_gelsight_mini_decode_the_others() {
    let Some(folder) = folder("gelsight_mini_balls") else { return };
    let read = |i: u32| (read_color(folder.join(format!("frame_{i}.jpg"))).expect("an image"), 0.002);
    let background = read_color(folder.join("calib_ball_median_background.png")).expect("an image");
    // Spread over the pad by place alone: the first nearest to its middle, each next the farthest from those taken.
    let chosen = [24, 14, 44, 21, 48, 40, 27, 19, 11, 31];
    let calibration: Vec<(Image, f64)> = chosen.iter().map(|&i| read(i)).collect();
    let others: Vec<(Image, f64)> = (1..=49).filter(|i| !chosen.contains(i)).map(read).collect();
    let params = GelParams { pitch: 8e-5, map: MapKind::Quadratic, markers: false, seed: 0 };
    let gel = calibrate_gel(&calibration, &background, &params).expect("clear presses");
    assert_eq!(gel.used.len(), 10);
    let (held_out, left_out) = gel.measure(&others).expect("the same background");
    say("held out", &held_out);
    assert_eq!((held_out.presses.len(), left_out.len()), (26, 13), "13 of 49 are cut, faint or lopsided");
    // Nothing is measured on what was calibrated with, and no press counts twice.
    let seen = gel.measure(&calibration).expect_err("all were calibrated with");
    assert!(matches!(&seen, GelError::NothingToMeasure { left_out } if left_out.len() == 10), "{seen}");
    let twice = vec![calibration[0].clone(); 5];
    let repeated = calibrate_gel(&twice, &background, &params).expect_err("one press");
    assert!(matches!(repeated, GelError::TooFewPresses { found: 1, .. }), "{repeated}");
    assert!(held_out.radius_error().abs() < 0.05, "{}", held_out.radius_error());
    assert!(held_out.residual_share() < 0.10, "{}", held_out.residual_share());
}

/// The mean is right; a single press is not: see docs/bench-guide.md.
#[test]
fn nine_presses_of_a_gel_with_markers_decode_each_other_on_average() {
    let Some(folder) = folder("gelsight_markers") else { return };
    let read = |i: u32| (read_color(folder.join(format!("sample_{i}.jpg"))).expect("an image"), 0.0038);
    let background = read_color(folder.join("ref.jpg")).expect("an image");
    let presses: Vec<(Image, f64)> = [8, 13, 34, 37, 38, 40, 42, 43, 47, 48].map(read).into();
    let params = GelParams { pitch: 0.10577e-3, map: MapKind::Quadratic, markers: true, seed: 0 };
    let gel = calibrate_gel(&presses, &background, &params).expect("clear presses");
    say("each by the others", &gel.quality);
    assert_eq!(gel.used.len(), 9);
    assert!(gel.quality.radius_error().abs() < 0.05, "{}", gel.quality.radius_error());
    assert!(gel.quality.residual_share() < 0.10, "{}", gel.quality.residual_share());
}
