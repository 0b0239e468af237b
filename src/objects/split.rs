//! Split of images and random streams into training and test parts.

use std::fmt;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Seed of the shuffle that splits the base images. It is fixed. So training objects of one seed never share an image
/// with test objects of another.
const SPLIT_SEED: u64 = 0x6c65_6e73_6c65_7473;
/// Bits set in every stream number here. Noise and patches of the same seed never repeat the draws of objects.
const OBJECT_STREAMS: u64 = 0x6f62 << 48;

/// A part of a set of objects.
///
/// Base images are shuffled once with a fixed seed: 80 % for training, 20 % for testing. No image is in both parts,
/// whatever the seeds of the objects. On request a tenth of the training part validates fits to the rest of it. Beads
/// have no base images: their parts are different random streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Objects to fit models on.
    Train,
    /// Objects to evaluate models on.
    Test,
    /// Objects from the whole set.
    All,
    /// Objects of the training part without the validation objects.
    Fit,
    /// Validation objects of the training part, for early stopping.
    Validation,
}

impl fmt::Display for Split {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Train => "train",
            Self::Test => "test",
            Self::All => "all",
            Self::Fit => "fit",
            Self::Validation => "validation",
        })
    }
}

impl Split {
    /// The generator of object `index` of this part.
    pub(super) fn generator(self, seed: u64, index: u64) -> ChaCha8Rng {
        let part = match self {
            Self::Train => 1,
            Self::Test => 2,
            Self::All => 3,
            Self::Fit => 4,
            Self::Validation => 5,
        };
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(OBJECT_STREAMS | part << 44 | index);
        generator
    }
}

/// Base images in shuffled order, the training part first.
#[derive(Clone, Debug)]
pub(super) struct Parts {
    order: Vec<u32>,
    train: usize,
}

impl Parts {
    /// Splits `images` base images. Of two or more images at least one is for testing.
    pub(super) fn new(images: usize) -> Self {
        let mut order: Vec<u32> = (0..images as u32).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(SPLIT_SEED));
        let test = if images < 2 { 0 } else { ((images as f64 * 0.2).round() as usize).clamp(1, images - 1) };
        Self { order, train: images - test }
    }

    /// Split of the training part alone. Every tenth image is for testing: at least two, where one is left for training.
    pub(super) fn of_training(&self) -> Self {
        let order = self.members(Split::Train).to_vec();
        let test = order.len().div_ceil(10).max(2).min(order.len().saturating_sub(1));
        Self { train: order.len() - test, order }
    }

    /// The training part in two halves of at least two images, all for training.
    pub(super) fn halves_of_training(&self) -> Option<[Self; 2]> {
        let train = self.members(Split::Train);
        let (first, second) = train.split_at(train.len() / 2);
        let half = |members: &[u32]| Self { train: members.len(), order: members.to_vec() };
        (first.len() > 1).then(|| [half(first), half(second)])
    }

    /// Training images that do not validate.
    fn fitted(&self) -> usize {
        self.train - self.train.div_ceil(10).min(self.train.saturating_sub(1))
    }

    /// Indices of the base images of a part.
    pub(super) fn members(&self, split: Split) -> &[u32] {
        match split {
            Split::Train => &self.order[..self.train],
            Split::Test => &self.order[self.train..],
            Split::All => &self.order,
            Split::Fit => &self.order[..self.fitted()],
            Split::Validation => &self.order[self.fitted()..self.train],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_disjoint_and_complete() {
        for (images, test) in [(0, 0), (1, 0), (2, 1), (3, 1), (9, 2), (10_000, 2_000)] {
            let parts = Parts::new(images);
            assert_eq!((parts.members(Split::Test).len(), parts.members(Split::All).len()), (test, images));
            let mut all = [parts.members(Split::Train), parts.members(Split::Test)].concat();
            all.sort_unstable();
            assert!(all.into_iter().eq(0..images as u32));
        }
        for (images, train, test) in [(0, 0, 0), (2, 1, 0), (3, 1, 1), (9, 5, 2), (10_000, 7_200, 800)] {
            let parts = Parts::new(images);
            let inner = parts.of_training();
            assert_eq!((inner.members(Split::Train).len(), inner.members(Split::Test).len()), (train, test));
            assert_eq!(inner.members(Split::All), parts.members(Split::Train), "none of the test images");
        }
        for (images, fit, validation) in [(0, 0, 0), (2, 1, 0), (3, 1, 1), (9, 6, 1), (1000, 720, 80)] {
            let parts = Parts::new(images);
            assert_eq!((parts.members(Split::Fit).len(), parts.members(Split::Validation).len()), (fit, validation));
            let both = [parts.members(Split::Fit), parts.members(Split::Validation)].concat();
            assert_eq!(both, parts.members(Split::Train));
        }
        assert!(Parts::new(4).halves_of_training().is_none());
        let parts = Parts::new(11);
        let [first, second] = parts.halves_of_training().unwrap();
        assert_eq!([first.members(Split::Train).len(), second.members(Split::Train).len()], [4, 5]);
        assert_eq!([first.members(Split::Train), second.members(Split::Train)].concat(), parts.members(Split::Train));
        assert!(first.members(Split::Test).is_empty() && second.members(Split::Test).is_empty());
        let parts = Parts::new(1000);
        assert!(!parts.members(Split::Test).is_sorted(), "the images are not shuffled");
    }
}
