use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;

/// An independent random stream for one purpose of one view of one object.
///
/// Names are hashed (FNV-1a), so that the order of objects, threads and other streams does not matter.
pub(crate) fn stream(seed: u64, object: &str, view: usize, purpose: &str) -> Pcg64Mcg {
    let bytes = object.bytes().chain([0]).chain(purpose.bytes()).chain([0]);
    let numbers = seed.to_le_bytes().into_iter().chain((view as u64).to_le_bytes());
    let hash =
        bytes.chain(numbers).fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    Pcg64Mcg::seed_from_u64(hash)
}
