//! The estimate: information in bits per pixel with everything needed to judge and reproduce it.

use serde::{Deserialize, Serialize};

use super::trial::Trial;
use crate::formats::DocumentKind;
use crate::information::ais::bound::AisBound;
use crate::information::bounds::bracket::{BeadBounds, Bracket, NamedBound};
use crate::information::bounds::method::BoundMethod;
use crate::information::engine_choice::EngineChoice;
use crate::information::entropy::noise_entropy::Protocol;
use crate::information::error::InformationError;
use crate::information::estimator::Estimator;
use crate::plural::counted;
use crate::sensor::Noise;

/// The kind of its JSON.
const ESTIMATE: DocumentKind = DocumentKind::new("lenslet-studio/estimate", "an estimate");

/// Origin of the measurements of an estimate, and a known bound on the truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Provenance {
    /// Background of the measurements, photons per pixel.
    pub bias: f64,
    /// The object set, for a reader.
    pub objects: String,
    /// Fingerprint of the object set, for a machine.
    pub objects_fingerprint: String,
    /// The encoder, for a reader.
    pub encoder: String,
    /// Throughput of the encoder; none where it is 1 or unknown.
    pub throughput: Option<f64>,
    /// A bound on the truth, bits per pixel, where the object entropy is known ([`super::EntropyBound`]).
    pub ceiling: Option<f64>,
    /// Further notes for the reader.
    pub notes: Vec<String>,
}

/// Mutual information between scenes and measured patches, bits per pixel, with its interval, settings and origin.
///
/// Made from trials by [`Estimate::new`] or read by [`Estimate::from_json`], never as a bare number.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let request = EstimateRequest::new(Estimator::GaussianFull).with_patch(6, 6).with_patches(400, 100);
/// let result = estimate(&Design::default(), &request, &mut CancelToken::new())?;
/// assert_eq!((result.patch, result.patches_test), ([6, 6], 100));
/// println!("{}", result.summary());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Estimate {
    /// Always "lenslet-studio/estimate".
    pub format: String,
    /// Version of the fields.
    pub format_version: u64,
    /// The smallest trial, bits per pixel. All trials are upper bounds, so the smallest is the tightest.
    pub bits_per_pixel: f64,
    /// 95 % interval (low, high) of that trial, bits per pixel; it covers the choice of test patches only.
    pub interval_95: [f64; 2],
    /// Information of the whole patch, bits.
    #[serde(default)]
    pub bits_per_patch: f64,
    /// Upper bound on the entropy of the measurements, bits per pixel: a model's cross-entropy, or noise entropy plus the
    /// upper bound.
    pub entropy_y: f64,
    /// Entropy of the noise, bits per pixel.
    pub entropy_y_given_x: f64,
    /// A bound on the truth, bits per pixel, where the object entropy is known.
    pub ceiling: Option<f64>,
    /// All known bounds, where there are more than one of a density model. The fields are `lower`,
    /// `lower_interval_95`, `lower_from`, `upper`, `upper_interval_95`, `upper_from`, `upper_bounds` and
    /// `lower_bounds`.
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub bracket: Option<Bracket>,
    /// The density model.
    pub estimator: Estimator,
    /// Compute backend of the network; `None` without a network and in old files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub engine: Option<EngineChoice>,
    /// How entropies were taken.
    pub protocol: Protocol,
    /// Patch shape [rows, cols], pixels.
    pub patch: [usize; 2],
    /// Patches the model was fitted to.
    pub patches_train: usize,
    /// Held-out patches it was scored on.
    pub patches_test: usize,
    /// Noise of the measurements.
    pub noise: Noise,
    /// Background of the measurements, photons per pixel.
    pub bias: f64,
    /// Number of trials.
    pub trials: usize,
    /// Largest minus smallest trial, bits per pixel; 0 for one trial.
    pub trial_spread: f64,
    /// Seed of the request, which reproduces the estimate. Trial t has the seed + t - 1.
    pub seed: u64,
    /// Number of the trial with the smallest estimate, from 1; `None` for one trial and in old files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub smallest_trial: Option<usize>,
    /// Computing time of all trials, seconds; includes drawing the measurements where the estimate did so.
    pub seconds: f64,
    /// The object set, for a reader.
    pub objects: String,
    /// Fingerprint of the object set, for a machine.
    pub objects_fingerprint: String,
    /// The encoder, for a reader.
    pub encoder: String,
    /// Throughput of the encoder; absent where it is 1 or unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub throughput: Option<f64>,
    /// Notes for the reader.
    pub notes: Vec<String>,
    /// The note on requested weights that could not be written; none in an estimate that was read from a file.
    #[serde(skip)]
    pub unwritten_weights: Option<String>,
    /// Prevents construction outside this module.
    #[serde(skip)]
    sealed: Sealed,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sealed;

