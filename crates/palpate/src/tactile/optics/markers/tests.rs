//! The superposition against closed forms.

use super::*;

const PITCH: f64 = 0.1e-3;

/// Depth and mask (above 0.4 of the depth, as a press has it: 1.63 mm wide to each side) of a ball of radius 3 mm pressed
/// 0.8 mm deep at the middle of `n × n` pixels of 0.1 mm.
fn ball(n: usize) -> (Raster<f32>, Raster<bool>) {
    let middle = 0.5 * (n as f64 - 1.0);
    let depth = Raster::from_fn(n, n, |r, c| {
        let d2 = ((r as f64 - middle).powi(2) + (c as f64 - middle).powi(2)) * 0.01;
        ((9.0 - d2).max(0.0).sqrt() - 2.2).max(0.0) as f32
    });
    let mask = depth.map(|d| *d > 0.32);
    (depth, mask)
}

fn moved(shear: (f64, f64)) -> Raster<[f32; 2]> {
    let (depth, mask) = ball(121);
    MarkerField::new(PITCH).expect("plausible").displacement(&depth, &mask, shear).expect("sound")
}

#[test]
fn nothing_touched_nothing_moves() {
    let field = MarkerField::new(PITCH).expect("plausible");
    let (depth, mask) = ball(40);
    let none = field.displacement(&depth, &mask.map(|_| false), (0.3, 0.1)).expect("sound");
    assert!(none.as_slice().iter().all(|d| *d == [0.0; 2]));
    let flat = field.displacement(&depth.map(|_| 0.0), &mask, (0.0, 0.0)).expect("sound");
    assert!(flat.as_slice().iter().all(|d| *d == [0.0; 2]));
    let empty = Raster::filled(0, 0, 0.0f32);
    assert_eq!(field.displacement(&empty, &empty.map(|_| true), (0.0, 0.0)).expect("sound").shape(), (0, 0));
}

#[test]
fn a_ball_drives_the_dots_around_it_outward() {
    let field = moved((0.0, 0.0));
    let mut largest = 0.0f64;
    for (row, col, d) in field.pixels() {
        let (x, y) = (col as f64 - 60.0, row as f64 - 60.0);
        let r = x.hypot(y);
        // From 1 mm beside the contact (nearer, the gel is drawn in) to the pad's corner, 8.5 mm away.
        if r > 26.0 {
            let outward = (f64::from(d[0]) * x + f64::from(d[1]) * y) / r;
            let across = (f64::from(d[0]) * y - f64::from(d[1]) * x) / r;
            assert!(outward > 0.0 && across.abs() < 0.02 * outward + 2e-4, "{row} {col}: {outward} {across}");
            largest = largest.max(outward);
        }
    }
    assert!((0.01..0.2).contains(&largest), "{largest} mm");
}

#[test]
fn a_quarter_turn_of_the_press_is_a_quarter_turn_of_the_motion() {
    let field = moved((0.0, 0.0));
    let largest = field.as_slice().iter().flatten().fold(0.0f32, |m, v| m.max(v.abs()));
    for (row, col, d) in field.pixels() {
        // (x, y) turns to (-y, x).
        let turned = field[(col, 120 - row)];
        let off = (turned[0] + d[1]).abs().max((turned[1] - d[0]).abs());
        assert!(off < 1e-3 * largest, "{row} {col}: {d:?} {turned:?}");
    }
}

#[test]
fn a_drag_adds_motion_along_itself_that_fades_with_distance() {
    let (still, along_x, along_y) = (moved((0.0, 0.0)), moved((0.5, 0.0)), moved((0.0, -0.5)));
    let added = |field: &Raster<[f32; 2]>, at: (usize, usize)| [0, 1].map(|k| field[at][k] - still[at][k]);
    // In the contact: 7 % of the drag.
    let [x, y] = added(&along_x, (60, 60));
    assert!((x - 0.035).abs() < 0.002 && y.abs() < 1e-4, "{x} {y}");
    let [x, y] = added(&along_y, (60, 60));
    assert!((y + 0.035).abs() < 0.002 && x.abs() < 1e-4, "{x} {y}");
    let (near, far) = (added(&along_x, (60, 90))[0], added(&along_x, (60, 118))[0]);
    assert!(near > far && far > 0.0, "{near} {far}");
}

/// Imposed less superposed depth at the spots, and at those cell corners where the ball is deeper than 0.45 mm: the largest.
fn misses(mask: &Raster<bool>) -> (f64, f64) {
    let depth = ball(121).0;
    let cells = Cells::new(&depth, mask, 3).expect("contact");
    assert!(cells.size == 3 && cells.spots.len() > 90);
    let table = InfluenceTable::new(&PointResponse::taxim(), (120, 120), 0.15, 0.3);
    let loads = Loads::solve(&cells.spots, &table, (0.0, 0.0));
    assert!(loads.press.iter().all(|l| *l >= 0.0));
    let pressed = |row: isize, col: isize| -> f64 {
        let each = cells.spots.iter().zip(loads.press.iter());
        each.map(|(s, l)| l * table.at(row - 2 * s.cell.0, col - 2 * s.cell.1).zz).sum()
    };
    let (mut at_spots, mut between) = (0.0f64, 0.0f64);
    for spot in &cells.spots {
        let (row, col) = (2 * spot.cell.0, 2 * spot.cell.1);
        at_spots = at_spots.max((pressed(row, col) - spot.depth_mm).abs());
        let r2 = (0.15 * (row + 1) as f64).powi(2) + (0.15 * (col + 1) as f64).powi(2);
        let imposed = (9.0 - r2).max(0.0).sqrt() - 2.2;
        if imposed > 0.45 {
            between = between.max((pressed(row + 1, col + 1) - imposed).abs());
        }
    }
    (at_spots, between)
}

