use super::*;
use crate::geometry::{Isometry, Point, Topology};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const RADIUS: f64 = 0.05;

/// Fibonacci points on a sphere about the origin.
fn sphere(count: usize) -> PointCloud {
    let turn = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let normals: Vec<Vector> = (0..count)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / count as f64;
            let (sin, cos) = (turn * i as f64).sin_cos();
            Vector::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + Vector::z() * z
        })
        .collect();
    let points = normals.iter().map(|n| Point::from(n * RADIUS)).collect();
    PointCloud { points, normals: Some(normals), colors: None }
}

fn at_depth(depth: u32) -> PoissonParams {
    PoissonParams { depth: Some(depth), ..PoissonParams::default() }
}

fn reconstruct(cloud: &PointCloud, params: &PoissonParams) -> PoissonSurface {
    let surface = screened_poisson(cloud, None, params).expect("a surface");
    let topology = Topology::of(&surface.mesh);
    assert!(topology.is_watertight() && topology.is_vertex_manifold(), "{topology:?}");
    assert_eq!((topology.degenerate_faces, topology.unused_vertices), (0, 0));
    assert_eq!(surface.density.len(), surface.mesh.vertices.len());
    surface
}

fn radial_errors(surface: &PoissonSurface) -> Vec<f64> {
    surface.mesh.vertices.iter().map(|v| (v.coords.norm() - RADIUS).abs() / surface.cell).collect()
}

#[test]
fn a_sphere_is_met_to_a_fraction_of_a_cell_at_every_depth() {
    let cloud = sphere(6000);
    for (depth, bound) in [(4, 0.15), (5, 0.06), (6, 0.06), (7, 0.12)] {
        let surface = reconstruct(&cloud, &at_depth(depth));
        assert_eq!(Topology::of(&surface.mesh).euler_characteristic, 2);
        let errors = radial_errors(&surface);
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(mean < bound, "depth {depth}: mean radial error {mean} cells");
        assert!(surface.mesh.volume() > 0.0);
    }
}

#[test]
fn the_automatic_cell_follows_the_spacing_and_density_is_samples_per_area() {
    let surface = reconstruct(&sphere(4000), &PoissonParams::default());
    let area = 4.0 * std::f64::consts::PI * RADIUS * RADIUS;
    let expected = 0.85 * (area / 4000.0).sqrt();
    assert!((surface.cell / expected - 1.0).abs() < 0.15, "{} against {expected}", surface.cell);
    let mean = surface.density.iter().sum::<f64>() / surface.density.len() as f64;
    assert!((mean * area / 4000.0 - 1.0).abs() < 0.15, "{mean} samples per m²");
    // Saying everything twice changes neither.
    let mut twice = sphere(4000);
    twice.append(&sphere(4000));
    let again = reconstruct(&twice, &PoissonParams::default());
    assert!((again.cell / surface.cell - 1.0).abs() < 0.05, "{} against {}", again.cell, surface.cell);
    assert!(radial_errors(&again).iter().all(|&e| e < 0.3));
}

#[test]
fn noise_is_averaged() {
    let mut cloud = sphere(8000);
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    for p in &mut cloud.points {
        *p += Vector::from_fn(|_, _| rng.random_range(-1e-3..1e-3));
    }
    let surface = reconstruct(&cloud, &PoissonParams::default());
    let errors = radial_errors(&surface);
    let mean = errors.iter().sum::<f64>() / errors.len() as f64 * surface.cell;
    // The radial noise is uniform with mean magnitude 0.5 mm.
    assert!(mean < 2.5e-4, "mean error {mean}");
    assert_eq!(Topology::of(&surface.mesh).components, 1);
}

