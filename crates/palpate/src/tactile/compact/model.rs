use super::planes::enlarge;
use super::weights::Tensors;
use super::{Convolution, Planes, WeightsError};
use crate::geometry::Raster;
use crate::tactile::integrate::Integrator;

/// Rows and columns of the images that the network works on.
pub const WORKING_SIZE: (usize, usize) = (240, 320);
/// Grey levels that become 1 at the input.
pub const LEVELS: f32 = 32.0;
/// Steps of the height between neighbouring pixels, mm, are given to networks times this.
pub const STEP_SCALE: f32 = 20.0;
/// The level network's output times this is millimetres.
pub const LEVEL_SCALE: f32 = 0.5;
/// Hidden channels of the gradient map.
pub const GRADIENT_WIDTH: usize = 32;
/// Hidden channels of the mask map.
pub const MASK_WIDTH: usize = 24;
/// Channels of the level network at 1/4, 1/8, 1/16 and 1/32 of the working size.
pub const LEVEL_WIDTHS: [usize; 4] = [16, 32, 64, 96];

/// The compact network: what the gel's colour says of its slope, of its level, and of contact.
///
/// 1. **Gradient map** (local): colour difference and place → the steps of the indentation between neighbouring pixels.
/// 2. The steps are integrated (Poisson, free borders): exact shape, but **no level**, and a slow drift.
/// 3. **Level network** (global, at a quarter of the size): from the same image and the integral, what integration cannot know.
/// 4. **Mask map** (local): from indentation, its peak and its steps, the contact.
#[derive(Debug, Clone)]
pub struct CompactModel {
    gradient: Vec<Convolution>,
    level: LevelNetwork,
    mask: Vec<Convolution>,
}

/// What the network makes of an image, at [`WORKING_SIZE`].
#[derive(Debug, Clone)]
pub struct Indentation {
    /// Depth of the gel below its relaxed surface, mm.
    pub depth: Raster<f32>,
    /// Contact logit: positive is contact.
    pub contact: Raster<f32>,
    /// Largest depth, mm, over means of 2 × 2 pixels.
    pub peak: f32,
}

impl CompactModel {
    /// Takes the tensors by name; sizes are checked against the architecture.
    pub(super) fn from_tensors(tensors: &Tensors) -> Result<Self, WeightsError> {
        Ok(Self {
            gradient: gradient_layers(tensors)?,
            level: LevelNetwork::from_tensors(tensors)?,
            mask: mask_layers(tensors)?,
        })
    }

    /// Number of weights and biases, batch normalisation folded in.
    pub fn parameters(&self) -> usize {
        self.convolutions().map(Convolution::parameters).sum::<usize>() + self.level.global_parameters()
    }

    /// Multiply-adds for one image.
    pub fn cost(&self) -> usize {
        let half = WORKING_SIZE.0 * WORKING_SIZE.1 / 4;
        self.gradient.iter().chain(&self.mask).map(|c| c.cost(half)).sum::<usize>() + self.level.cost()
    }

    fn convolutions(&self) -> impl Iterator<Item = &Convolution> {
        self.gradient.iter().chain(&self.mask).chain(self.level.convolutions())
    }

    /// Runs the network.
    ///
    /// * `difference` – image minus no-contact image, R, G, B grey levels, [`WORKING_SIZE`]
    /// * `dome` – z of the relaxed gel, metres, [`WORKING_SIZE`]
    /// * `integrator` – of [`WORKING_SIZE`]
    pub fn run(&self, difference: &Raster<[f32; 3]>, dome: &Raster<f32>, integrator: &Integrator) -> Indentation {
        let steps = gradient_map(&self.gradient, difference);
        let shape = integrator.integrate_steps(&steps);
        let level = self.level.forward(&level_input(difference, &shape, &steps, dome));
        let (depth, peak) = join(&shape, level.plane(0));
        let contact = run_layers(&self.mask, mask_input(&depth, &steps, peak)).channels_to_blocks(0, 2);
        Indentation { depth, contact, peak }
    }
}

/// The gradient map's layers alone, for training what comes after it.
pub(super) fn gradient_layers(tensors: &Tensors) -> Result<Vec<Convolution>, WeightsError> {
    let w = GRADIENT_WIDTH;
    [(3, 14, w), (1, w, w), (1, w, w), (1, w, 8)]
        .iter()
        .enumerate()
        .map(|(i, &(size, inputs, outputs))| tensors.convolution(&format!("gradient.{i}"), size, 1, inputs, outputs))
        .collect()
}

