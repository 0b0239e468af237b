//! Intervals between percentiles of resampled values.

/// The value below which the given share of sorted values lies, interpolated between neighbours.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = position as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

/// The 2.5 and 97.5 percentiles of resampled values, in any order.
///
/// # Panics
/// Without values.
pub fn interval_95(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    [0.025, 0.975].map(|share| percentile(&values, share))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_interpolate_between_neighbours() {
        let sorted = [0.0, 1.0, 2.0, 3.0, 4.0];
        assert!((percentile(&sorted, 0.025) - 0.1).abs() < 1e-12);
        assert!((percentile(&sorted, 0.975) - 3.9).abs() < 1e-12);
        assert_eq!((percentile(&sorted, 1.0), percentile(&[7.0], 0.5)), (4.0, 7.0));
        let [low, high] = interval_95((0..=100).rev().map(f64::from).collect());
        assert!((low - 2.5).abs() < 1e-12 && (high - 97.5).abs() < 1e-12);
    }
}
