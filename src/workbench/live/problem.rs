//! A design as its live estimate sees it: patches, model, scores.

use crate::progress::CancelToken;
use crate::workbench::live::schedule::SCHEDULE;
use std::sync::{Arc, OnceLock};

use ndarray::{Array3, Axis, s};

use crate::evaluation::estimation::moments;
use crate::evaluation::scene::{EvaluationError, LIVE_PATCH, Scene, ceiling_of};
use crate::forward::{Design, ForwardModel};
use crate::information::MeasurementStream;
use crate::information::{
    BeadChannel, CausalFit, CausalModel, CausalRequest, CausalStart, Estimator, FitLength, InformationError, Init,
    NoiseEntropy, PatchBatch, PatchStream, Protocol, SharedImages, cancellable_information_map, causal_model,
    paired_interval,
};
use crate::nn::Averaging;
use crate::objects::Split;
use crate::seeds::SeedStream;
use crate::sensor::{Convolver, Noise};
use crate::workbench::live::bounds::BeadBoundState;
use crate::workbench::live::estimate::{LiveEstimate, ReplayRecipe};

/// Share of the usual learning rate of a warm start from the model of a similar design, and the number of steps up to which it holds. For
/// more steps the share falls with their cube root. A long fit does not need large steps, and is nearer to convergence throughout.
const WARM_RATE: (f64, f64) = (0.35, 1400.0);
/// Averaging of the weights of such a fit, over more of its steps. Seconds after an edit, while rates are still high, the estimate is
/// then nearer to its converged value.
const WARM_AVERAGING: Averaging = Averaging::LastShare(0.3);
/// Bits per pixel above another bound at which a bound counts as loose.
const LOOSE: f64 = 0.02;
/// Number of patches whose own maps are kept.
const SHOWN: usize = 8;

/// A design with the inputs of its estimates.
pub(crate) struct LiveProblem<'a> {
    design: &'a Design,
    forward: &'a ForwardModel,
    pub patch: (usize, usize),
    convolver: Convolver,
    pub channel: Option<BeadChannel>,
    entropy: NoiseEntropy,
    psf: Array3<f64>,
    /// The object-entropy bound, once it was requested.
    ceiling: OnceLock<Option<f64>>,
}

impl<'a> LiveProblem<'a> {
    /// The problem for [`Design::bounding`] and its forward. The beads keep the noise of the design.
    pub fn new(
        design: &'a Design,
        noise: Noise,
        scene: &Scene,
        forward: &'a ForwardModel,
    ) -> Result<Self, EvaluationError> {
        let patch = forward.patch(Some((LIVE_PATCH, LIVE_PATCH)));
        let psf = design.psf(scene.set.planes())?;
        let convolver = forward.convolver(psf.view())?;
        let channel = forward.bead_channel(psf.view(), patch).map(|channel| BeadChannel { noise, ..channel });
        let entropy = NoiseEntropy::new(design.noise, Protocol::Default)?;
        Ok(Self { design, forward, patch, convolver, channel, entropy, psf, ceiling: OnceLock::new() })
    }

    /// The channel of whole measurements with their object-entropy bound, bits per pixel; none without a prior, and where measurements
    /// are no larger than a patch.
    pub fn whole(&self) -> Result<Option<(BeadChannel, Option<f64>)>, InformationError> {
        let sensor = self.forward.patch(None);
        let Some(noise) = self.channel.as_ref().filter(|_| sensor != self.patch).map(|channel| channel.noise) else {
            return Ok(None);
        };
        let Some(channel) = self.forward.bead_channel(self.psf.view(), sensor) else { return Ok(None) };
        let design = Design { noise, ..self.design.clone() };
        let ceiling = ceiling_of(&design, &self.forward.set, self.psf.view(), sensor)?;
        Ok(Some((BeadChannel { noise, ..channel }, ceiling.map(|found| found.bits_per_pixel))))
    }

