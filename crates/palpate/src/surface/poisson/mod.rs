//! Screened Poisson surface reconstruction on an adaptive octree.
//!
//! The samples' normals, smoothed, are the gradient of a function that is 1 inside and 0 outside; the function is sought in the span of hat functions
//! at every depth of an octree refined near the samples, with a pull towards ½ at the samples. Its level set is extracted on the finest lattice, which
//! makes it closed and manifold without any care for cells of different size: the function is single-valued and continuous everywhere.

mod basis;
mod crossings;
mod density;
mod domain;
mod extract;
mod finish;
mod noise;
mod octree;
mod params;
mod runs;
mod screening;
mod solve;
mod spans;
mod system;

pub(super) use domain::{noise_and_spacing, wanted_cell};
pub(super) use octree::octree_order;
pub use params::{Boundary, PoissonParams};

use crate::geometry::{PointCloud, TriangleMesh, Vector};
use crate::surface::SurfaceError;
use density::Density;
use domain::Domain;
use extract::{Field, Isovalue};
use octree::Samples;
use system::Weighted;

/// Distinct samples below which no surface is attempted.
const FEWEST_SAMPLES: usize = 4;

/// Share of the samples that must be dense enough for a depth; deeper ones are left out.
const DEEP_SHARE: f64 = 0.01;

/// Screening weights that an automatic choice stays within.
const AUTOMATIC_SCREENING: (f64, f64) = (1.5, 32.0);

/// The least where coarse cells were chosen because of the noise.
const COARSE_SCREENING: f64 = 1.0;

/// Automatic screening times (noise / finest cell)²: noise weighs as the inverse variance. From the errors of three objects at 50,000 points with
/// noise of 0 to 1 mm at two depths.
const SCREENING_TIMES_VARIANCE: f64 = 0.04;

/// The samples' mean distance from the surface over that of their noise up to which coarse cells will do.
const EXPLAINED: f64 = 1.05;

/// What screened Poisson made of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct PoissonSurface {
    /// The surface: closed unless faces were trimmed. Coloured if the cloud is.
    pub mesh: TriangleMesh,
    /// Samples per m² near each vertex: small where the surface was guessed across a gap.
    pub density: Vec<f64>,
    /// Depth of the octree that was used: as asked for, or less where the samples are too sparse for that.
    pub depth: u32,
    /// Edge of the finest cells, metres.
    pub cell: f64,
    /// Standard deviation of the samples along their normals, as given or as read from them, metres.
    pub noise: f64,
    /// Screening weight that was used.
    pub screening: f64,
    /// Faces that [`PoissonParams::trim`] cut away; if any, the mesh is open.
    pub trimmed_faces: usize,
}

