//! Clustered intervals for test patches that show the same images.
//!
//! Patches of mosaics of 180 images show each image dozens of times, so the mean over patches varies more than that of as
//! many independent patches. With the value of a patch as
//! `v = mean + sum over images of share x effect + rest`, the variances of effects and rests follow from two quadratic forms
//! of the values whose expectations are known (the method of moments of Henderson 1953; with these forms Rao's MINQUE, 1971).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::student_t::student_95;

/// Smallest determinant of the forms that is not rounding, relative.
const SINGULAR: f64 = 1e-9;

/// Images of each patch, and the share of its light from each; the shares of a patch add up to 1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct SharedImages {
    shares: Vec<Vec<(u32, f64)>>,
}

impl SharedImages {
    /// From the image numbers and shares of each patch. An image that occurs twice in a patch gets the sum of its shares.
    pub fn new(shares: Vec<Vec<(u32, f64)>>) -> Self {
        let merged = |patch: Vec<(u32, f64)>| {
            let mut sums: BTreeMap<u32, f64> = BTreeMap::new();
            for (image, share) in patch {
                *sums.entry(image).or_default() += share;
            }
            sums.into_iter().collect()
        };
        Self { shares: shares.into_iter().map(merged).collect() }
    }

    /// From patches that show one image each.
    pub fn one_each(images: impl IntoIterator<Item = u32>) -> Self {
        Self::new(images.into_iter().map(|image| vec![(image, 1.0)]).collect())
    }

    /// The numbers of the images of each patch, and their shares.
    pub fn shares(&self) -> &[Vec<(u32, f64)>] {
        &self.shares
    }

    /// These patches followed by `more`.
    #[must_use]
    pub fn and(mut self, more: Self) -> Self {
        self.shares.extend(more.shares);
        self
    }

    /// Number of different images.
    pub fn images(&self) -> usize {
        let mut all: Vec<u32> = self.shares.iter().flatten().map(|&(image, _)| image).collect();
        all.sort_unstable();
        all.dedup();
        all.len()
    }

    /// Added variance of the mean of `values` (one per patch) by shared images, beyond that of independent patches; 0 where
    /// nothing is shared or it cannot be estimated.
    pub fn added_variance(&self, values: &[f64]) -> f64 {
        let count = values.len().min(self.shares.len());
        if count < 3 {
            return 0.0;
        }
        let (shares, values, n) = (&self.shares[..count], &values[..count], count as f64);
        let mean = values.iter().sum::<f64>() / n;
        let mut light: BTreeMap<u32, f64> = BTreeMap::new();
        let mut excess: BTreeMap<u32, f64> = BTreeMap::new();
        let mut together: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for (patch, value) in shares.iter().zip(values) {
            for &(image, share) in patch {
                *light.entry(image).or_default() += share;
                *excess.entry(image).or_default() += share * (value - mean);
                for &(other, with) in patch {
                    *together.entry((image, other)).or_default() += share * with;
                }
            }
        }
        // A: the covariance of patches whose images have effects of variance 1. B: the same of differences from the mean.
        let square = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>();
        let all = square(&mut light.values().copied());
        let of_patch = |patch: &Vec<(u32, f64)>| patch.iter().map(|(image, share)| share * light[image]).sum();
        let rows = square(&mut shares.iter().map(of_patch));
        let own: f64 = shares.iter().flatten().map(|(_, share)| share * share).sum();
        let trace = own - all / n;
        let trace_of_square = square(&mut together.values().copied()) - 2.0 * rows / n + (all / n).powi(2);
        // e'Be = s^2 tr(BB) + t^2 tr(B) and e'e = s^2 tr(B) + t^2 (n - 1) on average.
        let form = square(&mut excess.values().copied());
        let squares = square(&mut values.iter().map(|value| value - mean));
        let determinant = trace_of_square * (n - 1.0) - trace * trace;
        if determinant <= SINGULAR * trace_of_square * (n - 1.0) {
            return 0.0;
        }
        let of_images = (form * (n - 1.0) - squares * trace) / determinant;
        (of_images * (all / (n * n) - trace / (n * (n - 1.0)))).max(0.0)
    }

