//! The live estimate: a causal density model that starts from the model of the design before the edit, is scored while it
//! is fitted, and settles.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ndarray::{Array2, Array3, Axis, s};

use super::design::Design;
use super::estimation::moments;
use super::evaluation::{EvaluationError, LIVE_PATCH, Scene};
use super::simulation::imaging;
use crate::design::{GradientDraw, Imaging, derived_seed};
use crate::information::{
    BeadChannel, CausalFit, CausalModel, CausalRequest, Decoder, Estimator, FitLength, InformationError, NamedBound,
    NoiseEntropy, PatchBatch, PatchStream, PosteriorFit, Protocol, QuickLowerBound, causal_model, information_map,
    paired_interval, posterior_lower_bound, posterior_upper_bound,
};
use crate::objects::Split;
use crate::optics::LensletGradient;

/// Time of a fit from the beginning, with some seconds for following the posterior.
const COLD: Duration = Duration::from_secs(66);
/// Time of a fit from the model of a similar design, likewise.
const WARM: Duration = Duration::from_secs(26);
/// Share of the usual learning rate in the latter.
const WARM_RATE: f64 = 0.5;
/// Time from the beginning of a fit to its first score; later ones follow at times that grow by [`GROWTH`].
const FIRST_SCORE: Duration = Duration::from_millis(300);
const GROWTH: f64 = 1.7;
/// Held-out patches of the scores in between, and of the last.
const SCORED: usize = 96;
const SCORED_LAST: usize = 384;
/// Time from the beginning of a fit from which on the gradient is taken along, and on how many objects and patches.
const FIRST_GRADIENT: Duration = Duration::from_secs(2);
const PULLED_OBJECTS: usize = 12;
const PULLED_PATCHES: usize = 32;
/// Time from the beginning of a fit from which on the lower bound is taken along; the most samples that it rests on
/// then and once the estimate has settled, and the half width of its interval that is enough, bits per pixel.
const FIRST_LOWER: Duration = Duration::from_millis(700);
const LOWER_SAMPLES: usize = 256;
const LOWER_SAMPLES_LAST: usize = 2048;
const LOWER_HALF_WIDTH: f64 = 0.002;
/// Time from the beginning of a fit from which on the posterior is followed, and for how long on each side then and once
/// the estimate has settled.
const FIRST_FOLLOWED: Duration = Duration::from_secs(3);
const FOLLOWED: Duration = Duration::from_secs(3);
const FOLLOWED_LAST: Duration = Duration::from_secs(8);
/// Patches whose own maps are kept.
const SHOWN: usize = 8;

/// An estimate that gets better while one waits: an upper bound on the information at any time.
#[derive(Clone, Debug)]
pub struct LiveEstimate {
    /// Bits per pixel.
    pub bits_per_pixel: f64,
    /// 95 % interval over held-out patches.
    pub interval_95: [f64; 2],
    /// Cross-entropy of the measurements, bits per pixel.
    pub entropy_y: f64,
    /// Entropy of the noise, bits per pixel.
    pub entropy_y_given_x: f64,
    /// Rows and columns of a patch.
    pub patch: (usize, usize),
    /// Held-out patches behind it.
    pub test_patches: usize,
    /// Training steps so far.
    pub steps: usize,
    /// Seconds of the fit so far.
    pub seconds: f64,
    /// Time left until it settles; none once it has.
    pub remaining: Option<Duration>,
    /// Whether the fit began with the model of a similar design.
    pub warm: bool,
    /// How it changes with each lenslet, bits per pixel and unit of the parameter; none for other masks and in the first
    /// seconds of a fit.
    pub gradient: Option<Vec<LensletGradient>>,
    /// The largest bound from below; none where the prior of the objects is not known, and in the first second of a fit.
    pub lower: Option<NamedBound>,
    /// Bound from above by posterior sampling; none where the prior is not known, and in the first seconds of a fit.
    pub upper: Option<NamedBound>,
    /// Bits that each place of a patch adds to what the pixels before it have told, mean over held-out patches.
    pub mean_map: Array2<f32>,
    /// The same for some patches one by one, shape (n, rows, cols).
    pub maps: Array3<f32>,
    /// Those patches, photons, shape (n, rows, cols).
    pub patches: Array3<f32>,
}

/// Keeps the last model for the next design.
#[derive(Default)]
pub(super) struct Refiner {
    last: Option<(Arc<Scene>, CausalModel)>,
}

