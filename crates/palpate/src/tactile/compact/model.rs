use super::planes::enlarge;
use super::{Convolution, Planes, Weights, WeightsError};
use crate::geometry::Raster;
use crate::tactile::gaussian::{blur, kernel_of_sigma};
use crate::tactile::integrate::Integrator;

/// Rows and columns of the images that the network works on.
pub const WORKING_SIZE: (usize, usize) = (240, 320);
/// Grey levels that become 1 at the input.
pub const LEVELS: f32 = 32.0;
/// Steps of the height between neighbouring pixels, mm, are given to networks times this.
pub const STEP_SCALE: f32 = 20.0;
/// The level network's output times this is millimetres.
pub const LEVEL_SCALE: f32 = 0.5;
/// σ with which the level is smoothed, pixels of a quarter of the working size: 0.7 mm.
const LEVEL_SMOOTHNESS: f64 = 2.83;
/// Channels of the level network at 1/8, 1/16 and 1/32 of the working size.
pub const LEVEL_WIDTHS: [usize; 3] = [32, 64, 96];
/// Residual pairs of the level network at 1/8, 1/16 and 1/32 of the working size.
pub const LEVEL_BLOCKS: [usize; 3] = [1, 1, 2];

/// Channels that the level network reads.
pub const LEVEL_INPUTS: usize = 9;

/// The compact network: what the gel's colour says of its slope, of its level, and of contact.
///
/// 1. **Gradient map** (local): colour difference and place → the steps of the indentation between neighbouring pixels.
/// 2. The steps are integrated (Poisson, free borders): exact shape, but **no level**, and a slow drift.
/// 3. **Level network** (global, from a quarter of the size): from the same image and the integral, what integration cannot know.
/// 4. **Mask map** (local): from indentation, its peak and its steps, the contact.
#[derive(Debug, Clone)]
pub struct CompactModel {
    /// Part 1.
    pub gradient: GradientMap,
    /// Part 3.
    pub level: LevelNetwork,
    /// Part 4.
    pub mask: MaskMap,
}

/// What the network makes of an image, at [`WORKING_SIZE`].
#[derive(Debug, Clone)]
pub struct Indentation {
    /// Depth of the gel below its relaxed surface, mm.
    pub depth: Raster<f32>,
    /// Steps of the depth to the next column and the next row as the gradient map gives them, mm.
    pub steps: Raster<[f32; 2]>,
    /// Largest depth, mm, over means of 2 × 2 pixels.
    pub peak: f32,
}

impl CompactModel {
    /// Takes the tensors by name; sizes are checked against the architecture.
    ///
    /// # Errors
    /// [`WeightsError`]: another architecture, a tensor that is missing or of another shape.
    pub fn from_weights(weights: &Weights) -> Result<Self, WeightsError> {
        weights.check_architecture()?;
        Ok(Self {
            gradient: GradientMap::from_weights(weights)?,
            level: LevelNetwork::from_weights(weights)?,
            mask: MaskMap::from_weights(weights)?,
        })
    }

    /// Number of weights and biases.
    pub fn parameters(&self) -> usize {
        let local = self.gradient.0.iter().chain(&self.mask.0);
        local.chain(self.level.convolutions()).map(Convolution::parameters).sum()
    }

    /// Multiply-adds for one image.
    pub fn cost(&self) -> usize {
        let half = WORKING_SIZE.0 * WORKING_SIZE.1 / 4;
        self.gradient.0.iter().chain(&self.mask.0).map(|c| c.cost(half)).sum::<usize>() + self.level.cost()
    }
}

/// Parts 1 to 3: the indentation.
///
/// * `difference` – image minus no-contact image, R, G, B grey levels, [`WORKING_SIZE`]
/// * `dome` – z of the relaxed gel, metres, [`WORKING_SIZE`]
/// * `integrator` – of [`WORKING_SIZE`]
pub fn indentation(
    gradient: &GradientMap,
    level: &LevelNetwork,
    difference: &Raster<[f32; 3]>,
    dome: &Raster<f32>,
    integrator: &Integrator,
) -> Indentation {
    let steps = gradient.run(difference);
    let shape = integrator.integrate_steps(&steps);
    let level = level.run(&level_input(difference, &shape, &steps, dome));
    let (depth, peak) = join(&shape, &level);
    Indentation { depth, steps, peak }
}

/// Colour difference and place to steps of the height, over 6 × 6 pixels.
#[derive(Debug, Clone)]
pub struct GradientMap(Vec<Convolution>);

