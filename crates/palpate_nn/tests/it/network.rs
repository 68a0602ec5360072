use burn::prelude::*;
use palpate_nn::fcrn::{Fcrn, FcrnConfig, Head};
use palpate_nn::weights::{named_tensors, trainable_count};
use palpate_nn::{Cpu, CpuDevice};

#[test]
fn the_network_of_the_thesis_has_its_number_of_parameters() {
    // Convolutions, biases, scales and shifts; not the running statistics. The same number as PyTorch counts.
    let model = Fcrn::<Cpu>::zeros(FcrnConfig::thesis(Head::HeightMap), &CpuDevice).expect("valid");
    assert_eq!(trainable_count(&model), 63_571_649);
}

#[test]
fn any_size_comes_out_as_it_went_in() {
    for head in [Head::HeightMap, Head::ContactMask] {
        let config = FcrnConfig { width: 1, head, dropout: 0.5 };
        let model = Fcrn::<Cpu>::new(config, 1, &CpuDevice).expect("valid");
        let output = model.forward(Tensor::ones([1, 3, 40, 70], &CpuDevice));
        assert_eq!(output.dims(), [1, 1, 40, 70]);
    }
}

#[test]
fn the_seed_decides_the_weights() {
    let config = FcrnConfig { width: 1, head: Head::HeightMap, dropout: 0.0 };
    let weights = |seed| named_tensors(&Fcrn::<Cpu>::new(config, seed, &CpuDevice).expect("valid"));
    assert_eq!(weights(1), weights(1));
    assert_ne!(weights(1), weights(2));
    let (a, kernel) = (weights(3), "encoder.layer4.2.middle.conv.weight");
    let values = &a[kernel].values;
    let deviation = (values.iter().map(|v| v * v).sum::<f32>() / values.len() as f32).sqrt();
    // N(0, √(2 / (3·3·8))).
    assert!((deviation - (2.0f32 / 72.0).sqrt()).abs() < 0.02, "{deviation}");
}

#[test]
fn impossible_shapes_of_the_network_are_refused() {
    let config = FcrnConfig { width: 0, head: Head::HeightMap, dropout: 0.0 };
    assert!(config.validate().expect_err("no channel").to_string().contains("width is 0"));
    assert!(FcrnConfig { width: 2, dropout: 1.0, ..config }.validate().is_err());
}
