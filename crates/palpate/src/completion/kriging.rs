use crate::evidence::cell_and_side;
use crate::geometry::{Point, Vector};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// At most this many anchors: fitting is cubic in them.
const MOST: usize = 150;
/// Side of the cells that observations are averaged in, metres, and its growth until no more than [`MOST`] are left.
const CELL: f64 = 6e-3;
const GROWTH: f64 = 1.3;

/// A place of the surface: position and outward normal.
pub(super) type Place = (Point, Vector);

/// Hyperparameters that are weighed against one another, in the unit of what is observed; lengths in metres.
pub(super) struct Grid {
    /// σ of the process.
    pub(super) sigmas: &'static [f64],
    /// How far it reaches along the surface.
    pub(super) lengths: &'static [f64],
    /// σ of what is only noise and detail.
    pub(super) noises: &'static [f64],
    /// Mean of the exponential prior of σ.
    pub(super) usual: f64,
    /// How much farther apart places are along their normals than along the surface.
    pub(super) across: f64,
    /// Power of (1 + n·n') / 2: how soon a side that faces another way is another surface.
    pub(super) facing: i32,
    /// Whether 0 everywhere, but for noise, is an answer too.
    pub(super) or_noise: bool,
}

/// A quantity known at some places of a surface, carried over to others: a Gaussian process of mean 0 over position and normal.
///
/// k = σ² w(|Δp| / ℓ) ((1 + n·n') / 2)^f, w(d) = (1 − d)₊⁴ (4 d + 1), where the part of Δp along the normals, the greater of the two, counts
/// `across` times. σ, ℓ and the noise are those of greatest posterior density. With `across` ≠ 1 that is no covariance for every set of places;
/// where the matrix is not positive definite, the hyperparameters are passed over.
///
/// # References
/// Rasmussen & Williams, *Gaussian Processes for Machine Learning*, 2006, eq. 2.23–2.26, 2.30, 5.8; Wendland, *Piecewise polynomial,
/// positive definite and compactly supported radial functions of minimal degree*, 1995.
#[derive(Debug, Clone)]
pub(super) struct Kriging {
    anchors: Vec<Place>,
    weights: DVector<f64>,
    root: Cholesky<f64, Dyn>,
    kernel: Kernel,
    variance: f64,
}

/// Correlation of two places.
#[derive(Debug, Clone, Copy)]
struct Kernel {
    length: f64,
    across: f64,
    facing: i32,
}

/// Log density, weights, root of the covariance, kernel, variance.
type Fit = (f64, DVector<f64>, Cholesky<f64, Dyn>, Kernel, f64);

impl Kriging {
    /// `None` without observations, and where noise alone explains them at least as well if that is an answer. O(cells³), at most 150 cells.
    pub(super) fn fit(observed: &[(Place, f64)], grid: &Grid) -> Option<Self> {
        if observed.is_empty() {
            return None;
        }
        let (anchors, values) = averaged(observed);
        let n = anchors.len();
        let alone = |noise: &f64| density(&values, &values.scale(noise.powi(-2)), 2.0 * noise.ln() * n as f64);
        let noises = grid.noises.iter().take(if grid.or_noise { usize::MAX } else { 0 });
        let noise_alone = noises.map(alone).fold(f64::NEG_INFINITY, f64::max);
        let best_of = |&length: &f64| {
            let (mut densest, mut best) = (noise_alone, None);
            let kernel = Kernel { length, across: grid.across, facing: grid.facing };
            let correlation = DMatrix::from_fn(n, n, |i, j| kernel.correlation(&anchors[i], &anchors[j]));
            for (&sigma, &noise) in grid.sigmas.iter().flat_map(|s| grid.noises.iter().map(move |n| (s, n))) {
                let mut covariance = &correlation * (sigma * sigma);
                (0..n).for_each(|i| covariance[(i, i)] += noise * noise);
                let Some(root) = Cholesky::new(covariance) else { continue };
                let weights = root.solve(&values);
                let log_determinant = 2.0 * root.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
                let density = density(&values, &weights, log_determinant) - sigma / grid.usual;
                if density > densest {
                    densest = density;
                    best = Some((density, weights, root, kernel, sigma * sigma));
                }
            }
            best
        };
        let of_lengths: Vec<_> = grid.lengths.par_iter().map(best_of).collect();
        let denser = |a: Fit, b: Fit| if b.0 > a.0 { b } else { a };
        let (_, weights, root, kernel, variance) = of_lengths.into_iter().flatten().reduce(denser)?;
        Some(Self { anchors, weights, root, kernel, variance })
    }

    /// The mean at a place.
    pub(super) fn mean(&self, at: &Place) -> f64 {
        let sum = self.anchors.iter().zip(self.weights.iter());
        self.variance * sum.map(|(anchor, weight)| weight * self.kernel.correlation(anchor, at)).sum::<f64>()
    }