impl Estimate {
    /// Combines trials of the same settings: the smallest with its own interval, and the spread of all.
    ///
    /// An estimate above the object-entropy bound gets a note.
    ///
    /// # Errors
    /// Without a trial, or when the trials differ in estimator, engine, protocol, noise, patch or numbers of patches,
    /// where these do not depend on time.
    pub fn new(trials: &[Trial], provenance: Provenance) -> Result<Self, InformationError> {
        let numbered = trials.iter().enumerate();
        let best = numbered.min_by(|(_, a), (_, b)| a.bits_per_pixel().total_cmp(&b.bits_per_pixel()));
        let ((place, best), first) = best.zip(trials.first()).ok_or(InformationError::Empty)?;
        for trial in trials {
            check_alike(best, trial)?;
        }
        let largest = trials.iter().map(Trial::bits_per_pixel).fold(best.bits_per_pixel(), f64::max);
        let settings = *best.settings();
        let Provenance { bias, objects, objects_fingerprint, encoder, throughput, ceiling, notes: given } = provenance;
        let mut notes = best.notes().to_vec();
        notes.extend(given);
        if best.bits_per_pixel() < 0.0 {
            notes.push("the estimate is negative; the information is zero within the error".to_owned());
        }
        if let Some(ceiling) = ceiling.filter(|&ceiling| best.bits_per_pixel() > ceiling) {
            notes.push(format!(
                "the estimate {:.3} exceeds the object-entropy bound {ceiling:.3} bits per pixel; the density model is loose for \
                 these objects, so do not rank designs by it",
                best.bits_per_pixel()
            ));
        }
        Ok(Self {
            format: ESTIMATE.format.to_owned(),
            format_version: ESTIMATE.version,
            bits_per_pixel: best.bits_per_pixel(),
            bits_per_patch: best.bits_per_pixel() * (settings.patch.0 * settings.patch.1) as f64,
            interval_95: best.interval_95(),
            entropy_y: best.entropy_y(),
            entropy_y_given_x: best.entropy_y_given_x(),
            ceiling,
            bracket: None,
            estimator: settings.estimator,
            engine: best.engine(),
            protocol: settings.protocol,
            patch: [settings.patch.0, settings.patch.1],
            patches_train: settings.patches_train,
            patches_test: best.patches_test(),
            noise: settings.noise,
            bias,
            trials: trials.len(),
            trial_spread: largest - best.bits_per_pixel(),
            seed: first.settings().seed,
            smallest_trial: (trials.len() > 1).then_some(place + 1),
            seconds: trials.iter().map(Trial::seconds).sum(),
            objects,
            objects_fingerprint,
            encoder,
            throughput,
            notes,
            unwritten_weights: best.unwritten_weights().map(Into::into),
            sealed: Sealed,
        })
    }

    /// An estimate with lower and upper bounds: trials of a density model, the Gaussian bound, the object-entropy bound and,
    /// for beads, a decoder and AIS. Its number is the smallest upper bound.
    ///
    /// # Errors
    /// As [`Estimate::new`].
    pub fn from_bracket(
        trials: &[Trial],
        gaussian: &Trial,
        beads: Option<&BeadBounds>,
        provenance: Provenance,
    ) -> Result<Self, InformationError> {
        let mut above = vec![NamedBound {
            from: BoundMethod::Gaussian,
            bits_per_pixel: gaussian.bits_per_pixel(),
            interval_95: gaussian.interval_95(),
        }];
        above.extend(beads.map(|beads| NamedBound::from(&beads.above)));
        let below = beads.map(BeadBounds::lower).unwrap_or_default();
        let mut estimate = Self::with_bounds(trials, above, below, provenance)?;
        match beads {
            Some(BeadBounds { decoder: lower, below, above }) => {
                let (tests, steps) = (lower.test_patches, lower.steps);
                estimate.notes.push(format!(
                    "decoder fitted in {} and tested on {}",
                    counted(steps, "step"),
                    counted(tests, "held-out sample")
                ));
                estimate.notes.extend(lower.notes.iter().cloned());
                estimate.notes.push(format!(
                    "lower bound by reverse AIS on {} with {}; upper bound by AIS on {} in {} of sites with {}",
                    counted(below.samples, "sample"),
                    counted(below.levels, "temperature"),
                    above.samples,
                    counted(above.groups, "group"),
                    counted(above.levels, "temperature")
                ));
            }
            None => {
                estimate.notes.push("the entropy of these objects is unknown, so there is no lower bound".to_owned());
            }
        }
        Ok(estimate)
    }

