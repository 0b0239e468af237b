//! Learning-rate schedule: linear warm-up and linear decay.

/// Share of the schedule in which the rate rises, and the smallest factor of the rate.
const WARM_UP: f64 = 0.03;
const LEAST: f64 = 0.005;

/// Factor of the rate after a share `done` (0 to 1) of the schedule: a linear rise, then a linear fall to nearly zero
/// (Defazio et al. 2023).
pub fn learning_rate_factor(done: f64) -> f64 {
    warmup_factor(done).min(1.0 - done).max(LEAST)
}

/// The warm-up alone, for online fits to data that change.
pub fn warmup_factor(done: f64) -> f64 {
    (done / WARM_UP).clamp(LEAST, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_rises_quickly_and_ends_low() {
        assert!(learning_rate_factor(0.0) < 0.03);
        assert!(learning_rate_factor(0.03) > 0.96);
        assert!((learning_rate_factor(0.5) - 0.5).abs() < 1e-6);
        assert!((learning_rate_factor(1.0) - 0.005).abs() < 1e-9);
        assert_eq!(warmup_factor(0.02), learning_rate_factor(0.02));
        assert!([0.03, 0.5, 1.0].iter().all(|&done| (warmup_factor(done) - 1.0).abs() < 1e-9));
    }
}
