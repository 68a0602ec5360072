//! The FCRN against PyTorch: outputs, loss, gradients of all parameters and running statistics; see `oracle/fcrn_parity.py`.
//!
//! Both sides compute in f64: in f32, rounding decides the sign of a few rectified values, and gradients of the same formula
//! differ by a per cent. Tolerance, relative to the largest value of each tensor: 1e-5. To it comes 1e-6 of the network's
//! largest gradient: that of a bias before a norm is zero but for rounding.

use burn::module::{AutodiffModule as _, Module, ModuleMapper, ModuleVisitor, Param};
use burn::prelude::*;
use burn::tensor::DType;
use palpate_nn::fcrn::{Fcrn, FcrnConfig, Head};
use palpate_nn::loss::Loss;
use palpate_nn::weights::{NamedTensors, TensorFile, load_tensors, named_tensors};
use palpate_nn::{Cpu, CpuAutodiff};
use std::path::{Path, PathBuf};

struct Oracle(NamedTensors);

impl Oracle {
    fn open() -> Self {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/it/oracle/fcrn_parity.safetensors");
        Self(TensorFile::open(&path).expect("the fixture is there").tensors)
    }

    fn part(&self, prefix: &str) -> NamedTensors {
        let strip = |(k, v): (&String, &_)| Some((k.strip_prefix(prefix)?.to_owned(), Clone::clone(v)));
        self.0.iter().filter_map(strip).collect()
    }

    fn image<B: Backend>(&self, name: &str) -> Tensor<B, 4> {
        let tensor = &self.0[name];
        double(TensorData::new(tensor.values.clone(), tensor.shape.clone()))
    }

    fn network<B: Backend>(&self, head: Head) -> Fcrn<B> {
        let config = FcrnConfig { width: 2, head, dropout: 0.0 };
        let model = Fcrn::zeros(config, &Default::default()).expect("a valid config");
        load_tensors(model, self.part("weights."), Path::new("fixture"))
            .expect("names and shapes agree")
            .map(&mut Double)
    }
}

fn double<B: Backend, const D: usize>(data: TensorData) -> Tensor<B, D> {
    Tensor::from_data(data.convert::<f64>(), (&Default::default(), DType::F64))
}

/// Turns all parameters into f64.
struct Double;

impl<B: Backend> ModuleMapper<B> for Double {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<B, D>>) -> Param<Tensor<B, D>> {
        let (id, old, mapper) = param.consume();
        let new = double(old.to_data()).set_require_grad(old.is_require_grad());
        Param::from_mapped_value(id, new, mapper)
    }
}

fn values<B: Backend, const D: usize>(tensor: Tensor<B, D>) -> Vec<f32> {
    assert_eq!(tensor.dtype(), DType::F64);
    tensor.into_data().convert::<f32>().to_vec().expect("f32")
}

fn largest(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

fn assert_close(name: &str, found: &[f32], needed: &[f32], relative: f32, floor: f32) {
    assert_eq!(found.len(), needed.len(), "{name}");
    let tolerance = relative * largest(needed) + floor;
    let error = found.iter().zip(needed).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(error <= tolerance, "{name}: off by {error}, at most {tolerance} allowed");
}

struct Gradients<'a> {
    path: Vec<String>,
    grads: &'a <CpuAutodiff as burn::tensor::backend::AutodiffBackend>::Gradients,
    found: NamedTensors,
}

impl ModuleVisitor<CpuAutodiff> for Gradients<'_> {
    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.to_owned());
    }
    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<CpuAutodiff, D>>) {
        if let Some(grad) = param.val().grad(self.grads) {
            let shape = grad.dims().to_vec();
            let values = values(grad);
            self.found.insert(self.path.join("."), palpate_nn::weights::NamedTensor { shape, values });
        }
    }
}

fn check(head: Head, name: &str, truth: &str, gradients_needed: usize) {
    let oracle = Oracle::open();
    let needed = |key: &str| oracle.0[&format!("{name}.{key}")].values.clone();

    let inference: Fcrn<Cpu> = oracle.network(head);
    let output = inference.forward(oracle.image("image"));
    assert_close("eval", &values(output), &needed("eval"), 1e-5, 0.0);

    let model: Fcrn<CpuAutodiff> = oracle.network(head);
    let output = model.forward(oracle.image("image"));
    assert_close("train", &values(output.clone()), &needed("train"), 1e-5, 0.0);
    let loss = Loss::RootMeanSquare.of(output, oracle.image(truth));
    assert_close("loss", &values(loss.clone()), &needed("loss"), 1e-5, 0.0);

    let grads = loss.backward();
    let mut found = Gradients { path: vec![], grads: &grads, found: NamedTensors::new() };
    model.visit(&mut found);
    let needed = oracle.part(&format!("{name}.gradient."));
    assert_eq!(needed.len(), gradients_needed);
    let floor = 1e-6 * needed.values().fold(0.0f32, |m, t| m.max(largest(&t.values)));
    for (key, tensor) in &needed {
        assert_eq!(found.found[key].shape, tensor.shape, "{key}");
        assert_close(key, &found.found[key].values, &tensor.values, 1e-5, floor);
    }
    if head == Head::HeightMap {
        let after = named_tensors(&model.valid());
        for (key, tensor) in oracle.part("after.") {
            assert_close(&key, &after[&key].values, &tensor.values, 1e-5, 1e-6);
        }
    }
}

#[test]
fn the_height_network_agrees_with_pytorch_in_values_and_all_gradients() {
    check(Head::HeightMap, "height", "truth.height", 260);
}

#[test]
fn the_mask_network_agrees_with_pytorch() {
    check(Head::ContactMask, "mask", "truth.mask", 3);
}
