use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_pcg::Pcg64;

/// What random numbers are for: each purpose has streams of its own.
#[derive(Clone, Copy)]
pub(crate) enum Purpose {
    /// Order of an epoch.
    Order = 1,
    /// Augmentation of a step's batch.
    Batch = 2,
    /// Dropout of a step.
    Dropout = 3,
}

/// The generator of one purpose and one step or epoch.
pub(crate) fn generator(seed: u64, purpose: Purpose, number: usize) -> Pcg64 {
    Pcg64::seed_from_u64(mix(mix(mix(seed) ^ purpose as u64) ^ number as u64))
}

/// Steele et al., *SplitMix*, OOPSLA 2014: one step of it separates neighbouring numbers.
pub(crate) fn mix(value: u64) -> u64 {
    let z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The sample indices of an epoch, shuffled.
pub(crate) fn order(seed: u64, epoch: usize, samples: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..samples).collect();
    order.shuffle(&mut generator(seed, Purpose::Order, epoch));
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn epochs_are_permutations_that_differ_and_repeat() {
        let (a, b) = (order(1, 0, 50), order(1, 1, 50));
        assert_ne!(a, b);
        assert_eq!(a, order(1, 0, 50));
        assert_ne!(a, order(2, 0, 50));
        let mut sorted = a;
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..50));
    }
}