#[test]
fn an_open_cloud_is_closed_and_its_guessed_part_has_low_density() {
    let full = sphere(6000);
    let half = full.filtered(|i| full.points[i].z > 0.0);
    for depth in [None, Some(6)] {
        let surface = reconstruct(&half, &PoissonParams { depth, ..PoissonParams::default() });
        let (mut seen, mut guessed) = (0.0_f64, 0.0_f64);
        for (v, d) in surface.mesh.vertices.iter().zip(&surface.density) {
            if v.z > 0.01 {
                seen = seen.max((v.coords.norm() - RADIUS).abs());
            } else if v.z < -0.02 {
                guessed = guessed.max(*d);
            }
        }
        assert!(seen < 0.3 * surface.cell, "the seen half is off by {seen}");
        let full_density = 6000.0 / (4.0 * std::f64::consts::PI * RADIUS * RADIUS);
        assert!(guessed < 0.3 * full_density, "{guessed} of {full_density}");
    }
}

#[test]
fn scale_does_not_matter_and_rigid_motion_hardly() {
    let cloud = sphere(3000);
    let reference = reconstruct(&cloud, &at_depth(5));
    for factor in [1e-6, 1e3] {
        let mut scaled = cloud.clone();
        for p in &mut scaled.points {
            *p = Point::from(p.coords * factor);
        }
        let surface = reconstruct(&scaled, &at_depth(5));
        assert_eq!(surface.mesh.faces.len(), reference.mesh.faces.len());
        assert!((surface.mesh.volume() / reference.mesh.volume() / factor.powi(3) - 1.0).abs() < 1e-6);
    }
    let moved_from_cloud = Isometry::new(Vector::new(3.0, -2.0, 1.0), Vector::new(0.4, 0.8, -0.3));
    let moved = reconstruct(&cloud.transformed(&moved_from_cloud), &at_depth(5));
    assert!((moved.mesh.volume() / reference.mesh.volume() - 1.0).abs() < 0.01);
    let back = moved.mesh.transformed(&moved_from_cloud.inverse());
    assert!(back.vertices.iter().all(|v| (v.coords.norm() - RADIUS).abs() < 0.2 * reference.cell));
}

#[test]
fn a_faint_outlier_sheet_loses_to_the_trusted_one() {
    let mut cloud = sphere(3000);
    let mut outer = sphere(3000);
    for p in &mut outer.points {
        *p = Point::from(p.coords * 1.04);
    }
    cloud.append(&outer);
    let weights: Vec<f64> = (0..6000).map(|i| if i < 3000 { 1.0 } else { 0.01 }).collect();
    let trusted = screened_poisson(&cloud, Some(&weights), &at_depth(5)).expect("a surface");
    let even = reconstruct(&cloud, &at_depth(5));
    let radius = |s: &PoissonSurface| (s.mesh.volume() * 0.75 / std::f64::consts::PI).cbrt();
    assert!((radius(&trusted) / RADIUS - 1.0).abs() < 0.005, "{}", radius(&trusted));
    assert!((radius(&even) / RADIUS - 1.02).abs() < 0.005, "{}", radius(&even));
    // Weight zero leaves a point out.
    let only: Vec<f64> = (0..6000).map(|i| if i < 3000 { 2.0 } else { 0.0 }).collect();
    assert_eq!(screened_poisson(&cloud, Some(&only), &at_depth(5)), Ok(reconstruct(&sphere(3000), &at_depth(5))));
}

#[test]
fn a_coplanar_cloud_gives_something_closed() {
    let points: Vec<Point> =
        (0..900).map(|i| Point::new((i % 30) as f64 * 1e-3, (i / 30) as f64 * 1e-3, 0.1)).collect();
    let cloud = PointCloud { normals: Some(vec![Vector::z(); 900]), points, colors: None };
    let surface = reconstruct(&cloud, &PoissonParams::default());
    assert!(surface.mesh.volume() > 0.0);
}

