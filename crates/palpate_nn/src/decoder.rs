//! FCRN as a [`TactileDecoder`].

use crate::config::{Input, Target, TrainConfig};
use crate::data::small_image;
use crate::fcrn::{Fcrn, FcrnConfig, FcrnError};
use crate::weights::{WeightFile, WeightsError, host_values};
use crate::{Cpu, CpuDevice};
use burn::prelude::*;
use palpate::geometry::Raster;
use palpate::tactile::resample::resize;
use palpate::tactile::{Contact, DecodeError, NoContact, TactileDecoder, TactileSensor, mask_from_height};
use std::path::Path;

/// Rows and columns of the contacts: those of the other decoders.
const OUTPUT_SIZE: (usize, usize) = (240, 320);

/// Why weights make no decoder.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FcrnDecoderError {
    /// The file is damaged, or of another network.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The network cannot be made.
    #[error("the network of the weights: {0}")]
    Network(#[from] FcrnError),
    /// The file does not say how the network was trained.
    #[error("the weights do not say what the network reads and gives: {reason}")]
    Run {
        /// What is wrong with the record.
        reason: String,
    },
    /// A mask network where a height network is needed, or the reverse.
    #[error("the weights are of a network for {found}; one for {needed} is needed")]
    Head {
        /// What it gives.
        found: &'static str,
        /// What is needed.
        needed: &'static str,
    },
}

/// One trained network and how it reads images.
struct Trained {
    network: Fcrn<Cpu>,
    run: TrainConfig,
}

/// Heights by a height network; contact by a mask network, or from the heights where there is none.
pub struct FcrnDecoder {
    height: Trained,
    mask: Option<Trained>,
    sensor: String,
    no_contact: NoContact,
}

impl FcrnDecoder {
    /// * `height` – weights of a height network
    /// * `mask` – weights of a contact network; without it, contact is where the indentation is over 0.4 of its peak
    ///
    /// # Errors
    /// [`FcrnDecoderError`].
    pub fn open(height: &Path, mask: Option<&Path>, no_contact: NoContact) -> Result<Self, FcrnDecoderError> {
        let (height, sensor) = Trained::open(height, true)?;
        let mask = mask.map(|path| Trained::open(path, false)).transpose()?.map(|(trained, _)| trained);
        Ok(Self { height, mask, sensor, no_contact })
    }
}

impl Trained {
    fn open(path: &Path, is_height: bool) -> Result<(Self, String), FcrnDecoderError> {
        let file = WeightFile::open(path)?;
        let config: FcrnConfig = file.config("fcrn", 1)?;
        let run: TrainConfig =
            serde_json::from_str(&file.provenance.run).map_err(|e| FcrnDecoderError::Run { reason: e.to_string() })?;
        let name = |height: bool| if height { "heights" } else { "contact" };
        if config.head.is_height() != is_height {
            return Err(FcrnDecoderError::Head { found: name(!is_height), needed: name(is_height) });
        }
        let sensor = file.provenance.sensor.clone();
        let empty = Fcrn::<Cpu>::zeros(config, &CpuDevice)?;
        let network = file.load_into(empty, &config.architecture())?;
        Ok((Self { network, run }, sensor))
    }

    /// The network's output for an image, at [`OUTPUT_SIZE`].
    fn run(&self, image: &Raster<[u8; 3]>, background: &Raster<[u8; 3]>) -> Raster<f32> {
        let (rows, cols) = (self.run.data.rows, self.run.data.cols);
        let mut channels = small_image(image, (rows, cols));
        if self.run.data.input == Input::Difference {
            let background = small_image(background, (rows, cols));
            channels.iter_mut().zip(background).for_each(|(v, b)| *v -= b);
        }
        let mut values = Vec::with_capacity(channels.len());
        self.run.data.input.encode(&channels, &mut values);
        let input = Tensor::from_data(TensorData::new(values, [1, 3, rows, cols]), &CpuDevice);
        let output = host_values(self.network.forward(input));
        let output = Raster::from_vec(rows, cols, output).expect("the size of the input");
        resize(&output, OUTPUT_SIZE.0, OUTPUT_SIZE.1)
    }
}

impl TactileDecoder for FcrnDecoder {
    fn decode(&self, image: &Raster<[u8; 3]>, sensor: &TactileSensor) -> Result<Contact, DecodeError> {
        if sensor.model != self.sensor {
            let (found, needed) = (sensor.model.clone(), self.sensor.clone());
            return Err(DecodeError::OtherSensor { found, needed });
        }
        // Judges the image; the network does its own subtraction.
        self.no_contact.difference(image)?;
        let background = self.no_contact.image();
        let (rows, cols) = OUTPUT_SIZE;
        let relaxed = sensor.relaxed(rows, cols);
        let height = self.height.run(image, background);
        let target = self.height.run.data.target;
        let unit = (1e-3 * target.millimetres(sensor)) as f32;
        let indentation = height.as_slice().iter().zip(relaxed.as_slice()).map(|(h, g)| match target {
            Target::IndentationMm => h * unit,
            Target::DepthPx => g + h * unit,
        });
        let indentation = Raster::from_vec(rows, cols, indentation.collect()).expect("of the output size");
        let mask = match &self.mask {
            Some(mask) => mask.run(image, background).map(|&p| p > 0.5),
            None => mask_from_height(&indentation, palpate::tactile::CONTACT_SHARE),
        };
        let z = relaxed.as_slice().iter().zip(indentation.as_slice()).map(|(g, d)| g - d);
        let height_map = Raster::from_vec(rows, cols, z.collect()).expect("of the output size");
        Ok(Contact::new(height_map, mask, sensor)?)
    }
}