/// The mask map's layers.
fn mask_layers(tensors: &Tensors) -> Result<Vec<Convolution>, WeightsError> {
    let w = MASK_WIDTH;
    [(3, 13, w), (1, w, w), (3, w, 4)]
        .iter()
        .enumerate()
        .map(|(i, &(size, inputs, outputs))| tensors.convolution(&format!("mask.{i}"), size, 1, inputs, outputs))
        .collect()
}

/// Layers with a rectifier between them, none after the last.
fn run_layers(layers: &[Convolution], input: Planes) -> Planes {
    let last = layers.len() - 1;
    layers.iter().enumerate().fold(input, |x, (i, layer)| if i < last { layer.forward_relu(&x) } else { layer.forward(&x) })
}

/// Steps of the indentation to the next column and the next row, mm.
pub(super) fn gradient_map(layers: &[Convolution], difference: &Raster<[f32; 3]>) -> Raster<[f32; 2]> {
    let out = run_layers(layers, gradient_input(difference));
    let (cols, rows) = (out.channels_to_blocks(0, 2), out.channels_to_blocks(1, 2));
    let pairs = cols.as_slice().iter().zip(rows.as_slice());
    let data = pairs.map(|(c, r)| [c / STEP_SCALE, r / STEP_SCALE]).collect();
    Raster::from_vec(cols.rows(), cols.cols(), data).expect("same size")
}

/// Input of the gradient map, 14 × rows/2 × cols/2: the 2 × 2 blocks of the difference, and the place.
///
/// * `difference` – of the working size
pub fn gradient_input(difference: &Raster<[f32; 3]>) -> Planes {
    let mut planes = Planes::blocks_to_channels(difference, 2);
    planes.data.iter_mut().for_each(|v| *v /= LEVELS);
    planes.append(&places(planes.rows, planes.cols));
    planes
}

/// Input of the level network, 9 × rows/4 × cols/4: difference, integral, steps (means over 4 × 4 pixels), place, dome.
///
/// * `shape` – the integral of the steps, mean 0, mm
pub fn level_input(
    difference: &Raster<[f32; 3]>,
    shape: &Raster<f32>,
    steps: &Raster<[f32; 2]>,
    dome: &Raster<f32>,
) -> Planes {
    let mut planes = Planes::block_means(difference, 4);
    planes.data.iter_mut().for_each(|v| *v /= LEVELS);
    planes.append(&Planes::block_means(&shape.map(|&h| [h]), 4));
    planes.append(&Planes::block_means(&steps.map(|s| s.map(|v| v * STEP_SCALE)), 4));
    planes.append(&places(planes.rows, planes.cols));
    planes.append(&Planes::block_means(&dome.map(|&z| [z * 1e3]), 4));
    planes
}

/// Input of the mask map, 13 × rows/2 × cols/2: 2 × 2 blocks of depth over peak and of the steps, and the peak.
pub fn mask_input(depth: &Raster<f32>, steps: &Raster<[f32; 2]>, peak: f32) -> Planes {
    let values = depth.as_slice().iter().zip(steps.as_slice());
    let share = 1.0 / peak.max(0.02);
    let data = values.map(|(d, s)| [d * share, s[0] * STEP_SCALE, s[1] * STEP_SCALE]).collect();
    let stacked = Raster::<[f32; 3]>::from_vec(depth.rows(), depth.cols(), data).expect("same size");
    let mut planes = Planes::blocks_to_channels(&stacked, 2);
    let mut constant = Planes::zeros(1, planes.rows, planes.cols);
    constant.data.fill(peak);
    planes.append(&constant);
    planes
}

/// Depth of the gel, mm, and its peak: the integral plus the level at a quarter of the size.
pub fn join(shape: &Raster<f32>, level: &[f32]) -> (Raster<f32>, f32) {
    let (rows, cols) = shape.shape();
    let mut depth = enlarge(level, rows / 4, cols / 4, 4);
    for (d, s) in depth.as_mut_slice().iter_mut().zip(shape.as_slice()) {
        *d = *d * LEVEL_SCALE + s;
    }
    let means = Planes::block_means(&depth.map(|&d| [d]), 2);
    let peak = means.data.iter().copied().fold(0.0, f32::max);
    (depth, peak)
}

/// Column and row of every pixel, from −1 to 1.
fn places(rows: usize, cols: usize) -> Planes {
    let mut planes = Planes::zeros(2, rows, cols);
    let at = |i: usize, n: usize| (i as f32 + 0.5) * 2.0 / n as f32 - 1.0;
    for row in 0..rows {
        for col in 0..cols {
            planes.data[row * cols + col] = at(col, cols);
            planes.data[(rows + row) * cols + col] = at(row, rows);
        }
    }
    planes
}

