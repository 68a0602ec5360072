use super::SlopeNetwork;
use crate::geometry::Raster;
use crate::tactile::{
    Border, Contact, DecodeError, Integrator, LookupDecoder, LookupTable, NoContact, RegressorDecoder, SlopeRegressor,
    TactileDecoder, TactileSensor, fill_markers, markers,
};

/// A calibrated map from colour to slope.
#[derive(Debug, Clone, PartialEq)]
pub enum GelMap {
    /// Colour to slope, cell by cell.
    Table(LookupTable),
    /// A quadratic in colours and place.
    Quadratic(SlopeRegressor),
    /// A small network of colours and place.
    Network(SlopeNetwork),
}

/// The kinds of [`GelMap`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MapKind {
    /// [`GelMap::Table`]: needs each colour to have been seen.
    Table,
    /// [`GelMap::Quadratic`]: closed form; five presses are enough.
    #[default]
    Quadratic,
    /// [`GelMap::Network`].
    Network,
}

impl GelMap {
    /// Which kind it is.
    pub fn kind(&self) -> MapKind {
        match self {
            Self::Table(_) => MapKind::Table,
            Self::Quadratic(_) => MapKind::Quadratic,
            Self::Network(_) => MapKind::Network,
        }
    }
}

impl MapKind {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::Quadratic => "quadratic",
            Self::Network => "network",
        }
    }
}

/// Decodes with a calibrated gel.
pub struct GelDecoder {
    inner: Box<dyn TactileDecoder + Send>,
    markers: bool,
    size: (usize, usize),
}

impl GelDecoder {
    /// * `background` – no-contact image of the sensor, as taken
    /// * `markers` – whether the gel has printed dots; they are filled in, in the background and in each image
    ///
    /// # Errors
    /// [`DecodeError`] if the background does not fit the sensor.
    pub fn new(
        map: GelMap,
        background: &Raster<[u8; 3]>,
        markers: bool,
        sensor: &TactileSensor,
    ) -> Result<Self, DecodeError> {
        let no_contact = NoContact::new(prepared(background, markers), sensor)?;
        let size = no_contact.shape();
        let inner: Box<dyn TactileDecoder + Send> = match map {
            GelMap::Table(table) => Box::new(LookupDecoder::new(table, no_contact, Border::Free)),
            GelMap::Quadratic(regressor) => Box::new(RegressorDecoder::new(regressor, no_contact)),
            GelMap::Network(network) => Box::new(NetworkDecoder::new(network, no_contact)),
        };
        Ok(Self { inner, markers, size })
    }
}

impl TactileDecoder for GelDecoder {
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        if !self.markers {
            return self.inner.decode(image, sensor);
        }
        let small = at_size(image, self.size.0, self.size.1);
        self.inner.decode(&prepared(&small, true), sensor)
    }
}

/// The image without its markers, if there are some.
pub(super) fn prepared(image: &Raster<[u8; 3]>, has_markers: bool) -> Raster<[u8; 3]> {
    if has_markers { fill_markers(image, &markers(image)) } else { image.clone() }
}

/// An image that is a whole multiple as large, averaged down; any other as it is.
pub(super) fn at_size(image: &Raster<[u8; 3]>, rows: usize, cols: usize) -> Raster<[u8; 3]> {
    let factor = image.rows() / rows.max(1);
    if factor <= 1 || image.shape() != (rows * factor, cols * factor) {
        return image.clone();
    }
    Raster::from_fn(rows, cols, |row, col| {
        let mut sum = [0u32; 3];
        for r in 0..factor {
            for c in 0..factor {
                let pixel = image[(row * factor + r, col * factor + c)];
                (0..3).for_each(|k| sum[k] += u32::from(pixel[k]));
            }
        }
        let n = (factor * factor) as u32;
        sum.map(|s| ((s + n / 2) / n) as u8)
    })
}

struct NetworkDecoder {
    network: SlopeNetwork,
    no_contact: NoContact,
    integrator: Integrator,
}

impl NetworkDecoder {
    fn new(network: SlopeNetwork, no_contact: NoContact) -> Self {
        let (rows, cols) = no_contact.shape();
        Self { network, no_contact, integrator: Integrator::new(rows, cols) }
    }
}

impl TactileDecoder for NetworkDecoder {
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        let difference = self.no_contact.difference(image)?;
        if NoContact::is_untouched(&difference) {
            return Contact::from_indentation(&difference.map(|_| 0.0), sensor);
        }
        let relative = SlopeRegressor::relative_difference(&self.no_contact, &difference);
        let (rows, cols) = relative.shape();
        let slopes = Raster::from_fn(rows, cols, |row, col| {
            self.network.slope(relative[(row, col)], SlopeRegressor::place(row, col, rows, cols))
        });
        let mut indentation = self.integrator.poisson_neumann(&slopes);
        let level = border_median(&indentation);
        let pitch = sensor.map_pitch(cols) as f32;
        indentation.as_mut_slice().iter_mut().for_each(|d| *d = (*d - level) * pitch);
        Contact::from_indentation(&indentation, sensor)
    }
}

/// Median of the border ring: taken as the relaxed gel.
fn border_median(map: &Raster<f32>) -> f32 {
    let (rows, cols) = map.shape();
    let on_ring = |r: usize, c: usize| r == 0 || c == 0 || r + 1 == rows || c + 1 == cols;
    let mut ring: Vec<f32> = map.pixels().filter(|p| on_ring(p.0, p.1)).map(|p| *p.2).collect();
    let middle = ring.len() / 2;
    *ring.select_nth_unstable_by(middle, f32::total_cmp).1
}
