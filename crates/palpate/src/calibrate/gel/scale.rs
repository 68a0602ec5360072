//! The size of a pixel.

use super::GelError;
use crate::geometry::Raster;
use std::f64::consts::PI;

/// Correlation of a ruler's profile with itself one mark further that is needed.
const LEAST_CORRELATION: f64 = 0.4;
/// How many times as strong the profile along the marks' direction must be as that across.
const LEAST_DIRECTED: f64 = 4.0;
/// Share by which sources of the pitch may differ.
const AGREEMENT: f64 = 0.03;
/// Distance of two presses that is needed, pixels.
const LEAST_APART: f64 = 30.0;

/// A pitch and where it comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PitchSource {
    /// For messages.
    pub name: &'static str,
    /// Metres per pixel.
    pub pitch: f64,
}

/// The pitch that all sources agree on: the first.
///
/// # Errors
/// [`GelError::NoPitch`] if there is none, [`GelError::PitchesDisagree`].
pub fn agree(sources: &[PitchSource]) -> Result<f64, GelError> {
    let Some((first, others)) = sources.split_first() else { return Err(GelError::NoPitch) };
    for other in others {
        // Written so that NaN fails too.
        if !((other.pitch / first.pitch - 1.0).abs() <= AGREEMENT) {
            return Err(GelError::PitchesDisagree {
                first: first.name,
                second: other.name,
                found: [first.pitch, other.pitch],
                limit: AGREEMENT,
            });
        }
    }
    Ok(first.pitch)
}

/// The pitch by two presses, centres `[column, row]`, that were so many metres apart.
///
/// # Errors
/// [`GelError::TooClose`].
pub fn presses_apart(a: [f64; 2], b: [f64; 2], distance: f64) -> Result<f64, GelError> {
    let found = (a[0] - b[0]).hypot(a[1] - b[1]);
    // Written so that NaN fails too.
    if !(found >= LEAST_APART) {
        return Err(GelError::TooClose { found, needed: LEAST_APART });
    }
    Ok(distance / found)
}

/// The distance of evenly spaced marks or grooves (a ruler's engraving, a screw's thread, a comb), pixels.
///
/// The direction in which the picture changes most; the profile along it, averaged across; its correlation with itself, refined over
/// as many marks as there are.
///
/// # Errors
/// [`GelError::NoMarks`].
pub fn ruler_period(difference: &Raster<[f32; 3]>) -> Result<f64, GelError> {
    // The profile is strongest where nothing smears: every degree, then an eighth of one.
    let strongest = |angles: &mut dyn Iterator<Item = f64>| {
        let scored = angles.map(|angle| (Profile::along(difference, angle).energy(), angle));
        scored.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |best| best.1)
    };
    let degree = PI / 180.0;
    let rough = strongest(&mut (0..180).map(|i| f64::from(i) * degree));
    let angle = strongest(&mut (-8..=8).map(|i| rough + f64::from(i) * degree / 8.0));
    let profile = Profile::along(difference, angle);
    let across = Profile::along(difference, angle + 0.5 * PI).energy();
    let none = |found: f64| GelError::NoMarks { found, needed: LEAST_CORRELATION };
    // A ball and noise are as strong in every direction.
    if profile.energy() < LEAST_DIRECTED * across {
        return Err(none(0.0));
    }
    let (period, found) = profile.period();
    if found < LEAST_CORRELATION { Err(none(found)) } else { Ok(period) }
}

/// Marks closer than this are not told from the raster, pixels.
const LEAST_PERIOD: f64 = 4.0;
/// Steps of a profile per pixel.
const FINE: f64 = 4.0;

/// Mean colours along a direction, detrended.
struct Profile {
    channels: [Vec<f64>; 3],
}

impl Profile {
    fn along(difference: &Raster<[f32; 3]>, angle: f64) -> Self {
        let (rows, cols) = difference.shape();
        let (sin, cos) = angle.sin_cos();
        let (cx, cy) = (0.5 * (cols as f64 - 1.0), 0.5 * (rows as f64 - 1.0));
        let reach = 0.5 * (cols as f64 * cos.abs() + rows as f64 * sin.abs());
        let count = (2.0 * reach * FINE) as usize;
        let (mut sums, mut weights) = (vec![[0.0f64; 3]; count], vec![0.0f64; count]);
        for (row, col, pixel) in difference.pixels() {
            let along = ((col as f64 - cx) * cos + (row as f64 - cy) * sin + reach) * FINE;
            let low = along.floor();
            for (bin, share) in [(low, 1.0 - (along - low)), (low + 1.0, along - low)] {
                if bin >= 0.0 && bin < count as f64 {
                    let sum = &mut sums[bin as usize];
                    (0..3).for_each(|k| sum[k] += share * f64::from(pixel[k]));
                    weights[bin as usize] += share;
                }
            }
        }
        // Averaged over two pixels: the raster itself repeats, too. Short lines at the image's corners are noise.
        let half = FINE as usize;
        let largest = weights.iter().copied().fold(0.0, f64::max);
        let mut kept: Vec<[f64; 3]> = Vec::new();
        for i in 0..count {
            let near = i.saturating_sub(half)..(i + half + 1).min(count);
            let weight: f64 = weights[near.clone()].iter().sum();
            if weight > 0.25 * largest {
                kept.push([0, 1, 2].map(|k| sums[near.clone()].iter().map(|s| s[k]).sum::<f64>() / weight));
            }
        }
        Self { channels: [0, 1, 2].map(|k| detrended(&kept.iter().map(|v| v[k]).collect::<Vec<_>>())) }
    }

