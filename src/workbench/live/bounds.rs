//! Bounds beside the live estimate that use the known prior of the objects.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::forward::Design;
use crate::information::{
    AisBound, AisProgress, AisSettings, BeadChannel, BoundMethod, Bracket, Decoder, DecoderTest, FitCheckpoint,
    InformationError, NamedBound, PairedDifference, PretrainedLowerBound, SceneDraw, ais_lower_bound, ais_upper_bound,
    decoder_information, paired_gain,
};
use crate::progress::{CancelToken, Progress};
use crate::seeds::SeedStream;
use crate::workbench::live::estimate::LiveEstimate;

/// Half-width of the interval at which the decoder's bound needs no more samples, bits per pixel.
const LOWER_HALF_WIDTH: f64 = 0.002;
/// Samples of one block in the comparison with the mask before the last edit.
const EDIT_BLOCK: usize = 64;

/// Source of a bound that uses the prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum BoundSource {
    /// The pretrained decoder, on at most this many samples.
    #[serde(alias = "at_once")]
    Decoder {
        /// Most samples.
        samples: usize,
    },
    /// Annealed importance sampling.
    #[serde(alias = "followed")]
    Ais {
        /// Number of inverse temperatures from the proposal to the posterior.
        levels: usize,
        /// Number of samples.
        samples: usize,
    },
}

impl BoundSource {
    /// Whether its counts are possible.
    pub(crate) fn is_valid(self) -> bool {
        match self {
            Self::Decoder { samples } => (1..=1 << 16).contains(&samples),
            Self::Ais { levels, samples } => (1..=1 << 16).contains(&levels) && (2..=1 << 16).contains(&samples),
        }
    }
}

/// Bounds on the information of whole measurements, where the prior of the objects is known.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorBounds {
    /// Rows and columns of a measurement.
    pub patch: (usize, usize),
    /// Bracket from the decoder, annealed importance sampling and the object-entropy bound.
    pub bracket: Bracket,
    /// Sources of the lower and the upper bound.
    pub draws: [BoundSource; 2],
}

/// State of the bounds that use a known prior, by the pretrained decoder. Without a prior there are no bounds. A computation that is
/// stopped leaves the earlier bounds in place.
pub(crate) struct BeadBoundState<'a> {
    /// Channel of the beads; none without a prior.
    pub channel: Option<&'a BeadChannel>,
    /// Seed of the design.
    seed: u64,
    pub lower: Option<(NamedBound, BoundSource)>,
    pub upper: Option<(NamedBound, BoundSource)>,
    /// The design before the last edit and the channel of its patches, where the two can be compared.
    pub before: Option<(Arc<Design>, BeadChannel)>,
    /// Information gain over the design before the last edit, by the decoder, and the number of samples.
    pub edit: Option<(PairedDifference, usize)>,
}

impl<'a> BeadBoundState<'a> {
    pub fn new(channel: Option<&'a BeadChannel>, seed: u64) -> Self {
        Self { channel, seed, lower: None, upper: None, before: None, edit: None }
    }

    /// Adopts the bounds of an estimate of the same design. Where that estimate was compared with another design before the last edit,
    /// the comparison is computed again on `samples` samples.
    pub fn take_over(&mut self, estimate: &LiveEstimate, samples: usize, cancel: &CancelToken) {
        self.lower = estimate.lower.clone().zip(estimate.recipe.lower);
        self.upper = estimate.upper.clone().zip(estimate.recipe.upper);
        if estimate.before.as_ref() == self.before.as_ref().map(|(before, _)| before) {
            self.edit = estimate.edit.zip(estimate.recipe.edit);
        } else {
            self.compare(samples, cancel);
        }
    }

    /// Compares the decoder's information on `samples` samples of the same beads through the mask and through the mask before the last
    /// edit. Returns whether there is something to compare.
    pub fn compare(&mut self, samples: usize, cancel: &CancelToken) -> bool {
        let (Some(channel), Some((_, before)), Some(decoder)) = (self.channel, &self.before, Decoder::shipped()) else {
            return false;
        };
        let seed = SeedStream::EditComparison.derive(self.seed);
        let draw = SceneDraw { scenes: 0..samples, seed, block: EDIT_BLOCK };
        let savings = |channel: &BeadChannel| decoder_information(decoder, channel, &draw, &mut cancel.clone()).ok();
        let Some((before, after)) = savings(before).zip(savings(channel)) else { return false };
        // Where the decoder gains no information for either mask, the prior alone does as well.
        if [&before, &after].iter().all(|savings| savings.iter().sum::<f64>() <= 0.0) {
            return false;
        }
        let (gain, half_width) = paired_gain(&before, &after);
        let difference = PairedDifference { bits_per_pixel: gain, interval_95: [gain - half_width, gain + half_width] };
        self.edit = Some((difference, samples));
        true
    }

