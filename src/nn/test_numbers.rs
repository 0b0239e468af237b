//! Numbers for tests of products.

/// A given number of values between -1 and 1 with a long period; another seed gives others.
pub fn numbers(count: usize, seed: usize) -> Vec<f32> {
    (0..count).map(|i| ((i * 37 + seed * 11) % 101) as f32 * 0.02 - 1.0).collect()
}