    /// The mean, and the share of the process' variance that is left, 0–1. O(anchors²).
    pub(super) fn mean_and_doubt(&self, at: &Place) -> (f64, f64) {
        let k = DVector::from_iterator(
            self.anchors.len(),
            self.anchors.iter().map(|anchor| self.variance * self.kernel.correlation(anchor, at)),
        );
        let explained = k.dot(&self.root.solve(&k));
        (k.dot(&self.weights), (1.0 - explained / self.variance).clamp(0.0, 1.0))
    }
}

/// Log density of values with covariance K, up to a constant.
///
/// * `solved` – K⁻¹ times the values
fn density(values: &DVector<f64>, solved: &DVector<f64>, log_determinant: f64) -> f64 {
    -0.5 * (values.dot(solved) + log_determinant)
}

impl Kernel {
    fn correlation(&self, a: &Place, b: &Place) -> f64 {
        let apart = a.0 - b.0;
        let along = || apart.dot(&a.1).powi(2).max(apart.dot(&b.1).powi(2));
        let more = self.across * self.across - 1.0;
        let squared = apart.norm_squared() + if more == 0.0 { 0.0 } else { more * along() };
        if squared >= self.length * self.length {
            return 0.0;
        }
        let d = squared.sqrt() / self.length;
        (1.0 - d).powi(4) * (4.0 * d + 1.0) * (0.5 * (1.0 + a.1.dot(&b.1))).powi(self.facing)
    }
}

/// Means over cells of position and rounded normal.
fn averaged(observed: &[(Place, f64)]) -> (Vec<Place>, DVector<f64>) {
    let mut size = CELL;
    let cells = loop {
        let mut cells: BTreeMap<[i32; 6], (Vector, Vector, f64, f64)> = BTreeMap::new();
        for ((p, n), value) in observed {
            let cell = cells.entry(cell_and_side(p, n, size)).or_default();
            *cell = (cell.0 + p.coords, cell.1 + n, cell.2 + value, cell.3 + 1.0);
        }
        if cells.len() <= MOST {
            break cells;
        }
        size *= GROWTH;
    };
    let place =
        |c: &(Vector, Vector, f64, f64)| (Point::from(c.0 / c.3), c.1.try_normalize(1e-9).unwrap_or_else(Vector::z));
    let anchors = cells.values().map(place).collect();
    let values = DVector::from_iterator(cells.len(), cells.values().map(|c| c.2 / c.3));
    (anchors, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid {
        sigmas: &[0.5, 1.0, 2.0],
        lengths: &[0.03, 0.1],
        noises: &[0.05, 0.3],
        usual: 1.0,
        across: 1.0,
        facing: 2,
        or_noise: true,
    };

    fn place(x: f64) -> Place {
        (Point::new(x, 0.0, 0.0), Vector::z())
    }

    #[test]
    fn a_smooth_quantity_is_carried_over_and_fades_out() {
        let wave = |x: f64| (x / 0.04).sin();
        let observed: Vec<_> = (0..12)
            .map(|i| f64::from(i) * 0.01)
            .filter(|x| (x - 0.05).abs() > 0.012)
            .map(|x| (place(x), wave(x)))
            .collect();
        let kriging = Kriging::fit(&observed, &GRID).expect("a wave is more than noise");
        let (mean, doubt) = kriging.mean_and_doubt(&place(0.05));
        assert!((mean - wave(0.05)).abs() < 0.1 && doubt < 0.2, "{mean} for {}, doubt {doubt}", wave(0.05));
        assert_eq!(kriging.mean(&place(0.05)), mean);
        let (far, doubt) = kriging.mean_and_doubt(&place(0.4));
        assert_eq!((far, doubt), (0.0, 1.0));
        let behind = kriging.mean(&(Point::new(0.04, 0.0, 0.0), -Vector::z()));
        assert_eq!(behind, 0.0, "another side is another surface");
    }

    #[test]
    fn noise_is_not_carried_over() {
        let observed: Vec<_> =
            (0..40).map(|i| (place(f64::from(i) * 0.01), if i % 2 == 0 { 0.3 } else { -0.3 })).collect();
        assert!(Kriging::fit(&observed, &GRID).is_none());
        assert!(Kriging::fit(&[], &GRID).is_none());
    }

    #[test]
    fn many_observations_are_thinned() {
        let observed: Vec<_> = (0..5000).map(|i| (place(f64::from(i) * 1e-3), 1.0)).collect();
        let kriging = Kriging::fit(&observed, &GRID).expect("a constant is more than noise");
        assert!(kriging.anchors.len() <= MOST);
        assert!((kriging.mean(&place(2.5)) - 1.0).abs() < 0.05);
    }
}