    /// The bounds that use a known prior, with the state before the last edit.
    pub fn beads(&self, before: Option<&Arc<Design>>) -> BeadBoundState<'_> {
        let before = before.and_then(|before| Some((Arc::clone(before), self.channel_through(before)?)));
        let mut beads = BeadBoundState::new(self.channel.as_ref(), self.design.seed);
        beads.before = before;
        beads
    }

    /// The channel of the same beads through the mask of another design. None without a prior, where the two designs differ in more than
    /// their masks, or where the masks are equal.
    fn channel_through(&self, other: &Design) -> Option<BeadChannel> {
        let (own, noise) = (self.design, self.channel.as_ref()?.noise);
        let is_seen_alike = (other.noise, other.bias_photons) == (noise, own.bias_photons);
        let is_alike = own.has_objects_of(other) && is_seen_alike && other.encoder.grid() == own.encoder.grid();
        if !is_alike || other.encoder == own.encoder {
            return None;
        }
        let psf = other.psf(self.forward.set.planes()).ok()?;
        self.forward.bead_channel(psf.view(), self.patch).map(|channel| BeadChannel { noise, ..channel })
    }

    /// Amount by which annealed importance sampling lowers the smaller one of the object-entropy bound and a density bound, bits per
    /// pixel; none where it did not run, or there is no object-entropy bound.
    pub fn lowered(&self, beads: &BeadBoundState<'_>, density: f64) -> Option<f64> {
        let (upper, _) = beads.upper.as_ref()?;
        Some(self.ceiling()?.min(density) - upper.bits_per_pixel)
    }

    /// Whether a bound that uses the prior is far below a density bound. The density bound then says more about its model than about the
    /// mask.
    pub fn is_loose(&self, beads: &BeadBoundState<'_>, density: f64) -> bool {
        let upper = beads.upper.as_ref().map(|(upper, _)| upper.bits_per_pixel);
        self.ceiling().into_iter().chain(upper).any(|bound| bound + LOOSE < density)
    }

    fn ceiling(&self) -> Option<f64> {
        let found = || ceiling_of(self.design, &self.forward.set, self.psf.view(), self.patch).ok().flatten();
        *self.ceiling.get_or_init(|| Some(found()?.bits_per_pixel))
    }

    pub fn stream(&self, split: Split) -> MeasurementStream {
        self.forward.stream(self.convolver.clone(), split, self.patch)
    }

    /// Returns `count` held-out patches, each of an object of its own. A smaller batch is the beginning of a larger one, so that
    /// successive scores differ little.
    pub fn test(&self, count: usize) -> Result<PatchBatch, InformationError> {
        let stream = self.stream(Split::Test);
        let (first, more) = self.parts(count);
        let some = stream.draw_one_each(first.0, first.1)?;
        if more.0 == 0 { Ok(some) } else { joined(&some, &stream.draw_one_each(more.0, more.1)?) }
    }

    /// Numbers and seeds of the two parts of `count` held-out patches.
    fn parts(&self, count: usize) -> ((usize, u64), (usize, u64)) {
        let first = count.min(SCHEDULE.score_patches);
        (
            (first, SeedStream::TestPatches.derive(self.design.seed)),
            (count - first, SeedStream::MoreTestPatches.derive(self.design.seed)),
        )
    }

    /// The base images that `count` held-out patches show.
    fn shared(&self, count: usize) -> Result<SharedImages, InformationError> {
        let stream = self.stream(Split::Test);
        let (first, more) = self.parts(count);
        let of = |(count, seed): (usize, u64)| stream.shared_images(self.forward, self.psf.view(), count, seed);
        let some = of(first)?.unwrap_or_default();
        Ok(if more.0 == 0 { some } else { some.and(of(more)?.unwrap_or_default()) })
    }

    /// Fresh patches for the fit, and the validation patches of a fit to few images.
    pub fn fitting(&self) -> Result<(MeasurementStream, Option<PatchBatch>), InformationError> {
        self.forward.fitting(&self.convolver, self.patch, SeedStream::LivePatches.derive(self.design.seed))
    }

    /// The model before its fit.
    pub fn model(
        &self,
        train: &dyn PatchStream,
        test: &PatchBatch,
        start: Option<&CausalStart>,
    ) -> Result<CausalModel, EvaluationError> {
        Ok(causal_model(&CausalRequest {
            stream: train,
            test,
            validation: None,
            keeper: None,
            moments: Some(&moments(self.design, self.forward, self.forward.set.fitting_parts().0, self.patch)?),
            noise: self.design.noise,
            length: FitLength::Steps(0),
            init: start.map_or(Init::Pretrained, Init::Warm),
            estimator: Estimator::Causal,
            seed: self.seed(),
        })?)
    }

    fn seed(&self) -> u64 {
        SeedStream::LiveFit.derive(self.design.seed)
    }

    pub fn fit(&self, planned: usize, warm: bool) -> CausalFit {
        let fit = CausalFit::new(FitLength::Steps(planned), self.seed());
        let share = WARM_RATE.0 * (WARM_RATE.1 / planned.max(1) as f64).cbrt().min(1.0);
        if warm { CausalFit { rate: share * fit.rate, averaging: WARM_AVERAGING, ..fit } } else { fit }
    }

    /// Scores a model on held-out patches; the recipe of the estimate is that of its fit. `cancel` is checked every few patches.
    pub fn score(
        &self,
        model: &CausalModel,
        test: &PatchBatch,
        recipe: ReplayRecipe,
        start: Option<Arc<CausalStart>>,
        cancel: &CancelToken,
    ) -> Result<LiveEstimate, InformationError> {
        let maps = cancellable_information_map(model, &self.entropy, test, cancel)?;
        let information: Vec<f64> = maps.outer_iter().map(|bits| bits.mean().unwrap_or(f64::NAN)).collect();
        let per_patch = self.entropy.patch_bits(test.clean.as_ref().unwrap_or(&test.noisy).view())?;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let (bits_per_pixel, entropy_y_given_x) = (mean(&information), mean(&per_patch));
        let independent = paired_interval(&information, self.design.seed)?;
        let interval_95 = self.shared(information.len())?.inflate_interval(&information, bits_per_pixel, independent);
        let shown = s![..SHOWN.min(maps.len_of(Axis(0))), .., ..];
        Ok(LiveEstimate {
            bits_per_pixel,
            interval_95,
            entropy_y: bits_per_pixel + entropy_y_given_x,
            entropy_y_given_x,
            patch: model.patch(),
            seconds: 0.0,
            remaining: None,
            bounding: false,
            recipe: ReplayRecipe {
                steps: recipe.steps,
                test_patches: information.len(),
                revised: recipe.revised,
                ..ReplayRecipe::of(recipe.planned)
            },
            start,
            model: Arc::new(model.clone()),
            pulls: None,
            lower: None,
            upper: None,
            sensor: None,
            before: None,
            edit: None,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::information_map;
    use crate::optics::{Encoder, heuristic_layout};

    /// The difference of an edit must not drown in the noise of both numbers: the same scenes are measured with the same random
    /// numbers before and after it.
    #[test]
    fn designs_before_and_after_an_edit_are_scored_on_the_same_draws() {
        let before = Design { encoder: Encoder::Lenslets(heuristic_layout(4)), ..Design::default() };
        let mut array = heuristic_layout(4);
        array.lenslets[0].x += 0.25;
        let after = Design { encoder: Encoder::Lenslets(array), ..before.clone() };
        let reseeded = Design { seed: before.seed + 1, ..after.clone() };
        let scene = Arc::new(Scene::open(&before, &mut CancelToken::new()).unwrap());
        let mut known = None;
        let mut bits = |design: &Design| -> Vec<f64> {
            let forward = ForwardModel::of_objects(design, Arc::clone(&scene.set)).unwrap();
            let subject = LiveProblem::new(design, design.noise, &scene, &forward).unwrap();
            let (train, test) = (subject.stream(Split::Train), subject.test(96).unwrap());
            let model = known.get_or_insert_with(|| subject.model(&train, &test, None).unwrap());
            let maps = information_map(model, &subject.entropy, &test).unwrap();
            maps.outer_iter().map(|map| map.mean().unwrap()).collect()
        };
        let [before, after, reseeded] = [&before, &after, &reseeded].map(&mut bits);
        let spread = |of: &[f64]| {
            let mean = of.iter().sum::<f64>() / of.len() as f64;
            (of.iter().map(|bits| (bits - mean).powi(2)).sum::<f64>() / of.len() as f64).sqrt()
        };
        let difference =
            |of: &[f64]| spread(&of.iter().zip(&before).map(|(one, other)| one - other).collect::<Vec<_>>());
        let (common, own) = (difference(&after), difference(&reseeded));
        assert!(common < 0.4 * own && own > spread(&before), "{common} {own} {}", spread(&before));
    }
}