    /// Mean square.
    fn energy(&self) -> f64 {
        let sum: f64 = self.channels.iter().flatten().map(|v| v * v).sum();
        sum / self.channels[0].len().max(1) as f64
    }

    /// Distance after which it repeats itself, pixels, and how well it does.
    fn period(&self) -> (f64, f64) {
        let n = self.channels[0].len();
        let correlation = |lag: usize| {
            let (mut product, mut a, mut b) = (0.0, 0.0, 0.0);
            for channel in &self.channels {
                for i in 0..n - lag {
                    product += channel[i] * channel[i + lag];
                    a += channel[i].powi(2);
                    b += channel[i + lag].powi(2);
                }
            }
            product / (a * b).sqrt().max(f64::MIN_POSITIVE)
        };
        if n < 64 {
            return (0.0, 0.0);
        }
        let all: Vec<f64> = (0..n / 2).map(correlation).collect();
        peaks(&all)
    }
}

/// The first high peak of a correlation, refined over its multiples.
fn peaks(correlation: &[f64]) -> (f64, f64) {
    let is_peak = |i: usize| correlation[i] >= correlation[i - 1] && correlation[i] > correlation[i + 1];
    let first_low = correlation.iter().position(|&c| c < 0.0).unwrap_or(correlation.len());
    let least = (LEAST_PERIOD * FINE) as usize;
    let candidates: Vec<usize> =
        (first_low.max(least)..correlation.len().saturating_sub(1)).filter(|&i| is_peak(i)).collect();
    let Some(&highest) = candidates.iter().max_by(|&&a, &&b| correlation[a].total_cmp(&correlation[b])) else {
        return (0.0, 0.0);
    };
    // The highest may be a multiple: the first nearly as high is the period.
    let first = candidates.iter().copied().find(|&i| correlation[i] > 0.75 * correlation[highest]).unwrap_or(highest);
    let fine = |i: usize| {
        let (low, top, high) = (correlation[i - 1], correlation[i], correlation[i + 1]);
        i as f64 + 0.5 * (low - high) / (low - 2.0 * top + high).min(-1e-12)
    };
    let mut period = fine(first);
    for multiple in 2..64 {
        let place = period * f64::from(multiple);
        let near =
            candidates.iter().copied().min_by(|&a, &b| (a as f64 - place).abs().total_cmp(&(b as f64 - place).abs()));
        match near {
            Some(i) if (i as f64 - place).abs() < 0.2 * period && correlation[i] > 0.3 * correlation[first] => {
                period = fine(i) / f64::from(multiple);
            }
            _ => break,
        }
    }
    (period / FINE, correlation[first])
}

/// Less the mean over a fifth of its length.
fn detrended(profile: &[f64]) -> Vec<f64> {
    let half = profile.len() / 10;
    let mut sums = vec![0.0];
    for v in profile {
        sums.push(sums[sums.len() - 1] + v);
    }
    let mean = |i: usize| {
        let (a, b) = (i.saturating_sub(half), (i + half + 1).min(profile.len()));
        (sums[b] - sums[a]) / (b - a) as f64
    };
    (0..profile.len()).map(|i| profile[i] - mean(i)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grooves every `period` pixels, turned, with a trend and noise.
    fn grooves(period: f64, angle: f64) -> Raster<[f32; 3]> {
        let (sin, cos) = angle.sin_cos();
        let mut state = 1u32;
        Raster::from_fn(120, 160, |r, c| {
            let along = c as f64 * cos + r as f64 * sin;
            let phase = (along / period).rem_euclid(1.0);
            let mark = (-((phase - 0.5) / 0.12).powi(2)).exp() * (phase - 0.5) * 300.0;
            std::array::from_fn(|k| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let noise = f64::from(state >> 20) / 4096.0 - 0.5;
                (mark * (1.0 - 0.4 * k as f64) + 0.03 * c as f64 + 6.0 * noise) as f32
            })
        })
    }

    #[test]
    fn marks_are_measured_at_any_angle() {
        for (period, angle) in [(12.5, 0.0), (9.46, -0.7), (15.77, 0.3)] {
            let found = ruler_period(&grooves(period, angle)).expect("marks");
            assert!((found / period - 1.0).abs() < 0.005, "{found} {period} {angle}");
        }
    }

    #[test]
    fn a_ball_and_noise_have_no_marks() {
        let mut state = 1u32;
        let noise = Raster::from_fn(120, 160, |_, _| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            [(state >> 24) as f32 - 128.0; 3]
        });
        assert!(matches!(ruler_period(&noise), Err(GelError::NoMarks { .. })), "{:?}", ruler_period(&noise));
    }

    #[test]
    fn sources_must_agree_and_one_is_needed() {
        assert_eq!(agree(&[]), Err(GelError::NoPitch));
        let source = |name, pitch| PitchSource { name, pitch };
        assert_eq!(agree(&[source("a", 8e-5), source("b", 8.1e-5)]), Ok(8e-5));
        let error =
            agree(&[source("the user", 6.34e-5), source("the ruler", 8e-5)]).expect_err("26 % apart").to_string();
        assert!(error.contains("0.06340 mm by the user, but 0.08000 mm by the ruler"), "{error}");
        assert_eq!(presses_apart([10.0, 20.0], [110.0, 20.0], 8e-3), Ok(8e-5));
        assert!(matches!(presses_apart([10.0, 20.0], [20.0, 20.0], 8e-3), Err(GelError::TooClose { .. })));
    }
}
