//! A gel with printed dots, a ball of 3.8 mm radius: dots masked and filled, then as without them.

use crate::measure::{Press, calibrate, report, split};
use palpate::geometry::Raster;
use palpate::io;
use palpate::render::render_indentation;
use palpate::tactile::{NoContact, RegressorDecoder, RelaxedGel, TactileDecoder, TactileSensor, fill_markers, markers};
use std::error::Error;
use std::path::Path;

const RADIUS_MM: f64 = 3.8;
const PITCH_MM: f64 = 0.10577;
const BALLS: [u32; 10] = [8, 13, 34, 37, 38, 40, 42, 43, 47, 48];
const OBJECTS: [u32; 2] = [4, 7];
const CALIBRATION: usize = 6;

pub(crate) fn run(folder: &Path, pictures: Option<&Path>) -> Result<(), Box<dyn Error>> {
    let sensor = TactileSensor {
        model: "marker gel".to_owned(),
        width: 427,
        height: 320,
        pixel_pitch: 1e-3 * PITCH_MM,
        relaxed_gel: RelaxedGel::Flat,
    };
    let read = |name: &str| io::read_color(folder.join(format!("{name}.jpg"))).map(without_dots);
    let no_contact = NoContact::new(read("ref")?, &sensor)?;
    let (rows, cols) = no_contact.shape();
    println!(
        "\nmarker gel\n| press | x | y | contact px | contrast | asymmetry | clear |\n|---|---|---|---|---|---|---|"
    );
    let mut clear = Vec::new();
    for number in BALLS {
        let name = format!("sample_{number}");
        let image = read(&name)?;
        let rough = outline(&no_contact.difference(&image)?);
        let Some(press) = Press::find(&name, image, &no_contact, rough)? else { continue };
        let (b, fits) = (press.ball, press.ball.is_clear(rows, cols));
        println!(
            "| {name} | {:.1} | {:.1} | {:.1} | {:.0} | {:.2} | {fits} |",
            b.center[0], b.center[1], b.contact_radius, b.contrast, b.asymmetry
        );
        if fits {
            clear.push(press);
        }
    }
    let (calibration, held_out) = split(clear, CALIBRATION, [0.5 * cols as f64, 0.5 * rows as f64]);
    println!("calibration: {}", calibration.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(" "));
    let decoder = RegressorDecoder::new(calibrate(&calibration, RADIUS_MM / PITCH_MM)?, no_contact.clone());
    report("marker gel, held out", &decoder, &held_out, &sensor, RADIUS_MM)?;
    for number in OBJECTS {
        let contact = decoder.decode(&read(&format!("reconstruct_{number}"))?, &sensor)?;
        if let Some(pictures) = pictures {
            let name = format!("markers_{number}.png");
            io::write_color(pictures.join(name), &render_indentation(&contact, &sensor))?;
        }
    }
    Ok(())
}

fn without_dots(image: Raster<[u8; 3]>) -> Raster<[u8; 3]> {
    let mask = markers(&image);
    fill_markers(&image, &mask)
}

/// Centre and radius of the pixels that changed by more than half of what the strongest did.
fn outline(difference: &Raster<[f32; 3]>) -> ([f64; 2], f64) {
    let size = difference.map(|d| d.iter().map(|v| v * v).sum::<f32>().sqrt());
    let mut sorted = size.as_slice().to_vec();
    sorted.sort_by(f32::total_cmp);
    let limit = 0.5 * sorted[sorted.len() * 995 / 1000];
    let (mut x, mut y, mut n) = (0.0, 0.0, 0.0);
    for (row, col, _) in size.pixels().filter(|(.., s)| **s > limit) {
        (x, y, n) = (x + col as f64, y + row as f64, n + 1.0);
    }
    ([x / n, y / n], (n / std::f64::consts::PI).sqrt())
}