    /// Updates the decoder's lower bound with fresh samples.
    pub fn decode(&mut self, samples: usize, cancel: &CancelToken) {
        let Some(channel) = self.channel else { return };
        let seed = SeedStream::LiveDecoder.derive(self.seed);
        let test = DecoderTest { samples, half_width: LOWER_HALF_WIDTH, seed };
        let Ok(Some(bound)) = PretrainedLowerBound::new(channel, test, &mut cancel.clone()) else { return };
        let (bits_per_pixel, interval_95) = (bound.bits_per_pixel, bound.interval_95);
        self.update_lower(
            NamedBound { from: BoundMethod::Decoder, bits_per_pixel, interval_95 },
            BoundSource::Decoder { samples },
        );
    }

    /// Computes the lower and the upper bound by annealed importance sampling, `time` for each.
    pub fn follow(&mut self, time: Duration, cancel: &CancelToken) {
        self.below(&AisSettings::within(time, SeedStream::AisLower.derive(self.seed)), cancel);
        self.follow_from_above(time, cancel);
    }

    /// Computes the upper bound alone by annealed importance sampling, in `time`.
    pub fn follow_from_above(&mut self, time: Duration, cancel: &CancelToken) {
        self.above(&AisSettings::within(time, SeedStream::AisUpper.derive(self.seed)), cancel);
    }

    /// Recomputes the bounds from exactly these samples. Bounds that cannot be computed are left out.
    pub fn repeat(&mut self, lower: Option<BoundSource>, upper: Option<BoundSource>, cancel: &CancelToken) {
        match lower {
            Some(BoundSource::Decoder { samples }) => self.decode(samples, cancel),
            Some(BoundSource::Ais { levels, samples }) => {
                self.below(&self.replay_fit(levels, samples, SeedStream::AisLower), cancel);
            }
            None => {}
        }
        if let Some(BoundSource::Ais { levels, samples }) = upper {
            self.above(&self.replay_fit(levels, samples, SeedStream::AisUpper), cancel);
        }
    }

    /// Both bounds as those of whole measurements, with the object-entropy bound of whole measurements; none where one bound is missing.
    pub fn of_sensor(&self, patch: (usize, usize), ceiling: Option<f64>) -> Option<SensorBounds> {
        let ((lower, by_lower), (upper, by_upper)) = (self.lower.clone()?, self.upper.clone()?);
        let named = |bits| NamedBound::exact(BoundMethod::EntropyBound, bits);
        let above = ceiling.map(named).into_iter().chain([upper]).collect();
        Some(SensorBounds { patch, bracket: Bracket::new(above, vec![lower])?, draws: [by_lower, by_upper] })
    }

    /// Settings of the annealed importance sampling that reproduces the bound from exactly these samples.
    pub fn replay_fit(&self, levels: usize, samples: usize, stream: SeedStream) -> AisSettings {
        let seed = stream.derive(self.seed);
        AisSettings { samples, half_width: 0.0, ..AisSettings::of_levels(levels, seed) }
    }

    pub fn below(&mut self, fit: &AisSettings, cancel: &CancelToken) {
        if let Some(below) = self.followed(ais_lower_bound, fit, cancel) {
            self.update_lower(NamedBound::from(&below), drawn(&below));
        }
    }

    pub fn above(&mut self, fit: &AisSettings, cancel: &CancelToken) {
        if let Some(above) = self.followed(ais_upper_bound, fit, cancel) {
            self.upper = Some((NamedBound::from(&above), drawn(&above)));
        }
    }

    fn followed(&self, bound: BoundOfPosterior, fit: &AisSettings, cancel: &CancelToken) -> Option<AisBound> {
        let (channel, decoder) = (self.channel?, Decoder::shipped()?);
        bound(channel, fit, decoder, None, &mut cancel.clone()).ok()
    }

    fn update_lower(&mut self, bound: NamedBound, draws: BoundSource) {
        if self.lower.as_ref().is_none_or(|(known, _)| bound.bits_per_pixel > known.bits_per_pixel) {
            self.lower = Some((bound, draws));
        }
    }
}

/// [`ais_lower_bound`] or [`ais_upper_bound`].
type BoundOfPosterior = fn(
    &BeadChannel,
    &AisSettings,
    &Decoder,
    Option<&dyn FitCheckpoint>,
    &mut (dyn Progress<AisProgress> + Send),
) -> Result<AisBound, InformationError>;

fn drawn(bound: &AisBound) -> BoundSource {
    BoundSource::Ais { levels: bound.levels, samples: bound.samples }
}
