use super::decoder::UpProjection;
use super::encoder::{ConvNorm, Encoder};
use crate::layers::{blur, conv, drop_channels, enlarge_twice};
use crate::weights::{Architecture, initialize};
use burn::nn::conv::Conv2d;
use burn::prelude::*;
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::ops::PadMode;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// What the network's single output channel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Head {
    /// A height ≥ 0 per pixel: ReLU, and a blur of the enlarged map.
    HeightMap,
    /// A height of either sign per pixel: no activation. A rectified output that is small nearly everywhere, as an indentation
    /// is, may die: it becomes 0 for all images and no gradient brings it back.
    SignedHeightMap,
    /// The probability of contact per pixel: sigmoid.
    ContactMask,
}

/// Shape of an [`Fcrn`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FcrnConfig {
    /// Channels of the first layer; all others are multiples. 64 is the thesis (63,571,649 trainable parameters); time and
    /// parameters grow with its square.
    pub width: usize,
    /// What the output is.
    pub head: Head,
    /// Share of the decoder's last channels set to zero while training, [0, 1). The thesis has 0.5.
    pub dropout: f64,
}

/// Why a network cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FcrnError {
    /// No channels, or more than anyone can train.
    #[error("width is {found}; it must lie in 1 … 256 (64 is the network of the thesis)")]
    Width {
        /// Width found.
        found: usize,
    },
    /// Not a share.
    #[error("dropout is {found}; it must lie in [0, 1)")]
    Dropout {
        /// Value found.
        found: f64,
    },
}

impl Head {
    /// Whether the output is a height.
    pub fn is_height(self) -> bool {
        self != Self::ContactMask
    }
}

impl FcrnConfig {
    /// The network of the thesis.
    pub fn thesis(head: Head) -> Self {
        Self { width: 64, head, dropout: 0.5 }
    }

    /// Checks both numbers.
    ///
    /// # Errors
    /// The first [`FcrnError`] found.
    pub fn validate(&self) -> Result<(), FcrnError> {
        if !(1..=256).contains(&self.width) {
            return Err(FcrnError::Width { found: self.width });
        }
        if !(0.0..1.0).contains(&self.dropout) {
            return Err(FcrnError::Dropout { found: self.dropout });
        }
        Ok(())
    }

    /// Name, version and shape, as weight files carry them.
    pub fn architecture(&self) -> Architecture {
        Architecture::new("fcrn", 1, self)
    }
}

/// The network; see [the module](crate::fcrn).
///
/// | stage | output (width w, input h × w) |
/// |---|---|
/// | encoder | 32 w × h/32 |
/// | bridge: 1 × 1 convolution and norm, no ReLU | 16 w × h/32 |
/// | four up-projections | 8 w × h/16, 4 w × h/8, 2 w × h/4, w × h/2 |
/// | dropout of channels, 3 × 3 convolution, activation | 1 × h/2 |
/// | bilinear enlargement; blur for the height map | 1 × h |
#[derive(Module, Debug)]
pub struct Fcrn<B: Backend> {
    encoder: Encoder<B>,
    bridge: ConvNorm<B>,
    up: Vec<UpProjection<B>>,
    last: Conv2d<B>,
    #[module(skip)]
    config: FcrnConfig,
}

impl<B: Backend> Fcrn<B> {
    /// A network with random weights; the same seed gives the same weights on every back end.
    ///
    /// # Errors
    /// [`FcrnError`] if `config` is out of range.
    pub fn new(config: FcrnConfig, seed: u64, device: &B::Device) -> Result<Self, FcrnError> {
        Ok(initialize(Self::zeros(config, device)?, seed))
    }

    /// A network whose convolutions are all zero, to load weights into.
    ///
    /// # Errors
    /// [`FcrnError`] if `config` is out of range.
    pub fn zeros(config: FcrnConfig, device: &B::Device) -> Result<Self, FcrnError> {
        config.validate()?;
        let w = config.width;
        Ok(Self {
            encoder: Encoder::new(w, device),
            bridge: ConvNorm::new((32 * w, 16 * w), 1, 1, device),
            up: [16, 8, 4, 2].map(|k| UpProjection::new(k * w, k / 2 * w, device)).into(),
            last: conv((w, 1), [3, 3], 1, 1, true, device),
            config,
        })
    }

    /// Its shape.
    pub fn config(&self) -> FcrnConfig {
        self.config
    }

    /// `[n, 3, rows, cols]` → `[n, 1, rows, cols]`: heights or probabilities, without dropout.
    ///
    /// On a differentiating back end, batch normalisation uses and records the statistics of this batch.
    pub fn forward(&self, images: Tensor<B, 4>) -> Tensor<B, 4> {
        self.run(images, None)
    }

    /// [`Self::forward`] for training: channels are dropped as `rng` decides.
    pub fn forward_train(&self, images: Tensor<B, 4>, rng: &mut Pcg64) -> Tensor<B, 4> {
        self.run(images, Some(rng))
    }

    fn run(&self, images: Tensor<B, 4>, rng: Option<&mut Pcg64>) -> Tensor<B, 4> {
        let [_, _, rows, cols] = images.dims();
        let x = self.bridge.forward(self.encoder.forward(pad_to_32(images)));
        let mut x = self.up.iter().fold(x, |x, up| up.forward(x));
        if let Some(rng) = rng {
            x = drop_channels(x, self.config.dropout, rng);
        }
        let x = self.last.forward(x);
        let x = match self.config.head {
            Head::HeightMap => blur(enlarge_twice(relu(x))),
            Head::SignedHeightMap => blur(enlarge_twice(x)),
            Head::ContactMask => enlarge_twice(sigmoid(x)),
        };
        x.narrow(2, 0, rows).narrow(3, 0, cols)
    }
}

/// Repeats the last row and column until 32 divides both sizes.
fn pad_to_32<B: Backend>(images: Tensor<B, 4>) -> Tensor<B, 4> {
    let [_, _, rows, cols] = images.dims();
    let missing = |n: usize| n.next_multiple_of(32) - n;
    if missing(rows) == 0 && missing(cols) == 0 {
        return images;
    }
    images.pad([(0, 0), (0, 0), (0, missing(rows)), (0, missing(cols))], PadMode::Edge)
}
