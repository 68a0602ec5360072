use super::decoder::prepared;
use super::quality::{PressQuality, Quality};
use super::{GelDecoder, GelError, GelMap, GelPress, MapKind, PressFault, SlopeNetwork, find_press};
use crate::geometry::Raster;
use crate::tactile::{
    CalibrationSample, LookupDecoder, LookupTable, NoContact, RelaxedGel, SlopeRegressor, SlopeSample, TactileDecoder,
    TactileSensor, markers,
};
use rayon::prelude::*;

/// Presses needed.
const LEAST_PRESSES: usize = 3;
/// Ridge of the quadratic. Leaving out one press after the other would choose a stiffer one: of few presses that are spread over the pad
/// most lie at the rim, and each left out has to be extrapolated to, which the map seldom has to do in use (docs/real-tactile.md).
const RIDGE: f64 = 3.0;
/// Balls that are pressed, metres.
const BALLS: std::ops::RangeInclusive<f64> = 2e-4..=0.05;

/// How a gel is calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GelParams {
    /// Metres per pixel of the background.
    pub pitch: f64,
    /// The kind of map.
    pub map: MapKind,
    /// Whether the gel has printed dots.
    pub markers: bool,
    /// Seed of the network.
    pub seed: u64,
}

/// A calibrated gel.
#[derive(Debug, Clone)]
pub struct GelCalibration {
    /// Size and pitch of the images.
    pub sensor: TactileSensor,
    /// From colour to slope.
    pub map: GelMap,
    /// No-contact image, as taken.
    pub background: Raster<[u8; 3]>,
    /// Whether markers are filled in.
    pub markers: bool,
    /// Each press decoded with the others' calibration: leave one out.
    pub quality: Quality,
    /// Presses used, in the order given.
    pub used: Vec<usize>,
    /// Presses left out, and why.
    pub left_out: Vec<(usize, PressFault)>,
    /// The presses used, as found.
    pub presses: Vec<GelPress>,
}

impl GelCalibration {
    /// The decoder of this gel.
    ///
    /// # Errors
    /// As [`GelDecoder::new`].
    pub fn decoder(&self) -> Result<GelDecoder, GelError> {
        Ok(GelDecoder::new(self.map.clone(), &self.background, self.markers, &self.sensor)?)
    }
}

/// Calibrates a gel from presses of balls.
///
/// * `presses` – images and the radius of the ball in each, metres
/// * `background` – no-contact image of the same sensor in the same light; its size is the sensor's
///
/// Presses that cannot be used are left out and named, and so is one that repeats another.
///
/// # Errors
/// [`GelError`].
pub fn calibrate_gel(
    presses: &[(Raster<[u8; 3]>, f64)],
    background: &Raster<[u8; 3]>,
    params: &GelParams,
) -> Result<GelCalibration, GelError> {
    if let Some((_, found)) = presses.iter().find(|(_, radius)| !BALLS.contains(radius)) {
        return Err(GelError::Ball { found: *found });
    }
    let sensor = TactileSensor {
        model: "custom".to_owned(),
        width: background.cols(),
        height: background.rows(),
        pixel_pitch: params.pitch,
        relaxed_gel: RelaxedGel::Flat,
    };
    sensor.validate()?;
    let no_contact = NoContact::new(prepared(background, params.markers), &sensor)?;
    let dots = params.markers.then(|| markers(background));
    let found: Vec<Result<GelPress, PressFault>> = presses
        .par_iter()
        .map(|(image, radius)| find_press(image, &no_contact, dots.as_ref(), *radius, params.pitch))
        .collect();
    let (mut used, mut good, mut left_out) = (Vec::new(), Vec::<GelPress>::new(), Vec::new());
    for (i, press) in found.into_iter().enumerate() {
        match press {
            Ok(press) => {
                if let Some(before) = good.iter().position(|g| press.repeats(g)) {
                    left_out.push((i, PressFault::Repeats { of: used[before] }));
                } else {
                    used.push(i);
                    good.push(press);
                }
            }
            Err(fault) => left_out.push((i, fault)),
        }
    }
    if good.len() < LEAST_PRESSES {
        return Err(GelError::TooFewPresses { found: good.len(), needed: LEAST_PRESSES, left_out });
    }
    let fitter = Fitter::new(&good, &no_contact, params);
    let quality = fitter.leave_one_out(&good, background, &sensor)?;
    let map = fitter.fit(None)?;
    Ok(GelCalibration {
        sensor,
        map,
        background: background.clone(),
        markers: params.markers,
        quality,
        used,
        left_out,
        presses: good,
    })
}

/// Samples of each press, from which maps are fitted with any one press left out.
struct Fitter {
    kind: MapKind,
    markers: bool,
    seed: u64,
    slopes: Vec<Vec<SlopeSample>>,
    colors: Vec<Vec<CalibrationSample>>,
}

