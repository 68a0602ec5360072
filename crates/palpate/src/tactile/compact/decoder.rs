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
        let felt =
            indentation(&self.model.gradient, &self.model.level, &difference, &relaxed, &self.integrator);
        let touched = 1e-3 * felt.peak > CONTACT_FLOOR;
        let mask = self.model.mask.run(&felt).map(|&logit| touched && logit > 0.0);
        let heights = relaxed.as_slice().iter().zip(felt.depth.as_slice()).map(|(g, d)| g - 1e-3 * d.max(-MOST_BULGE_MM));
        let height_map = Raster::from_vec(rows, cols, heights.collect()).expect("of the working size");
        Ok(Contact { height_map, mask })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tactile::optics::TactileOptics;

    #[test]
    fn speed() {
        let sensor = TactileSensor::preset("ycb-sight").expect("listed");
        let optics = TactileOptics::preset(&sensor).expect("has a table");
        let rest = optics.no_contact();
        let no_contact = NoContact::new(rest.clone(), &sensor).expect("sound");
        let decoder = CompactDecoder::shipped(no_contact);
        println!("{} parameters, {} MMAC", decoder.model().parameters(), decoder.model().cost() / 1_000_000);
        let diff = Raster::from_fn(240, 320, |r, c| [((r * 7 + c) % 19) as f32, ((r + c * 3) % 23) as f32, 3.0]);
        let dome = sensor.relaxed(240, 320);
        for _ in 0..5 {
            let t = std::time::Instant::now();
            let steps = decoder.model.gradient.run(&diff);
            let t1 = t.elapsed();
            let shape = decoder.integrator.integrate_steps(&steps);
            let t2 = t.elapsed();
            let input = crate::tactile::compact::level_input(&diff, &shape, &steps, &dome);
            let t3 = t.elapsed();
            let level = decoder.model.level.run(&input);
            let t4 = t.elapsed();
            let (depth, peak) = crate::tactile::compact::join(&shape, &level);
            let t5 = t.elapsed();
            let m = decoder.model.mask.run(&crate::tactile::compact::Indentation { depth, steps, peak });
            let t6 = t.elapsed();
            println!("grad {t1:?} dct {:?} input {:?} level {:?} join {:?} mask {:?} total {t6:?} {}", t2 - t1, t3 - t2, t4 - t3, t5 - t4, t6 - t5, m[(3, 3)]);
        }
    }
}
