//! Numbers for tests of products.

/// So many numbers between -1 and 1 that repeat late, others for another seed.
pub fn numbers(count: usize, seed: usize) -> Vec<f32> {
    (0..count).map(|i| ((i * 37 + seed * 11) % 101) as f32 * 0.02 - 1.0).collect()
}
