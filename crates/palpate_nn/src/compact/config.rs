use super::data::LightAugment;
use crate::train::{ConfigError, LoopConfig, OptimizerConfig, Schedule};
use serde::{Deserialize, Serialize};

/// A training run of the compact network: its parts one after the other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompactConfig {
    /// Random changes of training images.
    pub augment: LightAugment,
    /// The gradient map.
    pub gradient: LoopConfig,
    /// The level network.
    pub level: LoopConfig,
    /// The mask map.
    pub mask: LoopConfig,
}

impl CompactConfig {
    /// The run that made the shipped weights.
    pub fn preset(seed: u64) -> Self {
        let part = |epochs, batch_size, learning_rate, warmup_steps, validate_every| LoopConfig {
            seed,
            epochs,
            batch_size,
            learning_rate,
            schedule: Schedule::WarmupCosine { warmup_steps, floor: 0.01 },
            optimizer: OptimizerConfig::Adamw { weight_decay: 1e-4 },
            clip_norm: 2.0,
            validate_every,
            patience: 0,
        };
        Self {
            augment: LightAugment { share: 0.5, gain: 0.03, offset: 2.0, drift: 1.5 },
            gradient: LoopConfig { clip_norm: 5.0, ..part(4, 16, 4e-3, 100, 500) },
            level: part(5, 16, 2e-3, 150, 330),
            mask: part(1, 8, 4e-3, 50, 400),
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`ConfigError`] with the first field that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let augment = self.augment;
        if !(0.0..=1.0).contains(&augment.share) {
            return Err(ConfigError { field: "augment.share", found: augment.share, rule: "it must lie in [0, 1]" });
        }
        for (field, found) in
            [("augment.gain", augment.gain), ("augment.offset", augment.offset), ("augment.drift", augment.drift)]
        {
            if !(0.0..100.0).contains(&found) {
                return Err(ConfigError { field, found, rule: "it must lie in [0, 100)" });
            }
        }
        self.gradient.validate()?;
        self.level.validate()?;
        self.mask.validate()
    }
}
