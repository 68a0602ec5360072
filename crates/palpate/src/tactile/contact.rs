use super::TactileSensor;
use crate::geometry::{Isometry, Raster};

/// What the gel felt: its deformed surface and where the object touched it.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// z of the gel surface in the sensor frame, metres (indented < 0). Row, col over the whole pad.
    pub height_map: Raster<f32>,
    /// True where the object touches; same shape.
    pub mask: Raster<bool>,
}

/// One press of the fingertip.
#[derive(Debug, Clone)]
pub struct Touch {
    /// Recorded height map and mask, if any.
    pub contact: Option<Contact>,
    /// Tactile image, sRGB, if any.
    pub image: Option<Raster<[u8; 3]>>,
    /// Pose of the sensor frame in the pressed pose.
    pub world_from_sensor: Isometry,
}

/// What is wrong with a height map or a contact mask.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ContactError {
    /// The two rasters differ in size.
    #[error("height map is {} × {} (rows × cols) but contact mask is {} × {}", height.0, height.1, mask.0, mask.1)]
    ShapeMismatch {
        /// Rows and columns of the height map.
        height: (usize, usize),
        /// Rows and columns of the mask.
        mask: (usize, usize),
    },
    /// The raster does not have the pad's aspect.
    #[error(
        "height map is {found_rows} × {cols} (rows × cols); a map {cols} wide of this sensor has {needed_rows} rows"
    )]
    Aspect {
        /// Rows found.
        found_rows: usize,
        /// Columns found.
        cols: usize,
        /// Rows that fit the sensor.
        needed_rows: usize,
    },
    /// A height is NaN or infinite.
    #[error("height map at (row {row}, col {col}) is {found}; every height must be finite")]
    NotFinite {
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        col: usize,
        /// Value found.
        found: f32,
    },
    /// A height is beyond any gel.
    #[error(
        "height map at (row {row}, col {col}) is {found} m; |z| must stay under {limit} m (is the map in mm or pixels?)"
    )]
    TooLarge {
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        col: usize,
        /// Value found, metres.
        found: f32,
        /// Largest absolute value allowed, metres.
        limit: f64,
    },
    /// The gel stands out over its relaxed shape.
    #[error(
        "height map at (row {row}, col {col}) is {found} m, above the relaxed gel at {relaxed} m by more than {tolerance} m \
         (z must fall where the gel is indented: is the sign turned?)"
    )]
    AboveRelaxed {
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        col: usize,
        /// Value found, metres.
        found: f32,
        /// Relaxed gel there, metres.
        relaxed: f64,
        /// Bulge allowed, metres.
        tolerance: f64,
    },
}

impl Contact {
    /// Largest |z| of a gel surface, metres: no gel is thicker.
    pub const MAX_HEIGHT: f64 = 0.02;
    /// How far the surface may stand above the relaxed gel, metres: a pressed gel bulges round the contact, decoders err.
    pub const BULGE_TOLERANCE: f64 = 0.5e-3;

    /// Checks a height map and mask against the sensor that took them.
    ///
    /// * `height_map` – z in the sensor frame, metres; any resolution with the pad's aspect
    /// * `mask` – true where the object touches
    ///
    /// # Errors
    /// The first [`ContactError`] found, with the pixel.
    pub fn new(height_map: Raster<f32>, mask: Raster<bool>, sensor: &TactileSensor) -> Result<Self, ContactError> {
        let contact = Self { height_map, mask };
        contact.validate(sensor)?;
        Ok(contact)
    }

    /// The checks of [`Self::new`].
    ///
    /// # Errors
    /// The first [`ContactError`] found, with the pixel.
    pub fn validate(&self, sensor: &TactileSensor) -> Result<(), ContactError> {
        let (rows, cols) = self.height_map.shape();
        if self.mask.shape() != (rows, cols) {
            return Err(ContactError::ShapeMismatch { height: (rows, cols), mask: self.mask.shape() });
        }
        let needed_rows = sensor.map_rows(cols);
        if rows == 0 || rows.abs_diff(needed_rows) > 1 {
            return Err(ContactError::Aspect { found_rows: rows, cols, needed_rows });
        }
        for (row, col, &found) in self.height_map.pixels() {
            let z = f64::from(found);
            if !z.is_finite() {
                return Err(ContactError::NotFinite { row, col, found });
            }
            if z.abs() > Self::MAX_HEIGHT {
                return Err(ContactError::TooLarge { row, col, found, limit: Self::MAX_HEIGHT });
            }
            let relaxed = sensor.relaxed_z(row, col, rows, cols);
            if z > relaxed + Self::BULGE_TOLERANCE {
                let tolerance = Self::BULGE_TOLERANCE;
                return Err(ContactError::AboveRelaxed { row, col, found, relaxed, tolerance });
            }
        }
        Ok(())
    }

    /// Share of the pad that the mask covers.
    pub fn contact_share(&self) -> f64 {
        let area = self.mask.as_slice().len().max(1);
        self.mask.as_slice().iter().filter(|&&m| m).count() as f64 / area as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor() -> TactileSensor {
        TactileSensor::preset("gelsight-mini").expect("listed")
    }

    fn with(value: f32) -> Result<Contact, ContactError> {
        let mut height_map = Raster::filled(24, 32, 0.0f32);
        height_map[(5, 7)] = value;
        Contact::new(height_map, Raster::filled(24, 32, false), &sensor())
    }

    #[test]
    fn heights_are_checked_and_the_pixel_is_named() {
        assert!(with(-0.9e-3).is_ok());
        assert!(matches!(with(f32::NAN), Err(ContactError::NotFinite { row: 5, col: 7, .. })));
        assert!(matches!(with(-0.9), Err(ContactError::TooLarge { row: 5, col: 7, .. })));
        assert!(matches!(with(0.9e-3), Err(ContactError::AboveRelaxed { row: 5, col: 7, .. })));
        assert!(with(-30.0).expect_err("pixels").to_string().contains("mm or pixels"));
    }

    #[test]
    fn shapes_are_checked() {
        let map = |r, c| Raster::filled(r, c, 0.0f32);
        let mask = |r, c| Raster::filled(r, c, false);
        assert!(matches!(
            Contact::new(map(24, 32), mask(32, 24), &sensor()),
            Err(ContactError::ShapeMismatch { height: (24, 32), mask: (32, 24) })
        ));
        assert!(matches!(
            Contact::new(map(32, 24), mask(32, 24), &sensor()),
            Err(ContactError::Aspect { found_rows: 32, cols: 24, needed_rows: 18 })
        ));
    }
}