impl Refiner {
    /// Refines the live estimate of a design until it settles. `publish` gets every number; `stop` is asked at every step.
    ///
    /// Every design is scored on the same held-out objects at the same places, so that differences between edits are not
    /// drowned in those of the scenes.
    ///
    /// # Errors
    /// [`InformationError::Cancelled`] when stopped; [`EvaluationError`] where design, objects or noise allow no estimate.
    pub fn refine(
        &mut self,
        design: &Design,
        scene: &Arc<Scene>,
        publish: &mut dyn FnMut(LiveEstimate),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), EvaluationError> {
        let set = &scene.set;
        let imaging = imaging(design, set)?;
        let patch = imaging.patch(Some((LIVE_PATCH, LIVE_PATCH)));
        let psf = design.psf(set.planes())?;
        let convolver = imaging.convolver(psf.view())?;
        let stream = |split| imaging.stream(convolver.clone(), split, patch);
        let test = stream(Split::Test).draw(SCORED, derived_seed(design.seed, 2))?;
        let entropy = NoiseEntropy::new(design.noise, Protocol::Default)?;
        let known = self.last.take().filter(|(of, _)| Arc::ptr_eq(of, scene)).map(|(_, model)| model);
        let train = stream(Split::Train);
        let request = CausalRequest {
            stream: &train,
            test: &test,
            validation: None,
            keeper: None,
            moments: Some(&moments(design, &imaging, patch)?),
            noise: design.noise,
            length: FitLength::Time(if known.is_some() { WARM } else { COLD }),
            start: known.as_ref(),
            estimator: Estimator::Live,
            seed: derived_seed(design.seed, 3),
        };
        let mut model = causal_model(&request)?;
        let mut fit = CausalFit::new(request.length, request.seed);
        if known.is_some() {
            fit.rate *= WARM_RATE;
        }
        let scorer = Scorer { design, entropy: &entropy, warm: known.is_some() };
        let started = Instant::now();
        let mut next = FIRST_SCORE;
        let channel = imaging.bead_channel(psf.view(), patch);
        let mut beads = Beads { channel, design, lower: None, upper: None };
        let mut next_followed = FIRST_FOLLOWED;
        let mut failure = None;
        let fitted = fit.fit_watched(&mut model, &train, None, &mut |progress, snapshot| {
            if stop() {
                return ControlFlow::Break(());
            }
            if progress.elapsed >= next {
                match scorer.score(&snapshot(), &test, progress.step, started, progress.remaining) {
                    Ok(mut estimate) => {
                        if beads.lower.is_none() && progress.elapsed >= FIRST_LOWER {
                            beads.decode(LOWER_SAMPLES, stop);
                        }
                        if progress.elapsed >= FIRST_GRADIENT {
                            estimate.gradient = pull(design, &imaging, &snapshot());
                        }
                        publish(beads.known(estimate.clone()));
                        if progress.elapsed >= next_followed {
                            next_followed = Duration::MAX;
                            beads.follow(FOLLOWED, stop);
                            publish(beads.known(estimate));
                        }
                    }
                    Err(error) => {
                        failure = Some(error);
                        return ControlFlow::Break(());
                    }
                }
                next = started.elapsed().mul_f64(GROWTH);
            }
            ControlFlow::Continue(())
        });
        if let Some(failure) = failure {
            return Err(failure.into());
        }
        if let Ok(steps) = fitted {
            // The first patches are those of the scores before, so that the last one differs from them by little.
            let more = stream(Split::Test).draw(SCORED_LAST - SCORED, derived_seed(design.seed, 5))?;
            let test = joined(&test, &more)?;
            let mut estimate = scorer.score(&model, &test, steps, started, None)?;
            estimate.gradient = pull(design, &imaging, &model);
            publish(beads.known(estimate.clone()));
            beads.decode(LOWER_SAMPLES_LAST, stop);
            beads.follow(FOLLOWED_LAST, stop);
            publish(beads.known(estimate));
        }
        self.last = Some((Arc::clone(scene), model));
        Ok(fitted.map(|_| ())?)
    }
}

/// The bounds that rest on a known prior, by the decoder that comes with the program; there are none without a prior, and
/// those that were stopped leave the ones before.
struct Beads<'a> {
    channel: Option<BeadChannel>,
    design: &'a Design,
    lower: Option<NamedBound>,
    upper: Option<NamedBound>,
}

