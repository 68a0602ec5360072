use super::WeightsError;
use burn::module::{ModuleMapper, ModuleVisitor, Param};
use burn::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// One tensor on the host.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedTensor {
    /// Sizes, outermost first.
    pub shape: Vec<usize>,
    /// Values in row-major order.
    pub values: Vec<f32>,
}

/// Tensors by their place in the network, parts separated by dots.
pub type NamedTensors = BTreeMap<String, NamedTensor>;

/// All parameters and running statistics of a network.
///
/// Of a network in training pass `model.valid()`, which settles the running statistics first.
pub fn named_tensors<B: Backend, M: Module<B>>(model: &M) -> NamedTensors {
    let mut collect = Collect { path: TensorPath::default(), tensors: NamedTensors::new() };
    model.visit(&mut collect);
    collect.tensors
}

/// Number of values that training changes: all but the running statistics of batch normalisation.
pub fn trainable_count<B: Backend, M: Module<B>>(model: &M) -> usize {
    let mut count = Count { path: TensorPath::default(), values: 0 };
    model.visit(&mut count);
    count.values
}

/// Puts `tensors` into a new network; names and shapes must agree exactly.
///
/// * `path` – names the source in messages
///
/// # Errors
/// [`WeightsError::Missing`], [`WeightsError::Unknown`], [`WeightsError::Shape`].
pub fn load_tensors<B: Backend, M: Module<B>>(model: M, tensors: NamedTensors, path: &Path) -> Result<M, WeightsError> {
    let mut put = Put { path: TensorPath::default(), tensors, file: path, error: None };
    let model = model.map(&mut put);
    match (put.error, put.tensors.pop_first()) {
        (Some(error), _) => Err(error),
        (None, Some((tensor, t))) => Err(WeightsError::Unknown { path: path.to_owned(), tensor, found: t.shape }),
        (None, None) => Ok(model),
    }
}

/// Where a visitor stands in the tree of modules.
#[derive(Default)]
pub(crate) struct TensorPath(Vec<String>);

impl TensorPath {
    pub(crate) fn enter(&mut self, name: &str) {
        self.0.push(name.to_owned());
    }

    pub(crate) fn leave(&mut self) {
        self.0.pop();
    }

    pub(crate) fn name(&self) -> String {
        self.0.join(".")
    }

    /// Running statistics are state, not parameters.
    fn is_statistic(&self) -> bool {
        self.0.last().is_some_and(|name| name == "running_mean" || name == "running_var")
    }
}

/// Follows the path in a `ModuleVisitor` or `ModuleMapper` whose field `path` is a [`TensorPath`].
macro_rules! follow_path {
    () => {
        fn enter_module(&mut self, name: &str, _container: &str) {
            self.path.enter(name);
        }
        fn exit_module(&mut self, _name: &str, _container: &str) {
            self.path.leave();
        }
    };
}
pub(crate) use follow_path;

struct Collect {
    path: TensorPath,
    tensors: NamedTensors,
}

impl<B: Backend> ModuleVisitor<B> for Collect {
    follow_path!();
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<B, D>>) {
        let tensor = param.val();
        let shape = tensor.dims().to_vec();
        self.tensors.insert(self.path.name(), NamedTensor { shape, values: host_values(tensor) });
    }
}

struct Count {
    path: TensorPath,
    values: usize,
}

impl<B: Backend> ModuleVisitor<B> for Count {
    follow_path!();
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<B, D>>) {
        if !self.path.is_statistic() {
            self.values += param.lazy_shape().num_elements();
        }
    }
}

struct Put<'a> {
    path: TensorPath,
    tensors: NamedTensors,
    file: &'a Path,
    error: Option<WeightsError>,
}

impl<B: Backend> ModuleMapper<B> for Put<'_> {
    follow_path!();
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<B, D>>) -> Param<Tensor<B, D>> {
        if self.error.is_some() {
            return param;
        }
        let (id, old, mapper) = param.consume();
        let (path, tensor, needed) = (self.file.to_owned(), self.path.name(), old.dims().to_vec());
        let new = match self.tensors.remove(&tensor) {
            Some(found) if found.shape == needed => {
                let data = TensorData::new(found.values, needed);
                Tensor::from_data(data, &old.device()).set_require_grad(old.is_require_grad())
            }
            Some(found) => {
                self.error = Some(WeightsError::Shape { path, tensor, found: found.shape, needed });
                old
            }
            None => {
                self.error = Some(WeightsError::Missing { path, tensor, needed });
                old
            }
        };
        Param::from_mapped_value(id, new, mapper)
    }
}

/// The values of a tensor in row-major order.
pub(crate) fn host_values<B: Backend, const D: usize>(tensor: Tensor<B, D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().into_vec().expect("converted to f32")
}
