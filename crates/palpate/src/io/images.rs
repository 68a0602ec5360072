//! Images: 16-bit grey PNG for depth, 8-bit PNG for masks, PNG or JPEG for colours.

use super::error::read_bytes;
use super::{IoError, atomic_write};
use crate::geometry::Raster;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder as _, ImageFormat, ImageReader, Limits};
use std::io::{self, Cursor, Write};
use std::path::Path;

const PNG: &str = "PNG";
/// Most pixels of an image: 64 million, a third more than the largest industrial camera.
const PIXEL_LIMIT: u64 = 1 << 26;

/// Decodes after comparing the claimed size with the length of the file: deflate makes at most 1032 bytes of one.
fn decode(name: &Path, bytes: &[u8], formats: &[ImageFormat]) -> Result<DynamicImage, IoError> {
    let format = image::guess_format(bytes).ok().filter(|f| formats.contains(f));
    let wanted = if formats.len() > 1 { "PNG or JPEG" } else { PNG };
    let format = format.ok_or_else(|| IoError::malformed(name, wanted, "it does not begin like one"))?;
    let bad = |e: image::ImageError| IoError::malformed(name, wanted, e.to_string());
    let reader = || {
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        let mut limits = Limits::default();
        limits.max_alloc = Some(1 << 30);
        reader.limits(limits);
        reader
    };
    let (width, height) = reader().into_dimensions().map_err(bad)?;
    let pixels = u64::from(width) * u64::from(height);
    let possible = if format == ImageFormat::Png { (bytes.len() as u64 + 8) * 1032 * 8 } else { PIXEL_LIMIT };
    if pixels > PIXEL_LIMIT.min(possible) {
        let reason = format!("the header claims {width}×{height} pixels in a file of {} bytes", bytes.len());
        return Err(IoError::malformed(name, wanted, reason));
    }
    reader().decode().map_err(bad)
}

fn raster<T: Copy>(width: u32, height: u32, values: Vec<T>) -> Raster<T> {
    Raster::from_vec(height as usize, width as usize, values).expect("a decoded image has width · height pixels")
}

/// Reads a depth image: 16-bit grey PNG, 0 = no reading. Returns metres, NaN where there is none.
///
/// # Errors
/// [`IoError::Read`], [`IoError::Malformed`], or [`IoError::Content`] if it is not 16-bit grey or all 0.
pub fn read_depth_png(path: impl AsRef<Path>, metres_per_unit: f64) -> Result<Raster<f32>, IoError> {
    parse_depth_png(path.as_ref(), &read_bytes(path.as_ref())?, metres_per_unit)
}

/// [`read_depth_png`] from memory; `name` is used in messages.
///
/// # Errors
/// As [`read_depth_png`].
pub fn parse_depth_png(name: &Path, bytes: &[u8], metres_per_unit: f64) -> Result<Raster<f32>, IoError> {
    let image = match decode(name, bytes, &[ImageFormat::Png])? {
        DynamicImage::ImageLuma16(image) => image,
        other => {
            return Err(IoError::content(
                name,
                format!("the pixels are {:?}; a depth image is 16-bit grey (L16)", other.color()),
            ));
        }
    };
    let (width, height) = image.dimensions();
    let metres = |u: &u16| if *u == 0 { f32::NAN } else { (f64::from(*u) * metres_per_unit) as f32 };
    let depth: Vec<f32> = image.as_raw().iter().map(metres).collect();
    if depth.iter().all(|z| z.is_nan()) {
        return Err(IoError::content(name, format!("all {width}×{height} pixels are 0: there is no depth reading")));
    }
    Ok(raster(width, height, depth))
}

/// Writes a depth image as 16-bit grey PNG: NaN becomes 0, a depth is rounded to the nearest unit (at least 1).
///
/// # Errors
/// [`IoError::Content`] if a depth does not fit, else as [`atomic_write`].
pub fn write_depth_png(path: impl AsRef<Path>, depth: &Raster<f32>, metres_per_unit: f64) -> Result<(), IoError> {
    let path = path.as_ref();
    check_depth(path, depth, metres_per_unit)?;
    let units = |z: &f32| if z.is_nan() { 0 } else { in_units(*z, metres_per_unit).max(1.0) as u16 };
    let bytes: Vec<u8> = depth.as_slice().iter().flat_map(|z| units(z).to_ne_bytes()).collect();
    atomic_write(path, |w| encode(w, &bytes, depth.shape(), ExtendedColorType::L16))
}

fn in_units(z: f32, metres_per_unit: f64) -> f64 {
    (f64::from(z) / metres_per_unit).round()
}

