//! Pixels of messages to rasters.

use crate::{CompressedImage, Image};
use palpate::geometry::Raster;
use palpate::io::{parse_color, parse_depth_png};
use std::path::Path;

/// Metres of an image message, NaN where there is no reading: `16UC1` and `mono16` in millimetres, `32FC1` in metres.
pub(crate) fn depth(image: &Image) -> Result<Raster<f32>, String> {
    let size = match image.encoding.as_str() {
        "16UC1" | "mono16" => 2,
        "32FC1" => 4,
        other => return Err(format!("depth is encoded as '{other}'; 16UC1 (mm), mono16 (mm) or 32FC1 (m) is needed")),
    };
    rows_fit(image, size)?;
    let reading = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        if image.big_endian {
            bytes.reverse();
        }
        let z = match bytes[..] {
            [a, b] => (f64::from(u16::from_le_bytes([a, b])) * 1e-3) as f32,
            [a, b, c, d] => f32::from_le_bytes([a, b, c, d]),
            _ => f32::NAN,
        };
        if z > 0.0 && z.is_finite() { z } else { f32::NAN }
    };
    let at = |row: usize, col: usize| {
        let start = row * image.step + col * size;
        reading(&image.data[start..start + size])
    };
    Ok(Raster::from_fn(image.height, image.width, at))
}

/// sRGB of an image message.
pub(crate) fn color(image: &Image) -> Result<Raster<[u8; 3]>, String> {
    let (size, order) = match image.encoding.as_str() {
        "rgb8" => (3, [0, 1, 2]),
        "bgr8" | "8UC3" => (3, [2, 1, 0]),
        "rgba8" => (4, [0, 1, 2]),
        "bgra8" | "8UC4" => (4, [2, 1, 0]),
        "mono8" | "8UC1" => (1, [0, 0, 0]),
        other => {
            return Err(format!("colour is encoded as '{other}'; rgb8, bgr8, rgba8, bgra8 or mono8 is needed"));
        }
    };
    rows_fit(image, size)?;
    let at = |row: usize, col: usize| {
        let start = row * image.step + col * size;
        order.map(|k| image.data[start + k])
    };
    Ok(Raster::from_fn(image.height, image.width, at))
}

fn rows_fit(image: &Image, size: usize) -> Result<(), String> {
    if image.width.checked_mul(size).is_none_or(|row| row > image.step) {
        return Err(format!("{} pixels of {size} bytes do not fit a row of {} bytes", image.width, image.step));
    }
    Ok(())
}

/// sRGB of a compressed image: PNG or JPEG.
pub(crate) fn compressed_color(image: &CompressedImage) -> Result<Raster<[u8; 3]>, String> {
    parse_color(Path::new("message"), &image.data).map_err(|e| format!("format '{}': {e}", image.format))
}

/// Metres of a compressed depth image: PNG of 16 bits in millimetres, behind the twelve bytes that `compressedDepth` puts before it.
pub(crate) fn compressed_depth(image: &CompressedImage) -> Result<Raster<f32>, String> {
    const PNG: &[u8] = b"\x89PNG";
    let at = [0, 12].into_iter().find(|&at| image.data.get(at..).is_some_and(|rest| rest.starts_with(PNG)));
    let Some(at) = at else {
        return Err(format!("compressed depth of format '{}' is not a PNG; 16UC1 as PNG is needed", image.format));
    };
    if image.format.contains("32FC1") {
        return Err(format!("format '{}' stores inverse depth; 16UC1 as PNG is needed", image.format));
    }
    parse_depth_png(Path::new("message"), &image.data[at..], 0.001).map_err(|e| e.to_string())
}