    /// The smallest upper bound on the information about beads: density model, object-entropy bound, or AIS where `above` is
    /// given.
    ///
    /// # Errors
    /// As [`Estimate::new`].
    pub fn from_upper_bounds(
        trials: &[Trial],
        above: Option<&AisBound>,
        provenance: Provenance,
    ) -> Result<Self, InformationError> {
        let bounds = above.map(NamedBound::from).into_iter().collect();
        let mut estimate = Self::with_bounds(trials, bounds, Vec::new(), provenance)?;
        estimate.notes.extend(above.map(|above| {
            format!(
                "upper bound by AIS on {} in {} of sites with {}",
                counted(above.samples, "sample"),
                counted(above.groups, "group"),
                counted(above.levels, "temperature")
            )
        }));
        Ok(estimate)
    }

    /// The smallest of the trials of a density model, the object-entropy bound and these upper bounds.
    pub(super) fn with_bounds(
        trials: &[Trial],
        mut above: Vec<NamedBound>,
        below: Vec<NamedBound>,
        provenance: Provenance,
    ) -> Result<Self, InformationError> {
        // Most density models exceed the object-entropy bound; here it is one of several bounds.
        let ceiling = provenance.ceiling;
        let mut estimate = Self::new(trials, Provenance { ceiling: None, ..provenance })?;
        estimate.ceiling = ceiling;
        let (density, interval_95) = (estimate.bits_per_pixel, estimate.interval_95);
        above.push(NamedBound { from: BoundMethod::Density, bits_per_pixel: density, interval_95 });
        above.extend(ceiling.map(|ceiling| NamedBound::exact(BoundMethod::EntropyBound, ceiling)));
        if let Some(ceiling) = ceiling.filter(|&ceiling| density > ceiling) {
            estimate.notes.push(format!(
                "the density model, {density:.3} bits per pixel, exceeds the object-entropy bound {ceiling:.3}: it is loose for these \
                 objects"
            ));
        }
        let bracket = Bracket::new(above, below).ok_or(InformationError::Empty)?;
        estimate.notes.extend(note_of_crossing(&bracket));
        estimate.bits_per_pixel = bracket.upper;
        estimate.bits_per_patch = bracket.upper * estimate.pixels();
        estimate.interval_95 = bracket.upper_interval_95;
        estimate.entropy_y = estimate.entropy_y_given_x + bracket.upper;
        estimate.bracket = Some(bracket);
        Ok(estimate)
    }

    /// The estimate with one more lower bound; its number stays the same. Estimates of the paper protocol are not
    /// bounds and stay unchanged.
    #[must_use]
    pub fn with_lower_bound(mut self, below: NamedBound) -> Self {
        if self.protocol == Protocol::Paper {
            return self;
        }
        let (above, mut lower) = if let Some(bracket) = self.bracket.take() {
            (bracket.upper_bounds, bracket.lower_bounds)
        } else {
            let from = BoundMethod::Estimator(self.estimator);
            let own = NamedBound { from, bits_per_pixel: self.bits_per_pixel, interval_95: self.interval_95 };
            let ceiling = self.ceiling.map(|ceiling| NamedBound::exact(BoundMethod::EntropyBound, ceiling));
            (std::iter::once(own).chain(ceiling).collect(), Vec::new())
        };
        lower.push(below);
        self.bracket = Bracket::new(above, lower);
        let crossing = self.bracket.as_ref().and_then(note_of_crossing).filter(|note| !self.notes.contains(note));
        self.notes.extend(crossing);
        self
    }

    /// Pixels of the patch.
    pub fn pixels(&self) -> f64 {
        (self.patch[0] * self.patch[1]) as f64
    }

    /// Whether the number comes from its estimator, not from another upper bound.
    pub fn is_of_one_model(&self) -> bool {
        let own = BoundMethod::Estimator(self.estimator);
        self.bracket.as_ref().is_none_or(|bracket| bracket.upper_bounds.iter().any(|bound| bound.from == own))
    }

    /// The lower bound of a bracket that has one, bits per pixel.
    pub fn lower(&self) -> Option<f64> {
        self.bracket.as_ref()?.lower
    }

    /// Lower and upper bound with their 95 % intervals, bits per pixel, sorted: tight bounds can cross by chance.
    pub fn ends(&self) -> Option<[(f64, [f64; 2]); 2]> {
        let bracket = self.bracket.as_ref()?;
        let mut ends = [(bracket.lower?, bracket.lower_interval_95?), (self.bits_per_pixel, self.interval_95)];
        ends.sort_by(|one, other| one.0.total_cmp(&other.0));
        Some(ends)
    }

