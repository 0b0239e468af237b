//! Objects that are whole images.

use ndarray::{Array2, ArrayViewMut2};
use rand::seq::SliceRandom;

use crate::formats::PixelStack;

use super::autocovariance::{positive_semidefinite, summed_autocorrelation};
use super::mosaic::total;
use super::split::Split;

/// Objects of one shape and their photon scale.
#[derive(Clone, Debug)]
pub(super) struct WholeImages {
    stack: PixelStack,
    photons_per_count: f64,
}

impl WholeImages {
    /// Objects with a mean of `mean` photons per pixel over the set; `None` if every pixel is 0. The pixels have been
    /// checked to be finite and not negative.
    pub(super) fn new(stack: PixelStack, mean: f64) -> Option<Self> {
        let total = total(&stack.samples);
        let photons_per_count = mean / (total / stack.samples.len() as f64);
        (total > 0.0).then_some(Self { stack, photons_per_count })
    }

    pub(super) fn field(&self) -> (usize, usize) {
        (self.stack.rows, self.stack.cols)
    }

    pub(super) fn images(&self) -> usize {
        self.stack.pages
    }

    /// Photons of a truth of 1.
    pub(super) fn peak(&self) -> f64 {
        f64::from(self.stack.peak()) * self.photons_per_count
    }

    /// Members in the order of this seed. Objects take them in turn, so none repeats before all were used.
    pub(super) fn order(members: &[u32], split: Split, seed: u64) -> Vec<u32> {
        let mut order = members.to_vec();
        // Whole objects use no random numbers, so the stream of the first object is free for their order.
        order.shuffle(&mut split.generator(seed, 0));
        order
    }

    /// Fills `object` with image `page`.
    pub(super) fn copy(&self, page: usize, mut object: ArrayViewMut2<f32>) {
        let start = page * self.stack.rows * self.stack.cols;
        for (offset, pixel) in object.iter_mut().enumerate() {
            *pixel = (f64::from(self.stack.samples.value(start + offset)) * self.photons_per_count) as f32;
        }
    }

    /// Mean over the images of `members` of the unbiased linear autocovariance about their mean, photons squared. The
    /// negative part of its spectrum is clipped and the variance is preserved. Images have no pairs of pixels at lags as
    /// long as the image; those lags are set to 0 first.
    pub(super) fn autocovariance(&self, members: &[u32], max_lag: usize) -> Array2<f64> {
        let (rows, cols) = self.field();
        let pages = members.len();
        let photons = |page: u32, pixel: usize| {
            f64::from(self.stack.samples.value(page as usize * rows * cols + pixel)) * self.photons_per_count
        };
        let all = members.iter().flat_map(|&page| (0..rows * cols).map(move |pixel| photons(page, pixel)));
        let mean = all.sum::<f64>() / (pages * rows * cols) as f64;
        let mut sum = summed_autocorrelation(pages, (rows, cols), max_lag, |index, store| {
            for pixel in 0..rows * cols {
                store(pixel / cols, pixel % cols, photons(members[index], pixel) - mean);
            }
        });
        for ((row, col), value) in sum.indexed_iter_mut() {
            let (down, right) = (row.abs_diff(max_lag), col.abs_diff(max_lag));
            if down < rows && right < cols {
                *value /= ((rows - down) * (cols - right) * pages) as f64;
            }
        }
        positive_semidefinite(&sum)
    }

    /// Adds the content of the set to a fingerprint.
    pub(super) fn hash_into(&self, hasher: &mut blake3::Hasher) {
        for axis in [self.stack.pages, self.stack.rows, self.stack.cols] {
            hasher.update(&(axis as u64).to_le_bytes());
        }
        self.stack.samples.for_each_block(|block| {
            hasher.update(block);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Samples;
    use crate::objects::autocovariance::least_eigenvalue;

    #[test]
    fn autocovariance_is_valid_and_has_the_variance_of_the_pixels() {
        let values: Vec<u16> = (0..3 * 20 * 24).map(|index: u32| ((index * 48_271) % 1009) as u16).collect();
        let stack = PixelStack::new(3, 20, 24, Samples::U16(values));
        let set = WholeImages::new(stack.clone(), 50.0).unwrap();
        let photons = stack.into_array().mapv(f64::from);
        let photons = &photons * (50.0 / photons.mean().unwrap());
        let covariance = set.autocovariance(&[0, 1, 2], 30);
        assert!((covariance[[30, 30]] / photons.var(0.0) - 1.0).abs() < 1e-9);
        assert!(least_eigenvalue(&covariance) > -1e-9 * covariance[[30, 30]]);
    }

    #[test]
    fn the_autocovariance_of_some_images_knows_nothing_of_the_others() {
        let values: Vec<u16> = (0..3 * 12 * 12).map(|index: u32| ((index * 48_271) % 1009) as u16).collect();
        let (some, other) = (&values[..288], &values[288..]);
        let set = |parts: &[&[u16]]| {
            let values = parts.concat();
            WholeImages::new(PixelStack::new(values.len() / 144, 12, 12, Samples::U16(values)), 50.0).unwrap()
        };
        let bright: Vec<u16> = other.iter().map(|value| value * 30).collect();
        let alone = set(&[some]).autocovariance(&[0, 1], 6);
        for last in [other, &bright] {
            let among = set(&[some, last]).autocovariance(&[0, 1], 6);
            let scale = among[[6, 6]] / alone[[6, 6]];
            assert!(
                among
                    .iter()
                    .zip(&alone)
                    .all(|(among, alone)| (among - scale * alone).abs() < 1e-9 * among.abs().max(1.0))
            );
        }
    }

    #[test]
    fn a_smooth_random_field_gives_its_own_covariance() {
        // White noise averaged over 3 x 3 px has the pyramid (3 - |dr|) (3 - |dc|) / 81 as covariance.
        use rand::RngExt;
        let mut generator = Split::All.generator(5, 0);
        let noise = Array2::from_shape_fn((402, 402), |_| generator.random::<f32>());
        let smooth: Vec<f32> = (0..400 * 400)
            .map(|pixel| {
                let box_of_9 = (0..9).map(|index| noise[[pixel / 400 + index / 3, pixel % 400 + index % 3]]);
                box_of_9.sum::<f32>() / 9.0
            })
            .collect();
        let stack = PixelStack::new(1, 400, 400, Samples::F32(smooth));
        let covariance = WholeImages::new(stack, 0.5).unwrap().autocovariance(&[0], 4);
        let variance = 1.0 / 12.0 / 9.0;
        for (lag, expected) in [([4, 4], 9.0), ([4, 5], 6.0), ([5, 3], 4.0), ([6, 4], 3.0), ([4, 8], 0.0)] {
            let value = covariance[lag] / variance * 9.0;
            assert!((value - expected).abs() < 0.25, "{lag:?}: {value} against {expected}");
        }
    }
}