#[test]
fn the_same_bytes_for_any_number_of_threads() {
    let cloud = sphere(5000);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| screened_poisson(&cloud, None, &at_depth(6)))
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn bad_input_is_named() {
    let good = sphere(100);
    let fails = |cloud: &PointCloud, weights: Option<&[f64]>| {
        screened_poisson(cloud, weights, &at_depth(4)).expect_err("must fail")
    };
    assert_eq!(fails(&PointCloud { normals: None, ..good.clone() }, None), SurfaceError::NoNormals);
    assert_eq!(
        fails(&PointCloud::with_normals(vec![], vec![]).expect("equal"), None),
        SurfaceError::TooFewPoints { found: 0, needed: 4 }
    );
    assert_eq!(fails(&good.filtered(|i| i < 3), None), SurfaceError::TooFewPoints { found: 3, needed: 4 });
    assert_eq!(fails(&good, Some(&[1.0])), SurfaceError::WeightCount { found: 1, needed: 100 });
    let mut weights = vec![1.0; 100];
    weights[7] = -1.0;
    assert_eq!(fails(&good, Some(&weights)), SurfaceError::InvalidWeight { index: 7, weight: -1.0 });
    assert_eq!(fails(&good, Some(&[0.0; 100])), SurfaceError::TooFewPoints { found: 0, needed: 4 });
    let mut same = good.clone();
    same.points.fill(Point::new(1.0, 2.0, 3.0));
    assert_eq!(fails(&same, None), SurfaceError::TooFewPoints { found: 1, needed: 4 });
    let mut holed = good.clone();
    holed.points[5].y = f64::NAN;
    assert_eq!(fails(&holed, None), SurfaceError::NotFinite { index: 5 });
    let mut flat = good.clone();
    flat.normals = Some(vec![Vector::zeros(); 100]);
    assert_eq!(fails(&flat, None), SurfaceError::ZeroNormal { index: 0, length: 0.0 });
}
/// The upper half of a sphere.
fn dome(count: usize) -> PointCloud {
    let full = sphere(count);
    full.filtered(|i| full.points[i].z > 0.0)
}

#[test]
fn the_noise_sets_cell_and_screening() {
    let clean = reconstruct(&sphere(4000), &PoissonParams::default());
    assert!(clean.noise < 0.01 * clean.cell && clean.screening == 32.0, "{} {}", clean.noise, clean.screening);
    let params = PoissonParams { noise: Some(3e-3), ..PoissonParams::default() };
    let told = reconstruct(&sphere(4000), &params);
    assert_eq!(told.noise, 3e-3);
    assert!(told.cell > clean.cell && told.screening < clean.screening, "{} {}", told.cell, told.screening);
}

#[test]
fn a_depth_that_the_samples_do_not_fill_is_left_out() {
    let surface = reconstruct(&sphere(500), &at_depth(10));
    assert!(surface.depth <= 6, "depth {}", surface.depth);
    let edge = 1.1 * 2.0 * RADIUS;
    assert!((surface.cell * f64::from(1_u32 << surface.depth) / edge - 1.0).abs() < 0.01);
}

#[test]
fn an_open_sheet_runs_to_a_neumann_border_and_is_capped_there() {
    let points: Vec<Point> =
        (0..2500).map(|i| Point::new((i % 50) as f64 * 1e-3, (i / 50) as f64 * 1e-3, 0.1)).collect();
    let cloud = PointCloud { normals: Some(vec![Vector::z(); 2500]), points, colors: None };
    let run = |boundary| reconstruct(&cloud, &PoissonParams { boundary, depth: Some(6), ..PoissonParams::default() });
    let (open, closed) = (run(Boundary::Neumann), run(Boundary::Dirichlet));
    // Half of the domain is inside, less two thirds of a cell at five borders: the sheet goes straight to them.
    let domain = (1.1 * 0.049_f64).powi(3);
    assert!((open.mesh.volume() / domain - 0.47).abs() < 0.02, "{}", open.mesh.volume() / domain);
    assert!(closed.mesh.volume() < 0.8 * open.mesh.volume());
    let flat = open.mesh.vertices.iter().filter(|v| (v.z - 0.1).abs() < 0.3 * open.cell).count();
    assert!(flat > 55 * 55, "{flat} vertices on the sheet");
}

