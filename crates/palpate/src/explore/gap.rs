use crate::metrics::{Interval, quantile};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Mean errors of one object after the same number of touches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectErrors {
    /// Random touches.
    pub random: f64,
    /// Touches by the policy in question.
    pub chosen: f64,
    /// Oracle touches.
    pub oracle: f64,
}

/// Share of the gap between random and oracle that a policy closes: (Σ random − Σ chosen) / (Σ random − Σ oracle) over the objects,
/// with the 95 % interval of 2000 bootstrap draws of whole objects.
///
/// `None` if there is no object or the oracle is no better than random.
pub fn gap_closed(objects: &[ObjectErrors], seed: u64) -> Option<(f64, Interval)> {
    let share = |picked: &mut dyn Iterator<Item = &ObjectErrors>| {
        let (won, gap) = picked.fold((0.0, 0.0), |(w, g), o| (w + o.random - o.chosen, g + o.random - o.oracle));
        (gap > 0.0).then_some(won / gap)
    };
    let value = share(&mut objects.iter())?;
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let draws: Vec<f64> = (0..2000)
        .filter_map(|_| {
            let picked: Vec<&ObjectErrors> =
                objects.iter().map(|_| &objects[rng.random_range(0..objects.len())]).collect();
            share(&mut picked.into_iter())
        })
        .collect();
    Some((value, Interval { low: quantile(&draws, 0.025)?, high: quantile(&draws, 0.975)? }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_way_is_a_half_and_no_gap_is_no_answer() {
        let object = |random, chosen, oracle| ObjectErrors { random, chosen, oracle };
        let (share, interval) = gap_closed(&[object(2.0, 1.5, 1.0), object(4.0, 3.5, 3.0)], 0).expect("there is a gap");
        assert!(
            (share - 0.5).abs() < 1e-12 && (interval.low - 0.5).abs() < 1e-12 && (interval.high - 0.5).abs() < 1e-12
        );
        let (share, interval) = gap_closed(&[object(2.0, 1.0, 1.0), object(2.0, 2.0, 1.0)], 0).expect("a gap");
        assert!((share - 0.5).abs() < 1e-12 && interval.low < 0.1 && interval.high > 0.9, "{interval:?}");
        assert!(gap_closed(&[object(1.0, 1.0, 1.0)], 0).is_none() && gap_closed(&[], 0).is_none());
    }
}
