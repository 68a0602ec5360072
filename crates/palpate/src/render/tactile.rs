use super::font::write;
use super::item::palette;
use crate::geometry::Raster;
use crate::tactile::{Contact, TactileSensor};

/// Colour stops from untouched to deepest: perceptually even and readable in grey (after the viridis map).
const STOPS: [[f32; 3]; 6] = [
    [68.0, 1.0, 84.0],
    [65.0, 68.0, 135.0],
    [42.0, 120.0, 142.0],
    [34.0, 168.0, 132.0],
    [122.0, 209.0, 81.0],
    [253.0, 231.0, 37.0],
];
/// Smallest full scale, metres: an untouched gel stays dark.
const MIN_SCALE: f32 = 0.1e-3;
/// Slopes are drawn so many times steeper: imprints are shallow.
const RELIEF: f32 = 3.0;

/// Draws a tactile image beside what was decoded from it, as [`render_indentation`] does.
///
/// Each panel has the height map's size; an image of another size is sampled at its nearest pixels.
pub fn render_contact(image: &Raster<[u8; 3]>, contact: &Contact, sensor: &TactileSensor) -> Raster<[u8; 3]> {
    let decoded = render_indentation(contact, sensor);
    let (rows, cols) = contact.height_map.shape();
    let left = cols + gap(cols);
    Raster::from_fn(rows, left + decoded.cols(), |row, col| {
        if col < cols {
            image[(row * image.rows() / rows, col * image.cols() / cols)]
        } else if col < left {
            palette::PAPER
        } else {
            decoded[(row, col - left)]
        }
    })
}

/// Draws the indentation in colour, shaded from the upper left, the contact outlined in white, the colour scale at its right in
/// millimetres. Has the height map's size, and a fifth of its width for the scale.
pub fn render_indentation(contact: &Contact, sensor: &TactileSensor) -> Raster<[u8; 3]> {
    let depth = contact.indentation(sensor);
    let (rows, cols) = depth.shape();
    let scale = depth.as_slice().iter().copied().fold(MIN_SCALE, f32::max);
    let bar = (cols / 5).max(40);
    let mut picture = Raster::filled(rows, cols + gap(cols) + bar, palette::PAPER);
    let pitch = sensor.map_pitch(cols) as f32;
    for row in 0..rows {
        for col in 0..cols {
            picture[(row, col)] =
                if on_outline(&contact.mask, row, col) { [255; 3] } else { relief(&depth, row, col, scale, pitch) };
        }
    }
    scale_bar(&mut picture, cols + gap(cols), scale);
    picture
}

/// Paper between panels `cols` wide, pixels.
fn gap(cols: usize) -> usize {
    (cols / 40).max(2)
}

fn color(share: f32) -> [f32; 3] {
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let low = (place as usize).min(STOPS.len() - 2);
    let t = place - low as f32;
    [0, 1, 2].map(|k| STOPS[low][k] * (1.0 - t) + STOPS[low + 1][k] * t)
}

/// Colour by depth, brightness by slope.
fn relief(depth: &Raster<f32>, row: usize, col: usize, scale: f32, pitch: f32) -> [u8; 3] {
    let (rows, cols) = depth.shape();
    let step = |low: f32, high: f32, n: usize| RELIEF * (high - low) / (n.max(1) as f32 * pitch);
    let (left, right) = (col.saturating_sub(1), (col + 1).min(cols - 1));
    let (up, down) = (row.saturating_sub(1), (row + 1).min(rows - 1));
    let dx = step(depth[(row, left)], depth[(row, right)], right - left);
    let dy = step(depth[(up, col)], depth[(down, col)], down - up);
    // The object's side of the imprint, lit from the upper left.
    let light = (0.5 * (dx + dy) + 0.7) / (0.7 * (1.0 + dx * dx + dy * dy).sqrt());
    color(depth[(row, col)] / scale).map(|v| (v * light.clamp(0.35, 1.4)).min(255.0) as u8)
}

/// Whether a pixel of the mask has a neighbour outside it.
fn on_outline(mask: &Raster<bool>, row: usize, col: usize) -> bool {
    let (r, c) = (row as isize, col as isize);
    mask[(row, col)]
        && [(r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)].iter().any(|&(r, c)| mask.at(r, c) == Some(&false))
}

/// The colours from 0 to `scale`, with both ends written in millimetres.
fn scale_bar(picture: &mut Raster<[u8; 3]>, left: usize, scale: f32) {
    let (rows, width) = (picture.rows(), picture.cols() - left);
    let text = (0.19 * width as f64).clamp(6.0, 24.0);
    let margin = (1.6 * text) as usize;
    let (top, bottom) = (margin.min(rows / 2), rows.saturating_sub(margin).max(rows / 2));
    for row in top..bottom {
        let share = 1.0 - (row - top) as f32 / (bottom - top).max(2) as f32;
        for col in left + width / 3..left + 2 * width / 3 {
            picture[(row, col)] = color(share).map(|v| v as u8);
        }
    }
    let middle = left as f64 + 0.5 * width as f64;
    write(picture, &format!("{:.2} mm", 1e3 * scale), [middle, top as f64 - 0.4 * text], 0.8 * text, palette::INK);
    write(picture, "0", [middle, bottom as f64 + 1.1 * text], 0.8 * text, palette::INK);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_and_depth_stand_side_by_side_and_the_contact_is_outlined() {
        let sensor = TactileSensor::preset("gelsight-mini").expect("listed");
        let depth =
            Raster::from_fn(60, 80, |r, c| if r.abs_diff(30) < 10 && c.abs_diff(40) < 10 { 0.5e-3 } else { 0.0 });
        let contact = Contact::from_indentation(&depth, &sensor).expect("sound");
        let picture = render_contact(&Raster::filled(120, 160, [9, 8, 7]), &contact, &sensor);
        assert_eq!(picture[(30, 40)], [9, 8, 7]);
        let decoded = |r: usize, c: usize| picture[(r, 80 + 2 + c)];
        assert_eq!(decoded(21, 40), [255; 3]);
        // Deepest is yellow, untouched violet, both flat and so at full light.
        assert_eq!((decoded(30, 40), decoded(5, 5)), ([253, 231, 37], [68, 1, 84]));
    }
}
