use super::super::SimulateError;
use crate::geometry::Raster;
use rand::RngExt as _;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// How far a real camera and its lights stray from the rendered image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightParams {
    /// Each channel is multiplied by 1 ± this, uniform. Larger: lights that age or warm up more.
    pub gain: f64,
    /// 1σ of a constant added to each channel, grey levels.
    pub offset: f64,
    /// 1σ of a smooth field added to each channel (a 3 × 4 grid, interpolated), grey levels. Larger: light that moves.
    pub drift: f64,
    /// Largest 1σ of the pixel noise, grey levels; each image draws its own from 0 to this.
    pub noise: f64,
    /// Range of JPEG quality, 1 to 100; (0, 0) for none.
    pub jpeg: (u8, u8),
}

impl LightParams {
    /// Nothing but JPEG at quality 95, as in YCB-Sight.
    pub fn clean() -> Self {
        Self { gain: 0.0, offset: 0.0, drift: 0.0, noise: 0.0, jpeg: (95, 95) }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`SimulateError::Params`] with field, value and rule.
    pub fn validate(&self) -> Result<(), SimulateError> {
        let check = |field, found: f64, ok: bool, needed| {
            if ok { Ok(()) } else { Err(SimulateError::Params { field, found, needed }) }
        };
        check("light.gain", self.gain, (0.0..1.0).contains(&self.gain), "in [0, 1)")?;
        for (field, value) in [("light.offset", self.offset), ("light.drift", self.drift), ("light.noise", self.noise)]
        {
            check(field, value, (0.0..=128.0).contains(&value), "in [0, 128] grey levels")?;
        }
        let (low, high) = self.jpeg;
        check("light.jpeg", f64::from(high), low <= high && high <= 100, "low to high, at most 100")
    }

    /// Strays from the rendered image.
    pub(super) fn apply(&self, image: &mut Raster<[u8; 3]>, rng: &mut Pcg64Mcg) {
        let mut normal = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
        let offset: [f64; 3] = std::array::from_fn(|_| normal(self.offset));
        let knots: [[[f64; 4]; 3]; 3] =
            std::array::from_fn(|_| std::array::from_fn(|_| std::array::from_fn(|_| normal(self.drift))));
        let gain: [f64; 3] = std::array::from_fn(|_| 1.0 + self.gain * (2.0 * rng.random::<f64>() - 1.0));
        let sigma = self.noise * rng.random::<f64>();
        let quiet = gain == [1.0; 3] && offset == [0.0; 3] && self.drift == 0.0 && sigma == 0.0;
        if !quiet {
            let (rows, cols) = image.shape();
            for row in 0..rows {
                let v = 2.0 * row as f64 / rows.max(2) as f64;
                for col in 0..cols {
                    let u = 3.0 * col as f64 / cols.max(2) as f64;
                    let pixel = &mut image[(row, col)];
                    for k in 0..3 {
                        let noise = if sigma > 0.0 { sigma * rng.sample::<f64, _>(StandardNormal) } else { 0.0 };
                        let value = gain[k] * f64::from(pixel[k]) + offset[k] + bilinear(&knots[k], v, u) + noise;
                        pixel[k] = value.round() as u8;
                    }
                }
            }
        }
        let (low, high) = self.jpeg;
        if high > 0 {
            let quality = rng.random_range(low.max(1)..=high);
            *image = through_jpeg(image, quality);
        }
    }
}

impl Default for LightParams {
    /// What a decoder should withstand in daily use.
    fn default() -> Self {
        Self { gain: 0.05, offset: 3.0, drift: 2.5, noise: 4.0, jpeg: (70, 97) }
    }
}

fn bilinear(knots: &[[f64; 4]; 3], v: f64, u: f64) -> f64 {
    let (r, c) = ((v as usize).min(1), (u as usize).min(2));
    let (fv, fu) = (v - r as f64, u - c as f64);
    let line = |r: usize| knots[r][c] * (1.0 - fu) + knots[r][c + 1] * fu;
    line(r) * (1.0 - fv) + line(r + 1) * fv
}

/// The image after a JPEG file of this quality, 1 to 100.
pub(crate) fn through_jpeg(image: &Raster<[u8; 3]>, quality: u8) -> Raster<[u8; 3]> {
    let (rows, cols) = image.shape();
    let mut file = Vec::new();
    let bytes = image.as_slice().as_flattened();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut file, quality)
        .encode(bytes, cols as u32, rows as u32, image::ExtendedColorType::Rgb8)
        .expect("an image in memory can be encoded");
    let decoded = image::load_from_memory_with_format(&file, image::ImageFormat::Jpeg).expect("just encoded").to_rgb8();
    let pixels = decoded.into_raw().as_chunks::<3>().0.to_vec();
    Raster::from_vec(rows, cols, pixels).expect("same size")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;

    #[test]
    fn each_disturbance_has_its_stated_size() {
        let grey = || Raster::filled(60, 80, [120u8; 3]);
        let mean_and_sd = |image: &Raster<[u8; 3]>| {
            let values: Vec<f64> = image.as_slice().iter().map(|p| f64::from(p[1])).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
        };
        let none = LightParams { jpeg: (0, 0), ..LightParams::clean() };
        let run = |params: LightParams, seed| {
            let mut image = grey();
            params.apply(&mut image, &mut Pcg64Mcg::seed_from_u64(seed));
            mean_and_sd(&image)
        };
        assert_eq!(run(none, 1), (120.0, 0.0));
        let gains: Vec<f64> = (0..50).map(|s| run(LightParams { gain: 0.1, ..none }, s).0 / 120.0 - 1.0).collect();
        assert!(gains.iter().all(|g| g.abs() < 0.105) && gains.iter().any(|g| g.abs() > 0.07));
        let noises: Vec<f64> = (0..50).map(|s| run(LightParams { noise: 8.0, ..none }, s).1).collect();
        assert!(noises.iter().all(|n| *n < 8.4) && noises.iter().any(|n| *n > 6.0));
        let offsets: Vec<f64> = (0..50).map(|s| run(LightParams { offset: 5.0, ..none }, s).0 - 120.0).collect();
        let sd = (offsets.iter().map(|o| o * o).sum::<f64>() / 50.0).sqrt();
        assert!((3.5..6.5).contains(&sd), "{sd}");
    }
}
