//! Photometric tables and the background that ship with the crate: Taxim's calibration files (MIT), see `assets/taxim`.

use super::{OpticsError, PhotometricTable};
use crate::geometry::Raster;
use std::sync::OnceLock;

/// Shapes a preset's table: bins, width of the calibration frame, coefficients as float16 in an npy file.
type Asset = (usize, usize, &'static [u8]);

const DEFAULT: Asset = (125, 640, include_bytes!("../../../assets/taxim/default_gelsight.npy"));
const R15: Asset = (120, 480, include_bytes!("../../../assets/taxim/gelsight_r1.5.npy"));
const DIGIT: Asset = (125, 640, include_bytes!("../../../assets/taxim/digit.npy"));
const BACKGROUND: &[u8] = include_bytes!("../../../assets/taxim/background.jpg");

/// The photometric table of a sensor model.
///
/// `gelsight-mini` borrows the table of the default gel, since none of its own is published under a free licence.
pub(super) fn table(model: &str) -> Result<&'static PhotometricTable, OpticsError> {
    static DEFAULT_TABLE: OnceLock<PhotometricTable> = OnceLock::new();
    static R15_TABLE: OnceLock<PhotometricTable> = OnceLock::new();
    static DIGIT_TABLE: OnceLock<PhotometricTable> = OnceLock::new();
    match model {
        "ycb-sight" | "gelsight-mini" => Ok(DEFAULT_TABLE.get_or_init(|| load(DEFAULT))),
        "gelsight-r15" => Ok(R15_TABLE.get_or_init(|| load(R15))),
        "digit" => Ok(DIGIT_TABLE.get_or_init(|| load(DIGIT))),
        _ => Err(OpticsError::NoTable { model: model.to_owned() }),
    }
}

/// Photograph-like background of a model, 640 × 480, or a plain grey where nothing free is known of the sensor's light.
pub(super) fn background(model: &str) -> Raster<[u8; 3]> {
    match model {
        "ycb-sight" | "gelsight-mini" => {
            let image = image::load_from_memory(BACKGROUND).expect("the asset is a JPEG").to_rgb8();
            let (cols, rows) = (image.width() as usize, image.height() as usize);
            let pixels = image.into_raw();
            Raster::from_fn(rows, cols, |r, c| std::array::from_fn(|k| pixels[3 * (r * cols + c) + k]))
        }
        _ => Raster::filled(480, 640, [128; 3]),
    }
}

fn load((bins, width, file): Asset) -> PhotometricTable {
    let needed = bins * bins * 18;
    let data = &file[file.len() - 2 * needed..];
    let values: Vec<f32> = data.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect();
    PhotometricTable::new(bins, width, &values).expect("the asset is a complete table")
}