impl Fitter {
    fn new(presses: &[GelPress], no_contact: &NoContact, params: &GelParams) -> Self {
        let (rows, cols) = no_contact.shape();
        let gains = LookupDecoder::gains(no_contact);
        let labels: Vec<Vec<(usize, usize, [f32; 2])>> = presses.iter().map(|p| p.labels(params.pitch)).collect();
        let slopes = presses.iter().zip(&labels).map(|(press, labels)| {
            let sample = |&(row, col, slope): &(usize, usize, [f32; 2])| SlopeSample {
                relative: press.relative[(row, col)],
                place: SlopeRegressor::place(row, col, rows, cols),
                slope,
            };
            labels.iter().map(sample).collect()
        });
        let colors = presses.iter().zip(&labels).map(|(press, labels)| {
            let sample = |&(row, col, slope): &(usize, usize, [f32; 2])| {
                let (change, gain) = (press.difference[(row, col)], gains[(row, col)]);
                CalibrationSample { scaled_difference: [0, 1, 2].map(|k| change[k] * gain[k]), slope }
            };
            labels.iter().map(sample).collect()
        });
        Self {
            kind: params.map,
            markers: params.markers,
            seed: params.seed,
            slopes: slopes.collect(),
            colors: colors.collect(),
        }
    }

    fn samples(&self, without: Option<usize>) -> impl Iterator<Item = SlopeSample> + '_ {
        self.slopes.iter().enumerate().filter(move |(i, _)| Some(*i) != without).flat_map(|(_, s)| s.iter().copied())
    }

    fn fit(&self, without: Option<usize>) -> Result<GelMap, GelError> {
        Ok(match self.kind {
            MapKind::Quadratic => GelMap::Quadratic(SlopeRegressor::fit(self.samples(without), RIDGE)?),
            MapKind::Network => {
                let samples: Vec<SlopeSample> = self.samples(without).collect();
                GelMap::Network(SlopeNetwork::fit(&samples, self.seed))
            }
            MapKind::Table => {
                let kept = self.colors.iter().enumerate().filter(|(i, _)| Some(*i) != without);
                GelMap::Table(LookupTable::calibrate(kept.flat_map(|(_, s)| s.iter().copied()))?)
            }
        })
    }

    fn leave_one_out(
        &self,
        presses: &[GelPress],
        background: &Raster<[u8; 3]>,
        sensor: &TactileSensor,
    ) -> Result<Quality, GelError> {
        let each = presses.par_iter().enumerate().map(|(i, press)| -> Result<Option<PressQuality>, GelError> {
            let decoder = GelDecoder::new(self.fit(Some(i))?, background, self.markers, sensor)?;
            let contact = decoder.decode(&press.image, sensor)?;
            Ok(PressQuality::of(&contact, press, sensor))
        });
        let presses = each.collect::<Result<Vec<_>, _>>()?;
        if presses.iter().all(Option::is_none) {
            return Err(GelError::NoSphere);
        }
        Ok(Quality { presses })
    }
}

impl GelCalibration {
    /// How true this calibration is on other presses of a ball. Also those that cannot be measured on, by their place in the list, and
    /// why; a press that was calibrated with is one of them, and one that decodes to no sphere.
    ///
    /// # Errors
    /// As [`GelDecoder::new`]; [`GelError::NothingToMeasure`] if none can be measured on.
    pub fn measure(&self, presses: &[(Raster<[u8; 3]>, f64)]) -> Result<(Quality, Vec<(usize, PressFault)>), GelError> {
        let no_contact = NoContact::new(prepared(&self.background, self.markers), &self.sensor)?;
        let dots = self.markers.then(|| markers(&self.background));
        let decoder = self.decoder()?;
        let one = |(image, radius): &(Raster<[u8; 3]>, f64)| -> Result<PressQuality, PressFault> {
            let press = find_press(image, &no_contact, dots.as_ref(), *radius, self.sensor.pixel_pitch)?;
            if let Some(i) = self.presses.iter().position(|own| press.repeats(own)) {
                return Err(PressFault::CalibratedWith { of: self.used[i] });
            }
            PressQuality::of(&decoder.decode(image, &self.sensor)?, &press, &self.sensor).ok_or(PressFault::NoSphere)
        };
        let (mut measured, mut left_out) = (Vec::new(), Vec::new());
        for (i, found) in presses.par_iter().map(one).collect::<Vec<_>>().into_iter().enumerate() {
            match found {
                Ok(quality) => measured.push(Some(quality)),
                Err(fault) => left_out.push((i, fault)),
            }
        }
        if measured.is_empty() {
            return Err(GelError::NothingToMeasure { left_out });
        }
        Ok((Quality { presses: measured }, left_out))
    }
}
