use super::motion::Copying;
use crate::evidence::{Evidence, Provenance, Sample};
use crate::geometry::{Point, Vector};
use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A copy lands beside a measured surface, and not on another one, up to this offset, metres.
const BESIDE: f64 = 6e-3;
/// Farther along the surface than this a measured sample says nothing of a copy, metres.
const TANGENTIAL: f64 = 2.5e-3;
/// Least cosine between the normals of a copy and of what it lands beside.
const AGREEMENT: f64 = 0.85;
/// A sample that maps nearer to itself than this proves nothing, metres.
const ELSEWHERE: f64 = 6e-3;
/// Side of the cells whose misses are averaged, metres; it grows until no more than `MOST` cells are left.
const CELL: f64 = 6e-3;
const MOST: usize = 150;
/// Hyperparameters that are weighed against one another, metres: the misses' σ, how far they reach along the surface, and what is only
/// noise and detail.
const SIGMAS: [f64; 4] = [4e-4, 8e-4, 1.6e-3, 3.2e-3];
const LENGTHS: [f64; 4] = [15e-3, 30e-3, 60e-3, 120e-3];
const NOISES: [f64; 3] = [2.5e-4, 5e-4, 1e-3];
/// Mean of the exponential prior of σ, metres.
const USUAL: f64 = 1e-3;

/// By how much a family of copies misses what was measured, carried over to where nothing was: an object is seldom exactly symmetric, and
/// a touch on the guessed side says by how much it is not, around the touch too.
///
/// The misses along the normal are taken to be a Gaussian process over position and normal with mean 0, the simple kriging predictor,
/// k = σ² w(|Δp| / ℓ) ((1 + n·n') / 2)², w(d) = (1 − d)₊⁴ (4 d + 1). σ, ℓ and the noise are those of greatest posterior density.
///
/// # References
/// Rasmussen & Williams, *Gaussian Processes for Machine Learning*, 2006, eq. 2.23, 2.30, 5.8; Wendland, *Piecewise polynomial, positive
/// definite and compactly supported radial functions of minimal degree*, 1995.
pub(super) struct Correction {
    anchors: Vec<(Point, Vector)>,
    /// Times σ².
    weights: Vec<f64>,
    length: f64,
}

/// Misses summed over a cell.
#[derive(Default)]
struct Cell {
    position: Vector,
    normal: Vector,
    miss: f64,
    count: f64,
}

impl Correction {
    /// One for each of the families of `copyings`.
    ///
    /// O(samples · copyings + families · cells³), at most 150 cells.
    pub(super) fn of_families(
        evidence: &Evidence,
        copyings: &[Copying],
        families: usize,
    ) -> Vec<Option<Self>> {
        (0..families)
            .into_par_iter()
            .map(|family| {
                let members = copyings.iter().filter(|c| c.family as usize == family);
                let misses: Vec<_> = members.flat_map(|c| misses(evidence, c)).collect();
                Self::fit(&misses)
            })
            .collect()
    }

    fn fit(misses: &[(Sample, f64)]) -> Option<Self> {
        if misses.is_empty() {
            return None;
        }
        let mut size = CELL;
        let cells = loop {
            let cells = averaged(misses, size);
            if cells.len() <= MOST {
                break cells;
            }
            size *= 1.3;
        };
        let anchors: Vec<(Point, Vector)> = cells
            .iter()
            .map(|c| (Point::from(c.position / c.count), c.normal.try_normalize(1e-9).unwrap_or_else(Vector::z)))
            .collect();
        let miss = DVector::from_iterator(cells.len(), cells.iter().map(|c| c.miss / c.count));
        // Nothing to carry over, only noise: the model to beat.
        let noise_alone = NOISES.iter().map(|noise| density(&miss, &miss.scale(noise.powi(-2)), 2.0 * noise.ln() * miss.len() as f64));
        let mut best = (noise_alone.fold(f64::NEG_INFINITY, f64::max), None);
        for length in LENGTHS {
            let n = anchors.len();
            let correlation = DMatrix::from_fn(n, n, |i, j| kernel(&anchors[i], &anchors[j], length));
            for (sigma, noise) in SIGMAS.iter().flat_map(|s| NOISES.iter().map(move |n| (*s, *n))) {
                let mut covariance = &correlation * (sigma * sigma);
                (0..n).for_each(|i| covariance[(i, i)] += noise * noise);
                let Some(root) = Cholesky::new(covariance) else { continue };
                let weights = root.solve(&miss);
                let log_determinant = 2.0 * root.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
                let density = density(&miss, &weights, log_determinant) - sigma / USUAL;
                if density > best.0 {
                    best = (density, Some((length, weights * (sigma * sigma))));
                }
            }
        }
        let (length, weights) = best.1?;
        Some(Self { anchors, weights: weights.iter().copied().collect(), length })
    }

    /// How far the copy at `position` with `normal` should be moved along its normal, metres.
    pub(super) fn at(&self, position: &Point, normal: &Vector) -> f64 {
        let here = (*position, *normal);
        self.anchors.iter().zip(&self.weights).map(|(anchor, weight)| weight * kernel(anchor, &here, self.length)).sum()
    }
}

/// Log density of misses with covariance K, up to a constant.
///
/// * `solved` – K⁻¹ times the misses
fn density(misses: &DVector<f64>, solved: &DVector<f64>, log_determinant: f64) -> f64 {
    -0.5 * (misses.dot(solved) + log_determinant)
}

/// Correlation of the misses at two places.
fn kernel(a: &(Point, Vector), b: &(Point, Vector), length: f64) -> f64 {
    let squared = (a.0 - b.0).norm_squared();
    if squared >= length * length {
        return 0.0;
    }
    let d = squared.sqrt() / length;
    let facing = 0.5 * (1.0 + a.1.dot(&b.1));
    (1.0 - d).powi(4) * (4.0 * d + 1.0) * facing * facing
}

/// The copies that land beside a measured sample, and by how much along its normal, where one of the two was felt.
fn misses<'a>(evidence: &'a Evidence, copying: &'a Copying) -> impl Iterator<Item = (Sample, f64)> + 'a {
    let samples = &evidence.samples;
    samples.iter().filter_map(move |s| {
        let (position, normal) = (copying.motion.point(&s.position), copying.motion.vector(&s.normal));
        if (position - s.position).norm() < ELSEWHERE {
            return None;
        }
        let found = evidence.index.nearest_agreeing(samples, &position, &normal, AGREEMENT)?;
        let there = &samples[found.sample];
        if s.provenance == Provenance::Seen && there.provenance == Provenance::Seen {
            return None;
        }
        let miss = (there.position - position).dot(&there.normal);
        (found.tangential < TANGENTIAL && miss.abs() < BESIDE).then_some((Sample { position, normal, ..*s }, miss))
    })
}

fn averaged(misses: &[(Sample, f64)], size: f64) -> Vec<Cell> {
    let mut cells: BTreeMap<[i32; 6], Cell> = BTreeMap::new();
    for (s, miss) in misses {
        let at = |a: usize| (s.position[a] / size).floor() as i32;
        let side = |a: usize| s.normal[a].round() as i32;
        let cell = cells.entry([at(0), at(1), at(2), side(0), side(1), side(2)]).or_default();
        cell.position += s.position.coords;
        cell.normal += s.normal;
        cell.miss += miss;
        cell.count += 1.0;
    }
    cells.into_values().collect()
}
