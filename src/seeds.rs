//! Seeds that are derived from one seed, one for each purpose.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A seed of its own for each purpose of a run.
pub fn derived_seed(seed: u64, purpose: u64) -> u64 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(purpose);
    random.next_u64()
}