/// Encoder and decoder over four sizes, with a global summary at the smallest.
#[derive(Debug, Clone)]
struct LevelNetwork {
    stem: [Convolution; 2],
    /// Stride 2, then residual pairs.
    down: Vec<(Convolution, Vec<[Convolution; 2]>)>,
    /// Fully connected, twice.
    global: [Convolution; 2],
    /// 1 × 1 to the width of the larger size, then 3 × 3 after the sum.
    up: Vec<[Convolution; 2]>,
    head: Convolution,
}

/// Residual pairs at each size but the largest.
pub const LEVEL_BLOCKS: [usize; 3] = [1, 2, 2];

impl LevelNetwork {
    fn from_tensors(tensors: &Tensors) -> Result<Self, WeightsError> {
        let w = LEVEL_WIDTHS;
        let conv = |name: String, size, stride, inputs, outputs| {
            tensors.convolution(&format!("level.{name}"), size, stride, inputs, outputs)
        };
        let down = (0..3)
            .map(|i| {
                let enter = conv(format!("down.{i}.enter"), 3, 2, w[i], w[i + 1])?;
                let pair = |k: usize, half: usize| conv(format!("down.{i}.block.{k}.{half}"), 3, 1, w[i + 1], w[i + 1]);
                let blocks = (0..LEVEL_BLOCKS[i]).map(|k| Ok([pair(k, 0)?, pair(k, 1)?]));
                Ok((enter, blocks.collect::<Result<_, WeightsError>>()?))
            })
            .collect::<Result<_, WeightsError>>()?;
        let up = (0..3)
            .rev()
            .map(|i| {
                let narrow = conv(format!("up.{i}.narrow"), 1, 1, w[i + 1], w[i])?;
                Ok([narrow, conv(format!("up.{i}.mix"), 3, 1, w[i], w[i])?])
            })
            .collect::<Result<_, WeightsError>>()?;
        Ok(Self {
            stem: [conv("stem.0".into(), 3, 1, 9, w[0])?, conv("stem.1".into(), 3, 1, w[0], w[0])?],
            down,
            global: [conv("global.0".into(), 1, 1, w[3], w[3])?, conv("global.1".into(), 1, 1, w[3], w[3])?],
            up,
            head: conv("head".into(), 3, 1, w[0], 1)?,
        })
    }

    /// Level at the size of the input, in units of [`LEVEL_SCALE`].
    fn forward(&self, input: &Planes) -> Planes {
        let mut x = self.stem[1].forward_relu(&self.stem[0].forward_relu(input));
        let mut skips = Vec::with_capacity(3);
        for (enter, blocks) in &self.down {
            let smaller = enter.forward_relu(&x);
            skips.push(std::mem::replace(&mut x, smaller));
            for [first, second] in blocks {
                let change = second.forward(&first.forward_relu(&x));
                x.data.iter_mut().zip(&change.data).for_each(|(v, c)| *v = (*v + c).max(0.0));
            }
        }
        let summary = Planes { channels: LEVEL_WIDTHS[3], rows: 1, cols: 1, data: x.means() };
        let summary = self.global[1].forward(&self.global[0].forward_relu(&summary));
        x.add_per_channel(&summary.data);
        for ([narrow, mix], skip) in self.up.iter().zip(skips.iter().rev()) {
            x = mix.forward_relu(&narrow.forward(&x).doubled_plus(skip));
        }
        self.head.forward(&x)
    }

    fn convolutions(&self) -> impl Iterator<Item = &Convolution> {
        let down = self.down.iter().flat_map(|(enter, blocks)| std::iter::once(enter).chain(blocks.iter().flatten()));
        self.stem.iter().chain(down).chain(self.up.iter().flatten()).chain([&self.head])
    }

    fn global_parameters(&self) -> usize {
        self.global.iter().map(Convolution::parameters).sum()
    }

    fn cost(&self) -> usize {
        let quarter = WORKING_SIZE.0 * WORKING_SIZE.1 / 16;
        let at = |size: usize| quarter >> (2 * size);
        let stem: usize = self.stem.iter().chain([&self.head]).map(|c| c.cost(at(0))).sum();
        let down = self.down.iter().enumerate().map(|(i, (enter, blocks))| {
            enter.cost(at(i)) + blocks.iter().flatten().map(|c| c.cost(at(i + 1))).sum::<usize>()
        });
        let up = self.up.iter().enumerate().map(|(i, [narrow, mix])| narrow.cost(at(3 - i)) + mix.cost(at(2 - i)));
        stem + down.sum::<usize>() + up.sum::<usize>()
    }
}
