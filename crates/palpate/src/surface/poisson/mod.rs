//! Screened Poisson surface reconstruction on an adaptive octree.
//!
//! The samples' normals, smoothed, are the gradient of a function that is 1 inside and 0 outside; the function is sought in the span of hat functions
//! at every depth of an octree refined near the samples, with a pull towards ½ at the samples. Its level set is extracted on the finest lattice, which
//! makes it closed and manifold without any care for cells of different size: the function is single-valued and continuous everywhere.

mod basis;
mod density;
mod extract;
mod octree;
mod params;
mod solve;
mod system;

pub use params::PoissonParams;

use crate::geometry::{Point, PointCloud, TriangleMesh, Vector};
use crate::surface::SurfaceError;
use density::Density;
use extract::Field;
use octree::Samples;
use system::Weighted;

/// Distinct samples below which no surface is attempted.
const FEWEST_SAMPLES: usize = 4;

/// Depths that an automatic choice stays within.
const AUTOMATIC_DEPTHS: (u32, u32) = (4, 10);

/// What screened Poisson made of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct PoissonSurface {
    /// The closed surface.
    pub mesh: TriangleMesh,
    /// Samples per m² near each vertex: small where the surface was guessed across a gap.
    pub density: Vec<f64>,
    /// Depth of the octree that was used.
    pub depth: u32,
    /// Edge of the finest cells, metres.
    pub cell: f64,
}

/// Fits a closed surface to points with outward normals by screened Poisson reconstruction.
///
/// * `cloud` – needs normals; only their direction counts
/// * `weights` – trust in each point (say 1/σ²), only ratios count; zero leaves the point out
///
/// The mesh is closed, manifold and outward-oriented by construction, whatever the cloud: gaps are bridged, and the surface ends inside the domain, a
/// cube [`PoissonParams::scale`] times the cloud's box (Dirichlet condition: outside at its border). It may have several components; those that
/// pass near no sample are left out.
///
/// # Errors
/// [`SurfaceError`] for a cloud without normals, with fewer than four distinct points, coordinates or normals that are not finite, zero normals, weights
/// that do not fit, or parameters out of range.
///
/// # References
/// Kazhdan, Bolitho & Hoppe, *Poisson surface reconstruction*, SGP 2006; Kazhdan & Hoppe, *Screened Poisson surface reconstruction*, ACM Trans. Graph.
/// 32(3), 2013. Departures: degree-1 functions, nodal storage per depth, extraction on the finest lattice instead of the octree's cells, and weights
/// also divide the density, so that a faint region keeps its surface.
pub fn screened_poisson(
    cloud: &PointCloud,
    weights: Option<&[f64]>,
    params: &PoissonParams,
) -> Result<PoissonSurface, SurfaceError> {
    params.validate()?;
    let (normals, chosen) = checked(cloud, weights)?;
    let domain = Domain::choose(cloud, normals, weights, &chosen, params)?;
    let samples = Samples::new(cloud, normals, weights, &chosen, domain.origin, domain.edge);
    let density = Density::new(&samples, domain.depth);
    let input = weighted(&samples, &density, domain.depth, params.samples_per_node);
    let field = Field::new(solve::solve(&input, domain.depth, params.screening));
    let isovalue = field.isovalue(&input);
    let mesh = field.extract(&samples, isovalue, domain.origin, domain.edge);
    if mesh.is_empty() {
        let reason = "the normals cancel: no side is inside".to_owned();
        return Err(SurfaceError::NoSurface { points: cloud.len(), reason });
    }
    let area = domain.edge * domain.edge;
    let density =
        mesh.vertices.iter().map(|v| density.at(((v - domain.origin) / domain.edge).into()).count / area).collect();
    Ok(PoissonSurface { mesh, density, depth: domain.depth, cell: domain.cell() })
}

/// The cube that the octree divides.
struct Domain {
    origin: Point,
    edge: f64,
    depth: u32,
}

impl Domain {
    fn cell(&self) -> f64 {
        self.edge / f64::from(1_u32 << self.depth)
    }

