//! ResNet-50 with a width: 64 is the original.

use crate::layers::{conv, norm, normalize};
use burn::nn::BatchNorm;
use burn::nn::PaddingConfig2d;
use burn::nn::conv::Conv2d;
use burn::nn::pool::MaxPool2dConfig;
use burn::prelude::*;
use burn::tensor::activation::relu;

/// Convolution without bias, then batch normalisation.
#[derive(Module, Debug)]
pub(crate) struct ConvNorm<B: Backend> {
    conv: Conv2d<B>,
    norm: BatchNorm<B>,
}

impl<B: Backend> ConvNorm<B> {
    pub(crate) fn new(channels: (usize, usize), kernel: usize, stride: usize, device: &B::Device) -> Self {
        let conv = conv(channels, [kernel, kernel], stride, kernel / 2, false, device);
        Self { conv, norm: norm(channels.1, device) }
    }

    pub(crate) fn forward(&self, x: Tensor<B, 4>) -> Tensor<B, 4> {
        normalize(&self.norm, self.conv.forward(x))
    }
}

/// 1 × 1 down, 3 × 3 (which carries the stride), 1 × 1 up to four times the width, plus the input.
#[derive(Module, Debug)]
struct Bottleneck<B: Backend> {
    reduce: ConvNorm<B>,
    middle: ConvNorm<B>,
    expand: ConvNorm<B>,
    shortcut: Option<ConvNorm<B>>,
}

const EXPANSION: usize = 4;

impl<B: Backend> Bottleneck<B> {
    fn new(inputs: usize, width: usize, stride: usize, device: &B::Device) -> Self {
        let outputs = EXPANSION * width;
        Self {
            reduce: ConvNorm::new((inputs, width), 1, 1, device),
            middle: ConvNorm::new((width, width), 3, stride, device),
            expand: ConvNorm::new((width, outputs), 1, 1, device),
            shortcut: (stride != 1 || inputs != outputs).then(|| ConvNorm::new((inputs, outputs), 1, stride, device)),
        }
    }

    fn forward(&self, x: Tensor<B, 4>) -> Tensor<B, 4> {
        let short = self.shortcut.as_ref().map_or_else(|| x.clone(), |s| s.forward(x.clone()));
        let x = relu(self.reduce.forward(x));
        let x = relu(self.middle.forward(x));
        relu(self.expand.forward(x).add(short))
    }
}

/// 7 × 7 convolution, max pool, then 3, 4, 6 and 3 bottlenecks; all at stride 2 but the first group.
#[derive(Module, Debug)]
pub(crate) struct Encoder<B: Backend> {
    stem: ConvNorm<B>,
    layer1: Vec<Bottleneck<B>>,
    layer2: Vec<Bottleneck<B>>,
    layer3: Vec<Bottleneck<B>>,
    layer4: Vec<Bottleneck<B>>,
}

impl<B: Backend> Encoder<B> {
    pub(crate) fn new(width: usize, device: &B::Device) -> Self {
        let mut inputs = width;
        let mut group = |blocks: usize, width: usize, stride: usize| {
            (0..blocks)
                .map(|i| {
                    let block = Bottleneck::new(inputs, width, if i == 0 { stride } else { 1 }, device);
                    inputs = EXPANSION * width;
                    block
                })
                .collect()
        };
        Self {
            stem: ConvNorm::new((3, width), 7, 2, device),
            layer1: group(3, width, 1),
            layer2: group(4, 2 * width, 2),
            layer3: group(6, 4 * width, 2),
            layer4: group(3, 8 * width, 2),
        }
    }

    /// `[n, 3, h, w]` → `[n, 32·width, h/32, w/32]`.
    pub(crate) fn forward(&self, x: Tensor<B, 4>) -> Tensor<B, 4> {
        let pool = MaxPool2dConfig::new([3, 3])
            .with_strides([2, 2])
            .with_padding(PaddingConfig2d::Explicit(1, 1, 1, 1))
            .init();
        let x = pool.forward(relu(self.stem.forward(x)));
        [&self.layer1, &self.layer2, &self.layer3, &self.layer4]
            .into_iter()
            .flatten()
            .fold(x, |x, block| block.forward(x))
    }
}
