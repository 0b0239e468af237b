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

/// Least factor of the cosine schedule.
const LEAST_OF_COSINE: f64 = 0.01;

/// Factor of the rate after a share `done` (0 to 1) of the schedule: a linear rise, times a half cosine from 1 to 0.01 (Loshchilov and
/// Hutter 2017).
pub fn cosine_factor(done: f64) -> f64 {
    let half_wave = 0.5 * (1.0 + (std::f64::consts::PI * done.clamp(0.0, 1.0)).cos());
    warmup_factor(done) * (LEAST_OF_COSINE + (1.0 - LEAST_OF_COSINE) * half_wave)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosine_rises_quickly_and_ends_at_a_hundredth() {
        assert!(cosine_factor(0.0) < 0.006 && cosine_factor(0.03) > 0.99);
        assert!((cosine_factor(0.5) - 0.505).abs() < 1e-6);
        assert!((cosine_factor(1.0) - 0.01).abs() < 1e-9 && (cosine_factor(2.0) - 0.01).abs() < 1e-9);
    }

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
