//! Tensor operations that burn does not have in the form needed here. Images are `[batch, channel, row, col]`.

use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, Initializer, PaddingConfig2d};
use burn::prelude::*;
use rand::RngExt as _;
use rand_pcg::Pcg64;

/// A convolution with all parameters zero; [`crate::weights::initialize`] draws them.
pub(crate) fn conv<B: Backend>(
    (inputs, outputs): (usize, usize),
    kernel: [usize; 2],
    stride: usize,
    padding: usize,
    bias: bool,
    device: &B::Device,
) -> Conv2d<B> {
    Conv2dConfig::new([inputs, outputs], kernel)
        .with_stride([stride, stride])
        .with_padding(PaddingConfig2d::Explicit(padding, padding, padding, padding))
        .with_bias(bias)
        .with_initializer(Initializer::Zeros)
        .init(device)
}

/// Batch normalisation with scale 1 and shift 0.
pub(crate) fn norm<B: Backend>(channels: usize, device: &B::Device) -> BatchNorm<B> {
    BatchNormConfig::new(channels).init(device)
}

/// What [`BatchNorm::forward`] computes, without its broadcasts along the middle axis, for which the CPU back end has no fast path.
///
/// Each channel of each image is one row of a matrix, and statistics, scale and shift are one column of it.
pub(crate) fn normalize<B: Backend>(norm: &BatchNorm<B>, x: Tensor<B, 4>) -> Tensor<B, 4> {
    let dims @ [batch, channels, rows, cols] = x.dims();
    let x = x.reshape([batch * channels, rows * cols]);
    let column = |of: Tensor<B, 2>| of.repeat_dim(0, batch).reshape([batch * channels, 1]);
    let mean = |of: Tensor<B, 2>| of.mean_dim(1).reshape([batch, channels]).mean_dim(0);
    let line = |of: Tensor<B, 1>| of.reshape([1, channels]);
    let scale = |var: Tensor<B, 2>| line(norm.gamma.val()).div(var.add_scalar(norm.epsilon).sqrt());
    let beta = line(norm.beta.val());
    if !B::ad_enabled(&x.device()) {
        let scale = scale(line(norm.running_var.value()));
        let shift = beta.sub(line(norm.running_mean.value()).mul(scale.clone()));
        return x.mul(column(scale)).add(column(shift)).reshape(dims);
    }
    let centre = mean(x.clone());
    let centred = x.sub(column(centre.clone()));
    let var = mean(centred.clone().mul(centred.clone()));
    for (running, now) in [(&norm.running_mean, centre), (&norm.running_var, var.clone())] {
        let now = now.detach().reshape([channels]).mul_scalar(norm.momentum);
        running.update(running.value_sync().mul_scalar(1.0 - norm.momentum).add(now).detach());
    }
    centred.mul(column(scale(var))).add(column(beta)).reshape(dims)
}

/// A map of twice the size: `even_even` at (2r, 2c), `even_odd` at (2r, 2c + 1), `odd_even` at (2r + 1, 2c), and so on.
pub(crate) fn interleave<B: Backend>(
    even_even: Tensor<B, 4>,
    even_odd: Tensor<B, 4>,
    odd_even: Tensor<B, 4>,
    odd_odd: Tensor<B, 4>,
) -> Tensor<B, 4> {
    let [batch, channels, rows, cols] = even_even.dims();
    // Across columns by a transposition, which the CPU back end does in tiles; stacking single columns copies value by value.
    let across = |even, odd| {
        let both = Tensor::stack::<5>(vec![even, odd], 0).reshape([2, batch * channels * rows * cols]);
        both.swap_dims(0, 1).reshape([batch, channels, rows, 2 * cols])
    };
    let rows_apart = vec![across(even_even, even_odd), across(odd_even, odd_odd)];
    Tensor::stack::<5>(rows_apart, 3).reshape([batch, channels, 2 * rows, 2 * cols])
}

/// Bilinear enlargement by two, pixel areas aligned ("align corners" off), edges repeated.
///
/// Written with slices because not every back end differentiates its own interpolation.
pub(crate) fn enlarge_twice<B: Backend>(image: Tensor<B, 4>) -> Tensor<B, 4> {
    enlarge_axis(enlarge_axis(image, 2), 3)
}

fn enlarge_axis<B: Backend>(image: Tensor<B, 4>, axis: usize) -> Tensor<B, 4> {
    let mut dims = image.dims();
    let (before, after) = neighbours(image.clone(), axis, 0);
    let near = image.mul_scalar(0.75);
    let even = before.mul_scalar(0.25).add(near.clone());
    let odd = after.mul_scalar(0.25).add(near);
    dims[axis] *= 2;
    Tensor::stack::<5>(vec![even, odd], axis + 1).reshape(dims)
}

