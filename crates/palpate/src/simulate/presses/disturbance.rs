use super::light::{bilinear, through_jpeg};
use crate::geometry::Raster;
use crate::simulate::seed::stream;
use rand::RngExt as _;
use rand_distr::StandardNormal;

/// One thing that goes wrong with an image after the no-contact image was taken, of a stated size: to measure what a decoder
/// withstands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Disturbance {
    /// Every channel times this.
    Gain(f64),
    /// R, G, B plus these, grey levels.
    Offset([f64; 3]),
    /// Noise of this σ on every value, grey levels.
    Noise(f64),
    /// Through a JPEG file of this quality, 1 to 100.
    Jpeg(u8),
    /// A smooth field (3 × 4 knots) of this σ on every channel, grey levels: light that moved.
    Drift(f64),
}

impl Disturbance {
    /// Those of the benchmark, with their names.
    pub const BENCHMARK: [(&'static str, Self); 9] = [
        ("gain-0.8", Self::Gain(0.8)),
        ("gain-1.2", Self::Gain(1.2)),
        ("gain-1.05", Self::Gain(1.05)),
        ("offset-10", Self::Offset([10.0, 10.0, 10.0])),
        ("offset-red-10", Self::Offset([10.0, 0.0, 0.0])),
        ("noise-5", Self::Noise(5.0)),
        ("jpeg-80", Self::Jpeg(80)),
        ("drift-3", Self::Drift(3.0)),
        ("drift-6", Self::Drift(6.0)),
    ];

    /// A disturbance of the benchmark by name.
    pub fn named(name: &str) -> Option<Self> {
        Self::BENCHMARK.iter().find(|(n, _)| *n == name).map(|(_, d)| *d)
    }

    /// The image with the disturbance.
    ///
    /// * `name`, `number` – of the image: they choose the random numbers
    pub fn apply(self, image: &Raster<[u8; 3]>, name: &str, number: usize) -> Raster<[u8; 3]> {
        let mut rng = stream(0, name, number, "disturbance");
        let mut normal = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
        let (rows, cols) = image.shape();
        let each = |f: &mut dyn FnMut(usize, usize, usize, f64) -> f64| {
            Raster::from_fn(rows, cols, |r, c| {
                std::array::from_fn(|k| f(r, c, k, f64::from(image[(r, c)][k])).round() as u8)
            })
        };
        match self {
            Self::Gain(gain) => each(&mut |_, _, _, v| v * gain),
            Self::Offset(offset) => each(&mut |_, _, k, v| v + offset[k]),
            Self::Noise(sigma) => each(&mut |_, _, _, v| v + normal(sigma)),
            Self::Jpeg(quality) => through_jpeg(image, quality),
            Self::Drift(sigma) => {
                let knots: [[[f64; 4]; 3]; 3] =
                    std::array::from_fn(|_| std::array::from_fn(|_| std::array::from_fn(|_| normal(sigma))));
                each(&mut |r, c, k, v| {
                    v + bilinear(&knots[k], 2.0 * r as f64 / rows as f64, 3.0 * c as f64 / cols as f64)
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_has_its_stated_size_and_repeats() {
        let grey = Raster::filled(60, 80, [100u8, 120, 140]);
        for (name, disturbance) in Disturbance::BENCHMARK {
            assert_eq!(Disturbance::named(name), Some(disturbance));
            let (a, b) = (disturbance.apply(&grey, "x", 1), disturbance.apply(&grey, "x", 1));
            assert_eq!(a, b);
            let change: Vec<f64> = a.as_slice().iter().map(|p| f64::from(p[0]) - 100.0).collect();
            let mean = change.iter().sum::<f64>() / change.len() as f64;
            let rms = (change.iter().map(|c| c * c).sum::<f64>() / change.len() as f64).sqrt();
            match disturbance {
                Disturbance::Gain(gain) => assert!((mean - 100.0 * (gain - 1.0)).abs() < 0.6, "{name} {mean}"),
                Disturbance::Offset(offset) => assert!((mean - offset[0]).abs() < 1e-9, "{name} {mean}"),
                Disturbance::Noise(sigma) => assert!((rms / sigma - 1.0).abs() < 0.05, "{name} {rms}"),
                Disturbance::Jpeg(_) => assert!(rms < 1.5, "{name} {rms}"),
                Disturbance::Drift(sigma) => assert!(rms > 0.1 * sigma && rms < 3.0 * sigma, "{name} {rms}"),
            }
        }
        assert_eq!(Disturbance::named("fog"), None);
    }
}
