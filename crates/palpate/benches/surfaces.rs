//! Surface methods over the number of points: a dented sphere of 0.1 m with noise of a third of the spacing.
//!
//! `cargo bench --bench surfaces -- poisson/10` runs what the name matches; a million points take a few seconds an iteration.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use palpate::geometry::{Point, PointCloud, Vector, decimated, taubin_smoothed};
use palpate::surface::{BallPivotingParams, PoissonParams, ball_pivoting, screened_poisson};
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use std::hint::black_box;

const COUNTS: [usize; 4] = [10_000, 50_000, 200_000, 1_000_000];

/// Fibonacci points on r(z) = 0.1 (1 + 0.1 sin 6z) m, with the sphere's normals tilted to match.
fn cloud(count: usize) -> PointCloud {
    let turn = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let spacing = 0.1 * (4.0 * std::f64::consts::PI / count as f64).sqrt();
    let (mut rng, noise) = (Pcg64Mcg::seed_from_u64(1), Normal::new(0.0, spacing / 3.0).expect("finite"));
    let mut at = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (turn * i as f64).sin_cos();
        let direction = Vector::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + Vector::z() * z;
        let radius = 1.0 + 0.1 * (6.0 * z).sin();
        // For r(z) on the unit sphere the normal is r·d − (∇r on the sphere).
        let slope = (Vector::z() - direction * z) * (0.6 * (6.0 * z).cos());
        let normal = (direction * radius - slope).normalize();
        (Point::from(direction * (0.1 * radius) + normal * noise.sample(&mut rng)), normal)
    };
    let (points, normals) = (0..count).map(&mut at).unzip();
    PointCloud { points, normals: Some(normals), colors: None }
}

fn methods(criterion: &mut Criterion) {
    for count in COUNTS {
        let cloud = cloud(count);
        let mut group = criterion.benchmark_group("surface");
        group.sample_size(10).throughput(Throughput::Elements(count as u64));
        group.bench_with_input(BenchmarkId::new("poisson", count), &cloud, |b, cloud| {
            b.iter(|| screened_poisson(black_box(cloud), None, &PoissonParams::default()));
        });
        group.bench_with_input(BenchmarkId::new("ball-pivoting", count), &cloud, |b, cloud| {
            b.iter(|| ball_pivoting(black_box(cloud), &BallPivotingParams::default()));
        });
        let as_they_are = BallPivotingParams { project: Some(0), ..BallPivotingParams::default() };
        group.bench_with_input(BenchmarkId::new("ball-pivoting, points as they are", count), &cloud, |b, cloud| {
            b.iter(|| ball_pivoting(black_box(cloud), &as_they_are));
        });
        group.finish();
    }
}

fn clean_up(criterion: &mut Criterion) {
    let mesh = screened_poisson(&cloud(50_000), None, &PoissonParams::default()).expect("a surface").mesh;
    let mut group = criterion.benchmark_group("clean-up of 50,000 points' surface");
    group.sample_size(10);
    group.bench_function("ten rounds of Taubin", |b| b.iter(|| taubin_smoothed(black_box(&mesh), 10)));
    let tenth = mesh.faces.len() / 10;
    group.bench_function("decimation to a tenth", |b| b.iter(|| decimated(black_box(&mesh), tenth)));
    group.finish();
}

criterion_group!(surfaces, methods, clean_up);
criterion_main!(surfaces);
