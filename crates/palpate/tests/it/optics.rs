//! Shadows and dots against what the authors of Taxim published. Data: `../shared/data/taxim`, or the folder `PALPATE_DATA` names.

use palpate::geometry::Raster;
use palpate::io::read_npy;
use palpate::tactile::optics::{MarkerField, PressedGel, ShadowTable, cast_shadows, soften};
use serde_json::Value;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

const PITCH_MM: f64 = 0.0295;
const ROWS: usize = 480;
const COLS: usize = 640;

/// The shared data, or `None`, said aloud, where they are not at hand.
pub(crate) fn taxim(test: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("PALPATE_DATA").map_or_else(beside, PathBuf::from).join("taxim");
    if !folder.is_dir() {
        eprintln!("SKIPPED {test}: {} is absent", folder.display());
        return None;
    }
    Some(folder)
}

pub(crate) fn numbers(path: &Path) -> Vec<f64> {
    read_npy(path).expect("a sound array").values
}

fn raster(path: &Path) -> Raster<f64> {
    Raster::from_vec(ROWS, COLS, numbers(path)).expect("480 × 640")
}

/// B, G, R of a picture.
pub(crate) fn picture(path: &Path) -> Raster<[f64; 3]> {
    let image = image::open(path).expect("a picture").to_rgb8();
    let pixel = |row: usize, col: usize| image.get_pixel(col as u32, row as u32).0;
    Raster::from_fn(image.height() as usize, image.width() as usize, |r, c| {
        let [red, green, blue] = pixel(r, c).map(f64::from);
        [blue, green, red]
    })
}

/// A published press, and what is not published of it.
///
/// The height map is that of the deformed gel. Assumed: the press is 1 mm (Taxim's default); the objects' tops are flat, so that
/// the contact is where the map is as high as at its middle, less what the last 5 px blur took from its rim (1 px of the square's,
/// 2 px of height at the cylinder's). Under these assumptions Taxim's own deformation gives the map back to 0.014 and 0.035 px.
struct Press {
    height_px: Raster<f64>,
    depth_mm: Raster<f64>,
    mask: Raster<bool>,
}

impl Press {
    fn read(folder: &Path, name: &str) -> Self {
        let height_px = raster(&folder.join(format!("golden/{name}_height.npy")));
        let top = height_px[(ROWS / 2, COLS / 2)];
        let gel = binomial(&raster(&folder.join("gelmap5.npy")));
        let thickest = gel.as_slice().iter().fold(0.0f64, |m, g| m.max(*g));
        // Relaxed gel: -gel + constant, 1 mm below the object's top at the apex.
        let constant = thickest + top - 1.0 / PITCH_MM;
        let depth_mm = Raster::from_fn(ROWS, COLS, |r, c| (height_px[(r, c)] + gel[(r, c)] - constant) * PITCH_MM);
        let lost = if name == "square" { 1.0 } else { 2.0 };
        let near = |r: usize, c: usize| (r as f64 - 240.0).hypot(c as f64 - 320.0) < 200.0;
        let plateau = Raster::from_fn(ROWS, COLS, |r, c| near(r, c) && height_px[(r, c)] > top - lost);
        let grown = |r: usize, c: usize| {
            let around = [(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)];
            around.iter().any(|(y, x)| plateau.at(r as isize + y, c as isize + x) == Some(&true))
        };
        let mask = if name == "square" { Raster::from_fn(ROWS, COLS, grown) } else { plateau };
        Self { height_px, depth_mm, mask }
    }

    /// Colour change without shadows (B, G, R) and direction of rise, from the photometric table.
    fn shade(&self, table: &[f64]) -> (Raster<[f32; 3]>, Raster<f32>) {
        const BINS: usize = 125;
        let h = |r: usize, c: usize| self.height_px[(r, c)];
        // The outer ring has its neighbour's gradient.
        let gradient = |row: usize, col: usize| {
            let (r, c) = (row.clamp(1, ROWS - 2), col.clamp(1, COLS - 2));
            (0.5 * (h(r + 1, c) - h(r - 1, c)), 0.5 * (h(r, c + 1) - h(r, c - 1)))
        };
        let direction = Raster::from_fn(ROWS, COLS, |r, c| {
            let (down, right) = gradient(r, c);
            down.atan2(right) as f32
        });
        let change = Raster::from_fn(ROWS, COLS, |row, col| {
            let (down, right) = gradient(row, col);
            let i = (down.hypot(right).atan() / (0.5 * PI / 124.0)) as usize;
            let j = ((down.atan2(right) + PI) / (2.0 * PI / 124.0)) as usize;
            let (x, y) = (col as f64, row as f64);
            [0, 1, 2].map(|k| {
                let start = ((k * BINS + i) * BINS + j) * 6;
                let terms = [x * x, y * y, x * y, x, y, 1.0];
                table[start..start + 6].iter().zip(terms).map(|(c, t)| c * t).sum::<f64>() as f32
            })
        });
        (change, direction)
    }
}

