//! A decoder of one's own: any network or table that turns a tactile image into a height map and a contact mask.
//!
//! `cargo run --release --example 02_custom_decoder`

use palpate::geometry::Raster;
use palpate::tactile::{Contact, DecodeError, TactileDecoder, TactileSensor};

/// Takes brightness for depth, which no real gel obeys: white is 1 mm deep.
struct Brightness;

impl TactileDecoder for Brightness {
    fn decode(&self, image: &Raster<[u8; 3]>, _sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        let depth = |rgb: &[u8; 3]| 1e-3 * f32::from(rgb[1]) / 255.0;
        Ok(Contact { height_map: image.map(|rgb| -depth(rgb)), mask: image.map(|rgb| depth(rgb) > 4e-4) })
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = TactileSensor::preset("gelsight-mini")?;
    let bump = |row: usize, col: usize| {
        let squared = (row as f64 - 120.0).powi(2) + (col as f64 - 160.0).powi(2);
        [(255.0 * (1.0 - squared / 1600.0)).max(0.0) as u8; 3]
    };
    let contact = Brightness.decode(&Raster::from_fn(240, 320, bump), &sensor)?;
    let touching = contact.mask.as_slice().iter().filter(|m| **m).count();
    println!("{touching} pixels touch; hand `Brightness` to `Stages::decoder` and images are decoded by it");
    Ok(())
}
