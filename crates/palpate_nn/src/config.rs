//! The parameter file of a training run.

use crate::data::Augment;
use crate::fcrn::{FcrnConfig, FcrnError, Head};
use crate::loss::Loss;
use crate::train::{ConfigError, LoopConfig, OptimizerConfig, Schedule};
use palpate::io::{IoError, read_text};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Which network.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Channels of the first layer; 64 is the thesis. Time and size grow with its square.
    pub width: usize,
    /// What the output is.
    pub head: Head,
    /// Share of the last channels dropped in training, [0, 1).
    pub dropout: f64,
}

/// How an image is given to the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Blue, green, red, 0 … 255, as recorded: the thesis.
    Bgr255,
    /// Red, green, blue minus the image without contact, over 64 grey levels.
    Difference,
}

/// What a height network gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// Depth of the gel surface below the apex of the relaxed gel, in pixels of the sensor's pitch, dome included: the thesis.
    DepthPx,
    /// Depth below the relaxed gel at the same pixel, millimetres; 0 off contact.
    IndentationMm,
}

/// What goes in and comes out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataConfig {
    /// Rows that images are brought to.
    pub rows: usize,
    /// Columns that images are brought to.
    pub cols: usize,
    /// How an image is given to the network.
    pub input: Input,
    /// What a height network gives; without meaning for a contact mask.
    pub target: Target,
}

/// A training run of an FCRN.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Which network.
    pub network: NetworkConfig,
    /// What goes in and comes out.
    pub data: DataConfig,
    /// What training makes small.
    pub loss: Loss,
    /// Random changes of training images.
    pub augment: Augment,
    /// Everything that does not depend on the network.
    pub run: LoopConfig,
}