/// Says no before anything is written to a depth image that cannot hold every reading.
pub(super) fn check_depth(path: &Path, depth: &Raster<f32>, metres_per_unit: f64) -> Result<(), IoError> {
    let fits = |z: f32| z.is_nan() || (0.0..=65535.0).contains(&in_units(z, metres_per_unit));
    match depth.pixels().find(|(_, _, z)| !fits(**z)) {
        None => Ok(()),
        Some((row, col, z)) => {
            let farthest = 65535.0 * metres_per_unit;
            let reason = format!(
                "the depth of {z} m at pixel ({col}, {row}) does not fit 16 bits of {metres_per_unit} m (0 to {farthest} m)"
            );
            Err(IoError::content(path, reason))
        }
    }
}

/// A picture that keeps its depth: 16-bit grey (infrared), or colour.
#[derive(Debug, Clone, PartialEq)]
pub enum Picture {
    /// sRGB; 8-bit grey becomes colour.
    Color(Raster<[u8; 3]>),
    /// 16-bit grey.
    Gray16(Raster<u16>),
}

/// Reads a picture, PNG or JPEG: 16-bit grey as it is, anything else as [`read_color`] does.
///
/// # Errors
/// [`IoError::Read`] or [`IoError::Malformed`].
pub fn read_picture(path: impl AsRef<Path>) -> Result<Picture, IoError> {
    let path = path.as_ref();
    Ok(match decode(path, &read_bytes(path)?, &[ImageFormat::Png, ImageFormat::Jpeg])? {
        DynamicImage::ImageLuma16(image) => {
            let (width, height) = image.dimensions();
            Picture::Gray16(raster(width, height, image.into_raw()))
        }
        other => Picture::Color(color(other)),
    })
}

/// Writes a picture as PNG, in its depth.
///
/// # Errors
/// As [`atomic_write`].
pub fn write_picture(path: impl AsRef<Path>, picture: &Picture) -> Result<(), IoError> {
    match picture {
        Picture::Color(image) => write_color(path, image),
        Picture::Gray16(image) => {
            let bytes: Vec<u8> = image.as_slice().iter().flat_map(|v| v.to_ne_bytes()).collect();
            atomic_write(path, |w| encode(w, &bytes, image.shape(), ExtendedColorType::L16))
        }
    }
}

fn color(image: DynamicImage) -> Raster<[u8; 3]> {
    let image = image.into_rgb8();
    let pixels = image.as_raw().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    raster(image.width(), image.height(), pixels)
}

/// Reads a colour image, PNG or JPEG, as sRGB; grey becomes colour, transparency is dropped.
///
/// # Errors
/// [`IoError::Read`] or [`IoError::Malformed`].
pub fn read_color(path: impl AsRef<Path>) -> Result<Raster<[u8; 3]>, IoError> {
    parse_color(path.as_ref(), &read_bytes(path.as_ref())?)
}

/// [`read_color`] from memory; `name` is used in messages.
///
/// # Errors
/// As [`read_color`].
pub fn parse_color(name: &Path, bytes: &[u8]) -> Result<Raster<[u8; 3]>, IoError> {
    Ok(color(decode(name, bytes, &[ImageFormat::Png, ImageFormat::Jpeg])?))
}

/// Reads an image as grey values: 16-bit grey as it is (infrared), anything else as 8-bit luma. PNG or JPEG.
///
/// # Errors
/// [`IoError::Read`] or [`IoError::Malformed`].
pub fn read_gray(path: impl AsRef<Path>) -> Result<Raster<f32>, IoError> {
    let path = path.as_ref();
    let (width, height, values) = match decode(path, &read_bytes(path)?, &[ImageFormat::Png, ImageFormat::Jpeg])? {
        DynamicImage::ImageLuma16(image) => {
            (image.width(), image.height(), image.as_raw().iter().map(|&v| f32::from(v)).collect())
        }
        other => {
            let image = other.into_luma8();
            (image.width(), image.height(), image.as_raw().iter().map(|&v| f32::from(v)).collect())
        }
    };
    Ok(raster(width, height, values))
}

/// Writes an sRGB image as PNG.
///
/// # Errors
/// As [`atomic_write`].
pub fn write_color(path: impl AsRef<Path>, image: &Raster<[u8; 3]>) -> Result<(), IoError> {
    atomic_write(path, |w| encode(w, image.as_slice().as_flattened(), image.shape(), ExtendedColorType::Rgb8))
}

/// Reads a mask: PNG, true where the grey value is at least 128.
///
/// # Errors
/// [`IoError::Read`], [`IoError::Malformed`], or [`IoError::Content`] if something is marked, but all too faintly.
pub fn read_mask(path: impl AsRef<Path>) -> Result<Raster<bool>, IoError> {
    parse_mask(path.as_ref(), &read_bytes(path.as_ref())?)
}

/// [`read_mask`] from memory; `name` is used in messages.
///
/// # Errors
/// As [`read_mask`].
pub fn parse_mask(name: &Path, bytes: &[u8]) -> Result<Raster<bool>, IoError> {
    let image = decode(name, bytes, &[ImageFormat::Png])?.into_luma8();
    let largest = image.as_raw().iter().copied().max().unwrap_or(0);
    if (1..128).contains(&largest) {
        return Err(IoError::content(
            name,
            format!("the largest value is {largest}; a mask has 255 for yes and 0 for no"),
        ));
    }
    Ok(raster(image.width(), image.height(), image.as_raw().iter().map(|&v| v >= 128).collect()))
}