#[test]
fn loads_reproduce_the_imposed_depth_at_every_spot_and_between_them() {
    let (depth, mask) = ball(121);
    let (at_spots, between) = misses(&mask);
    assert!(at_spots < 1e-6 && between < 0.03, "{at_spots} {between} mm");
    // Up to the ball's very edge the gel sinks by itself, and loads may not pull it up again.
    let (at_spots, between) = misses(&depth.map(|d| *d > 0.0));
    assert!(at_spots < 0.12 && between < 0.06, "{at_spots} {between} mm");
}

#[test]
fn the_motion_hardly_depends_on_the_number_of_loads() {
    let motion = |smallest: usize| {
        let (depth, mask) = ball(121);
        let cells = Cells::new(&depth, &mask, smallest).expect("contact");
        let step = 0.05 * cells.size as f64;
        let table = InfluenceTable::new(&PointResponse::taxim(), (200, 200), step, 2.0 * step);
        let loads = Loads::solve(&cells.spots, &table, (0.0, 0.0));
        // 3 mm from the middle, along columns.
        superpose(&cells.spots, &loads, &table, (0, 60 / cells.size as isize))[0]
    };
    let (fine, coarse) = (motion(3), motion(6));
    assert!((fine - coarse).abs() < 0.08 * fine, "{fine} {coarse}");
}

#[test]
fn even_a_contact_of_one_pixel_and_one_of_the_whole_pad_move_the_dots() {
    let field = MarkerField::new(PITCH).expect("plausible");
    let depth = Raster::filled(60, 90, 0.5f32);
    let one = Raster::from_fn(60, 90, |r, c| (r, c) == (0, 89));
    for mask in [one, Raster::filled(60, 90, true)] {
        let motion = field.displacement(&depth, &mask, (0.1, 0.0)).expect("sound");
        assert!(motion.as_slice().iter().flatten().all(|v| v.is_finite() && v.abs() < 0.5));
        assert!(motion.as_slice().iter().any(|d| d[0].abs() > 1e-4));
    }
}

#[test]
fn impossible_input_is_refused_with_the_numbers() {
    assert!(MarkerField::new(0.1).expect_err("0.1 m").to_string().contains("pixel_pitch is 0.1"));
    let field = MarkerField::new(PITCH).expect("plausible");
    let (depth, mask) = ball(40);
    let shape = field.displacement(&ball(41).0, &mask, (0.0, 0.0)).expect_err("41 ≠ 40").to_string();
    assert_eq!(shape, "contact depth is (41, 41) (rows, cols); (40, 40) is needed");
    let pixels = field.displacement(&depth.map(|d| d * 34.0), &mask, (0.0, 0.0)).expect_err("pixels");
    assert!(pixels.to_string().contains("is it in pixels?"));
    assert!(field.displacement(&depth, &mask, (f64::NAN, 0.0)).is_err());
    for params in [
        MarkerParams { spacing: f64::NAN, ..MarkerParams::default() },
        MarkerParams { radius: 1.0e-3, ..MarkerParams::default() },
        MarkerParams { darkness: 1.5, ..MarkerParams::default() },
    ] {
        assert!(params.validate().is_err(), "{params:?}");
    }
    MarkerParams::default().validate().expect("default");
}

#[test]
fn dots_are_drawn_on_the_lattice_and_move_with_the_gel() {
    let white = Raster::filled(101, 121, [200u8; 3]);
    let params = MarkerParams { spacing: 2e-3, radius: 0.3e-3, darkness: 0.5 };
    let mut image = white.clone();
    draw_markers(&mut image, &Raster::filled(101, 121, [0.0; 2]), PITCH, &params).expect("sound");
    assert_eq!((image[(50, 60)], image[(50, 70)], image[(50, 80)]), ([100; 3], [200; 3], [100; 3]));
    assert_eq!(image[(10, 0)], [100; 3]);
    let mut image = white.clone();
    // 0.5 mm along columns, -0.2 mm along rows: 5 and -2 pixels.
    draw_markers(&mut image, &Raster::filled(101, 121, [0.5, -0.2]), PITCH, &params).expect("sound");
    assert_eq!((image[(48, 65)], image[(50, 60)]), ([100; 3], [200; 3]));
    let wrong = draw_markers(&mut image, &Raster::filled(3, 3, [0.0; 2]), PITCH, &params);
    assert!(wrong.is_err());
    draw_markers(&mut Raster::filled(0, 0, [0; 3]), &Raster::filled(0, 0, [0.0; 2]), PITCH, &params).expect("none");
}