    /// The interval of independent patches around `mean`, widened for shared images. The variance of few images is uncertain, so
    /// Student's t is used.
    pub fn inflate_interval(&self, values: &[f64], mean: f64, [low, high]: [f64; 2]) -> [f64; 2] {
        let quantile = student_95(self.images() as f64 - 1.0);
        let added = quantile * self.added_variance(values).sqrt();
        [mean - (mean - low).hypot(added), mean + (high - mean).hypot(added)]
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Values about 0 of patches that show two of `images` images at random shares.
    fn drawn(images: u32, patches: usize, effect: f64, random: &mut ChaCha8Rng) -> (SharedImages, Vec<f64>) {
        // Uniform numbers of variance 1.
        let mut uniform = || (random.random::<f64>() - 0.5) * 12f64.sqrt();
        let effects: Vec<f64> = (0..images).map(|_| effect * uniform()).collect();
        let rests: Vec<f64> = (0..patches).map(|_| uniform()).collect();
        let shares: Vec<Vec<(u32, f64)>> = (0..patches)
            .map(|_| {
                let first = 0.2 + 0.6 * random.random::<f64>();
                vec![(random.random_range(0..images), first), (random.random_range(0..images), 1.0 - first)]
            })
            .collect();
        let value = |(patch, rest): (&Vec<(u32, f64)>, &f64)| {
            rest + patch.iter().map(|&(image, share)| share * effects[image as usize]).sum::<f64>()
        };
        let values = shares.iter().zip(&rests).map(value).collect();
        (SharedImages::new(shares), values)
    }

    #[test]
    fn inflated_intervals_cover_the_mean() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for (images, effect) in [(40, 1.0), (40, 0.0), (300, 2.0)] {
            let (mut covered, mut narrow) = (0, 0);
            for _ in 0..400 {
                let (shared, values) = drawn(images, 400, effect, &mut random);
                let n = values.len() as f64;
                let mean = values.iter().sum::<f64>() / n;
                let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
                let half = student_95(n - 1.0) * (variance / n).sqrt();
                let [low, high] = shared.inflate_interval(&values, mean, [mean - half, mean + half]);
                assert!(low <= mean - half && high >= mean + half);
                covered += usize::from(low < 0.0 && high > 0.0);
                narrow += usize::from(mean.abs() < half);
            }
            assert!((368..=396).contains(&covered), "{images} images of effect {effect}: {covered} of 400");
            assert!(effect == 0.0 || narrow < 352, "{images} images of effect {effect}: {narrow} of 400");
        }
    }

    #[test]
    fn independent_patches_add_no_variance() {
        let values = [1.0, 4.0, 2.0, 3.0, 5.0];
        assert_eq!(SharedImages::one_each(0..5).added_variance(&values), 0.0);
        assert_eq!(SharedImages::one_each([7; 5]).added_variance(&values), 0.0);
        assert_eq!(SharedImages::default().added_variance(&values), 0.0);
        assert_eq!(SharedImages::one_each([7, 8, 7]).and(SharedImages::one_each([9])).images(), 3);
    }

    #[test]
    fn repeated_image_in_a_patch_is_merged() {
        let tiles = vec![vec![(1, 0.25), (2, 0.5), (1, 0.25)], vec![(3, 1.0)]];
        assert_eq!(SharedImages::new(tiles).shares(), [vec![(1, 0.5), (2, 0.5)], vec![(3, 1.0)]]);
    }

    #[test]
    fn one_image_per_patch_gives_the_variance_between_images() {
        // Two equal patches of each of three images carry as much as one of each.
        let values = [1.0, 1.0, 2.0, 2.0, 6.0, 6.0];
        let shared = SharedImages::one_each([0, 0, 1, 1, 2, 2]);
        let independent = values.iter().map(|v| (v - 3.0f64).powi(2)).sum::<f64>() / 5.0 / 6.0;
        let between = (4.0 + 1.0 + 9.0) / 2.0 / 3.0;
        let found = independent + shared.added_variance(&values);
        assert!((found - between).abs() < 1e-12, "{found} {between}");
    }
}
