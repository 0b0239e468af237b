//! Whether two numbers put designs in the same order, and how far they rise together.

/// Spearman's rank correlation of pairs, -1 to 1: Pearson's correlation of the ranks, equal values sharing the mean of
/// their ranks. `None` for fewer than two pairs, and where all values of one side are equal.
pub fn spearman(pairs: &[(f64, f64)]) -> Option<f64> {
    let first = ranks(pairs.iter().map(|pair| pair.0));
    let second = ranks(pairs.iter().map(|pair| pair.1));
    pearson(&first.into_iter().zip(second).collect::<Vec<_>>())
}

/// Pearson's correlation of pairs, -1 to 1. `None` for fewer than two pairs, and where all values of one side are equal.
pub fn pearson(pairs: &[(f64, f64)]) -> Option<f64> {
    let count = pairs.len() as f64;
    let mean = |side: fn(&(f64, f64)) -> f64| pairs.iter().map(side).sum::<f64>() / count;
    let means = (mean(|pair| pair.0), mean(|pair| pair.1));
    let (mut product, mut squares) = (0.0, (0.0, 0.0));
    for (a, b) in pairs {
        let (a, b) = (a - means.0, b - means.1);
        product += a * b;
        squares.0 += a * a;
        squares.1 += b * b;
    }
    let scale = f64::sqrt(squares.0 * squares.1);
    (scale > 0.0).then(|| product / scale)
}

/// Rank of each value, the smallest being 1.
fn ranks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sorted: Vec<(usize, f64)> = values.enumerate().collect();
    sorted.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut ranks = vec![0.0; sorted.len()];
    let mut start = 0;
    for group in sorted.chunk_by(|a, b| a.1 == b.1) {
        // Ranks start + 1 to start + length, shared.
        let shared = start as f64 + f64::midpoint(1.0, group.len() as f64);
        for &(index, _) in group {
            ranks[index] = shared;
        }
        start += group.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(first: &[f64], second: &[f64]) -> Option<f64> {
        spearman(&first.iter().copied().zip(second.iter().copied()).collect::<Vec<_>>())
    }

    #[test]
    fn order_counts_and_distance_does_not() {
        assert_eq!(of(&[1.0, 2.0, 3.0], &[0.1, 7.0, 1e9]), Some(1.0));
        assert_eq!(of(&[1.0, 2.0, 3.0], &[3.0, 0.0, -8.0]), Some(-1.0));
        // 1 - 6 sum d^2 / (n (n^2 - 1)) with d = 0, 1, 1, 2, 2.
        let bits = of(&[1.0, 2.0, 3.0, 4.0, 5.0], &[1.0, 3.0, 2.0, 6.0, 4.0]);
        assert!((bits.unwrap() - 0.8).abs() < 1e-12, "{bits:?}");
    }

    #[test]
    fn equal_values_share_their_ranks() {
        assert_eq!(ranks([2.0, 1.0, 2.0, 3.0].into_iter()), [2.5, 1.0, 2.5, 4.0]);
        // Pearson's correlation of (1.5, 1.5, 3) and (1, 2, 3).
        assert!((of(&[1.0, 1.0, 2.0], &[1.0, 2.0, 3.0]).unwrap() - 0.75_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn without_an_order_there_is_no_correlation() {
        for (first, second) in [(vec![], vec![]), (vec![1.0], vec![2.0]), (vec![1.0, 1.0], vec![1.0, 2.0])] {
            assert_eq!(of(&first, &second), None);
        }
    }

    #[test]
    fn correlations_of_published_tables_are_reproduced() {
        // Beads of density 0.02, one to eight lenslets: peak signal-to-noise ratio of the published U-nets in dB.
        let psnr = [27.18, 27.81, 28.15, 27.67, 27.46, 27.47, 27.38, 27.34];
        let sensor = [0.165, 0.184, 0.193, 0.193, 0.185, 0.186, 0.180, 0.177];
        let published = [0.267, 0.387, 0.477, 0.580, 0.617, 0.618, 0.604, 0.591];
        assert!((of(&sensor, &psnr).unwrap() - 0.8384).abs() < 1e-4);
        assert!((of(&published, &psnr).unwrap() + 1.0 / 14.0).abs() < 1e-12);
    }
}
