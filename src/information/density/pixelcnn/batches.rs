//! Batches of noisy patches, drawn from training patches in random order.

use ndarray::{Array3, ArrayView3, Axis};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::protocols::TrainingPatches;
use crate::information::statistics::dequantisation::dequantised;

/// Uses of random numbers under one seed; each step or pass has its own stream.
#[derive(Clone, Copy, Debug)]
pub(super) enum Purpose {
    Weights = 1,
    Order = 2,
    Noise = 3,
    Dequantisation = 4,
    Validation = 5,
}

/// A separate seed for every purpose and number.
pub(super) fn seed_for(seed: u64, purpose: Purpose, number: usize) -> u64 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(((purpose as u64) << 48) + number as u64);
    random.next_u64()
}

/// Draws batches; every patch is used once before any is used again.
#[derive(Debug)]
pub(super) struct Batches<'a> {
    patches: TrainingPatches<'a>,
    dequantise: bool,
    seed: u64,
    /// Indices of the patches to draw, in the order of this pass.
    order: Vec<usize>,
    next: usize,
    passes: usize,
    step: usize,
}

impl<'a> Batches<'a> {
    /// Batches of the patches with index `first` and above.
    pub fn new(patches: TrainingPatches<'a>, first: usize, dequantise: bool, seed: u64) -> Self {
        let order: Vec<usize> = (first..patches.noisy.len_of(Axis(0))).collect();
        Self { patches, dequantise, seed, next: order.len(), order, passes: 0, step: 0 }
    }

    /// Advances to the state after a number of draws of `count` patches.
    pub fn skip(&mut self, draws: usize, count: usize) {
        for _ in 0..draws * count {
            self.next_index();
        }
        self.step += draws;
    }

    /// The next `count` patches with their noise of this draw.
    pub fn draw(&mut self, count: usize) -> Array3<f32> {
        let indices: Vec<usize> = (0..count).map(|_| self.next_index()).collect();
        let (seed, step) = (self.seed, self.step);
        self.step += 1;
        let noisy = match self.patches.clean {
            Some((clean, noise)) => {
                noise.draw(clean.select(Axis(0), &indices).view(), seed_for(seed, Purpose::Noise, step))
            }
            None => self.patches.noisy.select(Axis(0), &indices),
        };
        prepared(noisy.view(), self.dequantise, seed_for(seed, Purpose::Dequantisation, step))
    }

    fn next_index(&mut self) -> usize {
        if self.next == self.order.len() {
            let mut random = ChaCha8Rng::seed_from_u64(seed_for(self.seed, Purpose::Order, self.passes));
            self.order.shuffle(&mut random);
            self.passes += 1;
            self.next = 0;
        }
        self.next += 1;
        self.order[self.next - 1]
    }
}

/// Patches as model inputs: with uniform numbers added where counts are whole.
pub(super) fn prepared(patches: ArrayView3<'_, f32>, dequantise: bool, seed: u64) -> Array3<f32> {
    if dequantise { dequantised(patches, seed, 0) } else { patches.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Noise;

    #[test]
    fn all_patches_come_once_before_any_comes_again() {
        let noisy = Array3::from_shape_fn((10, 1, 1), |(n, ..)| n as f32);
        let mut batches = Batches::new(TrainingPatches { noisy: noisy.view(), clean: None }, 2, false, 1);
        for _ in 0..3 {
            let mut seen: Vec<f32> = (0..2).flat_map(|_| batches.draw(4)).collect();
            seen.sort_by(f32::total_cmp);
            assert_eq!(seen, [2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
        }
    }

    #[test]
    fn draws_can_be_left_out() {
        let noisy = Array3::from_shape_fn((10, 1, 1), |(n, ..)| n as f32);
        let batches = || Batches::new(TrainingPatches { noisy: noisy.view(), clean: None }, 2, true, 1);
        let (mut all, mut later) = (batches(), batches());
        for _ in 0..7 {
            all.draw(3);
        }
        later.skip(7, 3);
        assert_eq!((all.draw(3), all.draw(3)), (later.draw(3), later.draw(3)));
    }

    #[test]
    fn clean_patches_get_noise_anew_and_whole_counts_a_fraction() {
        let clean = Array3::from_elem((4, 8, 8), 50.0_f32);
        let patches = TrainingPatches { noisy: clean.view(), clean: Some((clean.view(), Noise::Shot)) };
        let mut batches = Batches::new(patches, 0, false, 1);
        let (first, second) = (batches.draw(4), batches.draw(4));
        assert_ne!(first, second);
        assert!(first.iter().all(|y| y.fract() == 0.0));
        let mut same = Batches::new(patches, 0, true, 1);
        let dequantised = same.draw(4);
        assert_eq!(dequantised.mapv(f32::floor), first);
        assert!(dequantised.iter().any(|y| y.fract() != 0.0));
    }
}
