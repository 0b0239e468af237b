//! Information gain of a decoder over the prior on new samples.
//!
//! The prior code length of the drawn beads has a known mean. The difference of the two code lengths of each sample
//! therefore has the mean of the bound. It varies far less than the decoder's code length alone.
//!
//! The autoregressive decoder predicts sites in random order, each given those before it. Its mean code length over
//! orders is a mean over k, uniform from 0 to D - 1. The term of k is D / (D - k) times the code length of all D - k
//! sites given k revealed ones. Late k have few sites and large weights. So k is drawn with a probability near that
//! of least variance, proportional to (1 - k / D)^(-1/2). It is evenly spread over each block of samples and weighted
//! by its inverse. The spread removes the differences between early and late k from the error. The error is estimated
//! from the differences of neighbours in the spread; it is a little too large rather than too small (collapsed
//! strata; Cochran 1977, 5A.12).

use std::ops::Range;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::channel::BeadChannel;
use super::gradient::Passes;
use super::kind::DecoderKind;
use super::layers::Decoder;
use super::problem::Problem;
use super::samples::{Reveal, SampleRange};
use crate::information::error::InformationError;
use crate::progress::Progress;

/// Samples per block, evenly spread over k.
const BLOCK: usize = 256;
/// Samples between two reports.
const REPORT: usize = 16;
/// Standard errors to either side of a 95 % interval.
const NORMAL_95: f64 = 1.96;

/// Information gain over the prior, bits per pixel of the patch, one per test sample.
#[derive(Clone, Debug, Default)]
pub(super) struct InformationGain(pub Vec<f64>);

impl InformationGain {
    /// Number of test samples.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Mean and half the width of its 95 % interval, from the standard error of a normal mean.
    pub fn mean_and_half_width(&self) -> (f64, f64) {
        let count = self.0.len().max(1) as f64;
        let mean = self.0.iter().sum::<f64>() / count;
        let square: f64 = self.0.as_chunks::<2>().0.iter().map(|[one, other]| (one - other).powi(2)).sum();
        (mean, NORMAL_95 * square.sqrt() / count)
    }

    /// Scores one more block of new samples. The number of scored samples is reported every few of them.
    ///
    /// # Errors
    /// [`InformationError::Cancelled`] where `progress` cancels.
    pub fn add_block(
        &mut self,
        scene: &Problem,
        passes: &Passes<'_>,
        decoder: &Decoder,
        kind: DecoderKind,
        seed: u64,
        progress: &mut dyn Progress<usize>,
    ) -> Result<(), InformationError> {
        for _ in (0..BLOCK).step_by(REPORT) {
            let draw = SceneDraw { scenes: self.0.len()..self.0.len() + REPORT, seed, block: BLOCK };
            self.0.extend(scored(scene, passes, decoder, kind, &draw));
            if progress.report(&self.0.len()).is_break() {
                return Err(InformationError::Cancelled);
            }
        }
        Ok(())
    }
}

/// Scenes that a decoder is tested on.
#[derive(Clone, Debug)]
pub struct SceneDraw {
    /// Indices among the test scenes of the seed.
    pub scenes: Range<usize>,
    /// Seed of the scenes.
    pub seed: u64,
    /// Scenes of one block, over which the orders of revealed sites are spread evenly.
    pub block: usize,
}

/// Information gain of scenes, bits per pixel.
fn scored(
    scene: &Problem,
    passes: &Passes<'_>,
    decoder: &Decoder,
    kind: DecoderKind,
    &SceneDraw { ref scenes, seed, block }: &SceneDraw,
) -> impl Iterator<Item = f64> {
    let (sites, pixels) = (scene.decoded.len(), scene.pixels());
    let first = scenes.start;
    let reveal = |index: usize, random: &mut ChaCha8Rng| match kind {
        DecoderKind::Factorised => Reveal::Nothing,
        DecoderKind::Autoregressive => stratum(sites, (first + index) % block, block, random),
    };
    let outcomes = passes.test(decoder, SampleRange { seed, first, count: scenes.len() }, reveal);
    outcomes.into_iter().map(move |outcome| outcome.saved_bits / pixels as f64)
}