impl Beads<'_> {
    /// An estimate with what is known so far.
    fn known(&self, estimate: LiveEstimate) -> LiveEstimate {
        LiveEstimate { lower: self.lower.clone(), upper: self.upper.clone(), ..estimate }
    }

    /// What the decoder tells of fresh samples.
    fn decode(&mut self, samples: usize, stop: &(dyn Fn() -> bool + Sync)) {
        let Some(channel) = &self.channel else { return };
        let seed = derived_seed(self.design.seed, 7);
        let Ok(Some(bound)) = QuickLowerBound::new(channel, (samples, LOWER_HALF_WIDTH), seed, &|| !stop()) else {
            return;
        };
        let (bits_per_pixel, interval_95) = (bound.bits_per_pixel, bound.interval_95);
        self.raise(NamedBound { from: "decoder".into(), bits_per_pixel, interval_95 });
    }

    /// The posterior from both sides, for so long each.
    fn follow(&mut self, time: Duration, stop: &(dyn Fn() -> bool + Sync)) {
        let (Some(channel), Some(decoder)) = (&self.channel, Decoder::shipped()) else { return };
        let fit = |stream| PosteriorFit::within(time, derived_seed(self.design.seed, stream));
        let mut watch = |_: &_| if stop() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let below = posterior_lower_bound(channel, &fit(8), decoder, &mut watch);
        let above = posterior_upper_bound(channel, &fit(9), decoder, &mut watch);
        if let Ok(below) = below {
            self.raise(NamedBound::from(&below));
        }
        if let Ok(above) = above {
            self.upper = Some(NamedBound::from(&above));
        }
    }

    fn raise(&mut self, bound: NamedBound) {
        if self.lower.as_ref().is_none_or(|known| bound.bits_per_pixel > known.bits_per_pixel) {
            self.lower = Some(bound);
        }
    }
}

/// Where information pulls the lenslets of a design, on held-out objects; none for masks without lenslets, or where numbers
/// are not finite.
fn pull(design: &Design, imaging: &Imaging<'_>, model: &CausalModel) -> Option<Vec<LensletGradient>> {
    let array = design.encoder.lenslets()?;
    let seed = derived_seed(design.seed, 6);
    let draw = GradientDraw { split: Split::Test, objects: PULLED_OBJECTS, patches: PULLED_PATCHES, seed };
    let gradient = imaging.gradient(array, &draw, model.patch(), model).ok()?.lenslets;
    gradient.iter().all(|by| by.x.is_finite() && by.y.is_finite()).then_some(gradient)
}

/// Scores models of one design.
struct Scorer<'a> {
    design: &'a Design,
    entropy: &'a NoiseEntropy,
    warm: bool,
}

impl Scorer<'_> {
    fn score(
        &self,
        model: &CausalModel,
        test: &PatchBatch,
        steps: usize,
        started: Instant,
        remaining: Option<Duration>,
    ) -> Result<LiveEstimate, InformationError> {
        let maps = information_map(model, self.entropy, test)?;
        let information: Vec<f64> = maps.outer_iter().map(|bits| bits.mean().unwrap_or(f64::NAN)).collect();
        let per_patch = self.entropy.patch_bits(test.clean.as_ref().unwrap_or(&test.noisy).view())?;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let (bits_per_pixel, entropy_y_given_x) = (mean(&information), mean(&per_patch));
        let shown = s![..SHOWN.min(maps.len_of(Axis(0))), .., ..];
        Ok(LiveEstimate {
            bits_per_pixel,
            interval_95: paired_interval(&information, self.design.seed)?,
            entropy_y: bits_per_pixel + entropy_y_given_x,
            entropy_y_given_x,
            patch: model.patch(),
            test_patches: information.len(),
            steps,
            seconds: started.elapsed().as_secs_f64(),
            remaining,
            warm: self.warm,
            gradient: None,
            lower: None,
            upper: None,
            mean_map: maps.mean_axis(Axis(0)).unwrap_or_default().mapv(|bits| bits as f32),
            maps: maps.slice(shown).mapv(|bits| bits as f32),
            patches: test.noisy.slice(shown).to_owned(),
        })
    }
}

/// Both batches, one after the other.
fn joined(one: &PatchBatch, other: &PatchBatch) -> Result<PatchBatch, InformationError> {
    let both = |a: &Array3<f32>, b: &Array3<f32>| {
        ndarray::concatenate(Axis(0), &[a.view(), b.view()])
            .map_err(|error| InformationError::Stream { reason: error.to_string() })
    };
    let clean = match (&one.clean, &other.clean) {
        (Some(one), Some(other)) => Some(both(one, other)?),
        _ => None,
    };
    Ok(PatchBatch { noisy: both(&one.noisy, &other.noisy)?, clean })
}