#[test]
fn trimming_opens_the_mesh_where_it_was_guessed_and_says_so() {
    let cloud = dome(6000);
    let whole = reconstruct(&cloud, &at_depth(6));
    assert_eq!(whole.trimmed_faces, 0);
    for largest_component in [false, true] {
        let params = PoissonParams { trim: 0.4, largest_component, ..at_depth(6) };
        let trimmed = screened_poisson(&cloud, None, &params).expect("a surface");
        let topology = Topology::of(&trimmed.mesh);
        assert_eq!(trimmed.trimmed_faces, whole.mesh.faces.len() - trimmed.mesh.faces.len());
        assert!(trimmed.trimmed_faces > 100 && topology.boundary_edges > 0 && topology.unused_vertices == 0);
        assert_eq!(trimmed.density.len(), trimmed.mesh.vertices.len());
        let area = trimmed.mesh.area() / (2.0 * std::f64::consts::PI * RADIUS * RADIUS);
        assert!((0.95..1.3).contains(&area), "{area} of the dome");
        assert!(area < 0.85 * whole.mesh.area() / (2.0 * std::f64::consts::PI * RADIUS * RADIUS));
    }
}

#[test]
fn the_largest_component_is_kept_alone_when_asked() {
    let mut cloud = sphere(3000);
    let mut small = sphere(500);
    small.points.iter_mut().for_each(|p| *p = Point::from(p.coords * 0.3 + Vector::x() * 0.12));
    cloud.append(&small);
    let count = |largest_component| {
        let params = PoissonParams { largest_component, ..at_depth(6) };
        Topology::of(&reconstruct(&cloud, &params).mesh).components
    };
    assert_eq!((count(false), count(true)), (2, 1));
}

#[test]
fn colours_are_carried_to_the_vertices() {
    let mut cloud = sphere(4000);
    cloud.colors = Some(cloud.points.iter().map(|p| if p.z > 0.0 { [200, 10, 0] } else { [0, 10, 100] }).collect());
    let surface = reconstruct(&cloud, &at_depth(5));
    let colors = surface.mesh.colors.as_ref().expect("the cloud has colours");
    for (v, c) in surface.mesh.vertices.iter().zip(colors).filter(|(v, _)| v.z.abs() > 0.1 * RADIUS) {
        assert_eq!(*c, if v.z > 0.0 { [200, 10, 0] } else { [0, 10, 100] });
    }
    assert_eq!(reconstruct(&sphere(4000), &at_depth(5)).mesh.colors, None);
}

