//! Small presses of a ball, made up: brightness follows the slope.

use palpate::geometry::Raster;
use palpate::io::{ObjectSplit, parse_object_split};
use palpate::tactile::TactileSensor;
use palpate_nn::config::TrainConfig;
use palpate_nn::data::{Augment, MemorySamples, Parts, PressSample};
use palpate_nn::tactile::FcrnTask;
use std::path::Path;

pub(crate) fn presses(count: usize, rows: usize, cols: usize) -> MemorySamples {
    let sensor = TactileSensor::preset("ycb-sight").expect("a preset");
    let relaxed = sensor.relaxed(rows, cols);
    let background = Raster::filled(rows, cols, [120, 130, 140]);
    let press = |i: usize| {
        let (row0, col0) = (rows as f32 * (0.3 + 0.1 * (i % 5) as f32), cols as f32 * (0.3 + 0.07 * (i % 6) as f32));
        let radius = rows as f32 * 0.25;
        let depth = |r: usize, c: usize| {
            let (y, x) = ((r as f32 - row0) / radius, (c as f32 - col0) / radius);
            ((1.0 - x * x - y * y).max(0.0), y, x)
        };
        PressSample {
            image: Raster::from_fn(rows, cols, |r, c| {
                let (d, y, x) = depth(r, c);
                let grey = |base: f32, slope: f32| (base + if d > 0.0 { 60.0 * slope } else { 0.0 }) as u8;
                [grey(120.0, x), grey(130.0, y), grey(140.0, -x - y)]
            }),
            height_map: Raster::from_fn(rows, cols, |r, c| relaxed[(r, c)] - 1e-3 * depth(r, c).0),
            mask: Raster::from_fn(rows, cols, |r, c| depth(r, c).0 > 0.0),
        }
    };
    let objects = ["004_sugar_box", "primitive:sphere", "002_master_chef_can"];
    let presses = (0..count).map(|i| (objects[i % 3].to_owned(), press(i))).collect();
    MemorySamples { sensor, background, presses }
}

/// `reduced-*` shrunk to what a test can afford: width 2, 64 × 64. With dropout, so that its random numbers are tested.
pub(crate) fn tiny(preset: &str) -> TrainConfig {
    let mut config = TrainConfig::preset(preset).expect("a preset");
    (config.network.width, config.network.dropout, config.data.rows, config.data.cols) = (2, 0.1, 64, 64);
    (config.run.validate_every, config.run.patience, config.run.clip_norm) = (0, 0, 1.0);
    config.augment = Augment { gain: 0.05, offset: 1.0, noise: 0.5 };
    config.run.batch_size = 4;
    config
}

pub(crate) fn split() -> ObjectSplit {
    let text = "name = 'tiny'\ntrain = ['*']\nvalidation = ['002']\n";
    parse_object_split(Path::new("tiny.toml"), text).expect("valid")
}

pub(crate) fn task(samples: &MemorySamples, config: TrainConfig) -> FcrnTask<'_> {
    let parts: Parts = Parts::of(samples, &split()).expect("both parts");
    FcrnTask::new(samples, parts, config, "tiny", "test")
}
