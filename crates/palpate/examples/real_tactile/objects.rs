//! Objects pressed into another unit of the GelSight Mini, decoded with the balls of the first.

use palpate::io;
use palpate::render::render_indentation;
use palpate::tactile::{NoContact, RegressorDecoder, SlopeRegressor, TactileDecoder, TactileSensor};
use std::error::Error;
use std::path::Path;

/// The middle of the ball images' field, by the two no-contact images.
const VIEW: f32 = 5.0 / 7.0;

pub(crate) fn run(folder: &Path, regressor: &SlopeRegressor, pictures: Option<&Path>) -> Result<(), Box<dyn Error>> {
    let sensor = TactileSensor::preset("gelsight-mini")?;
    let no_contact = NoContact::new(io::read_color(folder.join("background.png"))?, &sensor)?;
    let decoder = RegressorDecoder::new(regressor.clone(), no_contact).with_view(VIEW);
    println!("\n| object | deepest mm | contact % of the pad |\n|---|---|---|");
    for name in ["key", "bead", "seed"] {
        let contact = decoder.decode(&io::read_color(folder.join(format!("{name}.png")))?, &sensor)?;
        let deepest = contact.height_map.as_slice().iter().fold(0.0f32, |a, &z| a.max(-z));
        println!("| {name} | {:.2} | {:.1} |", 1e3 * deepest, 100.0 * contact.contact_share());
        if let Some(pictures) = pictures {
            io::write_color(pictures.join(format!("{name}.png")), &render_indentation(&contact, &sensor))?;
        }
    }
    Ok(())
}