/// OpenCV's 5 px Gaussian of one channel.
fn binomial(raster: &Raster<f64>) -> Raster<f64> {
    let mut image = raster.map(|v| [*v as f32; 3]);
    soften(&mut image);
    image.map(|v| f64::from(v[0]))
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0usize), |(sum, n), v| (sum + v * v, n + 1));
    (sum / n as f64).sqrt()
}

#[test]
fn the_shipped_shadow_table_is_taxims() {
    let Some(folder) = taxim("the_shipped_shadow_table_is_taxims") else { return };
    let lengths: Vec<usize> = numbers(&folder.join("shadowTable_lengths.npy")).iter().map(|n| *n as usize).collect();
    let values: Vec<f32> = numbers(&folder.join("shadowTable_flat.npy")).iter().map(|v| *v as f32).collect();
    let directions = numbers(&folder.join("shadowDirections.npy"));
    let (source, shipped) = (ShadowTable::new(&directions, &lengths, values).expect("sound"), ShadowTable::taxim());
    let (directions, depths) = ShadowTable::SHAPE;
    for i in 0..3 * directions * depths {
        let (channel, direction, depth) = (i / depths / directions, i / depths % directions, i % depths);
        let (a, b) = (source.list(channel, direction, depth), shipped.list(channel, direction, depth));
        assert_eq!(a.len(), b.len(), "{channel} {direction} {depth}");
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1.0 / 512.0 + 1e-6), "{channel} {direction} {depth}");
    }
}

/// The difference between Taxim's picture with shadows and its picture without: all but the blur of the unpublished background.
#[test]
fn shadows_darken_as_in_taxims_pictures() {
    let Some(folder) = taxim("shadows_darken_as_in_taxims_pictures") else { return };
    let photometry = numbers(&folder.join("polycalib_default_gelsight_grad_rgb.npy"));
    let presses = ["square", "cylinder6"].map(|name| {
        let press = Press::read(&folder, name);
        let (change, direction) = press.shade(&photometry);
        let golden = ["sim", "shadow"].map(|kind| picture(&folder.join(format!("golden/{name}_{kind}.jpg"))));
        (name, press, change, direction, golden)
    });
    // The background: what the pictures without shadows have beyond the colour change, mean of both.
    let background = Raster::from_fn(ROWS, COLS, |r, c| {
        [0, 1, 2].map(|k| {
            let beyond = |i: usize| presses[i].4[0][(r, c)][k] as f32 - presses[i].2[(r, c)][k];
            0.5 * (beyond(0) + beyond(1))
        })
    });
    let finished = |change: &Raster<[f32; 3]>| {
        let mut image =
            Raster::from_fn(ROWS, COLS, |r, c| [0, 1, 2].map(|k| change[(r, c)][k] + background[(r, c)][k]));
        soften(&mut image);
        image
    };
    for (name, press, change, direction, [sim, shadow]) in &presses {
        let (height_px, contact_height_mm) = (press.height_px.map(|v| *v as f32), press.depth_mm.map(|v| *v as f32));
        let cast = |mask: &Raster<bool>| {
            let gel = PressedGel { height_px: &height_px, direction, contact_height_mm: &contact_height_mm, mask };
            let mut change = change.clone();
            cast_shadows(&mut change, &gel, &ShadowTable::taxim()).expect("one shape");
            change
        };
        let with = finished(&cast(&press.mask));
        // The same blurs without a rim to cast from.
        let without = finished(&cast(&press.mask.map(|_| false)));
        let error = |image: &Raster<[f32; 3]>, only: &Raster<bool>| {
            let pixels = image.pixels().filter(|&(r, c, _)| only[(r, c)]);
            rms(pixels.flat_map(|(r, c, v)| {
                let plain = [0, 1, 2].map(|k| (change[(r, c)][k] + background[(r, c)][k]).round().clamp(0.0, 255.0));
                let golden = [0, 1, 2].map(|k| shadow[(r, c)][k] - sim[(r, c)][k]);
                [0, 1, 2].map(|k| f64::from(v[k] - plain[k]) - golden[k])
            }))
        };
        let whole = press.mask.map(|_| true);
        let shaded =
            Raster::from_fn(ROWS, COLS, |r, c| (0..3).any(|k| (with[(r, c)][k] - without[(r, c)][k]).abs() > 2.0));
        let all = (error(&with, &whole), error(&without, &whole));
        let dark = (error(&with, &shaded), error(&without, &shaded));
        let share = shaded.as_slice().iter().filter(|s| **s).count() as f64 / (ROWS * COLS) as f64;
        println!(
            "{name}: rmse {:.3} levels, without shadows {:.3}; in the shaded {:.1} %: {:.3}, {:.3}",
            all.0,
            all.1,
            100.0 * share,
            dark.0,
            dark.1
        );
        // Two JPEG files of quality 95 differ by 0.9 levels as it is.
        assert!(all.0 < 1.1 && dark.0 < 1.5, "{name}: {all:?} {dark:?}");
        assert!(dark.1 > 4.0 * dark.0, "{name}: {dark:?}");
    }
}

