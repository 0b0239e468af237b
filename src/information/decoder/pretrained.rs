//! Pretrained weights for many encoders and scenes.

use std::sync::LazyLock;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::channel::BeadChannel;
use super::fit::{Mover, revealed_in_training};
use super::gradient::Passes;
use super::layers::Decoder;
use super::problem::Problem;
use super::samples::SampleRange;
use crate::information::error::InformationError;
use crate::nn::learning_rate_factor;
use crate::progress::Progress;

/// The pretrained weights of the program.
const SHIPPED: &[u8] = include_bytes!("../../../assets/first_decoder.safetensors");
const DEEP: &[u8] = include_bytes!("../../../assets/bracket_decoder.safetensors");
/// Channels in use at a time, and steps after which they are replaced.
const CHANNELS: usize = 16;
const STEPS: usize = 256;
/// Samples of one step.
const BATCH: usize = 2;

/// Progress of a fit to many channels.
#[derive(Clone, Copy, Debug, Default)]
pub struct DecoderPretrainProgress {
    /// Steps so far.
    pub steps: usize,
    /// Channels so far.
    pub channels: u64,
    /// Running mean of the information gain over channels with other sites revealed, bits per pixel.
    pub saved_bits: f64,
    /// Time so far.
    pub elapsed: Duration,
}

/// Settings of a fit to many channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoderPretraining {
    /// Time of the fit.
    pub length: Duration,
    /// Seed of channels, samples and noise.
    pub seed: u64,
    /// Largest learning rate.
    pub rate: f64,
}

/// A step of a fit to many channels, reported after it.
pub struct DecoderPretrainStep<'a> {
    /// Progress of the fit.
    pub progress: DecoderPretrainProgress,
    decoder: &'a dyn Fn() -> Decoder,
}

impl DecoderPretrainStep<'_> {
    /// The decoder as if the fit ended here.
    pub fn decoder(&self) -> Decoder {
        (self.decoder)()
    }
}

impl Decoder {
    /// The pretrained decoder, fitted to beads through many encoders; `None` where the program was built without
    /// weights of this version.
    pub fn shipped() -> Option<&'static Self> {
        static DECODER: LazyLock<Option<Decoder>> = LazyLock::new(|| Decoder::of_program(SHIPPED, Decoder::UNROLLED));
        DECODER.as_ref()
    }

    /// The pretrained decoder with [`Decoder::DEEP`] unrolled steps, for longer fits.
    pub fn shipped_deep() -> Option<&'static Self> {
        static DECODER: LazyLock<Option<Decoder>> = LazyLock::new(|| Decoder::of_program(DEEP, Decoder::DEEP));
        DECODER.as_ref()
    }

    fn of_program(bytes: &[u8], unrolled: usize) -> Option<Self> {
        Self::from_bytes(bytes).ok().filter(|decoder| decoder.unrolled() == unrolled)
    }

    /// Fits a decoder to many channels at once, with other sites revealed as for an autoregressive decoder. `channel`
    /// makes a channel from its number.
    ///
    /// # Errors
    /// Where a channel is invalid or numbers stay infinite; when `on_step` cancels.
    pub fn fit_generally(
        &mut self,
        channel: &dyn Fn(u64) -> Result<BeadChannel, InformationError>,
        DecoderPretraining { length, seed, rate }: DecoderPretraining,
        on_step: &mut dyn for<'a> Progress<DecoderPretrainStep<'a>>,
    ) -> Result<(), InformationError> {
        let started = Instant::now();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut mover = Mover::new(self);
        let mut progress = DecoderPretrainProgress::default();
        loop {
            let scenes = (0..CHANNELS as u64).map(|index| Problem::new(&channel(progress.channels + index)?));
            let scenes: Vec<Problem> = scenes.collect::<Result<_, _>>()?;
            progress.channels += CHANNELS as u64;
            let mut passes: Vec<Passes<'_>> = scenes.iter().map(|scene| Passes::new(scene, self)).collect();
            for _ in 0..STEPS {
                progress.elapsed = started.elapsed();
                let done = progress.elapsed.as_secs_f64() / length.as_secs_f64().max(1e-9);
                if done >= 1.0 {
                    self.weights = mover.result(self);
                    return Ok(());
                }
                let chosen = random.random_range(0..CHANNELS);
                let (scene, passes) = (&scenes[chosen], &mut passes[chosen]);
                let samples = SampleRange { seed: random.random(), first: 0, count: BATCH };
                let outcomes = passes.train(self, samples, |random| revealed_in_training(scene.decoded.len(), random));
                // Sparse objects hold less information; without this they would count for less.
                let prior = scene.prior_nats().max(1e-6);
                if !mover.step(self, &passes.gradient, prior, rate * learning_rate_factor(done))? {
                    continue;
                }
                progress.steps += 1;
                let saved = outcomes.iter().map(|outcome| outcome.saved_bits_per_site).sum::<f64>() / BATCH as f64;
                let bits = saved * scene.decoded.len() as f64 / scene.pixels() as f64;
                progress.saved_bits += (bits - progress.saved_bits) / (progress.steps.min(2000) as f64);
                let snapshot = || Self { weights: mover.result(self), ..self.clone() };
                if on_step.report(&DecoderPretrainStep { progress, decoder: &snapshot }).is_break() {
                    return Err(InformationError::Cancelled);
                }
            }
        }
    }
}
