use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// A range of values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// A set of numbers in brief.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// How many numbers.
    pub count: usize,
    /// Arithmetic mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// 95 % bootstrap interval of the mean.
    pub interval: Interval,
}

/// The `q` quantile, linear between order statistics (type 7 of Hyndman & Fan 1996, `NumPy`'s default).
///
/// `None` for an empty slice. NaN sorts last.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let mut sorted = values.to_vec();
    let at = q.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let below = at.floor() as usize;
    let (_, &mut low, rest) = sorted.select_nth_unstable_by(below, f64::total_cmp);
    let high = rest.iter().copied().min_by(f64::total_cmp).unwrap_or(low);
    Some(low + (high - low) * (at - below as f64))
}

/// 95 % percentile-bootstrap interval of the mean of groups of values.
///
/// Whole groups are drawn with replacement (views of one object are not independent: one group an object), `resamples` times,
/// seeded; with one value a group it is the ordinary bootstrap. `None` if there is no value.
///
/// # References
/// Efron & Tibshirani, *An Introduction to the Bootstrap*, 1993, ch. 13; cluster bootstrap: Davison & Hinkley 1997, §3.8.
pub fn bootstrap_interval(groups: &[Vec<f64>], resamples: usize, seed: u64) -> Option<Interval> {
    let totals: Vec<(f64, usize)> =
        groups.iter().filter(|g| !g.is_empty()).map(|g| (g.iter().sum(), g.len())).collect();
    if totals.is_empty() || resamples == 0 {
        return None;
    }
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let means: Vec<f64> = (0..resamples)
        .map(|_| {
            let (sum, count) = (0..totals.len()).fold((0.0, 0), |(sum, count), _| {
                let (s, n) = totals[rng.random_range(0..totals.len())];
                (sum + s, count + n)
            });
            sum / count as f64
        })
        .collect();
    Some(Interval { low: quantile(&means, 0.025)?, high: quantile(&means, 0.975)? })
}

/// Mean, median, extremes and bootstrap interval (2000 resamples) over groups of values; `None` if there is no value.
pub fn summarize(groups: &[Vec<f64>], seed: u64) -> Option<Summary> {
    let all: Vec<f64> = groups.iter().flatten().copied().collect();
    Some(Summary {
        count: all.len(),
        mean: all.iter().sum::<f64>() / all.len() as f64,
        median: quantile(&all, 0.5)?,
        min: quantile(&all, 0.0)?,
        max: quantile(&all, 1.0)?,
        interval: bootstrap_interval(groups, 2000, seed)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_like_numpy() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(quantile(&values, 0.0), Some(1.0));
        assert_eq!(quantile(&values, 0.5), Some(2.5));
        assert!(quantile(&values, 0.95).is_some_and(|q| (q - 3.85f64).abs() < 1e-12));
        assert_eq!(quantile(&values, 1.0), Some(4.0));
        assert_eq!(quantile(&[], 0.5), None);
    }

    #[test]
    fn bootstrap_of_normal_data_matches_the_normal_interval() {
        // 400 evenly spread quantiles of a uniform on [0, 1]: standard error √(1/12)/20, 95 % half-width 1.96 times that.
        let groups: Vec<Vec<f64>> = (0..400).map(|i| vec![(f64::from(i) + 0.5) / 400.0]).collect();
        let interval = bootstrap_interval(&groups, 4000, 7).expect("there are values");
        let half_width = 1.96 * (1.0f64 / 12.0).sqrt() / 20.0;
        assert!((f64::midpoint(interval.low, interval.high) - 0.5).abs() < 0.1 * half_width);
        assert!(((interval.high - interval.low) / (2.0 * half_width) - 1.0).abs() < 0.06);
    }

    #[test]
    fn copies_within_a_group_add_no_certainty() {
        let once: Vec<Vec<f64>> = (0..20).map(|i| vec![f64::from(i)]).collect();
        let thrice: Vec<Vec<f64>> = (0..20).map(|i| vec![f64::from(i); 3]).collect();
        assert_eq!(bootstrap_interval(&once, 500, 1), bootstrap_interval(&thrice, 500, 1));
    }

    #[test]
    fn constant_data_has_no_width() {
        let summary = summarize(&[vec![2.0, 2.0], vec![2.0]], 0).expect("there are values");
        assert_eq!((summary.count, summary.mean, summary.median), (3, 2.0, 2.0));
        assert_eq!(summary.interval, Interval { low: 2.0, high: 2.0 });
        assert!(summarize(&[], 0).is_none());
    }
}
