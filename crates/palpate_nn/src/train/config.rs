use super::ConfigError;
use serde::{Deserialize, Serialize};

/// How parameters move along their gradients.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum OptimizerConfig {
    /// Kingma & Ba, *Adam*, ICLR 2015; β = (0.9, 0.999), ε = 1e-8.
    Adam,
    /// Loshchilov & Hutter, *Decoupled Weight Decay Regularization*, ICLR 2019.
    Adamw {
        /// Share of each weight taken away per step, times the learning rate. Larger keeps weights smaller.
        weight_decay: f64,
    },
}

/// How the learning rate changes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Schedule {
    /// It does not.
    Constant,
    /// Times `factor` after every `epochs` epochs.
    Step {
        /// What remains, (0, 1].
        factor: f64,
        /// Epochs between two changes.
        epochs: usize,
    },
    /// Rises linearly for `warmup_steps`, then falls along half a cosine to `floor` times its peak.
    WarmupCosine {
        /// Steps of the rise.
        warmup_steps: usize,
        /// Share of the peak that remains at the end, [0, 1].
        floor: f64,
    },
}

impl Schedule {
    /// Learning rate of a step, for a run of `steps` steps with `steps_per_epoch` each epoch.
    pub fn rate(&self, peak: f64, step: usize, steps_per_epoch: usize, steps: usize) -> f64 {
        match *self {
            Self::Constant => peak,
            Self::Step { factor, epochs } => peak * factor.powi((step / steps_per_epoch / epochs) as i32),
            Self::WarmupCosine { warmup_steps, .. } if step < warmup_steps => {
                peak * (step + 1) as f64 / warmup_steps as f64
            }
            Self::WarmupCosine { warmup_steps, floor } => {
                let done = (step - warmup_steps) as f64 / steps.saturating_sub(warmup_steps).max(1) as f64;
                let cosine = 0.5 * (1.0 + (std::f64::consts::PI * done.min(1.0)).cos());
                peak * (floor + (1.0 - floor) * cosine)
            }
        }
    }
}

/// Everything about a run that does not depend on the network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopConfig {
    /// Decides weights, order, augmentation and dropout.
    pub seed: u64,
    /// Passes over the training samples.
    pub epochs: usize,
    /// Samples per step; the rest of an epoch that fills no batch is left out, another one each time.
    pub batch_size: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// How it changes.
    pub schedule: Schedule,
    /// What uses it.
    pub optimizer: OptimizerConfig,
    /// Largest Euclidean norm of the whole gradient; longer ones are scaled down to it. 0 = no limit.
    pub clip_norm: f64,
    /// Steps between validations (and checkpoints); 0 = after every epoch.
    pub validate_every: usize,
    /// Validations without improvement after which the run ends; 0 = never.
    pub patience: usize,
}

impl LoopConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ConfigError`] with the first field that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check =
            |ok: bool, field, found: f64, rule| if ok { Ok(()) } else { Err(ConfigError { field, found, rule }) };
        let positive = "it must be at least 1";
        check(self.epochs > 0, "epochs", self.epochs as f64, positive)?;
        check(self.batch_size > 0, "batch_size", self.batch_size as f64, positive)?;
        let rate = self.learning_rate;
        check(rate > 0.0 && rate <= 1.0, "learning_rate", rate, "it must lie in (0, 1]")?;
        check(self.clip_norm >= 0.0, "clip_norm", self.clip_norm, "it must not be negative")?;
        match self.schedule {
            Schedule::Constant => {}
            Schedule::Step { factor, epochs } => {
                check(factor > 0.0 && factor <= 1.0, "schedule.factor", factor, "it must lie in (0, 1]")?;
                check(epochs > 0, "schedule.epochs", epochs as f64, positive)?;
            }
            Schedule::WarmupCosine { floor, .. } => {
                check((0.0..=1.0).contains(&floor), "schedule.floor", floor, "it must lie in [0, 1]")?;
            }
        }
        if let OptimizerConfig::Adamw { weight_decay } = self.optimizer {
            let rule = "it must lie in [0, 1]";
            check((0.0..=1.0).contains(&weight_decay), "optimizer.weight_decay", weight_decay, rule)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_have_their_corner_values() {
        let step = Schedule::Step { factor: 0.6, epochs: 10 };
        assert_eq!(step.rate(1.0, 99, 10, 1000), 1.0);
        assert!((step.rate(1.0, 100, 10, 1000) - 0.6).abs() < 1e-12);
        let cosine = Schedule::WarmupCosine { warmup_steps: 4, floor: 0.1 };
        assert_eq!(cosine.rate(1.0, 0, 10, 104), 0.25);
        assert_eq!(cosine.rate(1.0, 3, 10, 104), 1.0);
        assert!((cosine.rate(1.0, 54, 10, 104) - 0.55).abs() < 1e-12);
        assert!((cosine.rate(1.0, 104, 10, 104) - 0.1).abs() < 1e-12);
    }
}
