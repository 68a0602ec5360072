use crate::data::DataError;
use crate::weights::{Architecture, Provenance};
use burn::module::AutodiffModule;
use burn::prelude::*;
use burn::tensor::backend::AutodiffBackend;
use rand_pcg::Pcg64;

/// Which way a metric improves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// Errors, losses.
    Lower,
    /// Overlaps, accuracies.
    Higher,
}

/// A number that validation gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Metric {
    /// Name with its unit, a column of `metrics.csv`.
    pub name: &'static str,
    /// Which way it improves.
    pub better: Better,
}

/// What [`train`](super::train) needs to know of a network and its data.
pub trait Task<B: AutodiffBackend>: Sync {
    /// The network.
    type Model: AutodiffModule<B>;
    /// Samples on the host, prepared on another thread while the network computes.
    type Batch: Send;

    /// Name, version and config of the network.
    fn architecture(&self) -> Architecture;

    /// Where the weights will come from, for their file.
    fn provenance(&self) -> Provenance;

    /// A network with weights drawn from `seed`.
    fn model(&self, seed: u64, device: &B::Device) -> Self::Model;

    /// Number of training samples.
    fn training_samples(&self) -> usize;

    /// Loads and augments the training samples `indices`; every random choice comes from `rng`.
    ///
    /// # Errors
    /// [`DataError`] if a sample cannot be read.
    fn batch(&self, indices: &[usize], rng: &mut Pcg64) -> Result<Self::Batch, DataError>;

    /// Mean loss of a batch, one value; dropout comes from `rng`.
    fn loss(&self, model: &Self::Model, batch: Self::Batch, rng: &mut Pcg64, device: &B::Device) -> Tensor<B, 1>;

    /// What [`Self::validate`] gives; the first one decides which weights are best. At least one.
    fn metrics(&self) -> &[Metric];

    /// The metrics over the validation samples, in the order of [`Self::metrics`].
    ///
    /// # Errors
    /// [`DataError`] if a sample cannot be read.
    fn validate(
        &self,
        model: &<Self::Model as AutodiffModule<B>>::InnerModule,
        device: &B::Device,
    ) -> Result<Vec<f64>, DataError>;
}
