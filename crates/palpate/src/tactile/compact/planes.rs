use crate::geometry::Raster;

/// Feature maps: `channels` planes of `rows × cols`, one after the other, rows in order.
#[derive(Debug, Clone, PartialEq)]
pub struct Planes {
    pub(super) channels: usize,
    pub(super) rows: usize,
    pub(super) cols: usize,
    pub(super) data: Vec<f32>,
}

impl Planes {
    /// All zero.
    pub fn zeros(channels: usize, rows: usize, cols: usize) -> Self {
        Self { channels, rows, cols, data: vec![0.0; channels * rows * cols] }
    }

    /// Channels, rows, columns.
    pub fn shape(&self) -> [usize; 3] {
        [self.channels, self.rows, self.cols]
    }

    /// All values: channel, row, column.
    pub fn as_slice(&self) -> &[f32] {
        &self.data
    }

    /// One channel, rows in order.
    pub fn plane(&self, channel: usize) -> &[f32] {
        let size = self.rows * self.cols;
        &self.data[channel * size..(channel + 1) * size]
    }

    /// One channel, rows in order.
    pub(super) fn plane_mut(&mut self, channel: usize) -> &mut [f32] {
        let size = self.rows * self.cols;
        &mut self.data[channel * size..(channel + 1) * size]
    }

    /// Each value as a plane of its own over the whole image: sub-pixel (i, j) of an n × n block of input channel k becomes
    /// channel (k · n + i) · n + j. Rows and columns must be multiples of n.
    pub fn from_blocks<const N: usize>(image: &Raster<[f32; N]>, n: usize) -> Self {
        let mut out = Self::zeros(N * n * n, image.rows() / n, image.cols() / n);
        let cols = out.cols;
        for row in 0..out.rows {
            for i in 0..n {
                let line = &image.as_slice()[(row * n + i) * image.cols()..][..image.cols()];
                for k in 0..N {
                    for j in 0..n {
                        let target = &mut out.plane_mut((k * n + i) * n + j)[row * cols..][..cols];
                        for (col, t) in target.iter_mut().enumerate() {
                            *t = line[col * n + j][k];
                        }
                    }
                }
            }
        }
        out
    }

    /// Undoes [`Self::from_blocks`] for channel `k` of the blocks.
    pub(super) fn channels_to_blocks(&self, k: usize, n: usize) -> Raster<f32> {
        let (rows, cols) = (self.rows * n, self.cols * n);
        let mut out = Raster::filled(rows, cols, 0.0);
        for i in 0..n {
            for j in 0..n {
                let plane = self.plane((k * n + i) * n + j);
                for row in 0..self.rows {
                    let target = &mut out.as_mut_slice()[(row * n + i) * cols..][..cols];
                    for (col, value) in plane[row * self.cols..][..self.cols].iter().enumerate() {
                        target[col * n + j] = *value;
                    }
                }
            }
        }
        out
    }

    /// Means over n × n blocks of an image, one plane per channel.
    pub fn means<const N: usize>(image: &Raster<[f32; N]>, n: usize) -> Self {
        let mut out = Self::zeros(N, image.rows() / n, image.cols() / n);
        let (cols, size) = (out.cols, out.rows * out.cols);
        let share = 1.0 / (n * n) as f32;
        for (row, line) in image.as_slice().chunks_exact(image.cols()).take(out.rows * n).enumerate() {
            let start = row / n * cols;
            for (col, block) in line.chunks_exact(n).enumerate() {
                for pixel in block {
                    for (k, v) in pixel.iter().enumerate() {
                        out.data[k * size + start + col] += v * share;
                    }
                }
            }
        }
        out
    }

    /// A rectangle of every plane: channel, row, column. It lies inside.
    pub fn crop(&self, row: usize, col: usize, rows: usize, cols: usize) -> Vec<f32> {
        let lines = (0..self.channels).flat_map(|channel| {
            let plane = self.plane(channel);
            (row..row + rows).map(move |r| &plane[r * self.cols + col..][..cols])
        });
        lines.flatten().copied().collect()
    }

