//! Sine transforms of many lines of one length, two at a time.

use rustdct::rustfft::num_complex::Complex;
use rustdct::rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// The sine transform of type 1, S(k) = Σ a(j) sin(π (j + 1)(k + 1) / (n + 1)): its own inverse up to a factor of 2 / (n + 1).
///
/// The Fourier transform of a line continued as an odd function is imaginary, and that of i times such a line real, so that one
/// complex transform of length 2 (n + 1) gives the sine transforms of two lines.
pub(super) struct SineTransform {
    length: usize,
    fft: Arc<dyn Fft<f32>>,
}

/// What [`SineTransform::process`] works in.
#[derive(Default)]
pub(super) struct SineBuffers {
    signal: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
}

impl SineTransform {
    /// * `length` – of a line, at least 1
    pub(super) fn new(length: usize) -> Self {
        Self { length, fft: FftPlanner::new().plan_fft_forward(2 * (length + 1)) }
    }

    /// Transforms every line of `data` in place.
    pub(super) fn process(&self, data: &mut [f32], buffers: &mut SineBuffers) {
        let n = self.length;
        let SineBuffers { signal, scratch } = buffers;
        signal.resize(2 * (n + 1), Complex::default());
        scratch.resize(self.fft.get_inplace_scratch_len(), Complex::default());
        for pair in data.chunks_mut(2 * n) {
            let (first, second) = pair.split_at_mut(n);
            (signal[0], signal[n + 1]) = (Complex::default(), Complex::default());
            for j in 0..n {
                let value = Complex::new(first[j], second.get(j).copied().unwrap_or(0.0));
                (signal[1 + j], signal[2 * n + 1 - j]) = (value, -value);
            }
            self.fft.process_with_scratch(signal, scratch);
            let halves = signal[1..=n].iter();
            halves.clone().zip(first).for_each(|(x, out)| *out = -0.5 * x.im);
            halves.zip(second).for_each(|(x, out)| *out = 0.5 * x.re);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn lines_in_pairs_and_alone_agree_with_the_sum() {
        for (n, lines) in [(1, 1), (2, 3), (7, 2), (46, 5)] {
            let value = |i: usize| ((i * 7919 + 13) % 101) as f32 / 50.0 - 1.0;
            let data: Vec<f32> = (0..n * lines).map(value).collect();
            let mut found = data.clone();
            SineTransform::new(n).process(&mut found, &mut SineBuffers::default());
            for (line, found) in data.chunks(n).zip(found.chunks(n)) {
                for (k, &found) in found.iter().enumerate() {
                    let angle = |j: usize| PI * ((j + 1) * (k + 1)) as f64 / (n + 1) as f64;
                    let sum: f64 = line.iter().enumerate().map(|(j, &a)| f64::from(a) * angle(j).sin()).sum();
                    assert!((f64::from(found) - sum).abs() < 1e-4, "{n} {k}: {found} {sum}");
                }
            }
        }
    }
}
