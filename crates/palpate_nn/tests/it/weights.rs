use palpate_nn::fcrn::{Fcrn, FcrnConfig, Head};
use palpate_nn::weights::{Architecture, Precision, Provenance, WeightFile, WeightsError, named_tensors};
use palpate_nn::{Cpu, CpuDevice};
use std::path::PathBuf;

const SHAPE: FcrnConfig = FcrnConfig { width: 1, head: Head::HeightMap, dropout: 0.0 };

fn saved(precision: Precision) -> (tempfile::TempDir, PathBuf, Fcrn<Cpu>) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("weights.safetensors");
    let model = Fcrn::<Cpu>::new(SHAPE, 5, &CpuDevice).expect("valid");
    let provenance = Provenance { sensor: "digit".into(), input: (32, 64), seed: 5, ..Provenance::default() };
    WeightFile::of(&model, SHAPE.architecture(), provenance).save(&path, precision).expect("written");
    (folder, path, model)
}

fn load(path: &std::path::Path, shape: FcrnConfig) -> Result<Fcrn<Cpu>, WeightsError> {
    let empty = Fcrn::zeros(shape, &CpuDevice).expect("valid");
    WeightFile::open(path)?.load_into(empty, &shape.architecture())
}

#[test]
fn weights_come_back_exactly_or_to_half_precision() {
    let (_guard, path, model) = saved(Precision::F32);
    let exact = named_tensors(&load(&path, SHAPE).expect("fits"));
    assert_eq!(exact, named_tensors(&model));
    assert_eq!(WeightFile::open(&path).expect("readable").provenance.sensor, "digit");
    let size = std::fs::metadata(&path).expect("there").len();

    let (_guard, path, _) = saved(Precision::F16);
    let half = named_tensors(&load(&path, SHAPE).expect("fits"));
    for (name, tensor) in &exact {
        let close = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-3 * a.abs() + 1e-6;
        assert!(tensor.values.iter().zip(&half[name].values).all(close), "{name}");
    }
    assert!(std::fs::metadata(&path).expect("there").len() < size * 7 / 10);
}

#[test]
fn the_same_weights_give_the_same_bytes() {
    let (_a, a, _) = saved(Precision::F32);
    let (_b, b, _) = saved(Precision::F32);
    assert!(std::fs::read(a).expect("there") == std::fs::read(b).expect("there"));
}

#[test]
fn a_cut_or_foreign_file_is_refused() {
    let (_guard, path, _) = saved(Precision::F32);
    let bytes = std::fs::read(&path).expect("there");
    for cut in [0, 4, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..cut]).expect("written");
        let error = load(&path, SHAPE).expect_err("cut");
        assert!(matches!(error, WeightsError::Malformed { .. }), "{cut}: {error}");
        assert!(error.to_string().contains("weights.safetensors"), "{error}");
    }
    std::fs::write(&path, b"PK\x03\x04 a zip file, as PyTorch writes them").expect("written");
    assert!(matches!(load(&path, SHAPE), Err(WeightsError::Malformed { .. })));
    let oracle = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/it/oracle/fcrn_parity.safetensors");
    assert!(matches!(load(&oracle, SHAPE), Err(WeightsError::Metadata { key: "architecture", .. })));
}

#[test]
fn another_network_is_named_with_the_one_needed() {
    let (_guard, path, _) = saved(Precision::F32);
    let error = load(&path, FcrnConfig { width: 2, ..SHAPE }).expect_err("another width").to_string();
    assert!(error.contains("\"width\":1") && error.contains("\"width\":2"), "{error}");
    let file = WeightFile::open(&path).expect("readable");
    let error = file.config::<FcrnConfig>("compact", 1).expect_err("another network").to_string();
    assert!(error.contains("fcrn v1") && error.contains("compact v1"), "{error}");
}

#[test]
fn a_missing_a_misshapen_and_an_unknown_tensor_are_named() {
    let (_guard, path, model) = saved(Precision::F32);
    let broken = |change: fn(&mut palpate_nn::weights::NamedTensors)| {
        let mut file = WeightFile::of(&model, SHAPE.architecture(), Provenance::default());
        change(&mut file.tensors);
        file.save(&path, Precision::F32).expect("written");
        load(&path, SHAPE).expect_err("broken").to_string()
    };
    let error = broken(|t| {
        t.remove("last.bias");
    });
    assert!(error.contains("'last.bias'") && error.contains("missing"), "{error}");
    let error = broken(|t| {
        let w = t.get_mut("last.weight").expect("there");
        w.shape = vec![9];
    });
    assert!(error.contains("[9]") && error.contains("[1, 1, 3, 3]"), "{error}");
    let error = broken(|t| {
        let w = t["last.bias"].clone();
        t.insert("extra".into(), w);
    });
    assert!(error.contains("'extra'"), "{error}");
}

#[test]
fn weights_that_are_not_finite_are_neither_written_nor_read() {
    let (_guard, path, model) = saved(Precision::F32);
    let mut file = WeightFile::of(&model, Architecture::new("fcrn", 1, &SHAPE), Provenance::default());
    file.tensors.get_mut("last.bias").expect("there").values[0] = 1e5;
    file.save(&path, Precision::F32).expect("finite");
    assert!(matches!(file.save(&path, Precision::F16), Err(WeightsError::NotFinite { .. })));
    file.tensors.get_mut("last.bias").expect("there").values[0] = f32::NAN;
    let error = file.save(&path, Precision::F32).expect_err("NaN").to_string();
    assert!(error.contains("'last.bias' holds NaN"), "{error}");
}
