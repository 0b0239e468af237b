//! IDEAL: gradient ascent of the mask on the information of its measurements, under a model that is refitted to the mask
//! (Kabuli et al. 2026).

mod ascent;
mod backtracking;
mod cardinality;
mod refit_check;
mod relocation;

use ndarray::Array4;
use serde_json::json;

use super::error::IdealError;
use super::merge::merged;
use super::objective_model::{DensityModel, ModelFit, ModelValue, ObjectiveModel, PixelCnnModel, PosteriorModel};
use super::observer::RunObserver;
use super::projection::project;
use super::settings::{IdealSettings, Objective};
use super::state::{Checkpoint, IdealEvent, IdealProgress, IdealState, Phase};
use crate::formats::{content_key, json_of};
use crate::forward::ForwardModel;
use crate::information::{
    CausalModel, DecoderProgress, DecoderTest, InformationError, NUMBERS_VERSION, PretrainedLowerBound,
};
use crate::nn::read_detail;
use crate::objects::Split;
use crate::optics::{LensletArray, Limits, Spot, render_psf};
use crate::progress::Progress;
use crate::seeds::SeedStream;
use crate::sparsity::tamura_of_stack;

/// Held-out measurements that the Tamura coefficient is computed from.
const TAMURA_IMAGES: usize = 32;
/// Factor by which the step scale recovers in every round.
const RECOVERY: f64 = 1.2;
/// Checkpoints from one lower bound beside an upper one to the next, and the samples of each.
const LOWER_EVERY: usize = 5;
const LOWER_SAMPLES: usize = 512;

/// Optimizer of a mask. It advances round by round, and can be saved between two rounds.
///
/// ```no_run
/// use lenslet_studio::prelude::*;
///
/// let design = Design { encoder: Encoder::Lenslets(random_layout(9, 1)), ..Design::default() };
/// let model = ForwardModel::open(&design)?;
/// let settings = IdealSettings { steps: 100, ..IdealSettings::new(Preset::Default, Objective::Posterior, 1) };
/// let mut optimizer = IdealOptimizer::new(&model, &random_layout(9, 1), design.limits, settings)?;
/// while !optimizer.is_finished() {
///     optimizer.advance(&mut CancelToken::new())?;
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct IdealOptimizer<'a> {
    forward: &'a ForwardModel,
    /// The mask before the first step, within the limits.
    start: LensletArray,
    limits: Limits,
    settings: IdealSettings,
    patch: (usize, usize),
    /// Held-out objects for the Tamura coefficient, shape (n, planes, rows, cols).
    held_out: Array4<f32>,
    model: Box<dyn ObjectiveModel + 'a>,
    state: IdealState,
}

/// A mask of the run at one moment.
struct Moment {
    step: usize,
    array: LensletArray,
    seconds: f64,
}