/// What is wrong with the parameters of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainConfigError {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The file is no TOML of the form needed.
    #[error("{}: {reason}", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        reason: String,
    },
    /// No preset of this name.
    #[error("no preset is called '{found}'; known: {}", TrainConfig::PRESETS.join(", "))]
    Preset {
        /// The name asked for.
        found: String,
    },
    /// The network cannot be made.
    #[error("network: {0}")]
    Network(#[from] FcrnError),
    /// A parameter of the loop is out of range.
    #[error("run: {0}")]
    Run(#[from] ConfigError),
    /// The input is too small or too large.
    #[error("data: input of {rows} × {cols} (rows × cols); both must lie in 32 … 2048")]
    Size {
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// The loss does not fit the head.
    #[error("loss: bce-dice is a loss of probabilities; head {head:?} needs root-mean-square or l1-gradient")]
    Loss {
        /// The head.
        head: Head,
    },
}

impl NetworkConfig {
    pub(crate) fn fcrn(&self) -> FcrnConfig {
        FcrnConfig { width: self.width, head: self.head, dropout: self.dropout }
    }
}

impl TrainConfig {
    /// Names that [`Self::preset`] knows.
    pub const PRESETS: [&'static str; 6] = [
        "thesis-height-map",
        "thesis-contact-mask",
        "better-height-map",
        "better-contact-mask",
        "reduced-height-map",
        "reduced-contact-mask",
    ];

    /// A known run.
    ///
    /// * `thesis-*` – as written in the thesis, without the slips of its code: there the height network's optimizer is made anew
    ///   each epoch (so that its moments are lost), the mask network's learning rate never falls, predicted masks are cut to
    ///   whole numbers before any threshold (so that all are empty), and the first ×0.6 comes at epoch 0
    /// * `better-*` – background subtracted, light augmented, losses that fit the outputs, `AdamW` with warm-up
    /// * `reduced-*` – width 4 and 64 × 96, background subtracted: trains on a CPU in minutes. Heights by the root mean square: with
    ///   an absolute error so small a network stays at 0, the median of all pixels
    ///
    /// # Errors
    /// [`TrainConfigError::Preset`], which lists the names.
    pub fn preset(name: &str) -> Result<Self, TrainConfigError> {
        let (kind, head) = match name.split_once('-') {
            Some((kind, "height-map")) => (kind, Head::HeightMap),
            Some((kind, "contact-mask")) => (kind, Head::ContactMask),
            _ => ("", Head::HeightMap),
        };
        match kind {
            "thesis" => Ok(Self::thesis(head)),
            "better" => Ok(Self::better(head)),
            "reduced" => Ok(Self::reduced(head)),
            _ => Err(TrainConfigError::Preset { found: name.to_owned() }),
        }
    }

    fn thesis(head: Head) -> Self {
        Self {
            network: NetworkConfig { width: 64, head, dropout: 0.5 },
            data: DataConfig { rows: 480, cols: 640, input: Input::Bgr255, target: Target::DepthPx },
            loss: Loss::RootMeanSquare,
            augment: Augment::default(),
            run: LoopConfig {
                seed: 0,
                epochs: if head == Head::HeightMap { 50 } else { 100 },
                batch_size: 16,
                learning_rate: 1e-5,
                schedule: Schedule::Step { factor: 0.6, epochs: 10 },
                optimizer: OptimizerConfig::Adam,
                clip_norm: 0.0,
                validate_every: 0,
                patience: 0,
            },
        }
    }

    fn better(head: Head) -> Self {
        Self {
            network: NetworkConfig {
                width: 64,
                // Most of an indentation map is 0, where a rectified output dies.
                head: if head == Head::HeightMap { Head::SignedHeightMap } else { head },
                dropout: 0.1,
            },
            data: DataConfig { rows: 240, cols: 320, input: Input::Difference, target: Target::IndentationMm },
            loss: match head {
                Head::HeightMap | Head::SignedHeightMap => Loss::L1Gradient { gradient: 1.0 },
                Head::ContactMask => Loss::BceDice { dice: 1.0 },
            },
            augment: Augment { gain: 0.1, offset: 5.0, noise: 2.0 },
            run: LoopConfig {
                seed: 0,
                epochs: 30,
                batch_size: 32,
                learning_rate: 3e-4,
                schedule: Schedule::WarmupCosine { warmup_steps: 200, floor: 0.01 },
                optimizer: OptimizerConfig::Adamw { weight_decay: 0.01 },
                clip_norm: 1.0,
                validate_every: 0,
                patience: 10,
            },
        }
    }

    fn reduced(head: Head) -> Self {
        let better = Self::better(head);
        Self {
            network: NetworkConfig { width: 4, dropout: 0.0, ..better.network },
            data: DataConfig { rows: 64, cols: 96, ..better.data },
            loss: if head == Head::ContactMask { better.loss } else { Loss::RootMeanSquare },
            augment: Augment { gain: 0.03, offset: 2.0, noise: 1.0 },
            run: LoopConfig {
                epochs: if head == Head::ContactMask { 4 } else { 6 },
                batch_size: 8,
                learning_rate: 4e-3,
                schedule: Schedule::WarmupCosine { warmup_steps: 50, floor: 0.01 },
                optimizer: OptimizerConfig::Adamw { weight_decay: 1e-4 },
                clip_norm: 10.0,
                validate_every: 662,
                ..better.run
            },
        }
    }

    /// Reads a TOML file and checks it.
    ///
    /// # Errors
    /// [`TrainConfigError`].
    pub fn open(path: &Path) -> Result<Self, TrainConfigError> {
        let text = read_text(path)?;
        let config: Self = toml::from_str(&text).map_err(|e| TrainConfigError::Toml {
            path: path.to_owned(),
            reason: e.to_string().trim_end().to_owned(),
        })?;
        config.validate()?;
        Ok(config)
    }

    /// The file that [`Self::open`] reads.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("plain structs")
    }

    /// Checks every field.
    ///
    /// # Errors
    /// The first [`TrainConfigError`] found.
    pub fn validate(&self) -> Result<(), TrainConfigError> {
        self.network.fcrn().validate()?;
        self.run.validate()?;
        let DataConfig { rows, cols, .. } = self.data;
        if ![rows, cols].iter().all(|n| (32..=2048).contains(n)) {
            return Err(TrainConfigError::Size { rows, cols });
        }
        if self.loss.needs_probabilities() && self.network.head != Head::ContactMask {
            return Err(TrainConfigError::Loss { head: self.network.head });
        }
        Ok(())
    }
}