/// The image, of at least two pixels along `axis`, moved by one towards larger and towards smaller indices.
///
/// * `beyond` – the pixel that stands in for the one outside, counted from the edge: 0 repeats the edge, 1 reflects about it
fn neighbours<B: Backend>(image: Tensor<B, 4>, axis: usize, beyond: usize) -> (Tensor<B, 4>, Tensor<B, 4>) {
    let n = image.dims()[axis];
    let part = |start, length| image.clone().narrow(axis, start, length);
    let before = Tensor::cat(vec![part(beyond, 1), part(0, n - 1)], axis);
    (before, Tensor::cat(vec![part(1, n - 1), part(n - 1 - beyond, 1)], axis))
}

/// 3 × 3 Gaussian blur with σ = 0.8 px, edges reflected about the outermost pixel.
pub(crate) fn blur<B: Backend>(image: Tensor<B, 4>) -> Tensor<B, 4> {
    const SIGMA: f64 = 0.8;
    let side = (-0.5 / (SIGMA * SIGMA)).exp();
    let (side, centre) = (side / (1.0 + 2.0 * side), 1.0 / (1.0 + 2.0 * side));
    [2, 3].into_iter().fold(image, |image, axis| {
        let (before, after) = neighbours(image.clone(), axis, 1);
        image.mul_scalar(centre).add(before.add(after).mul_scalar(side))
    })
}

/// Sets whole channels to zero with `probability` and scales the others to keep the mean.
///
/// The choice is drawn on the host, so that it is the same on every back end and survives a resumed run.
pub(crate) fn drop_channels<B: Backend>(image: Tensor<B, 4>, probability: f64, rng: &mut Pcg64) -> Tensor<B, 4> {
    if probability <= 0.0 {
        return image;
    }
    let [batch, channels, ..] = image.dims();
    let keep = (1.0 / (1.0 - probability)) as f32;
    let scale: Vec<f32> =
        (0..batch * channels).map(|_| if rng.random_bool(probability) { 0.0 } else { keep }).collect();
    let device = image.device();
    image.mul(Tensor::from_data(TensorData::new(scale, [batch, channels, 1, 1]), &device))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cpu, CpuDevice};

    fn image(values: Vec<f32>, rows: usize, cols: usize) -> Tensor<Cpu, 4> {
        Tensor::from_data(TensorData::new(values, [1, 1, rows, cols]), &CpuDevice)
    }

    fn values(image: Tensor<Cpu, 4>) -> Vec<f32> {
        image.into_data().to_vec().expect("f32")
    }

    #[test]
    fn interleaving_puts_each_map_on_its_parity() {
        let maps = [1.0, 2.0, 3.0, 4.0].map(|v| image(vec![v, v], 1, 2));
        let [a, b, c, d] = maps;
        assert_eq!(values(interleave(a, b, c, d)), [1., 2., 1., 2., 3., 4., 3., 4.]);
    }

    #[test]
    fn enlarging_keeps_planes_inside_and_repeats_edges() {
        let line = values(enlarge_twice(image(vec![0.0, 4.0, 8.0, 0.0, 4.0, 8.0], 2, 3)));
        assert_eq!(line, [0., 1., 3., 5., 7., 8.].repeat(4));
    }

    #[test]
    fn blur_has_the_weights_of_the_thesis_and_keeps_constants() {
        let mut impulse = vec![0.0; 49];
        impulse[24] = 1.0;
        let spread = values(blur(image(impulse, 7, 7)));
        assert!((spread[24] - 0.5220 * 0.5220).abs() < 1e-4 && (spread[23] - 0.5220 * 0.2390).abs() < 1e-4);
        assert!(values(blur(image(vec![2.0; 12], 3, 4))).iter().all(|v| (v - 2.0).abs() < 1e-6));
    }

    #[test]
    fn dropped_channels_are_whole_and_the_mean_is_kept() {
        use rand::SeedableRng as _;
        let ones = Tensor::<Cpu, 4>::ones([4, 64, 2, 2], &CpuDevice);
        let dropped = values(drop_channels(ones, 0.5, &mut Pcg64::seed_from_u64(1)));
        assert!(dropped.chunks(4).all(|c| c.iter().all(|&v| v == c[0] && (v == 0.0 || v == 2.0))));
        let mean = dropped.iter().sum::<f32>() / dropped.len() as f32;
        assert!((mean - 1.0).abs() < 0.2, "{mean}");
    }
}