/// Kernel size, inputs, outputs of the layers of the gradient map.
pub const GRADIENT_LAYERS: [(usize, usize, usize); 4] = [(3, 14, 32), (1, 32, 32), (1, 32, 32), (1, 32, 8)];
/// Kernel size, inputs, outputs of the layers of the mask map.
pub const MASK_LAYERS: [(usize, usize, usize); 3] = [(3, 13, 24), (1, 24, 24), (3, 24, 4)];

impl GradientMap {
    /// Takes the tensors `gradient.*`.
    ///
    /// # Errors
    /// [`WeightsError::Missing`] or [`WeightsError::Shape`].
    pub fn from_weights(weights: &Weights) -> Result<Self, WeightsError> {
        weights.layers("gradient", &GRADIENT_LAYERS).map(Self)
    }

    /// Steps of the indentation to the next column and the next row, mm.
    ///
    /// * `difference` – image minus no-contact image, R, G, B grey levels
    pub fn run(&self, difference: &Raster<[f32; 3]>) -> Raster<[f32; 2]> {
        let out = run_layers(&self.0, gradient_input(difference));
        let (cols, rows) = (out.channels_to_blocks(0, 2), out.channels_to_blocks(1, 2));
        let pairs = cols.as_slice().iter().zip(rows.as_slice());
        let data = pairs.map(|(c, r)| [c / STEP_SCALE, r / STEP_SCALE]).collect();
        Raster::from_vec(cols.rows(), cols.cols(), data).expect("same size")
    }
}

/// Indentation and its steps to contact, over 12 × 12 pixels.
#[derive(Debug, Clone)]
pub struct MaskMap(Vec<Convolution>);

impl MaskMap {
    /// Takes the tensors `mask.*`.
    ///
    /// # Errors
    /// [`WeightsError::Missing`] or [`WeightsError::Shape`].
    pub fn from_weights(weights: &Weights) -> Result<Self, WeightsError> {
        weights.layers("mask", &MASK_LAYERS).map(Self)
    }

    /// Contact logit of every pixel: positive is contact.
    pub fn run(&self, felt: &Indentation) -> Raster<f32> {
        run_layers(&self.0, mask_input(&felt.depth, &felt.steps, felt.peak)).channels_to_blocks(0, 2)
    }
}

/// Layers with a rectifier between them, none after the last.
fn run_layers(layers: &[Convolution], input: Planes) -> Planes {
    let last = layers.len() - 1;
    layers
        .iter()
        .enumerate()
        .fold(input, |x, (i, layer)| if i < last { layer.forward_relu(&x) } else { layer.forward(&x) })
}

/// Input of the gradient map, 14 × rows/2 × cols/2: the 2 × 2 blocks of the difference, and the place.
///
/// * `difference` – of the working size
pub fn gradient_input(difference: &Raster<[f32; 3]>) -> Planes {
    let mut planes = Planes::from_blocks(difference, 2);
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
    let mut planes = Planes::means(difference, 4);
    planes.data.iter_mut().for_each(|v| *v /= LEVELS);
    planes.append(&Planes::means(&shape.map(|&h| [h]), 4));
    planes.append(&Planes::means(&steps.map(|s| s.map(|v| v * STEP_SCALE)), 4));
    planes.append(&places(planes.rows, planes.cols));
    planes.append(&Planes::means(&dome.map(|&z| [z * 1e3]), 4));
    planes
}

/// Input of the mask map, 13 × rows/2 × cols/2: 2 × 2 blocks of depth over peak and of the steps, and the peak.
pub fn mask_input(depth: &Raster<f32>, steps: &Raster<[f32; 2]>, peak: f32) -> Planes {
    let values = depth.as_slice().iter().zip(steps.as_slice());
    let share = 1.0 / peak.max(0.02);
    let data = values.map(|(d, s)| [d * share, s[0] * STEP_SCALE, s[1] * STEP_SCALE]).collect();
    let stacked = Raster::<[f32; 3]>::from_vec(depth.rows(), depth.cols(), data).expect("same size");
    let mut planes = Planes::from_blocks(&stacked, 2);
    let mut constant = Planes::zeros(1, planes.rows, planes.cols);
    constant.data.fill(peak);
    planes.append(&constant);
    planes
}

