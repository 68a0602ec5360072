use super::model::{CompactModel, WORKING_SIZE, indentation};
use super::{Weights, WeightsError};
use crate::geometry::Raster;
use crate::tactile::{CONTACT_FLOOR, Contact, DecodeError, Integrator, NoContact, TactileDecoder, TactileSensor};

/// Most that the decoded gel stands out over its relaxed shape, mm: the membrane bends outwards a little beside a deep imprint.
const MOST_BULGE_MM: f32 = 0.2;

/// The decoder "compact": tactile image to height map and contact mask, about a hundredth of a second an image.
#[derive(Debug)]
pub struct CompactDecoder {
    model: CompactModel,
    /// Model of the sensor that the weights were trained for.
    trained_for: String,
    no_contact: NoContact,
    integrator: Integrator,
}

/// The weights that come with the crate: see the model card beside the file.
const SHIPPED: &[u8] = include_bytes!("../../../assets/compact/ycb-sight.safetensors");

impl CompactDecoder {
    /// The decoder for the sensor `ycb-sight` with the weights that come with the crate.
    pub fn shipped(no_contact: NoContact) -> Self {
        let weights = Weights::parse(SHIPPED).expect("the shipped file is whole");
        Self::new(&weights, no_contact).expect("the shipped file is of this network")
    }

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
        let felt = indentation(&self.model.gradient, &self.model.level, &difference, &relaxed, &self.integrator);
        let touched = 1e-3 * felt.peak > CONTACT_FLOOR;
        let mask = self.model.mask.run(&felt).map(|&logit| touched && logit > 0.0);
        let heights =
            relaxed.as_slice().iter().zip(felt.depth.as_slice()).map(|(g, d)| g - 1e-3 * d.max(-MOST_BULGE_MM));
        let height_map = Raster::from_vec(rows, cols, heights.collect()).expect("of the working size");
        Ok(Contact { height_map, mask })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tactile::optics::TactileOptics;

    fn decoder() -> (CompactDecoder, TactileSensor, Raster<[u8; 3]>) {
        let sensor = TactileSensor::preset("ycb-sight").expect("listed");
        let rest = TactileOptics::preset(&sensor).expect("has a table").no_contact();
        let no_contact = NoContact::new(rest.clone(), &sensor).expect("sound");
        (CompactDecoder::shipped(no_contact), sensor, rest)
    }

    #[test]
    fn an_untouched_gel_is_relaxed() {
        let (decoder, sensor, rest) = decoder();
        let contact = decoder.decode(&rest, &sensor).expect("decoded");
        assert!(contact.mask.as_slice().iter().all(|m| !m));
        assert_eq!(contact.height_map, sensor.relaxed(240, 320));
    }

    #[test]
    fn a_ball_is_felt_where_and_as_deep_as_it_was_pressed() {
        use crate::tactile::{PressParams, press_surface};
        let (decoder, sensor, _) = decoder();
        let optics = TactileOptics::preset(&sensor).expect("has a table");
        let radius = 10e-3;
        let ball = Raster::from_fn(480, 640, |r, c| {
            let (x, y) = sensor.pixel_position(r, c, 480, 640);
            let rest = radius * radius - (x - 2e-3f64).powi(2) - (y + 1e-3f64).powi(2);
            if rest > 0.0 { (radius - rest.sqrt()) as f32 } else { f32::INFINITY }
        });
        let truth = press_surface(&ball, &nalgebra::Isometry3::identity(), &sensor, &PressParams::default());
        let truth = truth.expect("contact").contact;
        let image = optics.render(&truth.height_map).expect("its size");
        let contact = decoder.decode(&image, &sensor).expect("decoded");
        let (mut both, mut either, mut worst) = (0.0, 0.0, 0.0f32);
        for (row, col, &felt) in contact.mask.pixels() {
            let really = truth.mask[(2 * row, 2 * col)];
            both += f64::from(u8::from(felt && really));
            either += f64::from(u8::from(felt || really));
            if really {
                let z = truth.height_map[(2 * row, 2 * col)];
                worst = worst.max((contact.height_map[(row, col)] - z).abs());
            }
        }
        assert!(both / either > 0.9, "{}", both / either);
        assert!(worst < 0.15e-3, "{worst}");
    }

    #[test]
    fn images_of_other_sensors_are_refused() {
        let (decoder, _, rest) = decoder();
        let digit = TactileSensor::preset("digit").expect("listed");
        let error = decoder.decode(&rest, &digit).expect_err("another sensor").to_string();
        assert!(error.contains("'digit'") && error.contains("'ycb-sight'"), "{error}");
    }

    #[test]
    fn weights_that_are_damaged_or_of_another_network_are_refused() {
        assert!(matches!(Weights::parse(b"not weights"), Err(WeightsError::Malformed { .. })));
        for end in [0, 7, 100, SHIPPED.len() / 2, SHIPPED.len() - 1] {
            assert!(matches!(Weights::parse(&SHIPPED[..end]), Err(WeightsError::Malformed { .. })), "{end}");
        }
        let text = String::from_utf8_lossy(SHIPPED).into_owned();
        assert!(text.contains("palpate-compact"));
        let other = |from: &str, to: &str| {
            let at = SHIPPED.windows(from.len()).position(|w| w == from.as_bytes()).expect("in the header");
            let mut bytes = SHIPPED.to_vec();
            bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
            CompactModel::from_weights(&Weights::parse(&bytes).expect("still a safetensors file"))
        };
        assert!(matches!(other("palpate-compact", "palpate-another"), Err(WeightsError::Architecture { .. })));
        assert!(matches!(other("level.head.bias", "level.tail.bias"), Err(WeightsError::Missing { .. })));
        let mut nan = SHIPPED.to_vec();
        let last = nan.len() - 2;
        nan[last..].copy_from_slice(&half::f16::NAN.to_le_bytes());
        assert!(matches!(Weights::parse(&nan), Err(WeightsError::NotFinite { .. })));
    }
}