/// Information gain of a decoder over the prior on test scenes, bits per pixel each. The mean over whole blocks is a
/// lower bound. From 64 scenes a block on, the spread does not widen the interval
/// ([`PretrainedLowerBound::of_savings`](super::PretrainedLowerBound::of_savings)).
///
/// # Errors
/// For an invalid channel; where `progress`, which receives the number of samples every few of them, cancels.
//
// Beads are drawn at all sites of the whole spot, dark or not, so that masks on one grid are tested on the same ones.
pub fn decoder_information(
    decoder: &Decoder,
    channel: &BeadChannel,
    draw: &SceneDraw,
    progress: &mut dyn Progress<usize>,
) -> Result<Vec<f64>, InformationError> {
    let scene = Problem::of(channel, channel.whole_spot()?)?;
    let passes = Passes::new(&scene, decoder);
    let mut savings = Vec::with_capacity(draw.scenes.len());
    for first in draw.scenes.clone().step_by(REPORT) {
        let part = SceneDraw { scenes: first..draw.scenes.end.min(first + REPORT), ..draw.clone() };
        savings.extend(scored(&scene, &passes, decoder, DecoderKind::Autoregressive, &part));
        if progress.report(&savings.len()).is_break() {
            return Err(InformationError::Cancelled);
        }
    }
    Ok(savings)
}

/// Mean increase of the information gain on the same samples after a change, bits per pixel, and half the width of
/// its 95 % interval. Variation that both share drops out of the difference.
pub fn paired_gain(before: &[f64], after: &[f64]) -> (f64, f64) {
    InformationGain(before.iter().zip(after).map(|(before, after)| after - before).collect()).mean_and_half_width()
}

/// Number of revealed sites of one sample of a block, and the weight that makes the mean that over all k.
fn stratum(sites: usize, place: usize, block: usize, random: &mut ChaCha8Rng) -> Reveal {
    if sites == 0 {
        // Nothing is decoded, so there is no gain.
        return Reveal::Random { count: 0, weight: 0.0 };
    }
    let all = sites as f64;
    let root = (place as f64 + random.random::<f64>()) / block as f64;
    let count = (((1.0 - root * root) * all) as usize).min(sites.saturating_sub(1));
    // Those u in [0, 1] with 1 - u^2 between k / D and (k + 1) / D.
    let left = all - count as f64;
    let probability = (left / all).sqrt() - ((left - 1.0).max(0.0) / all).sqrt();
    Reveal::Random { count, weight: 1.0 / (probability * left) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn half_width_is_that_of_the_mean_of_a_spread() {
        // Values that rise with their place, plus noise of standard deviation 1: the rise adds no error.
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let values = (0..1 << 14).map(|i| {
            let normal: f64 = random.sample(rand_distr::StandardNormal);
            (i % BLOCK) as f64 * 0.02 + normal
        });
        let (mean, half_width) = InformationGain(values.collect()).mean_and_half_width();
        assert!((mean - 2.55).abs() < 0.03, "{mean}");
        assert!((half_width / (1.96 / 128.0) - 1.0).abs() < 0.05, "{half_width}");
    }

    #[test]
    fn weights_make_the_mean_over_orders() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for sites in [1, 2, 7, 300] {
            // Code lengths that depend on k: 1 + k / D per remaining site; over orders their sum is D + (D - 1) / 2.
            let rounds = 400;
            let mut sum = 0.0;
            for place in (0..rounds).flat_map(|_| 0..BLOCK) {
                let Reveal::Random { count, weight } = stratum(sites, place, BLOCK, &mut random) else { panic!() };
                assert!(count < sites);
                sum += weight * (sites - count) as f64 * (1.0 + count as f64 / sites as f64);
            }
            let expected = sites as f64 + (sites as f64 - 1.0) / 2.0;
            let found = sum / (rounds * BLOCK) as f64;
            assert!((found / expected - 1.0).abs() < 0.01, "{sites}: {found} {expected}");
        }
    }
}
