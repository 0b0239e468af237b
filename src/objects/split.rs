//! Which images and which random streams belong to training and which to testing.

use std::fmt;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Seed of the shuffle that parts base images. It is fixed, so that training objects of one seed never share an image
/// with test objects of another.
const SPLIT_SEED: u64 = 0x6c65_6e73_6c65_7473;
/// Set in every stream number here, so that noise or patches of the same seed never repeat the draws of objects.
const OBJECT_STREAMS: u64 = 0x6f62 << 48;

/// A part of a set of objects.
///
/// Base images are shuffled once and for all, 80 % are for training and 20 % for testing; no image is in both parts,
/// independent of the seeds of the objects. A tenth of the training part validates fits to the rest of it, on request. Beads have
/// no base images: the parts are different random streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Objects to fit models on.
    Train,
    /// Objects to evaluate them on.
    Test,
    /// Objects from the whole set.
    All,
    /// Objects of the training part but for those that validate.
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
    /// Parts `images` base images, at least one of which is for testing if there are two.
    pub(super) fn new(images: usize) -> Self {
        let mut order: Vec<u32> = (0..images as u32).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(SPLIT_SEED));
        let test = if images < 2 { 0 } else { ((images as f64 * 0.2).round() as usize).clamp(1, images - 1) };
        Self { order, train: images - test }
    }

    /// The training part alone, of which every tenth image, at least two where one is left, is for testing.
    pub(super) fn of_training(&self) -> Self {
        let order = self.members(Split::Train).to_vec();
        let test = order.len().div_ceil(10).max(2).min(order.len().saturating_sub(1));
        Self { train: order.len() - test, order }
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
        let parts = Parts::new(1000);
        assert!(!parts.members(Split::Test).is_sorted(), "the images are not shuffled");
    }
}
