//! Up-projection: residual enlargement by two.

use crate::layers::{conv, interleave, norm, normalize};
use burn::nn::BatchNorm;
use burn::nn::conv::Conv2d;
use burn::prelude::*;
use burn::tensor::activation::relu;
use burn::tensor::module::conv2d;
use burn::tensor::ops::ConvOptions;

/// A 5 × 5 convolution of the zero-interleaved map, as the four convolutions that meet its non-zero pixels (Laina et al.
/// 2016, Fig. 3), each with a bias of its own.
///
/// The 2 × 3 result fills (even row, odd col) and the 3 × 2 one (odd row, even col), padded before the first row and
/// column, as in the published tactile networks; the derivation would swap the two and pad after the last.
/// It is the same function class: only the roles of the kernels differ.
#[derive(Module, Debug)]
struct Unpool<B: Backend> {
    conv3x3: Conv2d<B>,
    conv2x3: Conv2d<B>,
    conv3x2: Conv2d<B>,
    conv2x2: Conv2d<B>,
}

impl<B: Backend> Unpool<B> {
    fn new(channels: (usize, usize), device: &B::Device) -> Self {
        let make = |rows, cols| conv(channels, [rows, cols], 1, 1, true, device);
        Self { conv3x3: make(3, 3), conv2x3: make(2, 3), conv3x2: make(3, 2), conv2x2: make(2, 2) }
    }

    /// One 3 × 3 convolution does the work of the four: a kernel that begins at the same pixel and is a row or column shorter
    /// equals one with zeros there.
    fn forward(&self, x: Tensor<B, 4>) -> Tensor<B, 4> {
        let parts = [&self.conv3x3, &self.conv2x3, &self.conv3x2, &self.conv2x2];
        let kernels = parts.map(|conv| [2, 3].into_iter().fold(conv.weight.val(), three_long));
        let biases = parts.map(|conv| conv.bias.as_ref().expect("made with one").val());
        let same = ConvOptions::new([1, 1], [1, 1], [1, 1], 1);
        let all = conv2d(x, Tensor::cat(kernels.into(), 0), Some(Tensor::cat(biases.into(), 0)), same);
        let outputs = all.dims()[1] / parts.len();
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| all.clone().narrow(1, i * outputs, outputs));
        interleave(a, b, c, d)
    }
}

/// A kernel with zeros at the end of an axis, up to a length of three.
fn three_long<B: Backend>(kernel: Tensor<B, 4>, axis: usize) -> Tensor<B, 4> {
    match kernel.dims()[axis] {
        3 => kernel,
        n => {
            let zeros = kernel.clone().narrow(axis, 0, 3 - n).zeros_like();
            Tensor::cat(vec![kernel, zeros], axis)
        }
    }
}

/// Two enlarged branches: unpool, norm, ReLU, 3 × 3, norm; and unpool, norm. Their sum, rectified.
#[derive(Module, Debug)]
pub(crate) struct UpProjection<B: Backend> {
    main_unpool: Unpool<B>,
    main_norm1: BatchNorm<B>,
    main_conv: Conv2d<B>,
    main_norm2: BatchNorm<B>,
    short_unpool: Unpool<B>,
    short_norm: BatchNorm<B>,
}

impl<B: Backend> UpProjection<B> {
    pub(crate) fn new(inputs: usize, outputs: usize, device: &B::Device) -> Self {
        Self {
            main_unpool: Unpool::new((inputs, outputs), device),
            main_norm1: norm(outputs, device),
            main_conv: conv((outputs, outputs), [3, 3], 1, 1, true, device),
            main_norm2: norm(outputs, device),
            short_unpool: Unpool::new((inputs, outputs), device),
            short_norm: norm(outputs, device),
        }
    }

    /// `[n, inputs, h, w]` → `[n, outputs, 2h, 2w]`.
    pub(crate) fn forward(&self, x: Tensor<B, 4>) -> Tensor<B, 4> {
        let short = normalize(&self.short_norm, self.short_unpool.forward(x.clone()));
        let main = relu(normalize(&self.main_norm1, self.main_unpool.forward(x)));
        relu(normalize(&self.main_norm2, self.main_conv.forward(main)).add(short))
    }
}
