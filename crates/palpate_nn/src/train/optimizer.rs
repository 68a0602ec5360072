use super::OptimizerConfig;
use crate::weights::{NamedTensor, NamedTensors};
use crate::weights::{TensorPath, follow_path, host_values};
use burn::module::{AutodiffModule, ModuleMapper, ModuleVisitor, Param};
use burn::optim::{AdamW, AdamWConfig, AdamWState, AdaptiveMomentumState, GradientsParams, SimpleOptimizer as _};
use burn::prelude::*;
use burn::tensor::backend::AutodiffBackend;
use std::collections::BTreeMap;

/// burn's AdamW with its state by tensor name instead of by the random number of a parameter, so that a checkpoint is one plain
/// file of named tensors. Adam is AdamW without decay.
pub(super) struct Optimizer<B: Backend> {
    rule: AdamW,
    moments: BTreeMap<String, AdaptiveMomentumState<B, 1>>,
}

impl<B: Backend> Optimizer<B> {
    pub(super) fn new(config: OptimizerConfig) -> Self {
        let weight_decay = match config {
            OptimizerConfig::Adam => 0.0,
            OptimizerConfig::Adamw { weight_decay } => weight_decay,
        };
        let rule = AdamWConfig::new().with_epsilon(1e-8).with_weight_decay(weight_decay as f32).build();
        Self { rule, moments: BTreeMap::new() }
    }

    /// One step; the gradients are multiplied by `scale` first.
    pub(super) fn step<A, M>(&mut self, model: M, grads: GradientsParams, rate: f64, scale: f64) -> M
    where
        A: AutodiffBackend<InnerBackend = B>,
        M: AutodiffModule<A>,
    {
        model.map(&mut Step { path: TensorPath::default(), optimizer: self, grads, rate, scale })
    }

    /// Steps each tensor has made, and both moments under `moment1.` and `moment2.`.
    pub(super) fn state(&self, tensors: &mut NamedTensors) -> BTreeMap<String, usize> {
        let mut times = BTreeMap::new();
        for (name, state) in &self.moments {
            times.insert(name.clone(), state.time);
            for (prefix, moment) in [("moment1", &state.moment_1), ("moment2", &state.moment_2)] {
                let values = host_values(moment.clone());
                tensors.insert(format!("{prefix}.{name}"), NamedTensor { shape: vec![values.len()], values });
            }
        }
        times
    }

    /// Undoes [`Self::state`]; the name of a missing moment is the error.
    pub(super) fn restore(
        &mut self,
        tensors: &mut NamedTensors,
        times: BTreeMap<String, usize>,
        device: &B::Device,
    ) -> Result<(), String> {
        for (name, time) in times {
            let mut moment = |prefix: &str| {
                let key = format!("{prefix}.{name}");
                let values = tensors.remove(&key).ok_or(key)?.values;
                let n = values.len();
                Ok::<_, String>(Tensor::from_data(TensorData::new(values, [n]), device))
            };
            let (moment_1, moment_2) = (moment("moment1")?, moment("moment2")?);
            self.moments.insert(name, AdaptiveMomentumState { time, moment_1, moment_2, max_moment_2: None });
        }
        Ok(())
    }
}

/// Euclidean norm of all gradients together.
pub(super) fn gradient_norm<A: AutodiffBackend, M: AutodiffModule<A>>(model: &M, grads: &GradientsParams) -> f64 {
    let mut squares = Squares::<A::InnerBackend> { grads, sum: None };
    model.visit(&mut squares);
    squares.sum.map_or(0.0, |sum| f64::from(host_values(sum)[0]).sqrt())
}

struct Squares<'a, B: Backend> {
    grads: &'a GradientsParams,
    sum: Option<Tensor<B, 1>>,
}

impl<A: AutodiffBackend> ModuleVisitor<A> for Squares<'_, A::InnerBackend> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<A, D>>) {
        if let Some(grad) = self.grads.get::<A::InnerBackend, D>(param.id) {
            let n = grad.shape().num_elements();
            let square = grad.reshape([n]).square().sum();
            self.sum = Some(match self.sum.take() {
                Some(sum) => sum.add(square),
                None => square,
            });
        }
    }
}

struct Step<'a, B: Backend> {
    path: TensorPath,
    optimizer: &'a mut Optimizer<B>,
    grads: GradientsParams,
    rate: f64,
    scale: f64,
}

impl<A: AutodiffBackend> ModuleMapper<A> for Step<'_, A::InnerBackend> {
    follow_path!();
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<A, D>>) -> Param<Tensor<A, D>> {
        let (id, tensor, mapper) = param.consume();
        // Running statistics have no gradient.
        let Some(grad) = self.grads.remove::<A::InnerBackend, D>(id) else {
            return Param::from_mapped_value(id, tensor, mapper);
        };
        let (name, required, shape) = (self.path.name(), tensor.is_require_grad(), tensor.shape());
        let n = shape.num_elements();
        let grad = grad.reshape([n]);
        let grad = if self.scale < 1.0 { grad.mul_scalar(self.scale) } else { grad };
        // The update is element by element, so one rank serves all tensors.
        let state = self.optimizer.moments.remove(&name).map(AdamWState::new);
        let (new, state) = self.optimizer.rule.step(self.rate, tensor.inner().reshape([n]), grad, state);
        if let Some(state) = state {
            self.optimizer.moments.insert(name, state.momentum);
        }
        let new = Tensor::from_inner(new.reshape(shape)).set_require_grad(required);
        Param::from_mapped_value(id, new, mapper)
    }
}
