//! Lower bound on the information, bits per pixel, with its settings and origin.

use serde::{Deserialize, Serialize};

use super::channel::BeadChannel;
use super::fit::{DecoderFit, DecoderProgress, Run};
use super::gradient::Passes;
use super::information_gain::InformationGain;
use super::kind::DecoderKind;
use super::layers::Decoder;
use super::problem::Problem;
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::progress::Progress;
use crate::sensor::Noise;

/// Lower bound on the mutual information between beads and noisy measurements, by a trained decoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LowerBound {
    /// The bound, bits per pixel of the patch; never below 0, which the prior alone reaches.
    pub bits_per_pixel: f64,
    /// 95 % interval (low, high), bits per pixel, from the standard error over test samples. It covers the choice of
    /// test samples only.
    pub interval_95: [f64; 2],
    /// The bound for the whole patch, bits.
    pub bits_per_measurement: f64,
    /// The decoder.
    pub decoder: DecoderKind,
    /// Patch shape [rows, cols], pixels.
    pub patch: [usize; 2],
    /// Decoded object pixels over all planes: those whose light reaches the patch.
    pub sites: usize,
    /// Probability of a bead at each of them.
    pub probability: f64,
    /// Background, photons per pixel.
    pub bias: f64,
    /// Noise of the measurements.
    pub noise: Noise,
    /// New samples on which the decoder was tested.
    pub test_patches: usize,
    /// Training steps.
    pub steps: usize,
    /// Samples of each step.
    pub batch: usize,
    /// Unrolled steps of the decoder.
    pub unrolled: usize,
    /// Time for fit and test, seconds.
    pub seconds: f64,
    /// Seed of initial weights, samples and test.
    pub seed: u64,
    /// Notes for the reader.
    pub notes: Vec<String>,
}

/// Fits a decoder to new samples of a channel and tests it on others. The fit starts from random weights or from
/// those of `start`.
///
/// The bound holds for any decoder, however short the fit; a longer fit raises it. Training and test samples come
/// from different random streams of the same seed. The fit resumes from the checkpoint in `keeper`. With a fixed
/// number of steps a resumed fit gives the same bits.
///
/// # Errors
/// For an invalid channel or fit, for numbers that stay infinite, and when cancelled. For a checkpoint that cannot be
/// read or written or belongs to another fit.
pub fn decoder_lower_bound(
    channel: &BeadChannel,
    fit: &DecoderFit,
    start: Option<&Decoder>,
    keeper: Option<&dyn FitCheckpoint>,
    progress: &mut dyn Progress<DecoderProgress>,
) -> Result<(LowerBound, Decoder), InformationError> {
    fit.check()?;
    let scene = Problem::new(channel)?;
    let mut decoder = match start {
        Some(start) if start.unrolled() == fit.unrolled => start.clone(),
        Some(start) => {
            let (expected, found) = ("a start of as many unrolled steps", format!("{} steps", start.unrolled()));
            return Err(InformationError::DecoderFit { expected, found });
        }
        None => Decoder::new(fit.unrolled, fit.seed)?,
    };
    let mut passes = Passes::new(&scene, &decoder);
    let mut run = Run::new(fit, &scene, &mut decoder, keeper)?;
    let steps = run.train(&mut decoder, &mut passes, progress)?;
    let savings = test(&scene, fit, &run, &passes, &decoder, progress)?;
    let (mean, half_width) = savings.mean_and_half_width();
    let mut notes = Vec::new();
    if start.is_some() {
        notes.push("the fit of the decoder started from weights of other encoders and scenes".to_owned());
    }
    if mean <= 0.0 {
        notes.push(format!(
            "the fitted decoder does worse than the prior ({mean:.4} bits per pixel), which is a decoder of 0 bits; fit \
             it for longer"
        ));
    }
    let bits_per_pixel = mean.max(0.0);
    let bound = LowerBound {
        bits_per_pixel,
        interval_95: [(mean - half_width).max(0.0), (mean + half_width).max(0.0)],
        bits_per_measurement: bits_per_pixel * scene.pixels() as f64,
        decoder: fit.kind,
        patch: channel.patch.into(),
        sites: scene.decoded.len(),
        probability: channel.probability,
        bias: channel.bias,
        noise: channel.noise,
        test_patches: savings.count(),
        steps,
        batch: fit.batch,
        unrolled: fit.unrolled,
        seconds: run.elapsed().as_secs_f64(),
        seed: fit.seed,
        notes,
    };
    Ok((bound, decoder))
}

