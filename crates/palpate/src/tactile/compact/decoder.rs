use super::model::{CompactModel, WORKING_SIZE, indentation};
use super::{Weights, WeightsError};
use crate::geometry::Raster;
use crate::tactile::{Contact, DecodeError, Integrator, NoContact, TactileDecoder, TactileSensor};

/// Peak indentation under which nothing is called a contact, mm.
const CONTACT_FLOOR_MM: f32 = 0.05;

/// The decoder "compact": tactile image to height map and contact mask, about a hundredth of a second an image.
#[derive(Debug)]
pub struct CompactDecoder {
    model: CompactModel,
    /// Model of the sensor that the weights were trained for.
    trained_for: String,
    no_contact: NoContact,
    integrator: Integrator,
}

impl CompactDecoder {
    /// * `weights` – of this architecture, trained for the sensor's model
    /// * `no_contact` – of this very sensor and light
    ///
    /// # Errors
    /// [`WeightsError`] for weights of another network.
    pub fn new(weights: &Weights, no_contact: NoContact) -> Result<Self, WeightsError> {
        let model = CompactModel::from_weights(weights)?;
        let trained_for = weights.metadata("sensor").unwrap_or("unknown").to_owned();
        let integrator = Integrator::new(WORKING_SIZE.0, WORKING_SIZE.1);
        Ok(Self { model, trained_for, no_contact, integrator })
    }

    /// The network.
    pub fn model(&self) -> &CompactModel {
        &self.model
    }
}

impl TactileDecoder for CompactDecoder {
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        if sensor.model != self.trained_for {
            let (found, needed) = (sensor.model.clone(), self.trained_for.clone());
            return Err(DecodeError::OtherSensor { found, needed });
        }
        let (rows, cols) = WORKING_SIZE;
        let difference = self.no_contact.difference_at(image, rows, cols)?;
        let relaxed = sensor.relaxed(rows, cols);
        if NoContact::is_untouched(&difference) {
            return Ok(Contact { height_map: relaxed, mask: Raster::filled(rows, cols, false) });
        }
        let felt =
            indentation(&self.model.gradient, &self.model.level, &difference, &relaxed, &self.integrator);
        let touched = felt.peak > CONTACT_FLOOR_MM;
        let mask = self.model.mask.run(&felt).map(|&logit| touched && logit > 0.0);
        let heights = relaxed.as_slice().iter().zip(felt.depth.as_slice()).map(|(g, d)| g - 1e-3 * d.max(0.0));
        let height_map = Raster::from_vec(rows, cols, heights.collect()).expect("of the working size");
        Ok(Contact { height_map, mask })
    }
}