    /// One line for people: the number, its interval and its source.
    pub fn summary(&self) -> String {
        let [low, high] = self.interval_95;
        let (bits, from) = (self.bits_per_pixel, self.upper_from());
        match self.ends() {
            Some(ends) => {
                let [least, most] = ends.map(|(bits, [low, high])| format!("{bits:.4} [{low:.4}, {high:.4}]"));
                format!("between {least} and {most} bits per pixel")
            }
            None => format!("{} {bits:.4} bits per pixel [{low:.4}, {high:.4}] ({from})", self.relation()),
        }
    }

    /// The relation to the truth: "at most" for bounds, "about" for the paper protocol, whose test patches share base
    /// images with the training patches.
    pub fn relation(&self) -> &'static str {
        match self.protocol {
            Protocol::Default => "at most",
            Protocol::Paper => "about",
        }
    }

    /// Both bounds on one line: "at least 0.1973, at most 0.2052 bits per pixel".
    pub fn bounds(&self) -> String {
        let lower = self.lower().map_or(String::new(), |bits| format!("at least {bits:.4}, "));
        format!("{lower}{} {:.4} bits per pixel", self.relation(), self.bits_per_pixel)
    }

    /// The estimator and, where it has several bounds, the one that the number comes from.
    pub fn upper_from(&self) -> String {
        match self.bracket.as_ref().filter(|_| !self.is_of_one_model()) {
            Some(bracket) => format!("{}: {}", self.estimator, bracket.upper_from),
            None => self.estimator.to_string(),
        }
    }

    /// Whether the estimate exceeds a known object-entropy bound.
    pub fn above_ceiling(&self) -> bool {
        self.ceiling.is_some_and(|ceiling| self.bits_per_pixel > ceiling)
    }

    /// Whether all its numbers are finite.
    pub(crate) fn is_finite(&self) -> bool {
        let [low, high] = self.interval_95;
        let bounds = self.bracket.iter().flat_map(|bracket| {
            let bounds = bracket.upper_bounds.iter().chain(&bracket.lower_bounds);
            let bounds = bounds.flat_map(|bound| [bound.bits_per_pixel, bound.interval_95[0], bound.interval_95[1]]);
            bounds.chain(bracket.lower).chain(bracket.lower_interval_95.into_iter().flatten())
        });
        [self.bits_per_pixel, low, high, self.entropy_y, self.entropy_y_given_x]
            .into_iter()
            .chain(self.ceiling)
            .chain(bounds)
            .all(f64::is_finite)
    }

    /// Reads an estimate from JSON.
    ///
    /// # Errors
    /// When the text is not an estimate, or one of a newer format than this program knows.
    pub fn from_json(text: &str) -> Result<Self, InformationError> {
        let wrong = |error: serde_json::Error| InformationError::Format { reason: error.to_string() };
        let value = serde_json::from_str(text).map_err(wrong)?;
        ESTIMATE.version_of(&value).map_err(|found| InformationError::Format {
            reason: format!(
                "expected the format \"{}\" up to version {}, found {found}; {}",
                ESTIMATE.format,
                ESTIMATE.version,
                found.advice()
            ),
        })?;
        serde_json::from_value(value).map_err(wrong)
    }
}

/// A note for bounds that cross.
fn note_of_crossing(bracket: &Bracket) -> Option<String> {
    bracket.width().filter(|&width| width < 0.0)?;
    let is_chance = bracket.lower_interval_95.is_none_or(|[low, _]| low <= bracket.upper_interval_95[1]);
    let note = if is_chance {
        "the bounds cross within their intervals: they agree"
    } else {
        "the bounds cross by more than their intervals: one of them is wrong here, so rely on neither"
    };
    Some(note.to_owned())
}

fn check_alike(a: &Trial, b: &Trial) -> Result<(), InformationError> {
    let (first, second) = (a.settings(), b.settings());
    // The number of new patches of a timed fit depends on the machine.
    let is_counted = !matches!(first.estimator, Estimator::Causal | Estimator::Bracket);
    let what = if first.estimator != second.estimator {
        "estimator"
    } else if a.engine() != b.engine() {
        "engine"
    } else if first.protocol != second.protocol {
        "protocol"
    } else if first.noise != second.noise {
        "noise"
    } else if first.patch != second.patch {
        "patch"
    } else if a.patches_test() != b.patches_test() || (is_counted && first.patches_train != second.patches_train) {
        "the number of patches"
    } else {
        return Ok(());
    };
    Err(InformationError::TrialsDiffer { what })
}
