//! Differences of estimates that are scored on the same test patches.

use serde::{Deserialize, Serialize};

use super::bootstrap::paired_interval;
use super::shared_images::SharedImages;
use crate::information::error::InformationError;

/// Information of each test patch by a density model, and the images that it shows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct TestPatches {
    /// Bits per pixel of each patch.
    pub information: Vec<f64>,
    /// Base images of the patches; empty where they share none.
    pub images: SharedImages,
}

/// Difference of two estimates, bits per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct PairedDifference {
    /// The difference of the two.
    pub bits_per_pixel: f64,
    /// Its 95 % interval (low, high).
    pub interval_95: [f64; 2],
}

impl PairedDifference {
    /// Mean of `of` minus `than` over the same test patches, with the paired 95 % interval ([`paired_interval`]). Scenes and
    /// noise that raise both estimates cancel in the difference. Shared images widen the interval
    /// ([`SharedImages::inflate_interval`]). It covers the choice of test patches only, neither the fits nor the looseness of
    /// the models.
    ///
    /// None where the numbers of patches differ, or there are fewer than two.
    ///
    /// # Errors
    /// When a value is not finite.
    pub fn new(of: &[f64], than: &TestPatches, seed: u64) -> Result<Option<Self>, InformationError> {
        let TestPatches { information, images } = than;
        if of.len() != information.len() || of.len() < 2 {
            return Ok(None);
        }
        let differences: Vec<f64> = of.iter().zip(information).map(|(one, other)| one - other).collect();
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        let interval = paired_interval(&differences, seed)?;
        Ok(Some(Self { bits_per_pixel: mean, interval_95: images.inflate_interval(&differences, mean, interval) }))
    }

    /// Whether the interval excludes 0.
    pub fn is_clear(&self) -> bool {
        let [low, high] = self.interval_95;
        low > 0.0 || high < 0.0
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// Information of the same patches under two models, 0.01 more under the first.
    fn information_of(patches: usize, seed: u64) -> (Vec<f64>, TestPatches) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = |deviation: f64| deviation * random.sample::<f64, _>(StandardNormal);
        let (mut of, mut than) = (Vec::new(), Vec::new());
        for _ in 0..patches {
            let scene = 0.3 + normal(0.1);
            of.push(scene + 0.01 + normal(0.02));
            than.push(scene + normal(0.02));
        }
        (of, TestPatches { information: than, images: SharedImages::default() })
    }

    #[test]
    fn common_variation_of_scenes_cancels() {
        let covered = (0..300).filter(|&seed| {
            let (of, than) = information_of(200, seed);
            let PairedDifference { interval_95: [low, high], .. } =
                PairedDifference::new(&of, &than, seed).unwrap().unwrap();
            // The means scatter by 0.0071 each, their difference by 0.002.
            assert!(high - low < 0.011, "{low} to {high}");
            low <= 0.01 && 0.01 <= high
        });
        let share = covered.count() as f64 / 300.0;
        assert!((0.90..=0.98).contains(&share), "{share}");
        let (of, than) = information_of(200, 1);
        let found = PairedDifference::new(&of, &than, 1).unwrap().unwrap();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        assert!((found.bits_per_pixel - (mean(&of) - mean(&than.information))).abs() < 1e-12 && found.is_clear());
        let none = PairedDifference::new(&than.information, &than, 1).unwrap().unwrap();
        assert!(none.bits_per_pixel == 0.0 && !none.is_clear());
    }

    #[test]
    fn shared_images_widen_the_interval() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        // Ten images, each in twenty patches; the difference of the models varies by image.
        let effects: Vec<f64> = (0..10).map(|_| 0.02 * random.sample::<f64, _>(StandardNormal)).collect();
        let of: Vec<f64> =
            (0..200).map(|patch| effects[patch % 10] + 0.01 * random.sample::<f64, _>(StandardNormal)).collect();
        let than = |images| TestPatches { information: vec![0.0; 200], images };
        let width = |than: &TestPatches| {
            let [low, high] = PairedDifference::new(&of, than, 1).unwrap().unwrap().interval_95;
            high - low
        };
        let shared = SharedImages::one_each((0..200).map(|patch| patch % 10));
        assert!(width(&than(shared)) > 2.0 * width(&than(SharedImages::default())));
    }

    #[test]
    fn different_patches_have_no_difference() {
        let (of, than) = information_of(20, 1);
        assert_eq!(PairedDifference::new(&of[..19], &than, 1), Ok(None));
        assert_eq!(PairedDifference::new(&[], &TestPatches::default(), 1), Ok(None));
        let one = TestPatches { information: vec![0.3], ..TestPatches::default() };
        assert_eq!(PairedDifference::new(&[0.4], &one, 1), Ok(None));
        let broken = TestPatches { information: vec![f64::NAN; 20], ..TestPatches::default() };
        assert!(PairedDifference::new(&of, &broken, 1).is_err());
    }
}
