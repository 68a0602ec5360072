//! Time and memory of the FCRN, with random weights: inference of one image, or training steps.
//!
//! ```sh
//! RAYON_NUM_THREADS=1 cargo run --release -p palpate_nn --example fcrn_time -- forward 64 240 320
//! RAYON_NUM_THREADS=1 cargo run --release -p palpate_nn --example fcrn_time -- step 4 64 96 8
//! ```
//!
//! Arguments: `forward WIDTH ROWS COLS` or `step WIDTH ROWS COLS BATCH`. Times are means, by the clock and (on Linux) of all cores together,
//! which counts on a busy machine.

use burn::module::AutodiffModule as _;
use burn::optim::{AdamWConfig, GradientsParams, Optimizer as _};
use burn::tensor::backend::Backend;
use burn::tensor::{Distribution, Tensor};
use palpate_nn::fcrn::{Fcrn, FcrnConfig, Head};
use palpate_nn::loss::Loss;
use palpate_nn::weights::trainable_count;
use palpate_nn::{Cpu, CpuAutodiff, CpuDevice};
use std::time::Instant;

const USAGE: &str = "arguments: forward WIDTH ROWS COLS | step WIDTH ROWS COLS BATCH";

fn main() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let numbers: Vec<usize> = arguments.iter().skip(1).map_while(|a| a.parse().ok()).collect();
    match (arguments.first().map(String::as_str), numbers.as_slice()) {
        (Some("forward"), &[width, rows, cols]) => forward(width, rows, cols),
        (Some("step"), &[width, rows, cols, batch]) => step(width, [batch, 3, rows, cols]),
        _ => Err(USAGE.to_owned()),
    }
}

fn network<B: Backend<Device = CpuDevice>>(width: usize) -> Result<Fcrn<B>, String> {
    let config = FcrnConfig { width, head: Head::SignedHeightMap, dropout: 0.0 };
    Fcrn::new(config, 0, &CpuDevice).map_err(|e| e.to_string())
}

fn forward(width: usize, rows: usize, cols: usize) -> Result<(), String> {
    let model = network::<Cpu>(width)?;
    let image = Tensor::<Cpu, 4>::random([1, 3, rows, cols], Distribution::Normal(0.0, 1.0), &CpuDevice);
    let each = mean_time(5, || {
        let _ = model.forward(image.clone()).into_data();
    });
    println!("width {width}, {} parameters, one image of {cols} x {rows}: {each}", trainable_count(&model));
    report_memory();
    Ok(())
}

fn step(width: usize, shape: [usize; 4]) -> Result<(), String> {
    let mut model = network::<CpuAutodiff>(width)?;
    let mut optimizer = AdamWConfig::new().init();
    let normal = Distribution::Normal(0.0, 1.0);
    let images = Tensor::<CpuAutodiff, 4>::random(shape, normal, &CpuDevice);
    let truth = Tensor::random([shape[0], 1, shape[2], shape[3]], normal, &CpuDevice);
    let each = mean_time(10, || {
        let loss = Loss::RootMeanSquare.of(model.forward(images.clone()), truth.clone());
        let grads = GradientsParams::from_grads(loss.backward(), &model);
        model = optimizer.step(1e-4, model.clone(), grads);
    });
    println!("width {width}, {} parameters, training step of {shape:?}: {each}", trainable_count(&model.valid()));
    report_memory();
    Ok(())
}

/// What `times` calls take on average, after one that is not counted.
fn mean_time(times: u32, mut call: impl FnMut()) -> String {
    call();
    let (start, cpu) = (Instant::now(), cpu_seconds());
    (0..times).for_each(|_| call());
    let clock = start.elapsed().as_secs_f64() / f64::from(times);
    let cpu = cpu_seconds().zip(cpu).map(|(after, before)| (after - before) / f64::from(times));
    cpu.map_or(format!("{clock:.3} s"), |cpu| format!("{clock:.3} s, {cpu:.3} CPU-s"))
}

/// Seconds that this process has computed, on all cores together: fields 14 and 15 of its line in hundredths of a second.
fn cpu_seconds() -> Option<f64> {
    let line = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = line.rsplit(')').next()?.split_whitespace().collect();
    let ticks = |field: usize| fields.get(field - 3)?.parse::<f64>().ok();
    Some((ticks(14)? + ticks(15)?) / 100.0)
}

/// The largest resident memory of this process so far, where the system tells it.
fn report_memory() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(peak) = status.lines().find_map(|line| line.strip_prefix("VmHWM:")) {
        println!("peak memory: {}", peak.trim());
    }
}