/// Writes a mask as 8-bit grey PNG: 255 = true.
///
/// # Errors
/// As [`atomic_write`].
pub fn write_mask(path: impl AsRef<Path>, mask: &Raster<bool>) -> Result<(), IoError> {
    let bytes: Vec<u8> = mask.as_slice().iter().map(|&m| if m { 255 } else { 0 }).collect();
    atomic_write(path, |w| encode(w, &bytes, mask.shape(), ExtendedColorType::L8))
}

/// Writes an sRGB image as JPEG.
///
/// * `quality` – 1 to 100
///
/// # Errors
/// As [`atomic_write`].
pub fn write_jpeg(path: impl AsRef<Path>, image: &Raster<[u8; 3]>, quality: u8) -> Result<(), IoError> {
    let (rows, cols) = image.shape();
    atomic_write(path, |w| {
        image::codecs::jpeg::JpegEncoder::new_with_quality(w, quality)
            .encode(image.as_slice().as_flattened(), cols as u32, rows as u32, ExtendedColorType::Rgb8)
            .map_err(io::Error::other)
    })
}

fn encode(w: &mut impl Write, bytes: &[u8], (rows, cols): (usize, usize), color: ExtendedColorType) -> io::Result<()> {
    PngEncoder::new_with_quality(w, CompressionType::Default, FilterType::Adaptive)
        .write_image(bytes, cols as u32, rows as u32, color)
        .map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn infrared_keeps_its_sixteen_bits() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("ir.png");
        let infrared = Picture::Gray16(Raster::from_fn(12, 16, |r, c| (100 * r + c) as u16));
        write_picture(&path, &infrared).expect("written");
        assert_eq!(read_picture(&path).expect("read"), infrared);
        let color = Picture::Color(Raster::from_fn(12, 16, |r, c| [r as u8, c as u8, 7]));
        write_picture(&path, &color).expect("written");
        assert_eq!(read_picture(&path).expect("read"), color);
    }

    #[test]
    fn depth_survives_writing_and_reading() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("depth.png");
        let depth =
            Raster::from_fn(3, 5, |r, c| if r == c { f32::NAN } else { 0.5 + 0.01 * r as f32 + 0.0001 * c as f32 });
        write_depth_png(&path, &depth, 0.0001).expect("written");
        let back = read_depth_png(&path, 0.0001).expect("read");
        assert_eq!(back.shape(), (3, 5));
        for (a, b) in depth.as_slice().iter().zip(back.as_slice()) {
            assert!((a - b).abs() < 1e-6 || (a.is_nan() && b.is_nan()), "{a} {b}");
        }
        assert!(write_depth_png(&path, &Raster::filled(1, 1, 7.0), 0.0001).is_err());
    }

    #[test]
    fn colours_and_masks_survive_writing_and_reading() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("image.png");
        let color = Raster::from_fn(4, 3, |r, c| [r as u8 * 60, c as u8 * 100, 255]);
        write_color(&path, &color).expect("written");
        assert_eq!(read_color(&path).expect("read"), color);
        let mask = Raster::from_fn(4, 3, |r, c| (r + c) % 2 == 0);
        write_mask(&path, &mask).expect("written");
        assert_eq!(read_mask(&path).expect("read"), mask);
        let wrong = read_depth_png(&path, 0.001).expect_err("8 bit");
        assert!(wrong.to_string().contains("L8; a depth image is 16-bit grey"), "{wrong}");
    }

    #[test]
    fn no_reading_at_all_and_faint_masks_are_errors() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("image.png");
        write_depth_png(&path, &Raster::filled(2, 2, f32::NAN), 0.001).expect("written");
        assert!(read_depth_png(&path, 0.001).expect_err("empty").to_string().contains("are 0"));
        atomic_write(&path, |w| encode(w, &[0, 1, 1, 0], (2, 2), ExtendedColorType::L8)).expect("written");
        assert!(read_mask(&path).expect_err("faint").to_string().contains("largest value is 1"));
    }

    #[test]
    fn a_claimed_size_beyond_the_file_is_refused() {
        let mut bytes = Vec::new();
        encode(&mut bytes, &[0, 1, 0, 1], (1, 2), ExtendedColorType::L16).expect("memory");
        bytes[16..24].copy_from_slice(&[0, 0, 32, 0, 0, 0, 32, 0]); // 8192 × 8192
        let crc = bytes[12..29].iter().fold(!0u32, |crc, &b| {
            (0..8).fold(crc ^ u32::from(b), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
        });
        bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
        let error = parse_depth_png(Path::new("big.png"), &bytes, 0.001).expect_err("a lie").to_string();
        assert!(error.contains("claims 8192×8192 pixels"), "{error}");
    }
}
