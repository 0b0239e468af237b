//! Splitting samples between threads so that the result does not depend on their number.

use std::ops::Range;

use rayon::prelude::*;

use super::arithmetic::vectorised;

/// Samples of part `index` of `parts` when `samples` are split as evenly as whole numbers allow.
pub fn part_range(samples: usize, parts: usize, index: usize) -> Range<usize> {
    samples * index / parts..samples * (index + 1) / parts
}

/// Numbers that one thread sums at a time.
const STRETCH: usize = 16_384;

/// `total = parts[0] + parts[1] + ...`, each number summed in that order.
pub fn ordered_sum(parts: &[&[f32]], total: &mut [f32]) {
    total.par_chunks_mut(STRETCH).enumerate().for_each(|(index, total)| {
        let stretch = index * STRETCH..index * STRETCH + total.len();
        let Some((first, others)) = parts.split_first() else { return total.fill(0.0) };
        total.copy_from_slice(&first[stretch.clone()]);
        for part in others {
            add_assign(total, &part[stretch.clone()]);
        }
    });
}

vectorised! {
    /// `total += part`.
    pub fn add_assign<'a>(total: &'a mut [f32], part: &'a [f32]) {
        for (sum, value) in total.iter_mut().zip(part) {
            *sum += value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_all_samples_once() {
        for (samples, parts) in [(64, 16), (3, 3), (10, 4), (5, 8)] {
            let all: Vec<usize> = (0..parts).flat_map(|index| part_range(samples, parts, index)).collect();
            assert_eq!(all, (0..samples).collect::<Vec<_>>());
        }
    }

    #[test]
    fn sum_covers_all_parts() {
        let parts: Vec<Vec<f32>> = (0..3).map(|k| (0..40_000).map(|i| (i * (k + 1)) as f32).collect()).collect();
        let mut total = vec![7.0; 40_000];
        ordered_sum(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut total);
        assert!(total.iter().enumerate().all(|(i, &sum)| (sum - (i * 6) as f32).abs() < 0.5));
        ordered_sum(&[], &mut total);
        assert!(total.iter().all(|&sum| sum == 0.0));
    }
}