/// Scores blocks of test samples until the interval is narrow, the samples are many, or the budget is used up.
fn test(
    scene: &Problem,
    fit: &DecoderFit,
    run: &Run<'_>,
    passes: &Passes<'_>,
    decoder: &Decoder,
    progress: &mut dyn Progress<DecoderProgress>,
) -> Result<InformationGain, InformationError> {
    let mut savings = InformationGain::default();
    let mut on_scored = |tested: &usize| progress.report(&run.progress(Some(*tested)));
    loop {
        savings.add_block(scene, passes, decoder, fit.kind, fit.seed, &mut on_scored)?;
        let narrow = savings.mean_and_half_width().1 <= fit.half_width;
        let late = fit.budget.is_some_and(|budget| run.elapsed() >= budget);
        if narrow || late || savings.count() >= fit.max_test {
            return Ok(savings);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::information::fit_checkpoint::InMemory;
    use crate::progress::CancelToken;
    use ndarray::array;

    #[test]
    fn a_decoder_worse_than_the_prior_gives_zero_and_says_so() {
        let spot = array![[[9.0, 14.0, 5.0]]];
        let channel = BeadChannel { spot, probability: 0.02, bias: 40.0, noise: Noise::Shot, patch: (2, 8) };
        let fit = DecoderFit { unrolled: 2, ..DecoderFit::of_steps(0, DecoderKind::Factorised, 2) };
        let mut start = Decoder::new(2, 1).unwrap();
        start.weights.iter_mut().for_each(|weight| *weight *= 5.0);
        let (bound, _) = decoder_lower_bound(&channel, &fit, Some(&start), None, &mut CancelToken::new()).unwrap();
        assert_eq!((bound.bits_per_pixel, bound.bits_per_measurement, bound.interval_95[0]), (0.0, 0.0, 0.0));
        assert!(bound.notes[1].contains("worse than the prior"), "{:?}", bound.notes);
    }

    #[test]
    fn a_fit_whose_numbers_run_away_is_given_up() {
        let channel = BeadChannel {
            spot: array![[[9.0, 14.0, 5.0]]],
            probability: 0.1,
            bias: 4.0,
            noise: Noise::Shot,
            patch: (2, 8),
        };
        let fit = DecoderFit {
            rate: f64::from(f32::MAX),
            unrolled: 2,
            ..DecoderFit::of_steps(500, DecoderKind::Factorised, 2)
        };
        let result = decoder_lower_bound(&channel, &fit, None, None, &mut CancelToken::new());
        assert_eq!(result.unwrap_err(), InformationError::Diverged { refused: 30 });
    }

    #[test]
    fn a_fit_that_was_stopped_goes_on_where_it_stood_and_comes_to_the_same_bits() {
        let spot = array![[[9.0, 14.0, 5.0]]];
        let channel = BeadChannel { spot, probability: 0.1, bias: 4.0, noise: Noise::Shot, patch: (2, 8) };
        let fit = DecoderFit { unrolled: 2, max_test: 64, ..DecoderFit::of_steps(12, DecoderKind::Autoregressive, 2) };
        let run = |keeper: Option<&dyn FitCheckpoint>, stop_at: usize| {
            let mut reported = Vec::new();
            let result = decoder_lower_bound(&channel, &fit, None, keeper, &mut |progress: &DecoderProgress| {
                reported.push(*progress);
                if progress.step < stop_at { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            });
            (result, reported)
        };
        let (whole, whole_reported) = run(None, usize::MAX);
        let (whole, one) = whole.unwrap();
        let whole = LowerBound { seconds: 0.0, ..whole };
        let keepers: [&dyn FitCheckpoint; 2] = [&InMemory::default(), &InMemory::of_cancelled()];
        for keeper in keepers {
            let (stopped, before) = run(Some(keeper), 5);
            assert_eq!(stopped.unwrap_err(), InformationError::Cancelled);
            let (resumed, after) = run(Some(keeper), usize::MAX);
            assert_eq!((after[0].step, after[0].training_bits), (6, whole_reported[5].training_bits));
            assert!(after[0].elapsed > before[3].elapsed, "the time continues, too: {after:?}");
            let (resumed, other) = resumed.unwrap();
            assert_eq!(one.weights(), other.weights());
            assert_eq!(whole, LowerBound { seconds: 0.0, ..resumed });
        }
    }
}
