//! Bounds that use the known prior of beads: by a decoder, and by annealed importance sampling.

use std::sync::Arc;

use crate::evaluation::checkpoint::EstimateCheckpoint;
use crate::evaluation::progress::{EstimateProgress, converting};
use crate::evaluation::request::{DensityModel, EstimateRequest};
use crate::evaluation::scene::EvaluationError;
use crate::forward::{Design, ForwardModel};
use crate::information::{
    AisBound, AisSettings, BeadBounds, BeadChannel, BoundMethod, Decoder, DecoderFit, DecoderKind, Estimate, FitLength,
    InformationError, NamedBound, PretrainedLowerBound, Protocol, ais_lower_bound, ais_upper_bound,
    decoder_lower_bound,
};
use crate::information::{DecoderProgress, DecoderTest};
use crate::objects::ObjectSet;
use crate::progress::{CancelToken, Progress};
use crate::seeds::SeedStream;

/// Shares of the time for the fit of the decoder where there is a prior, and for the lower and the upper bound by annealed importance
/// sampling. The upper bound is soon as good as it gets. The rest belongs to the density model.
const DECODING: f64 = 0.25;
const FOLLOWING_BELOW: f64 = 5.0 / 16.0;
const FOLLOWING_ABOVE: f64 = 3.0 / 16.0;
/// Shares left to a density model: in an estimate with an upper bound alone, and with both bounds.
pub(crate) const DENSITY_ABOVE: f64 = 1.0 - FOLLOWING_ABOVE;
pub(crate) const DENSITY_BETWEEN: f64 = 1.0 - (DECODING + FOLLOWING_BELOW + FOLLOWING_ABOVE);

/// Steps per temperature of the annealed importance sampling beside fits with a fixed number of steps, and the fewest and the most
/// temperatures.
const STEPS_PER_LEVEL: usize = 4;
const LEVELS: (usize, usize) = (64, 400);

/// The channel of bead patches, or the reason why no bound can use the prior of these objects.
pub(crate) fn bead_channel(
    design: &Design,
    forward: &ForwardModel,
    patch: (usize, usize),
) -> Result<(Option<BeadChannel>, Option<InformationError>), EvaluationError> {
    let Some(channel) = forward.bead_channel(forward.psf(design)?.view(), patch) else {
        return Ok((None, None));
    };
    let channel = BeadChannel { noise: design.noise, ..channel };
    Ok(match channel.checked_spot() {
        Ok(_) => (Some(channel), None),
        Err(refusal) => (None, Some(refusal)),
    })
}

/// Fresh scenes behind an immediate bound: beside fits, which take long, and beside immediate numbers. Fewer are drawn once half the
/// interval is this narrow, bits per pixel.
const BESIDE_FITS: usize = 1024;
const IN_A_MOMENT: usize = 256;
const NARROW: f64 = 0.002;

/// The lower bound of the pretrained decoder for patches (rows, cols) of the beads of a design, without any fit. None for other objects,
/// and where the patches hold no information about them.
///
/// # Errors
/// Where mask and objects do not belong together, or numbers are not finite.
pub fn pretrained_lower_bound(
    design: &Design,
    set: &Arc<ObjectSet>,
    patch: (usize, usize),
) -> Result<Option<NamedBound>, EvaluationError> {
    let (channel, _) = bead_channel(design, &ForwardModel::of_objects(design, Arc::clone(set))?, patch)?;
    channel.map_or(Ok(None), |channel| immediate_bound(&channel, IN_A_MOMENT, design.seed, &mut CancelToken::new()))
}