/// Taxim plotted the motion it computed for both presses, each panel in its own colour scale: compared by correlation.
#[test]
fn dots_move_as_in_taxims_plots() {
    let Some(folder) = taxim("dots_move_as_in_taxims_plots") else { return };
    let oracle: Value = serde_json::from_str(include_str!("oracle/taxim_compose.json")).expect("valid JSON");
    let field = MarkerField::new(PITCH_MM * 1e-3).expect("plausible");
    for name in ["square", "cylinder6"] {
        let press = Press::read(&folder, name);
        let depth = press.depth_mm.map(|v| *v as f32);
        let motion = |shear| field.displacement(&depth, &press.mask, shear).expect("sound");
        let still = motion((0.0, 0.0));
        let drags = [motion((1.0, 0.0)), motion((0.0, 1.0))];
        for (axis, key) in ["x", "y"].into_iter().enumerate() {
            let plotted = oracle["fields"][format!("{name}_{key}")].as_array().expect("a list");
            let plotted: Vec<f64> = plotted.iter().map(|v| v.as_f64().expect("a number")).collect();
            let sampled = |f: &Raster<[f32; 2]>| -> Vec<f64> {
                (0..30 * 40).map(|i| f64::from(f[(16 * (i / 40) + 8, 16 * (i % 40) + 8)][axis])).collect()
            };
            let press_only = sampled(&still);
            let drag = [0, 1]
                .map(|k| -> Vec<f64> { sampled(&drags[k]).iter().zip(&press_only).map(|(a, b)| a - b).collect() });
            // How far either object was dragged is not said: least squares over press, both drags and the scale's zero.
            let left = explained(&plotted, &[press_only.clone(), drag[0].clone(), drag[1].clone()]);
            let press_alone = explained(&plotted, &[press_only]);
            println!("{name} {key}: R² {left:.4}, by the press alone {press_alone:.4}");
            assert!(left > 0.98, "{name} {key}: {left}");
            // The square was not dragged to speak of.
            assert!(name != "square" || press_alone > 0.97, "{name} {key}: {press_alone}");
        }
    }
}

/// Share of the variance of `target` that a linear combination of `parts` and a constant explains.
fn explained(target: &[f64], parts: &[Vec<f64>]) -> f64 {
    let a = nalgebra::DMatrix::from_fn(target.len(), parts.len() + 1, |i, j| parts.get(j).map_or(1.0, |p| p[i]));
    let b = nalgebra::DVector::from_column_slice(target);
    let weights = a.clone().svd(true, true).solve(&b, 1e-12).expect("computed");
    let mean = b.mean();
    1.0 - (&b - &a * weights).norm_squared() / b.map(|v| v - mean).norm_squared()
}
