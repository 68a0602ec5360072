//! The three trained parts, layer by layer as in `palpate::tactile::compact`.

use crate::layers::conv;
use crate::weights::initialize;
use burn::module::Module;
use burn::nn::conv::Conv2d;
use burn::prelude::*;
use burn::tensor::activation::relu;
use palpate::tactile::compact::{LEVEL_BLOCKS, LEVEL_INPUTS, LEVEL_WIDTHS};

/// Convolutions with a rectifier between them, none after the last: gradient map or mask map.
#[derive(Module, Debug)]
pub struct LocalNetwork<B: Backend> {
    layers: Vec<Conv2d<B>>,
}

impl<B: Backend> LocalNetwork<B> {
    /// * `layers` – kernel size, inputs and outputs of each
    pub fn new(layers: &[(usize, usize, usize)], seed: u64, device: &B::Device) -> Self {
        let layer = |&(size, inputs, outputs): &(usize, usize, usize)| {
            conv((inputs, outputs), [size, size], 1, size / 2, true, device)
        };
        initialize(Self { layers: layers.iter().map(layer).collect() }, seed)
    }

    /// `[batch, channel, row, col]` to the same size.
    pub fn forward(&self, input: Tensor<B, 4>) -> Tensor<B, 4> {
        let last = self.layers.len() - 1;
        self.layers.iter().enumerate().fold(input, |x, (i, layer)| {
            let y = layer.forward(x);
            if i < last { relu(y) } else { y }
        })
    }
}

/// The level network: encoder and decoder over three sizes.
///
/// Without batch normalisation: residual branches and the head start small instead, which trains as well and runs as it is.
#[derive(Module, Debug)]
pub struct LevelModule<B: Backend> {
    enter: Vec<Conv2d<B>>,
    /// For each size, residual pairs: first and second convolution of one after the other.
    block: Vec<Vec<Vec<Conv2d<B>>>>,
    global: Vec<Conv2d<B>>,
    narrow: Vec<Conv2d<B>>,
    mix: Vec<Conv2d<B>>,
    head: Conv2d<B>,
}

/// What the drawn weights of residual branches and of the head are multiplied with.
const SMALL: f64 = 0.2;

impl<B: Backend> LevelModule<B> {
    /// A network with weights drawn from `seed`.
    pub fn new(seed: u64, device: &B::Device) -> Self {
        let w = LEVEL_WIDTHS;
        let layer = |size: usize, stride: usize, inputs: usize, outputs: usize| {
            conv((inputs, outputs), [size, size], stride, size / 2, true, device)
        };
        let enter = |i: usize| layer(3, 2, if i == 0 { LEVEL_INPUTS } else { w[i - 1] }, w[i]);
        let pair = |i: usize| (0..2).map(|_| layer(3, 1, w[i], w[i])).collect();
        let network = Self {
            enter: (0..3).map(enter).collect(),
            block: (0..3).map(|i| (0..LEVEL_BLOCKS[i]).map(|_| pair(i)).collect()).collect(),
            global: vec![layer(1, 1, w[2], w[2]), layer(1, 1, w[2], w[2])],
            narrow: (0..2).map(|i| layer(1, 1, w[i + 1], w[i])).collect(),
            mix: (0..2).map(|i| layer(3, 1, w[i], w[i])).collect(),
            head: layer(3, 1, w[0], 4),
        };
        let mut network = initialize(network, seed);
        let ends = network.block.iter_mut().flatten().map(|pair| &mut pair[1]);
        for layer in ends.chain([&mut network.global[1], &mut network.head]) {
            layer.weight = layer.weight.clone().map(|w| w.mul_scalar(SMALL).detach().require_grad());
        }
        network
    }

    /// `[batch, 9, rows, cols]` to the level `[batch, 4, rows/2, cols/2]`: the 2 × 2 blocks of the input's size.
    pub fn forward(&self, input: Tensor<B, 4>) -> Tensor<B, 4> {
        let mut skips = Vec::new();
        let mut x = input;
        for (enter, blocks) in self.enter.iter().zip(&self.block) {
            skips.push(x.clone());
            x = relu(enter.forward(x));
            for pair in blocks {
                let change = pair[1].forward(relu(pair[0].forward(x.clone())));
                x = relu(x.add(change));
            }
        }
        let summary = x.clone().mean_dim(2).mean_dim(3);
        let summary = self.global[1].forward(relu(self.global[0].forward(summary)));
        x = x.add(summary);
        for i in [1, 0] {
            let skip = skips[i + 1].clone();
            x = relu(self.mix[i].forward(doubled(self.narrow[i].forward(x), skip.dims()).add(skip)));
        }
        self.head.forward(x)
    }
}

/// Each value four times, cut to the size of the larger map.
fn doubled<B: Backend>(x: Tensor<B, 4>, [_, _, to_rows, to_cols]: [usize; 4]) -> Tensor<B, 4> {
    let [batch, channels, rows, cols] = x.dims();
    let x: Tensor<B, 6> = x.reshape([batch, channels, rows, 1, cols, 1]);
    let x = x.repeat_dim(3, 2).repeat_dim(5, 2).reshape([batch, channels, 2 * rows, 2 * cols]);
    if (2 * rows, 2 * cols) == (to_rows, to_cols) { x } else { x.narrow(2, 0, to_rows).narrow(3, 0, to_cols) }
}
