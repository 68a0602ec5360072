//! CPU seconds of the stages before the mesh, one thread: `RAYON_NUM_THREADS=1 measure_stages DEPTH.png MESH.ply`.
//!
//! The picture: 640×480, 0.1 mm a unit, the camera of `6dofgraspnet_mustard`. Prints name, median CPU seconds of five runs, and what came out; the peers' side
//! is `benches/stages.py`.

#[path = "shared/cpu.rs"]
mod cpu;

use cpu::cpu_seconds;
use palpate::camera::{Background, DepthNoise, Frame, PinholeCamera, SmoothParams, raster_normals, smooth_depth};
use palpate::geometry::{
    Bvh, Isometry, KdTree, PlaneRansac, Point, Raster, Vector, cluster_sizes, estimate_normals, euclidean_clusters,
    statistical_outliers, voxel_average,
};
use palpate::geometry::{PointCloud, TriangleMesh};
use palpate::io::{read_depth_png, read_mesh};
use palpate::metrics::SurfaceSamples;
use palpate::tactile::Integrator;
use std::error::Error;
use std::hint::black_box;

/// Runs the work five times and prints the median CPU time.
fn measure<T>(name: &str, mut work: impl FnMut() -> T, result: impl Fn(&T) -> String) -> T {
    let mut made = None;
    let mut spent: Vec<f64> = (0..5)
        .map(|_| {
            let start = cpu_seconds();
            made = Some(black_box(work()));
            cpu_seconds() - start
        })
        .collect();
    spent.sort_by(f64::total_cmp);
    let made = made.expect("ran");
    println!("{name} | {:.4} | {}", spent[2], result(&made));
    made
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let (png, ply) = (words.next().ok_or("no DEPTH.png given")?, words.next().ok_or("no MESH.ply given")?);
    let camera = PinholeCamera {
        width: 640,
        height: 480,
        fx: 616.3653,
        fy: 616.2029,
        cx: 310.2588,
        cy: 236.5998,
        distortion: [0.0; 5],
    };
    let frame = Frame {
        camera,
        world_from_camera: Isometry::identity(),
        depth: read_depth_png(&png, 1e-4)?,
        background: Background::Unknown,
        noise: DepthNoise { sigma: 1e-3, sigma_quadratic: 0.0 },
        color: None,
        mask: None,
        support: None,
    };
    depth_stages(&frame);
    mesh_stages(&read_mesh(&ply)?);
    let steps = Raster::from_fn(480, 640, |r, c| [(r as f32 * 0.01).sin(), (c as f32 * 0.02).cos()]);
    let integrator = Integrator::new(480, 640);
    measure("fast Poisson 640x480, Dirichlet", || integrator.poisson_dirichlet(&steps), |_| String::new());
    Ok(())
}

fn depth_stages(frame: &Frame) {
    let lifted = measure("depth to cloud", || frame.unproject(), |_| String::new());
    let points: Vec<Point> = lifted.as_slice().iter().filter(|p| p.z.is_finite()).copied().collect();
    let count = |outlier: &Vec<bool>| format!("{} kept", outlier.iter().filter(|o| !**o).count());
    let plane = measure(
        "plane 5 mm",
        || PlaneRansac::default().fit(&points, |_| true),
        |fit| format!("{} inliers", fit.as_ref().map_or(0, |f| f.inliers)),
    );
    measure("statistical outliers k 20, 2 sigma, full frame", || statistical_outliers(&points, 20, 2.0), count);
    measure("normals kNN 30, full frame", || estimate_normals(&points, 30, &Point::origin()), |_| String::new());
    measure(
        "normals from the raster, full frame",
        || raster_normals(&frame.depth, &frame.camera, 4, 0.012),
        |_| String::new(),
    );
    let all = frame.depth.map(|z| z.is_finite());
    measure(
        "denoise and normals from the raster, full frame",
        || smooth_depth(&frame.depth, &all, &frame.camera, frame.noise, &SmoothParams::default()),
        |_| String::new(),
    );
    let cloud = PointCloud { points: points.clone(), ..PointCloud::default() };
    measure("voxel 3 mm", || voxel_average(&cloud, 3e-3), |c| format!("{} points", c.len()));
    let Some(fit) = plane else { return };
    let off: Vec<Point> = points.iter().filter(|p| fit.plane.signed_distance(p).abs() >= 5e-3).copied().collect();
    measure("statistical outliers k 20, 2 sigma, off the plane", || statistical_outliers(&off, 20, 2.0), count);
    let largest = |labels: &Vec<u32>| {
        let sizes = cluster_sizes(labels);
        format!("{} of {} points in the largest of {}", sizes.iter().max().unwrap_or(&0), labels.len(), sizes.len())
    };
    measure("clusters 10 mm, off the plane", || euclidean_clusters(&off, 0.01), largest);
}

fn mesh_stages(mesh: &TriangleMesh) {
    let tree = measure("BVH build", || Bvh::new(mesh), |_| format!("{} triangles", mesh.faces.len()));
    let (low, high) = mesh.bounds().map_or((Point::origin(), Point::origin()), |b| (b.min, b.max));
    let centre = middle(&low, &high);
    let eye = centre + Vector::new(0.0, 0.0, 0.4);
    let hits = || {
        let ray = |k: usize| Vector::new((k % 640) as f64 - 319.5, (k / 640) as f64 - 239.5, -600.0) / 600.0;
        (0..640 * 480).filter(|&k| tree.cast_ray(&eye, &ray(k), 10.0).is_some()).count()
    };
    measure("cast 640x480", hits, |n| format!("{n} hits"));
    let mut state = 1_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5
    };
    let queries: Vec<Point> =
        (0..100_000).map(|_| centre + Vector::new(uniform(), uniform(), uniform()) * 0.3).collect();
    let nearest = |q: &[Point]| q.iter().filter_map(|p| tree.closest_point(p)).map(|s| s.distance).sum::<f64>();
    measure("closest point, 100k in 300 mm", || nearest(&queries), |sum| format!("mean {:.3} mm", sum * 1e-2));
    let draw = |seed| SurfaceSamples::draw(mesh, 100_000, seed).points;
    let (a, b) = (draw(1), draw(2));
    let far: Vec<Point> = b.iter().map(|p| p + Vector::new(0.02, 0.0, 0.0)).collect();
    let chamfer = |p: &[Point], q: &[Point]| {
        let one = |from: &[Point], to: &[Point]| {
            let tree = KdTree::new(to);
            from.iter().filter_map(|x| tree.nearest(x)).map(|n| n.1).sum::<f64>() / from.len() as f64
        };
        1e3 * (one(p, q) + one(q, p)) / 2.0
    };
    measure("chamfer 100k, near", || chamfer(&a, &b), |c| format!("{c:.3} mm"));
    measure("chamfer 100k, 20 mm apart", || chamfer(&a, &far), |c| format!("{c:.3} mm"));
}

fn middle(a: &Point, b: &Point) -> Point {
    a + (b - a) * 0.5
}
