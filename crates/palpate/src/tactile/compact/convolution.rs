use super::Planes;
use nalgebra::{Const, DMatrix, DMatrixView, Dyn, MatrixViewMut};

/// A 1 × 1 or 3 × 3 convolution with bias; borders are padded with zeros so that stride 1 keeps
/// the size.
#[derive(Debug, Clone, PartialEq)]
pub struct Convolution {
    size: usize,
    stride: usize,
    inputs: usize,
    /// (inputs · size²) × outputs; the row of input k at kernel place (i, j) is (k · size + i) · size + j.
    weights: DMatrix<f32>,
    bias: Vec<f32>,
}

impl Convolution {
    /// From weights in the order output, input, kernel row, kernel column.
    ///
    /// * `size` – 1 or 3
    pub(super) fn new(size: usize, stride: usize, inputs: usize, weights: &[f32], bias: Vec<f32>) -> Self {
        let weights = DMatrix::from_column_slice(inputs * size * size, bias.len(), weights);
        Self { size, stride, inputs, weights, bias }
    }

    /// Multiply-adds for an input of this many pixels.
    pub(super) fn cost(&self, pixels: usize) -> usize {
        pixels / (self.stride * self.stride) * self.weights.len()
    }

    /// Number of weights and biases.
    pub(super) fn parameters(&self) -> usize {
        self.weights.len() + self.bias.len()
    }

    /// Applies the convolution.
    pub(super) fn forward(&self, input: &Planes) -> Planes {
        debug_assert_eq!(input.channels, self.inputs);
        let (rows, cols) = (input.rows.div_ceil(self.stride), input.cols.div_ceil(self.stride));
        let mut out = Planes::zeros(self.bias.len(), rows, cols);
        if self.size == 1 && self.stride == 1 {
            self.multiply(&input.data, rows * cols, &mut out.data, rows * cols, 0);
        } else {
            // In bands that stay in the cache: the unfolded input is size² times as large.
            let band = (1 << 15) / (self.weights.nrows() * cols).max(1);
            let band = band.clamp(1, rows);
            let mut unfolded = Vec::new();
            for first in (0..rows).step_by(band) {
                let band = band.min(rows - first);
                self.unfold(input, first..first + band, cols, &mut unfolded);
                self.multiply(&unfolded, band * cols, &mut out.data, rows * cols, first * cols);
            }
        }
        out.add_per_channel(&self.bias);
        out
    }

    /// [`Self::forward`], then max(0, ·).
    pub(super) fn forward_relu(&self, input: &Planes) -> Planes {
        let mut out = self.forward(input);
        out.data.iter_mut().for_each(|v| *v = v.max(0.0));
        out
    }

    /// Adds `left` (pixels × inputs) · weights to the pixels from `start` on of every output plane of `stride` pixels.
    fn multiply(&self, left: &[f32], pixels: usize, out: &mut [f32], stride: usize, start: usize) {
        let left = DMatrixView::from_slice(left, pixels, self.weights.nrows());
        let outputs = self.weights.ncols();
        let end = (outputs - 1) * stride + start + pixels;
        let shape = (Dyn(pixels), Dyn(outputs), Const::<1>, Dyn(stride));
        let mut out =
            MatrixViewMut::from_slice_with_strides_generic(&mut out[start..end], shape.0, shape.1, shape.2, shape.3);
        out.gemm(1.0, &left, &self.weights, 0.0);
    }

    /// Every pixel's neighbourhood as a row of a pixels × (inputs · size²) matrix, columns one after the other.
    fn unfold(&self, input: &Planes, band: std::ops::Range<usize>, cols: usize, out: &mut Vec<f32>) {
        let half = self.size as isize / 2;
        out.clear();
        out.resize(band.len() * cols * self.weights.nrows(), 0.0);
        let mut columns = out.chunks_exact_mut(band.len() * cols);
        for channel in 0..self.inputs {
            let plane = input.plane(channel);
            for i in 0..self.size {
                for j in 0..self.size {
                    let Some(column) = columns.next() else { return };
                    for (row, target) in band.clone().zip(column.chunks_exact_mut(cols)) {
                        let from = (row * self.stride + i) as isize - half;
                        if from < 0 || from >= input.rows as isize {
                            continue;
                        }
                        let line = &plane[from as usize * input.cols..][..input.cols];
                        shift(line, target, self.stride, j as isize - half);
                    }
                }
            }
        }
    }
}

/// target\[c\] = line\[c · stride + offset\], leaving what lies outside.
fn shift(line: &[f32], target: &mut [f32], stride: usize, offset: isize) {
    let first = if offset < 0 { (-offset as usize).div_ceil(stride) } else { 0 };
    let Some(last) = (line.len() as isize - 1 - offset).checked_div(stride as isize) else { return };
    let count = target.len().min((last + 1).max(0) as usize);
    if first >= count {
        return;
    }
    let from = (first * stride) as isize + offset;
    let source = &line[from as usize..];
    if stride == 1 {
        target[first..count].copy_from_slice(&source[..count - first]);
    } else {
        for (t, s) in target[first..count].iter_mut().zip(source.iter().step_by(stride)) {
            *t = *s;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hash(i: usize) -> f32 {
        ((i * 2_654_435_761) % 1000) as f32 / 500.0 - 1.0
    }

    /// The definition, written out.
    fn reference(conv: &Convolution, weights: &[f32], input: &Planes) -> Planes {
        let (rows, cols) = (input.rows.div_ceil(conv.stride), input.cols.div_ceil(conv.stride));
        let mut out = Planes::zeros(conv.bias.len(), rows, cols);
        let half = (conv.size / 2) as isize;
        for o in 0..conv.bias.len() {
            for r in 0..rows {
                for c in 0..cols {
                    let mut sum = conv.bias[o];
                    for k in 0..conv.inputs {
                        for i in 0..conv.size {
                            for j in 0..conv.size {
                                let y = (r * conv.stride + i) as isize - half;
                                let x = (c * conv.stride + j) as isize - half;
                                if y >= 0 && x >= 0 && (y as usize) < input.rows && (x as usize) < input.cols {
                                    let w = weights[((o * conv.inputs + k) * conv.size + i) * conv.size + j];
                                    sum += w * input.plane(k)[y as usize * input.cols + x as usize];
                                }
                            }
                        }
                    }
                    out.plane_mut(o)[r * cols + c] = sum;
                }
            }
        }
        out
    }

    #[test]
    fn every_size_and_stride_equals_the_definition() {
        for (size, stride, rows, cols) in [(1, 1, 5, 7), (3, 1, 5, 7), (3, 2, 5, 7), (3, 2, 8, 6), (3, 1, 60, 80)] {
            let (inputs, outputs) = (3, 4);
            let weights: Vec<f32> = (0..inputs * outputs * size * size).map(hash).collect();
            let bias = (0..outputs).map(|i| hash(i + 99)).collect();
            let conv = Convolution::new(size, stride, inputs, &weights, bias);
            let data = (0..inputs * rows * cols).map(|i| hash(i + 7)).collect();
            let input = Planes { channels: inputs, rows, cols, data };
            let (found, needed) = (conv.forward(&input), reference(&conv, &weights, &input));
            assert_eq!(found.shape(), needed.shape());
            for (a, b) in found.data.iter().zip(&needed.data) {
                assert!((a - b).abs() < 1e-4, "{size} {stride}: {a} {b}");
            }
        }
    }
}
