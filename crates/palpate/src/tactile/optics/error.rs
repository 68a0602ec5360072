use crate::tactile::SensorError;

/// Why tactile images cannot be rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OpticsError {
    /// The sensor is unknown or inconsistent.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// There is no photometric table for this sensor.
    #[error(
        "no photometric table is known for the sensor '{model}'; presets with one: ycb-sight, gelsight-r15, gelsight-mini, digit"
    )]
    NoTable {
        /// Model of the sensor.
        model: String,
    },
    /// A photometric table has the wrong number of coefficients.
    #[error(
        "the photometric table has {found} coefficients; {bins} × {bins} bins of 3 channels with 6 terms need {needed}"
    )]
    TableSize {
        /// Coefficients found.
        found: usize,
        /// Bins along magnitude and direction.
        bins: usize,
        /// Coefficients needed.
        needed: usize,
    },
    /// A coefficient is NaN or infinite.
    #[error("coefficient {index} of the photometric table is {found}; all must be finite")]
    NotFinite {
        /// Index in the table, term fastest.
        index: usize,
        /// Value found.
        found: f32,
    },
    /// A raster does not have the sensor's size.
    #[error("{what} is {} × {} (rows × cols); the sensor needs {} × {}", found.0, found.1, needed.0, needed.1)]
    Size {
        /// Which raster.
        what: &'static str,
        /// Rows and columns found.
        found: (usize, usize),
        /// Rows and columns needed.
        needed: (usize, usize),
    },
}
