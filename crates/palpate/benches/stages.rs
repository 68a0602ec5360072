//! One bench per stage, on a rendered frame (a ball on a table at 640×480), and the main job end to end.

use criterion::{Criterion, criterion_group, criterion_main};
use palpate::camera::{
    Background, DepthNoise, Frame, PinholeCamera, SegmentParams, SmoothParams, segment_object, smooth_depth,
};
use palpate::geometry::{Isometry, PlaneRansac, Point, Raster, Vector};
use palpate::pipeline::{ReconstructParams, Stages, reconstruct};
use palpate::simulate::{Primitive, SimulateParams, Solid, simulate_scene};
use palpate::tactile::compact::CompactDecoder;
use palpate::tactile::optics::TactileOptics;
use palpate::tactile::{
    Integrator, NoContact, PressParams, TactileDecoder as _, TactileSensor, ThresholdDecoder, press_surface,
};
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use std::cell::RefCell;
use std::hint::black_box;
use std::time::Instant;

/// Height of the camera over the table, metres.
const HEIGHT: f64 = 0.475;

/// A camera that looks 45° down on a table, and a ball of about 24,000 pixels on it.
fn frame() -> Frame {
    let camera =
        PinholeCamera { width: 640, height: 480, fx: 554.26, fy: 554.26, cx: 319.5, cy: 239.5, distortion: [0.0; 5] };
    let up = Vector::new(0.0, -1.0, -1.0).normalize();
    let center = Vector::new(0.0, 0.0, 0.55);
    let radius = HEIGHT + up.dot(&center);
    let (mut rng, noise) = (Pcg64Mcg::seed_from_u64(1), Normal::new(0.0, 1e-3).expect("finite"));
    let depth = Raster::from_fn(480, 640, |row, col| {
        let ray = camera.ray(col as f64, row as f64);
        let (a, b) = (ray.norm_squared(), ray.dot(&center));
        let root = b * b - a * (center.norm_squared() - radius * radius);
        let z = if root > 0.0 { (b - root.sqrt()) / a } else { -HEIGHT / up.dot(&ray) };
        if z > 0.0 && z < 2.0 { (z + noise.sample(&mut rng)) as f32 } else { f32::NAN }
    });
    Frame {
        camera,
        world_from_camera: Isometry::identity(),
        depth,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 1e-3, sigma_quadratic: 0.0 },
        color: None,
        mask: None,
        support: None,
    }
}

fn see(criterion: &mut Criterion) {
    let frame = frame();
    let points: Vec<Point> = frame.unproject().as_slice().iter().filter(|p| p.z.is_finite()).copied().collect();
    criterion.bench_function("see/support plane, 640x480", |b| {
        b.iter(|| PlaneRansac { tolerance: 0.008, ..PlaneRansac::default() }.fit(black_box(&points), |_| true));
    });
    let visible = segment_object(&frame, &SegmentParams::default()).expect("a ball on a table");
    criterion.bench_function("see/denoise and normals", |b| {
        b.iter(|| {
            smooth_depth(black_box(&frame.depth), &visible.mask, &frame.camera, frame.noise, &SmoothParams::default())
        });
    });
    criterion.bench_function("see/segment_object, 640x480", |b| {
        b.iter(|| segment_object(black_box(&frame), &SegmentParams::default()));
    });
}

/// A ball of 8 mm pressed 1 mm deep: simulated, rendered and decoded, on one core as a robot's control computer would.
fn feel(criterion: &mut Criterion) {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one");
    let sensor = TactileSensor::preset("ycb-sight").expect("listed");
    let optics = TactileOptics::preset(&sensor).expect("has a table");
    let ball = Primitive::ball(8e-3, (1e-3, -5e-4)).surface(&sensor, sensor.height, sensor.width);
    let press = || press_surface(&ball, &Isometry::identity(), &sensor, &PressParams::default()).expect("contact");
    let contact = press().contact;
    let image = optics.render(&contact.height_map).expect("the sensor's size");
    // Every other pixel: what a pixel holds does not matter here.
    let half = |image: &Raster<[u8; 3]>| Raster::from_fn(240, 320, |r, c| image[(2 * r, 2 * c)]);
    let (small, rest) = (half(&image), half(&optics.no_contact()));
    let no_contact = NoContact::new(rest.clone(), &sensor).expect("sound");
    let decoder = CompactDecoder::shipped(no_contact.clone());
    let threshold = ThresholdDecoder::new(no_contact);
    let difference = Raster::from_fn(240, 320, |r, c| {
        let (a, b) = (small[(r, c)], rest[(r, c)]);
        [0, 1, 2].map(|k| f32::from(a[k]) - f32::from(b[k]))
    });
    let integrator = Integrator::new(240, 320);
    let mut group = criterion.benchmark_group("feel, one core");
    let mut bench = |name: &str, work: &(dyn Fn() + Sync)| {
        group.bench_function(name, |b| b.iter(|| one.install(work)));
    };
    bench("press a surface, 640x480", &|| drop(black_box(press())));
    bench("render, 640x480", &|| drop(black_box(optics.render(black_box(&contact.height_map)))));
    bench("render with shadows, 640x480", &|| drop(black_box(optics.render_with_shadows(black_box(&contact)))));
    bench("compact, 320x240", &|| drop(black_box(decoder.decode(black_box(&small), &sensor))));
    bench("gradient map and integration alone, 320x240", &|| {
        drop(black_box(integrator.integrate_steps(&decoder.model().gradient.run(black_box(&difference)))));
    });
    bench("threshold, 320x240", &|| drop(black_box(threshold.decode(black_box(&small), &sensor))));
    group.finish();
}

/// The whole of `fused` at the defaults with 20 touches at 640×480; the stage breakdown goes to standard error.
fn main_job(criterion: &mut Criterion) {
    let solid = Solid::named("tabbed-box").expect("a known solid").mesh(1e-4, 5e-3);
    let mut simulate = SimulateParams::default();
    simulate.touch.count = 20;
    let made = simulate_scene("tabbed-box", &solid, &simulate).expect("a valid scene");
    let params = ReconstructParams::default();
    let log = RefCell::new(Vec::new());
    let stages = Stages { on_stage: Some(&|name| log.borrow_mut().push((name, Instant::now()))), ..Stages::default() };
    reconstruct(&made.scene, &params, &stages).expect("a mesh");
    let log = log.into_inner();
    let ends = log.iter().skip(1).map(|l| l.1).chain([Instant::now()]);
    for ((name, start), end) in log.iter().zip(ends) {
        eprintln!("{name:>10} {:.3} s", (end - *start).as_secs_f64());
    }
    let mut group = criterion.benchmark_group("main job");
    group.sample_size(10);
    group.bench_function("fused, 20 touches, 640x480", |b| {
        b.iter(|| reconstruct(black_box(&made.scene), &params, &Stages::default()));
    });
    group.finish();
}

criterion_group!(stages, see, feel, main_job);
criterion_main!(stages);