    /// Appends the planes of another of the same size.
    pub(super) fn append(&mut self, other: &Self) {
        debug_assert_eq!((self.rows, self.cols), (other.rows, other.cols));
        self.channels += other.channels;
        self.data.extend_from_slice(&other.data);
    }

    /// Twice the size in both directions, each value four times, and adds `skip`.
    pub(super) fn doubled_plus(&self, skip: &Self) -> Self {
        debug_assert_eq!(self.channels, skip.channels);
        let mut out = skip.clone();
        for channel in 0..self.channels {
            let source = self.plane(channel);
            let target = out.plane_mut(channel);
            for (row, line) in target.chunks_exact_mut(skip.cols).enumerate() {
                let from = &source[(row / 2).min(self.rows - 1) * self.cols..][..self.cols];
                for (col, t) in line.iter_mut().enumerate() {
                    *t += from[(col / 2).min(self.cols - 1)];
                }
            }
        }
        out
    }

    /// Adds one value per channel to the whole plane.
    pub(super) fn add_per_channel(&mut self, values: &[f32]) {
        let size = self.rows * self.cols;
        for (plane, v) in self.data.chunks_exact_mut(size).zip(values) {
            for p in plane {
                *p += v;
            }
        }
    }

    /// Mean of each channel.
    pub(super) fn channel_means(&self) -> Vec<f32> {
        let size = self.rows * self.cols;
        self.data.chunks_exact(size).map(|plane| plane.iter().sum::<f32>() / size as f32).collect()
    }
}

/// Bilinear enlargement of one plane by a whole factor; pixel centres are at half-integers, the border is continued.
pub(super) fn enlarge(plane: &[f32], rows: usize, cols: usize, n: usize) -> Raster<f32> {
    let taps = |i: usize, size: usize| {
        let x = ((i as f32 + 0.5) / n as f32 - 0.5).clamp(0.0, size as f32 - 1.0);
        let low = (x as usize).min(size.saturating_sub(2));
        (low, (low + 1).min(size - 1), x - low as f32)
    };
    let across: Vec<_> = (0..cols * n).map(|c| taps(c, cols)).collect();
    let mut out = Raster::filled(rows * n, cols * n, 0.0);
    let mut line = vec![0.0; cols];
    for (row, target) in out.as_mut_slice().chunks_exact_mut(cols * n).enumerate() {
        let (above, below, share) = taps(row, rows);
        for (col, v) in line.iter_mut().enumerate() {
            *v = plane[above * cols + col] * (1.0 - share) + plane[below * cols + col] * share;
        }
        for (t, &(left, right, share)) in target.iter_mut().zip(&across) {
            *t = line[left] * (1.0 - share) + line[right] * share;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_go_to_channels_and_back() {
        let image = Raster::from_fn(6, 8, |r, c| [(r * 8 + c) as f32, -((r * 8 + c) as f32)]);
        let planes = Planes::from_blocks(&image, 2);
        assert_eq!(planes.shape(), [8, 3, 4]);
        assert_eq!(planes.channels_to_blocks(1, 2), image.map(|p| p[1]));
        let means = Planes::means(&image, 2);
        assert_eq!(means.plane(0)[0], (0.0 + 1.0 + 8.0 + 9.0) / 4.0);
    }

    #[test]
    fn enlarging_keeps_ramps_inside_and_doubling_repeats() {
        let ramp: Vec<f32> = (0..12).map(|i| (i % 4) as f32).collect();
        let big = enlarge(&ramp, 3, 4, 4);
        // Pixel 6 is centred at 6.5 / 4 − 0.5 = 1.125 of the source.
        assert!((big[(5, 6)] - 1.125).abs() < 1e-6);
        assert_eq!(big[(0, 0)], 0.0);
        let small = Planes { channels: 1, rows: 1, cols: 2, data: vec![1.0, 2.0] };
        let sum = small.doubled_plus(&Planes { channels: 1, rows: 2, cols: 3, data: vec![10.0; 6] });
        assert_eq!(sum.data, [11.0, 11.0, 12.0, 11.0, 11.0, 12.0]);
    }
}
