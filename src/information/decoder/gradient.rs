//! Samples through the decoder on all threads, with results that do not depend on their number.

use std::sync::{Mutex, PoisonError};

use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::draws::{Purpose, Reveal};
use super::layers::Decoder;
use super::pass::Pass;
use super::scene::Scene;
use crate::network::sum_in_order;

/// What one sample told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Outcome {
    /// Bits that the decoder saves over the prior on the sites it predicts, times the weight of the sample.
    pub saved_bits: f64,
    /// The same per predicted site, without the weight.
    pub saved_bits_per_site: f64,
}

/// Memory of the threads, kept from step to step. Which thread gets which does not matter: all of it is written before it
/// is read.
pub(super) struct Passes<'a> {
    scene: &'a Scene,
    steps: usize,
    free: Mutex<Vec<Pass<'a>>>,
    parts: Vec<Vec<f32>>,
    /// Gradient of the mean loss by all weights, nats per decoded site.
    pub gradient: Vec<f32>,
}

impl<'a> Passes<'a> {
    /// For decoders like this one.
    pub fn new(scene: &'a Scene, decoder: &Decoder) -> Self {
        let gradient = vec![0.0; decoder.layout.count()];
        Self { scene, steps: decoder.unrolled(), free: Mutex::default(), parts: Vec::new(), gradient }
    }

    /// The gradient of a batch of fresh training samples, numbered from `first`, in [`Passes::gradient`].
    ///
    /// `reveal` chooses what is revealed; its weight is that of the sample in the loss.
    pub fn train(
        &mut self,
        decoder: &Decoder,
        (seed, first, count): (u64, usize, usize),
        reveal: impl Fn(&mut ChaCha8Rng) -> Reveal + Sync,
    ) -> Vec<Outcome> {
        self.parts.resize_with(count, || vec![0.0; decoder.layout.count()]);
        let (scene, passes) = (self.scene, &Pool { scene: self.scene, steps: self.steps, free: &self.free });
        let share = 1.0 / (count * scene.decoded.len().max(1)) as f64;
        let parts = self.parts.par_iter_mut().with_max_len(1).enumerate();
        let outcomes = parts.map(|(index, gradient)| {
            passes.with(|pass| {
                pass.sample.draw(scene, (seed, Purpose::Training, first + index), &reveal, &mut pass.blur);
                let outcome = decode(pass, decoder);
                gradient.fill(0.0);
                let weight = pass.sample.weight * share;
                pass.backward(decoder, &decoder.weights, weight as f32, gradient);
                outcome
            })
        });
        let outcomes = outcomes.collect();
        let parts: Vec<&[f32]> = self.parts.iter().map(Vec::as_slice).collect();
        sum_in_order(&parts, &mut self.gradient);
        outcomes
    }

    /// Decodes fresh test samples, numbered from `first`; `reveal` gets the place in this call besides.
    pub fn test(
        &self,
        decoder: &Decoder,
        (seed, first, count): (u64, usize, usize),
        reveal: impl Fn(usize, &mut ChaCha8Rng) -> Reveal + Sync,
    ) -> Vec<Outcome> {
        let passes = Pool { scene: self.scene, steps: self.steps, free: &self.free };
        let decoded = (0..count).into_par_iter().map(|index| {
            passes.with(|pass| {
                let draw = (seed, Purpose::Test, first + index);
                pass.sample.draw(self.scene, draw, |random| reveal(index, random), &mut pass.blur);
                decode(pass, decoder)
            })
        });
        decoded.collect()
    }
}

fn decode(pass: &mut Pass<'_>, decoder: &Decoder) -> Outcome {
    let bits = pass.forward(decoder, &decoder.weights);
    let saved = pass.prior_bits() - bits;
    let free = pass.free_sites().max(1) as f64;
    Outcome { saved_bits: saved * pass.sample.weight, saved_bits_per_site: saved / free }
}

/// Lends memory to threads.
struct Pool<'a, 'p> {
    scene: &'a Scene,
    steps: usize,
    free: &'p Mutex<Vec<Pass<'a>>>,
}

impl<'a> Pool<'a, '_> {
    fn with<T>(&self, work: impl FnOnce(&mut Pass<'a>) -> T) -> T {
        let kept = self.free.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut pass = kept.unwrap_or_else(|| Pass::new(self.scene, self.steps));
        let result = work(&mut pass);
        self.free.lock().unwrap_or_else(PoisonError::into_inner).push(pass);
        result
    }
}