    /// With a stated depth, the cloud's box times the scale; otherwise the smallest such cube that is a power of two of the wanted cells.
    fn choose(
        cloud: &PointCloud,
        normals: &[Vector],
        weights: Option<&[f64]>,
        chosen: &[u32],
        params: &PoissonParams,
    ) -> Result<Self, SurfaceError> {
        let bounds = crate::geometry::Aabb::of(chosen.iter().map(|&i| &cloud.points[i as usize]));
        let few = |found| SurfaceError::TooFewPoints { found, needed: FEWEST_SAMPLES };
        let bounds = bounds.ok_or(few(0))?;
        let longest = bounds.size().max();
        if !(longest > 0.0 && longest.is_finite()) {
            return Err(few(1));
        }
        let cube = |edge: f64, depth: u32| Self { origin: bounds.center() - Vector::repeat(0.5 * edge), edge, depth };
        let smallest = params.scale * longest;
        let first = cube(smallest, 0);
        let samples = Samples::new(cloud, normals, weights, chosen, first.origin, first.edge);
        let distinct = samples.distinct();
        if distinct < FEWEST_SAMPLES {
            return Err(few(distinct));
        }
        if let Some(depth) = params.depth {
            return Ok(cube(smallest, depth));
        }
        let cell = params.cell_per_spacing * median_spacing(&samples) * smallest;
        let depth = (smallest / cell).log2().ceil() as u32;
        let (low, high) = AUTOMATIC_DEPTHS;
        if depth < low || depth > high {
            return Ok(cube(smallest, depth.clamp(low, high)));
        }
        Ok(cube(cell * f64::from(1_u32 << depth), depth))
    }
}

/// Median over the samples of 1/√density, repeated positions counted once on average.
fn median_spacing(samples: &Samples) -> f64 {
    let density = Density::new(samples, AUTOMATIC_DEPTHS.1);
    let mut counts: Vec<f64> = density.at_samples(samples).iter().map(|r| r.count).collect();
    let middle = counts.len() / 2;
    let (_, median, _) = counts.select_nth_unstable_by(middle, f64::total_cmp);
    let repeats = samples.len() as f64 / samples.distinct() as f64;
    (repeats / *median).sqrt()
}

/// Gives every sample its area and the depth that its density supports.
fn weighted<'a>(samples: &'a Samples, density: &Density, depth: u32, samples_per_node: f64) -> Weighted<'a> {
    let readings = density.at_samples(samples);
    let cell_area = 0.25_f64.powi(depth as i32);
    let supported = |count: f64| {
        let missing = (samples_per_node / (count * cell_area)).log2() / 2.0;
        f64::from(depth) - missing.max(0.0)
    };
    Weighted {
        samples,
        area: readings.iter().zip(&samples.weight).map(|(r, w)| w / r.weight).collect(),
        depth: readings.iter().map(|r| supported(r.count)).collect(),
    }
}

/// The normals, and the indices of the points that have weight.
fn checked<'a>(cloud: &'a PointCloud, weights: Option<&[f64]>) -> Result<(&'a [Vector], Vec<u32>), SurfaceError> {
    let normals = cloud.normals.as_deref().ok_or(SurfaceError::NoNormals)?;
    if let Some(w) = weights
        && w.len() != cloud.len()
    {
        return Err(SurfaceError::WeightCount { found: w.len(), needed: cloud.len() });
    }
    let mut chosen = Vec::with_capacity(cloud.len());
    for (index, (p, n)) in cloud.points.iter().zip(normals).enumerate() {
        if !p.iter().chain(n.iter()).all(|c| c.is_finite()) {
            return Err(SurfaceError::NotFinite { index });
        }
        if n.norm() < 1e-6 {
            return Err(SurfaceError::ZeroNormal { index, length: n.norm() });
        }
        let weight = weights.map_or(1.0, |w| w[index]);
        if !(weight >= 0.0 && weight.is_finite()) {
            return Err(SurfaceError::InvalidWeight { index, weight });
        }
        if weight > 0.0 {
            chosen.push(index as u32);
        }
    }
    Ok((normals, chosen))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Isometry, Topology};
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
        let expected = PoissonParams::default().cell_per_spacing * (area / 4000.0).sqrt();
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
}