impl<'a> IdealOptimizer<'a> {
    /// An optimizer that starts from a mask, projected to the limits.
    ///
    /// # Errors
    /// Where settings, mask, objects and noise do not allow a run.
    pub fn new(
        forward: &'a ForwardModel,
        start: &LensletArray,
        limits: Limits,
        settings: IdealSettings,
    ) -> Result<Self, IdealError> {
        start.check()?;
        settings.check(start)?;
        let patch = forward.patch(settings.patch);
        // No patch is larger than the measurement; the record holds the patch that is used.
        let settings = IdealSettings { patch: settings.patch.map(|_| patch), ..settings };
        let mut array = start.clone().with_unit_weight();
        if settings.anisotropic {
            for lenslet in &mut array.lenslets {
                let (xx, xy, yy) = lenslet.spot.covariance();
                lenslet.spot = Spot::Anisotropic { xx, xy, yy };
            }
        }
        project(&mut array, &settings, &limits);
        let model: Box<dyn ObjectiveModel + 'a> = match settings.objective {
            Objective::Density => Box::new(DensityModel::new(forward, &array, &limits, patch, settings.seed)?),
            Objective::PixelCnn => Box::new(PixelCnnModel::new(forward, &array, patch, settings.seed)?),
            Objective::Posterior => Box::new(PosteriorModel::new(forward, &array, patch, settings.seed)?),
        };
        let (start, state) = (array.clone(), IdealState::new(array, settings.steps));
        let held_out =
            forward.set.objects(Split::Test, TAMURA_IMAGES, SeedStream::HeldOutObjects.derive(settings.seed))?;
        Ok(Self { forward, start, limits, settings, patch, held_out, model, state })
    }

    /// The same run in the state of [`IdealOptimizer::to_bytes`]. It continues bit for bit as an uninterrupted one, over the number
    /// of steps that it was planned for.
    ///
    /// # Errors
    /// For bytes that are no state of this run.
    pub fn resumed(mut self, bytes: &[u8]) -> Result<Self, IdealError> {
        let other = |reason: String| IdealError::OtherRun { reason };
        let key = read_detail(bytes, "key").map_err(|error| other(error.to_string()))?;
        if key != self.key() && key != self.earlier_key() {
            return Err(other("it was started from another mask, scene or setting, or by another version".into()));
        }
        let state = Self::state_in(bytes)?;
        if let Some(checkpoint) = state.checkpoints.last() {
            if state.steps_left_in_round > 0 {
                // Within a round the model belongs to the mask of the checkpoint.
                self.model.retarget(&checkpoint.array, false)?;
            }
            self.model.restore(bytes)?;
            if state.model_up_to_date {
                // The model was fitted to the mask of the round before.
                self.model.retarget(&checkpoint.array, true)?;
            }
        }
        if state.planned > 0 {
            self.settings.steps = state.planned;
        }
        self.state = state;
        Ok(self)
    }

    /// The state in the bytes of [`IdealOptimizer::to_bytes`].
    ///
    /// # Errors
    /// For bytes that are no state of a run.
    pub fn state_in(bytes: &[u8]) -> Result<IdealState, IdealError> {
        let text = read_detail(bytes, "run").map_err(InformationError::from)?;
        serde_json::from_str(&text).map_err(|error| IdealError::OtherRun { reason: error.to_string() })
    }

    /// State and weights of the run, as the bytes of a safetensors file.
    ///
    /// # Errors
    /// Where the weights cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>, IdealError> {
        let run =
            serde_json::to_string(&self.state).map_err(|error| IdealError::OtherRun { reason: error.to_string() })?;
        self.model.to_bytes(vec![("key", self.key()), ("run", run)])
    }

    /// Key of the run: equal for runs that differ in their number of steps alone.
    fn key(&self) -> String {
        content_key(&json!([NUMBERS_VERSION, {
            "settings": self.settings.identity(),
            "start": json_of(&self.start),
            "limits": json_of(&self.limits),
            "objects": self.forward.set.fingerprint(),
            "bias_photons": self.forward.bias,
            "noise": self.forward.noise.to_string(),
            "patch": [self.patch.0, self.patch.1],
        }]))
    }

    /// Key of the same run in the notation of earlier versions. It holds the version of the numbers, and can be deleted when that
    /// changes.
    fn earlier_key(&self) -> String {
        let (settings, start) = (self.settings.earlier_identity(), &self.start);
        let forward = (self.forward.set.fingerprint(), self.forward.bias, self.forward.noise, self.patch);
        blake3::hash(format!("{NUMBERS_VERSION} {settings} {start:?} {forward:?} {:?}", self.limits).as_bytes())
            .to_hex()
            .to_string()
    }

    /// State of the run.
    pub fn state(&self) -> &IdealState {
        &self.state
    }

    /// Settings of the run.
    pub fn settings(&self) -> &IdealSettings {
        &self.settings
    }

    /// Fingerprint of the objects.
    pub fn objects_fingerprint(&self) -> String {
        self.forward.set.fingerprint()
    }

    /// The causal density model as it was fitted last, where the objective has one.
    pub fn density_model(&self) -> Option<&CausalModel> {
        self.model.density_model()
    }

    /// Whether the last fit is done.
    pub fn is_finished(&self) -> bool {
        self.state.finished
    }

    /// Checks that the run can reach `steps` steps: an unfinished run keeps the number of steps that it was planned for, or is
    /// extended afterwards.
    ///
    /// # Errors
    /// [`IdealError::Setting`] for fewer steps than an unfinished run was planned for.
    pub fn check_length(&self, steps: usize) -> Result<(), IdealError> {
        if self.state.finished || steps >= self.settings.steps {
            return Ok(());
        }
        Err(IdealError::Setting {
            name: "steps",
            found: steps.to_string(),
            expected: "at least the steps that the run was planned for",
        })
    }

    /// Extends a finished run to `steps` steps of the mask; without effect where it has as many.
    pub fn extend_to(&mut self, steps: usize) {
        let step = self.state.step;
        if self.state.finished && steps > step {
            self.settings.steps = steps.min(IdealSettings::MOST.max(step));
            self.state.planned = self.settings.steps;
            self.state.finished = false;
            self.state.events.push(IdealEvent::Extended { step });
        }
    }

    /// Computes one round: refits the objective model to the mask, adds a checkpoint with the information on held-out objects, and
    /// takes the gradient steps up to the next round.
    ///
    /// A decoder trains in the course of these steps for the next round; the checkpoint is then computed in the course of them as
    /// well. Where fits are cold, which take long, one call does a part of a round: fit and checkpoint, or one step. States for
    /// [`IdealOptimizer::to_bytes`] lie between two calls.
    ///
    /// # Errors
    /// Where objects or model fail, too many steps are refused, or `progress` cancels. The mask then stays where the last
    /// step has left it.
    pub fn advance(&mut self, progress: &mut dyn for<'b> Progress<IdealProgress<'b>>) -> Result<(), IdealError> {
        let observer = RunObserver::new(progress, self.state.seconds);
        if self.steps_left_in_round() > 0 {
            self.ascend(None, &observer)?;
            self.state.seconds = observer.seconds();
            return Ok(());
        }
        self.prune();
        self.relocate(&observer)?;
        let (is_first, is_last) = (self.state.checkpoints.is_empty(), self.state.step >= self.settings.steps);
        // The steps are as large as the model allows.
        self.state.step_scale = (self.state.step_scale * RECOVERY).min(1.0);
        let is_up_to_date = std::mem::take(&mut self.state.model_up_to_date) && !is_last;
        match (is_up_to_date, self.model.is_upper_bound()) {
            (false, _) => {
                let steps = match (is_last, is_first || !self.settings.warm) {
                    (true, _) => self.settings.last_fit,
                    (false, true) => self.settings.first_fit,
                    (false, false) => self.settings.refit,
                };
                self.model.retarget(&self.state.array, self.settings.warm)?;
                self.fit(steps, 0, &observer)?;
                self.add_checkpoint(is_last, &observer)?;
                if self.settings.warm {
                    self.ascend_unless_reverted(&observer)?;
                } else {
                    self.state.steps_left_in_round = self.settings.refit_every;
                }
            }
            // An upper bound is checked before the mask moves on, and before the scale of the model moves with it.
            (true, true) => {
                self.add_checkpoint(is_last, &observer)?;
                self.model.retarget(&self.state.array, true)?;
                self.ascend_unless_reverted(&observer)?;
            }
            (true, false) => {
                self.model.retarget(&self.state.array, true)?;
                self.ascend_with_checkpoint(&observer)?;
            }
        }
        self.state.seconds = observer.seconds();
        Ok(())
    }

    /// Takes the steps of a round, unless the run has just reverted to an earlier mask that a density model must be fitted to first.
    fn ascend_unless_reverted(&mut self, observer: &RunObserver<'_>) -> Result<(), IdealError> {
        let step = self.state.step;
        let has_reverted =
            matches!(self.state.events.last(), Some(IdealEvent::Reverted { step: at, .. }) if *at == step);
        let is_fitted = self.state.checkpoints.last().is_some_and(|last| last.array == self.state.array);
        if has_reverted && !is_fitted && self.model.is_upper_bound() {
            return Ok(());
        }
        self.ascend(None, observer).map(|_| ())
    }

    /// Steps that are left of a round whose model stays as it is.
    fn steps_left_in_round(&self) -> usize {
        self.state.steps_left_in_round.min(self.settings.steps.saturating_sub(self.state.step))
    }

    /// Adds a checkpoint of the current mask, by the model as it is; reverts to an earlier mask where that has more information.
    fn add_checkpoint(&mut self, is_last: bool, observer: &RunObserver<'_>) -> Result<(), IdealError> {
        let mut checkpoint = self.checkpoint(is_last, observer)?;
        if self.can_be_stale() && (self.is_stale(&checkpoint) || self.is_due_for_cold_fit(is_last)) {
            checkpoint = self.checked_by_cold_fit(checkpoint, is_last, observer)?;
        } else if self.state.checkpoints.is_empty() && self.model.is_upper_bound() && self.settings.warm {
            checkpoint.cold_fit_bits = Some(checkpoint.bits_per_pixel);
        }
        if is_last && let Some(better) = self.better_final(&checkpoint, observer)? {
            checkpoint = better;
        }
        if self.model.is_upper_bound() && (is_last || self.state.checkpoints.len().is_multiple_of(LOWER_EVERY)) {
            checkpoint.lower = self.lower(&checkpoint.array, observer)?;
        }
        self.state.checkpoints.push(checkpoint);
        self.state.finished = is_last;
        self.backtrack(observer)
    }

    /// Fits the model to the current mask. `part` is 0 for the fit of the round; later parts are cold fits with draws of their own.
    fn fit(&mut self, steps: usize, part: u64, observer: &RunObserver<'_>) -> Result<(), IdealError> {
        let round = self.state.checkpoints.len();
        let seed = SeedStream::RoundFit { part, round }.derive(self.settings.seed);
        let fit = ModelFit { steps, seed, warm: part == 0 && self.settings.warm && round > 0 };
        let state = &self.state;
        self.model.fit(&fit, &mut |share: &f64| observer.notify(state, Some((Phase::Fitting, *share))))
    }

    /// A checkpoint of the current mask, on the same held-out objects every time.
    fn checkpoint(&self, is_last: bool, observer: &RunObserver<'_>) -> Result<Checkpoint, IdealError> {
        let array = &self.state.array;
        let progress = &mut |_: &usize| observer.notify(&self.state, Some((Phase::Measuring, 1.0)));
        let value = self.model.value(array, is_last, progress)?;
        self.checkpoint_of(Moment { step: self.state.step, array: array.clone(), seconds: observer.seconds() }, value)
    }

    /// The checkpoint of a mask with a value of the model.
    fn checkpoint_of(&self, moment: Moment, value: ModelValue) -> Result<Checkpoint, IdealError> {
        let Moment { step, array, seconds } = moment;
        let psf = render_psf(&array, self.forward.set.planes())?;
        let encoded = self.forward.convolver(psf.view())?.measure(self.held_out.view(), self.forward.bias)?;
        let measured = self.forward.noise.draw(encoded.view(), SeedStream::TamuraNoise.derive(self.settings.seed));
        let distinct = merged(&array);
        Ok(Checkpoint {
            step,
            array,
            bits_per_pixel: value.bits_per_pixel,
            interval_95: value.interval_95,
            lower: None,
            cold_fit_bits: None,
            tamura: tamura_of_stack(measured.view()).mean().unwrap_or(0.0),
            distinct_lenslets: distinct.lenslets.len(),
            effective_lenslets: distinct.effective_count(),
            seconds,
        })
    }

    /// Lower bound by the pretrained decoder on fresh scenes; none where the prior of the objects is unknown.
    fn lower(
        &self,
        array: &LensletArray,
        observer: &RunObserver<'_>,
    ) -> Result<Option<PretrainedLowerBound>, IdealError> {
        let psf = render_psf(array, self.forward.set.planes())?;
        let Some(channel) = self.forward.bead_channel(psf.view(), self.patch) else { return Ok(None) };
        let seed = SeedStream::RunLowerBound.derive(self.settings.seed);
        let progress = &mut |_: &DecoderProgress| observer.notify(&self.state, Some((Phase::Measuring, 1.0)));
        let test = DecoderTest { samples: LOWER_SAMPLES, half_width: 0.0, seed };
        Ok(PretrainedLowerBound::new(&channel, test, progress)?)
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::settings::Preset;
    use super::*;
    use crate::design::IdealProgress;
    use crate::objects::{ObjectOptions, ObjectSet};
    use crate::optics::Lenslet;
    use crate::progress::CancelToken;
    use crate::sensor::Noise;

    pub(super) fn beads() -> ObjectSet {
        let options = ObjectOptions { field: (27, 27), mean_photons: 100.0, ..ObjectOptions::default() };
        ObjectSet::open(&"beads:0.05".parse().unwrap(), &options).unwrap()
    }

    /// One lenslet and a small sensor, with one step in every round.
    pub(super) fn small<'a>(forward: &'a ForwardModel, settings: &IdealSettings) -> IdealOptimizer<'a> {
        let start = LensletArray::new(12, 12, vec![Lenslet::round(5.0, 5.0, 1.0, 1.0)]);
        let settings = IdealSettings { refit_every: 1, ..settings.clone() };
        IdealOptimizer::new(forward, &start, Limits::default(), settings).unwrap()
    }

    /// Beads so sparse that more lenslets show more of them on a small sensor.
    pub(super) fn few_beads() -> ObjectSet {
        let options = ObjectOptions { field: (31, 31), mean_photons: 100.0, ..ObjectOptions::default() };
        ObjectSet::open(&"beads:0.01".parse().unwrap(), &options).unwrap()
    }

    /// A short run by the decoder objective with one step in every round.
    pub(super) fn short<'a>(forward: &'a ForwardModel, lenslets: &[Lenslet], steps: usize) -> IdealOptimizer<'a> {
        let start = LensletArray::new(16, 16, lenslets.to_vec());
        let settings = IdealSettings {
            patch: Some((16, 16)),
            refit_every: 1,
            first_fit: 1,
            refit: 1,
            last_fit: 1,
            patches: 2,
            relocation_candidates: 0,
            steps,
            ..IdealSettings::new(Preset::Default, Objective::Posterior, 1)
        };
        IdealOptimizer::new(forward, &start, Limits::default(), settings).unwrap()
    }

    /// All numbers of a safetensors file.
    pub(super) fn weights_in(bytes: &mut [u8]) -> &mut [u8] {
        let header = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
        &mut bytes[size_of::<u64>() + header..]
    }

    /// The bytes of a safetensors file with zeros for all numbers.
    pub(super) fn without_weights(mut bytes: Vec<u8>) -> Vec<u8> {
        weights_in(&mut bytes).fill(0);
        bytes
    }

    #[test]
    fn run_with_a_cardinality_resumes_its_own_state() {
        let set = beads();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((500, 500)),
            cardinality: Some(2),
            steps: 3,
            ..IdealSettings::new(Preset::Default, Objective::Posterior, 1)
        };
        let lenslet =
            |index: usize| Lenslet::round(2.0 + (index % 3) as f64 * 3.0, 2.0 + (index / 3) as f64 * 3.0, 1.0, 1.0);
        let start = LensletArray::new(12, 12, (0..9).map(lenslet).collect());
        let begun = || IdealOptimizer::new(&forward, &start, Limits::default(), settings.clone()).unwrap();
        let mut ideal = begun();
        ideal.advance(&mut CancelToken::new()).unwrap();
        assert_eq!(begun().resumed(&ideal.to_bytes().unwrap()).unwrap().state.array, ideal.state.array);
        // The settings hold the patch that is used.
        assert_eq!(ideal.settings().patch, Some((16, 16)));
    }

    #[test]
    fn run_can_be_stopped_within_a_step() {
        let set = beads();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((5, 5)),
            first_fit: 1,
            patches: 4096,
            ..IdealSettings::new(Preset::Paper, Objective::PixelCnn, 1)
        };
        let mut ideal = small(&forward, &settings);
        let mut calls_in_step = 0;
        let mut on_progress = |progress: &IdealProgress<'_>| {
            calls_in_step += usize::from(progress.phase.is_none());
            if calls_in_step < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        // The cold fit and the checkpoint come before.
        ideal.advance(&mut on_progress).unwrap();
        let stopped = ideal.advance(&mut on_progress);
        assert!(matches!(stopped, Err(IdealError::Information(InformationError::Cancelled))));
        assert_eq!(ideal.state.step, 0);
    }
}
