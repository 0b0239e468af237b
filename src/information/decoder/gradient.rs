//! Decoding of samples on all threads, with results that do not depend on their number.

use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::layers::Decoder;
use super::pass::Pass;
use super::problem::Problem;
use super::samples::{Purpose, Reveal, SampleRange};
use crate::nn::{Pool, ordered_sum};

/// Result of one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::information) struct Outcome {
    /// Information gain over the prior at the predicted sites, bits, times the weight of the sample.
    pub saved_bits: f64,
    /// The same per predicted site, without the weight.
    pub saved_bits_per_site: f64,
}

/// Memory of the threads, reused from step to step.
pub(in crate::information) struct Passes<'a> {
    scene: &'a Problem,
    steps: usize,
    free: Pool<Pass<'a>>,
    parts: Vec<Vec<f32>>,
    /// Gradient of the mean loss by all weights, nats per decoded site.
    pub gradient: Vec<f32>,
}

impl<'a> Passes<'a> {
    /// Memory for decoders of this shape.
    pub fn new(scene: &'a Problem, decoder: &Decoder) -> Self {
        let gradient = vec![0.0; decoder.layout.count()];
        Self { scene, steps: decoder.unrolled(), free: Pool::default(), parts: Vec::new(), gradient }
    }

    /// Writes the gradient of a batch of new training samples to [`Passes::gradient`].
    ///
    /// `reveal` chooses the revealed sites; its weight is that of the sample in the loss.
    pub fn train(
        &mut self,
        decoder: &Decoder,
        samples: SampleRange,
        reveal: impl Fn(&mut ChaCha8Rng) -> Reveal + Sync,
    ) -> Vec<Outcome> {
        self.parts.resize_with(samples.count, || vec![0.0; decoder.layout.count()]);
        let (scene, steps, free) = (self.scene, self.steps, &self.free);
        let share = 1.0 / (samples.count * scene.decoded.len().max(1)) as f64;
        let parts = self.parts.par_iter_mut().with_max_len(1).enumerate();
        let outcomes = parts.map(|(index, gradient)| {
            lend(free, scene, steps, |pass| {
                pass.sample.draw(scene, samples.sample(Purpose::Training, index), &reveal, &mut pass.blur);
                let outcome = decode(pass, decoder);
                gradient.fill(0.0);
                let weight = pass.sample.weight * share;
                pass.backward(decoder, &decoder.weights, weight as f32, gradient);
                outcome
            })
        });
        let outcomes = outcomes.collect();
        let parts: Vec<&[f32]> = self.parts.iter().map(Vec::as_slice).collect();
        ordered_sum(&parts, &mut self.gradient);
        outcomes
    }

    /// Decodes new test samples. `reveal` also gets the place of the sample in this call.
    pub fn test(
        &self,
        decoder: &Decoder,
        samples: SampleRange,
        reveal: impl Fn(usize, &mut ChaCha8Rng) -> Reveal + Sync,
    ) -> Vec<Outcome> {
        let decoded = (0..samples.count).into_par_iter().map(|index| {
            self.lend(|pass| {
                let sample = samples.sample(Purpose::Test, index);
                pass.sample.draw(self.scene, sample, |random| reveal(index, random), &mut pass.blur);
                decode(pass, decoder)
            })
        });
        decoded.collect()
    }

    /// Runs `work` with the memory of a thread.
    pub fn lend<T>(&self, work: impl FnOnce(&mut Pass<'a>) -> T) -> T {
        lend(&self.free, self.scene, self.steps, work)
    }
}

fn decode(pass: &mut Pass<'_>, decoder: &Decoder) -> Outcome {
    let bits = pass.forward(decoder, &decoder.weights);
    let saved = pass.prior_bits() - bits;
    let free = pass.free_sites().max(1) as f64;
    Outcome { saved_bits: saved * pass.sample.weight, saved_bits_per_site: saved / free }
}

fn lend<'a, T>(free: &Pool<Pass<'a>>, scene: &'a Problem, steps: usize, work: impl FnOnce(&mut Pass<'a>) -> T) -> T {
    free.with(|_| true, || Pass::new(scene, steps), work)
}