/// The same bound for a channel, by a limited number of fresh scenes.
fn immediate_bound(
    channel: &BeadChannel,
    scenes: usize,
    seed: u64,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Option<NamedBound>, EvaluationError> {
    let step = EstimateProgress::of_step("Bounding from below", 0, 1);
    let progress = &mut |_: &DecoderProgress| progress.report(&step);
    let test = DecoderTest { samples: scenes, half_width: NARROW, seed: SeedStream::Decoder.derive(seed) };
    let bound = PretrainedLowerBound::new(channel, test, progress)?;
    Ok(bound.map(|PretrainedLowerBound { bits_per_pixel, interval_95, .. }| NamedBound {
        from: BoundMethod::PretrainedDecoder,
        bits_per_pixel,
        interval_95,
    }))
}

/// An estimate with the pretrained decoder's lower bound on the same patches. Nothing is added to a bracket, whose own bounds had more
/// time, and to published numbers, which are no bounds. Where the bound cannot be computed the long estimate is kept without it.
///
/// # Errors
/// When cancelled.
pub(crate) fn with_pretrained_lower_bound(
    mut estimate: Estimate,
    channel: &BeadChannel,
    request: &EstimateRequest,
    seed: u64,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Estimate, EvaluationError> {
    let scenes = match request.model {
        _ if request.protocol == Protocol::Paper => return Ok(estimate),
        DensityModel::Bracket { .. } => return Ok(estimate),
        DensityModel::Causal { .. } | DensityModel::PixelCnn { .. } => BESIDE_FITS,
        _ => IN_A_MOMENT,
    };
    match immediate_bound(channel, scenes, seed, progress) {
        Ok(below) => return Ok(below.into_iter().fold(estimate, Estimate::with_lower_bound)),
        Err(error) if error.is_cancelled() => return Err(error),
        Err(error) => estimate.notes.push(format!("no lower bound: {error}")),
    }
    Ok(estimate)
}

/// A share of a time; a number of steps is not divided.
pub(crate) fn scale_budget(length: FitLength, share: f64) -> FitLength {
    match length {
        FitLength::Time(time) => FitLength::Time(time.mul_f64(share)),
        steps @ FitLength::Steps(_) => steps,
    }
}

/// The bounds that use the prior of the objects: the decoder's lower bound, and both bounds by annealed importance sampling.
pub(crate) fn bead_bounds(
    channel: &BeadChannel,
    seed: u64,
    length: FitLength,
    fresh: bool,
    kept: &mut EstimateCheckpoint,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<BeadBounds, EvaluationError> {
    let start = if fresh { None } else { Decoder::shipped_deep() };
    let (kind, decoder_seed) = (DecoderKind::Autoregressive, SeedStream::Decoder.derive(seed));
    let fit = match scale_budget(length, DECODING) {
        FitLength::Time(budget) => DecoderFit::within(budget, kind, decoder_seed),
        FitLength::Steps(steps) => DecoderFit::of_steps(steps, kind, decoder_seed),
    };
    let fit = match start {
        Some(start) => DecoderFit { rate: DecoderFit::RATE_ON, unrolled: start.unrolled(), ..fit },
        None => fit,
    };
    let (bound, decoder) =
        kept.decoder(|keeper| decoder_lower_bound(channel, &fit, start, keeper, &mut converting(progress)))?;
    let follow = |share: f64, stream: SeedStream| posterior_fit(seed, scale_budget(length, share), stream);
    let (below, above) = (follow(FOLLOWING_BELOW, SeedStream::AisLower), follow(FOLLOWING_ABOVE, SeedStream::AisUpper));
    let below = kept.below(|keeper| ais_lower_bound(channel, &below, &decoder, keeper, &mut converting(progress)))?;
    let above = kept.above(|keeper| ais_upper_bound(channel, &above, &decoder, keeper, &mut converting(progress)))?;
    Ok(BeadBounds { decoder: bound, below, above })
}

/// The upper bound by annealed importance sampling beside a density model, where a pretrained decoder gives the proposal.
pub(crate) fn bound_above(
    channel: &BeadChannel,
    seed: u64,
    length: FitLength,
    kept: &mut EstimateCheckpoint,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Option<AisBound>, InformationError> {
    let Some(decoder) = Decoder::shipped() else { return Ok(None) };
    let fit = posterior_fit(seed, scale_budget(length, FOLLOWING_ABOVE), SeedStream::AisUpper);
    kept.above(|keeper| ais_upper_bound(channel, &fit, decoder, keeper, &mut converting(progress))).map(Some)
}

/// Settings of the annealed importance sampling for one bound of this length.
fn posterior_fit(seed: u64, length: FitLength, stream: SeedStream) -> AisSettings {
    let seed = stream.derive(seed);
    match length {
        FitLength::Time(budget) => AisSettings::within(budget, seed),
        FitLength::Steps(steps) => AisSettings::of_levels((steps / STEPS_PER_LEVEL).clamp(LEVELS.0, LEVELS.1), seed),
    }
}