/// Fits a closed surface to points with outward normals by screened Poisson reconstruction.
///
/// * `cloud` – needs normals; only their direction counts
/// * `weights` – trust in each point (say 1/σ²), only ratios count; zero leaves the point out
///
/// The mesh is closed, manifold and outward-oriented by construction, whatever the cloud: gaps are bridged, and the surface ends inside the domain, a
/// cube [`PoissonParams::scale`] times the cloud's box ([`Boundary`] says how). It may have several components; those that pass near no sample are left
/// out. Only [`PoissonParams::trim`] opens it.
///
/// Time and memory are linear in the points: a cell is refined only where it holds samples, and the finest depth is one that they fill.
///
/// # Errors
/// [`SurfaceError`] for a cloud without normals, with fewer than four distinct points, coordinates or normals that are not finite, zero normals, weights
/// that do not fit, or parameters out of range.
///
/// # References
/// Kazhdan, Bolitho & Hoppe, *Poisson surface reconstruction*, SGP 2006; Kazhdan & Hoppe, *Screened Poisson surface reconstruction*, ACM Trans. Graph.
/// 32(3), 2013. Departures: degree-1 functions, nodal storage per depth, extraction on the finest lattice instead of the octree's cells, weights that
/// also divide the density, so that a faint region keeps its surface, and depth and screening chosen from the samples' noise.
pub fn screened_poisson(
    cloud: &PointCloud,
    weights: Option<&[f64]>,
    params: &PoissonParams,
) -> Result<PoissonSurface, SurfaceError> {
    params.validate()?;
    let (normals, chosen) = checked(cloud, weights)?;
    let (samples, domain) = Domain::choose(cloud, normals, weights, &chosen, params)?;
    let least = if domain.coarse { COARSE_SCREENING } else { AUTOMATIC_SCREENING.0 };
    let mut solved = solve_at(&samples, &domain, domain.depth, least, params);
    if let Some(finer) = domain.finer_depth
        && solved.misfit_per_noise(&domain) > EXPLAINED
    {
        solved = solve_at(&samples, &domain, finer, AUTOMATIC_SCREENING.0, params);
    }
    let Solved { mut density, field, isovalue, depth, screening, .. } = solved;
    let cell = domain.cell(depth);
    let usual_density = finish::median_density(&mut density, &samples);
    let mut mesh = field.extract(&samples, &isovalue, domain.origin, domain.edge);
    drop(field);
    if mesh.is_empty() {
        let reason = "the normals cancel: no side is inside".to_owned();
        return Err(SurfaceError::NoSurface { points: cloud.len(), reason });
    }
    if params.largest_component {
        mesh = crate::geometry::largest_piece(&mesh);
    }
    let area = domain.edge * domain.edge;
    let places: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| ((v - domain.origin) / domain.edge).into()).collect();
    let mut vertex_density: Vec<f64> = density.at(&places).iter().map(|r| r.count / area).collect();
    drop(places);
    let trimmed_faces =
        finish::trim(&mut mesh, &mut vertex_density, params.trim * usual_density / area, params.largest_component);
    if mesh.is_empty() {
        let reason = format!("trimming at {} of the usual density leaves nothing", params.trim);
        return Err(SurfaceError::NoSurface { points: cloud.len(), reason });
    }
    mesh.colors = finish::colors(cloud, &chosen, &mesh.vertices);
    Ok(PoissonSurface { mesh, density: vertex_density, depth, cell, noise: domain.noise, screening, trimmed_faces })
}

/// The function at one choice of depth.
struct Solved<'a> {
    input: Weighted<'a>,
    density: Density<'a>,
    field: Field,
    isovalue: Isovalue,
    depth: u32,
    screening: f64,
}

impl Solved<'_> {
    /// Mean distance of the samples from the surface over what their noise alone makes (σ√(2/π)).
    fn misfit_per_noise(&self, domain: &Domain) -> f64 {
        let expected = domain.noise * (2.0 / std::f64::consts::PI).sqrt();
        self.field.misfit(&self.input, self.isovalue.value) * domain.edge / expected
    }
}

fn solve_at<'a>(
    samples: &'a Samples,
    domain: &Domain,
    wanted: u32,
    least_screening: f64,
    params: &PoissonParams,
) -> Solved<'a> {
    let mut density = Density::new(samples, wanted);
    let input = weighted(samples, &mut density, wanted, params.samples_per_node);
    let depth = filled_depth(&input, wanted);
    let screening =
        params.screening.unwrap_or_else(|| automatic_screening(domain.noise / domain.cell(depth), least_screening));
    let field = Field::new(solve::solve(&input, depth, |_| screening, params.boundary, solve::TOLERANCE));
    let isovalue = field.isovalue(&input);

    Solved { input, density, field, isovalue, depth, screening }
}

fn automatic_screening(noise_per_cell: f64, least: f64) -> f64 {
    (SCREENING_TIMES_VARIANCE / noise_per_cell.powi(2)).clamp(least, AUTOMATIC_SCREENING.1)
}

/// The deepest depth, at most `depth`, that enough samples are dense enough for.
fn filled_depth(input: &Weighted, depth: u32) -> u32 {
    let needed = (DEEP_SHARE * input.samples.len() as f64).ceil() as usize;
    let filled = |d: &u32| input.depth.iter().filter(|&&s| s > f64::from(d - 1)).count() >= needed;
    (2..=depth).rev().find(filled).unwrap_or(2)
}

/// Gives every sample its area and the depth that its density supports.
fn weighted<'a>(samples: &'a Samples, density: &mut Density, depth: u32, samples_per_node: f64) -> Weighted<'a> {
    let readings = density.at_samples();
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
mod tests;
