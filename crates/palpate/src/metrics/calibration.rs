//! Does a stated uncertainty mean anything? Rank correlation and interval coverage of σ against true errors.

use super::quantile;
use serde::{Deserialize, Serialize};

/// How well stated σ agree with true errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// How many values.
    pub count: usize,
    /// Spearman's rank correlation of σ and |error|.
    pub spearman: f64,
    /// Share of the errors inside the 90 % interval of a normal distribution, |error| ≤ 1.645 σ.
    pub coverage_90: f64,
    /// Share inside ±1 σ; 0.683 for normal errors.
    pub coverage_68: f64,
    /// 90 % quantile of |error| / (1.645 σ): 1 = exact, above 1 = σ too small.
    pub ratio_90: f64,
}

/// Two-sided 90 % quantile of the standard normal distribution.
pub const NORMAL_90: f64 = 1.644_853_626_951;

impl Calibration {
    /// Compares stated σ with the sizes of true errors, in one unit, both of one length; pairs with a value that is not finite or a σ that is
    /// not positive are left out. `None` if fewer than two pairs remain.
    pub fn new(sigmas: &[f64], errors: &[f64]) -> Option<Self> {
        let usable = |(s, e): &(&f64, &f64)| s.is_finite() && **s > 0.0 && e.is_finite();
        let (sigmas, errors): (Vec<f64>, Vec<f64>) =
            sigmas.iter().zip(errors).filter(usable).map(|(s, e)| (*s, e.abs())).unzip();
        if sigmas.len() < 2 {
            return None;
        }
        let ratios: Vec<f64> = sigmas.iter().zip(&errors).map(|(s, e)| e / s).collect();
        let within = |k: f64| ratios.iter().filter(|r| **r <= k).count() as f64 / ratios.len() as f64;
        Some(Self {
            count: sigmas.len(),
            spearman: spearman(&sigmas, &errors)?,
            coverage_90: within(NORMAL_90),
            coverage_68: within(1.0),
            ratio_90: quantile(&ratios, 0.9)? / NORMAL_90,
        })
    }
}

/// Spearman's rank correlation: Pearson's of the ranks, ties sharing their mean rank. `None` below two values or if the lengths differ; 0 if
/// one side is constant.
///
/// # References
/// C. Spearman, *The Proof and Measurement of Association between Two Things*, 1904; ties as in Kendall, *Rank Correlation Methods*, 1948, ch. 3.
pub fn spearman(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.len() != b.len() || a.len() < 2 {
        return None;
    }
    let (a, b) = (ranks(a), ranks(b));
    let mean = f64::midpoint(a.len() as f64, 1.0);
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    let scale = (product(&a, &a) * product(&b, &b)).sqrt();
    Some(if scale > 0.0 { product(&a, &b) / scale } else { 0.0 })
}

/// Ranks from 1; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_unstable_by(|&i, &j| values[i].total_cmp(&values[j]).then(i.cmp(&j)));
    let mut ranks = vec![0.0; values.len()];
    let mut below = 0;
    for tied in order.chunk_by(|&i, &j| values[i].total_cmp(&values[j]).is_eq()) {
        let shared = below as f64 + f64::midpoint(tied.len() as f64, 1.0);
        for &i in tied {
            ranks[i] = shared;
        }
        below += tied.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_by_hand() {
        assert_eq!(ranks(&[3.0, 1.0, 3.0, 2.0]), [3.5, 1.0, 3.5, 2.0]);
        // 1 − 6 Σ d² / (n (n² − 1)) with d = 0, 1, 1, 0.
        let rho = spearman(&[1.0, 2.0, 3.0, 4.0], &[10.0, 30.0, 20.0, 40.0]).expect("four pairs");
        assert!((rho - 0.8).abs() < 1e-12, "{rho}");
        assert_eq!(spearman(&[1.0, 2.0, 3.0], &[9.0, 4.0, 1.0]), Some(-1.0));
        assert_eq!(spearman(&[1.0, 2.0], &[5.0, 5.0]), Some(0.0));
        assert_eq!(spearman(&[1.0], &[1.0]), None);
        assert_eq!(spearman(&[1.0, 2.0], &[1.0]), None);
        // With ties, as SciPy's spearmanr gives.
        let rho = spearman(&[1.0, 2.0, 2.0, 3.0], &[1.0, 3.0, 2.0, 4.0]).expect("four pairs");
        assert!((rho - 0.948_683_298_050_513_8).abs() < 1e-12, "{rho}");
    }

    #[test]
    fn normal_errors_are_covered_as_they_should_be_and_doubled_ones_are_not() {
        use rand::{RngExt as _, SeedableRng as _};
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let sigmas: Vec<f64> = (0..20_000).map(|i| 1e-3 * (1.0 + f64::from(i % 7))).collect();
        let errors: Vec<f64> = sigmas.iter().map(|s| s * rng.sample::<f64, _>(rand_distr::StandardNormal)).collect();
        let c = Calibration::new(&sigmas, &errors).expect("many pairs");
        assert!((c.coverage_90 - 0.9).abs() < 0.01 && (c.coverage_68 - 0.683).abs() < 0.015, "{c:?}");
        assert!((c.ratio_90 - 1.0).abs() < 0.03 && c.spearman > 0.3 && c.spearman < 0.9, "{c:?}");
        let doubled: Vec<f64> = errors.iter().map(|e| 2.0 * e).collect();
        let c = Calibration::new(&sigmas, &doubled).expect("many pairs");
        assert!(c.coverage_90 < 0.65 && (c.ratio_90 - 2.0).abs() < 0.06, "{c:?}");
    }

    #[test]
    fn values_that_mean_nothing_are_left_out() {
        let c = Calibration::new(&[1.0, f64::NAN, 0.0, 1.0, 2.0], &[0.5, 1.0, 1.0, f64::INFINITY, -1.0]);
        assert_eq!(c.expect("two pairs").count, 2);
        assert!(Calibration::new(&[1.0], &[1.0]).is_none());
    }
}
