//! How the learning rate rises and falls.

/// Share of the schedule in which the rate rises, and the share of the rate that is left at its end.
const WARM_UP: f64 = 0.03;
const FINAL_RATE: f64 = 0.02;

/// Factor of the rate when a share `done` (0 to 1) of the schedule is over: a linear rise, then a cosine (Loshchilov and
/// Hutter 2017).
pub fn rate_schedule(done: f64) -> f64 {
    let rise = (done / WARM_UP).min(1.0);
    let fall = FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
    rise.max(FINAL_RATE) * fall
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_rises_quickly_and_ends_low() {
        assert!(rate_schedule(0.0) < 0.03);
        assert!(rate_schedule(0.03) > 0.99);
        assert!((rate_schedule(0.5) - 0.51).abs() < 1e-6);
        assert!((rate_schedule(1.0) - 0.02).abs() < 1e-9);
    }
}