/// Depth of the gel, mm, and its peak: the integral plus the level at a quarter of the size.
///
/// The level is smoothed first: detail is the integral's. On validation objects this takes the normal error from 1.70° to 1.35°
/// and leaves the heights as they are.
pub fn join(shape: &Raster<f32>, level: &Raster<f32>) -> (Raster<f32>, f32) {
    let (rows, cols) = shape.shape();
    let mut level = level.clone();
    blur(&mut level, &kernel_of_sigma(LEVEL_SMOOTHNESS));
    let mut depth = enlarge(level.as_slice(), rows / 4, cols / 4, 4);
    for (d, s) in depth.as_mut_slice().iter_mut().zip(shape.as_slice()) {
        *d = *d * LEVEL_SCALE + s;
    }
    let means = Planes::means(&depth.map(|&d| [d]), 2);
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

/// Encoder and decoder over three sizes, with a global summary at the smallest.
#[derive(Debug, Clone)]
pub struct LevelNetwork {
    /// At each size: a convolution of stride 2 into it, then residual pairs.
    down: Vec<(Convolution, Vec<[Convolution; 2]>)>,
    /// Fully connected, twice.
    global: [Convolution; 2],
    /// From the smallest size up: 1 × 1 to the width of the larger size, then 3 × 3 after the sum.
    up: Vec<[Convolution; 2]>,
    head: Convolution,
}

impl LevelNetwork {
    /// Takes the tensors `level.*`.
    ///
    /// # Errors
    /// [`WeightsError::Missing`] or [`WeightsError::Shape`].
    pub fn from_weights(weights: &Weights) -> Result<Self, WeightsError> {
        let w = LEVEL_WIDTHS;
        let conv = |name: String, size, stride, inputs, outputs| {
            weights.convolution(&format!("level.{name}"), size, stride, inputs, outputs)
        };
        let down = (0..3)
            .map(|i| {
                let enter = conv(format!("enter.{i}"), 3, 2, if i == 0 { LEVEL_INPUTS } else { w[i - 1] }, w[i])?;
                let half = |k: usize, half: usize| conv(format!("block.{i}.{k}.{half}"), 3, 1, w[i], w[i]);
                let blocks = (0..LEVEL_BLOCKS[i]).map(|k| Ok([half(k, 0)?, half(k, 1)?]));
                Ok((enter, blocks.collect::<Result<_, WeightsError>>()?))
            })
            .collect::<Result<_, WeightsError>>()?;
        let up = [1, 0].map(|i| {
            let narrow = conv(format!("narrow.{i}"), 1, 1, w[i + 1], w[i])?;
            Ok([narrow, conv(format!("mix.{i}"), 3, 1, w[i], w[i])?])
        });
        Ok(Self {
            down,
            global: [conv("global.0".into(), 1, 1, w[2], w[2])?, conv("global.1".into(), 1, 1, w[2], w[2])?],
            up: up.into_iter().collect::<Result<_, WeightsError>>()?,
            head: conv("head".into(), 3, 1, w[0], 4)?,
        })
    }

    /// Level at the size of the input, in units of [`LEVEL_SCALE`].
    ///
    /// * `input` – of [`level_input`]
    pub fn run(&self, input: &Planes) -> Raster<f32> {
        let mut skips = Vec::with_capacity(3);
        let mut x = input.clone();
        for (enter, blocks) in &self.down {
            let smaller = enter.forward_relu(&x);
            skips.push(std::mem::replace(&mut x, smaller));
            for [first, second] in blocks {
                let change = second.forward(&first.forward_relu(&x));
                x.data.iter_mut().zip(&change.data).for_each(|(v, c)| *v = (*v + c).max(0.0));
            }
        }
        let summary = Planes { channels: LEVEL_WIDTHS[2], rows: 1, cols: 1, data: x.channel_means() };
        let summary = self.global[1].forward(&self.global[0].forward_relu(&summary));
        x.add_per_channel(&summary.data);
        for ([narrow, mix], skip) in self.up.iter().zip(skips.iter().skip(1).rev()) {
            x = mix.forward_relu(&narrow.forward(&x).doubled_plus(skip));
        }
        self.head.forward(&x).channels_to_blocks(0, 2)
    }

    fn convolutions(&self) -> impl Iterator<Item = &Convolution> {
        let down = self.down.iter().flat_map(|(enter, blocks)| std::iter::once(enter).chain(blocks.iter().flatten()));
        down.chain(&self.global).chain(self.up.iter().flatten()).chain([&self.head])
    }

    /// Multiply-adds; the global summary's are too few to count.
    fn cost(&self) -> usize {
        let at = |size: usize| (WORKING_SIZE.0 * WORKING_SIZE.1 / 16) >> (2 * size);
        let down = self.down.iter().enumerate().map(|(i, (enter, blocks))| {
            enter.cost(at(i)) + blocks.iter().flatten().map(|c| c.cost(at(i + 1))).sum::<usize>()
        });
        let up = self.up.iter().enumerate().map(|(i, [narrow, mix])| narrow.cost(at(3 - i)) + mix.cost(at(2 - i)));
        down.sum::<usize>() + up.sum::<usize>() + self.head.cost(at(1))
    }
}