/// Minimises ∫|∇χ − V|² + α 2^d Σ a (χ − ½)² over the hats of depth 3 by quadrature and a dense factorisation.
fn dense(input: &Weighted, alpha: f64, low: i16, high: i16) -> Vec<f64> {
    let n = 8.0;
    let side = (high - low + 1) as usize;
    let unknown = |node: [i16; 3]| -> Option<usize> {
        node.iter()
            .all(|c| (low..=high).contains(c))
            .then(|| node.iter().rev().fold(0, |index, c| index * side + (c - low) as usize))
    };
    let corner = |cell: [i16; 3], c: usize| [0, 1, 2].map(|k| cell[k] + ((c >> k) & 1) as i16);
    // Normals per node of the whole lattice, in units of 1/length.
    let mut field = std::collections::BTreeMap::new();
    let mut matrix = nalgebra::DMatrix::<f64>::zeros(side.pow(3), side.pow(3));
    let mut right = nalgebra::DVector::<f64>::zeros(side.pow(3));
    let mut cells = std::collections::BTreeMap::<[i16; 3], (f64, [f64; 3])>::new();
    for i in 0..input.samples.len() {
        let (cell, place) = octree::locate(input.samples.position[i], 3);
        let b = basis::hats(place);
        for c in 0..8 {
            let v = field.entry(corner(cell, c)).or_insert([0.0; 3]);
            let normal = input.samples.normal(i).map(f64::from);
            *v = [0, 1, 2].map(|k| v[k] - b[c] * normal[k] * input.area[i] * n * n * n);
        }
        let (area, sum) = cells.entry(cell).or_insert((0.0, [0.0; 3]));
        *area += input.area[i];
        *sum = [0, 1, 2].map(|k| sum[k] + input.area[i] * place[k]);
    }
    let mut add = |cell: [i16; 3], weight: f64, row: [f64; 8], target: f64| {
        for i in 0..8 {
            let Some(at) = unknown(corner(cell, i)) else { continue };
            right[at] += weight * row[i] * target;
            for j in 0..8 {
                if let Some(other) = unknown(corner(cell, j)) {
                    matrix[(at, other)] += weight * row[i] * row[j];
                }
            }
        }
    };
    let gauss = [0.5 - 0.15_f64.sqrt(), 0.5, 0.5 + 0.15_f64.sqrt()];
    let weight = [5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0];
    for cell in (0..512_i16).map(|k| [k % 8, k / 8 % 8, k / 64]) {
        for q in 0..27 {
            let at = [q % 3, q / 3 % 3, q / 9];
            let (place, w) = (at.map(|a| gauss[a]), at.map(|a| weight[a]).iter().product::<f64>() / (n * n * n));
            let b = basis::hats(place);
            for axis in 0..3 {
                let step = 1e-3;
                let moved = |by: f64| basis::hats([0, 1, 2].map(|k| place[k] + if k == axis { by } else { 0.0 }));
                let (up, down) = (moved(step), moved(-step));
                let slope: [f64; 8] = std::array::from_fn(|c| (up[c] - down[c]) / (2.0 * step) * n);
                let v: f64 = (0..8).map(|c| b[c] * field.get(&corner(cell, c)).map_or(0.0, |v| v[axis])).sum();
                add(cell, w, slope, v);
            }
        }
    }
    for (cell, (area, sum)) in cells {
        add(cell, alpha * n * area, basis::hats(sum.map(|s| s / area)), 0.5);
    }
    matrix.cholesky().expect("positive definite").solve(&right).iter().copied().collect()
}

#[test]
fn the_solver_agrees_with_a_dense_one() {
    let mut cloud = sphere(300);
    cloud.points.iter_mut().enumerate().for_each(|(i, p)| p.z *= if i % 3 == 0 { 0.7 } else { 1.0 });
    let chosen: Vec<u32> = (0..300).collect();
    let corner = Point::new(-0.06, -0.055, -0.065);
    let samples = Samples::new(&cloud.points, cloud.normals.as_deref().expect("given"), None, &chosen, corner, 0.12);
    let input = Weighted {
        area: (0..300).map(|i| 1e-3 * (1.0 + (i % 7) as f64)).collect(),
        depth: vec![9.0; 300],
        samples: &samples,
    };
    for (boundary, low, high) in [(Boundary::Dirichlet, 1, 7), (Boundary::Neumann, 0, 8)] {
        for alpha in [0.5, 20.0] {
            let expected = dense(&input, alpha, low, high);
            let range = expected.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            let levels = solve::solve(&input, 3, |_| alpha, boundary, 1e-6);
            let mut k = 0;
            for (node, value) in levels[0].lattice.nodes.iter().zip(&levels[0].values) {
                if node.iter().all(|c| (low..=high).contains(c)) {
                    let off = (f64::from(*value) - expected[k]).abs();
                    assert!(off < 1e-3 * range, "{boundary:?} {alpha} {node:?}: {value} against {}", expected[k]);
                    k += 1;
                }
            }
            assert_eq!(k, expected.len());
        }
    }
}
