//! Gradient steps of one round. A step has several substeps; fits and checkpoints are computed in parts between them, so that the
//! mask moves smoothly.

use super::{IdealOptimizer, Moment};
use crate::design::adam::{PARAMETERS, ParameterGradient, by_parameters};
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::design::objective_model::{ModelFit, lower_bound};
use crate::design::observer::RunObserver;
use crate::design::state::IdealEvent;
use crate::information::InformationError;
use crate::objects::Split;
use crate::optics::LensletArray;
use crate::progress::CancelToken;
use crate::seeds::SeedStream;

/// Refused steps after which a run fails.
const MAX_REFUSED: usize = 30;
/// Patches whose gradient is computed between two substeps, if any: enough for two cores.
const PATCHES_AT_ONCE: usize = 2;
/// Scenes of a checkpoint that are computed between two substeps, if any.
const SCENES_AT_ONCE: usize = 8;

/// Position of a substep: its index and their number.
#[derive(Clone, Copy)]
struct Substep {
    index: usize,
    of: usize,
}

impl IdealOptimizer<'_> {
    /// Takes the steps of a round, and computes the checkpoint of the current mask in the course of them.
    pub(super) fn ascend_with_checkpoint(&mut self, observer: &RunObserver<'_>) -> Result<(), IdealError> {
        let moment = Moment { step: self.state.step, array: self.state.array.clone(), seconds: observer.seconds() };
        let gains = self.ascend(Some(&moment.array), observer)?;
        let checkpoint = self.checkpoint_of(moment, lower_bound(gains))?;
        self.state.checkpoints.push(checkpoint);
        self.backtrack(observer)
    }

    /// Takes the steps of a round, or one step where the model stays as it is.
    ///
    /// A causal model trains before every substep. A decoder trains for the next round in the course of this one, and computes the
    /// information gain of all held-out scenes through the mask `evaluated`, which is returned in bits.
    pub(super) fn ascend(
        &mut self,
        evaluated: Option<&LensletArray>,
        observer: &RunObserver<'_>,
    ) -> Result<Vec<f64>, IdealError> {
        let steps = if self.settings.warm {
            self.settings.refit_every.min(self.settings.steps.saturating_sub(self.state.step))
        } else {
            self.steps_left_in_round().min(1)
        };
        let substeps = self.settings.substeps.min(self.patches());
        let all = steps * substeps;
        let seed = SeedStream::OnlineFit { step: self.state.step }.derive(self.settings.seed);
        let fit = ModelFit { steps: self.settings.refit_from(self.state.step), seed, warm: true };
        let (mut refit, mut gains) = (None, Vec::new());
        if let Some(posterior) = self.model.posterior().filter(|_| self.settings.warm && steps > 0) {
            refit = Some(posterior.refit(&fit)?);
        }
        let mut partial = PartialStep::new(&self.state.array);
        for number in 1..=all {
            let substep = Substep { index: (number - 1) % substeps, of: substeps };
            let due = fit.steps * number / all;
            if self.settings.warm {
                let progress = &mut |_: &usize| observer.notify(&self.state, None);
                self.state.model_up_to_date = self.model.fit_online(&fit, &self.state.array, due, progress)?;
            }
            let (mut fitted, failed) = (Ok(()), CancelToken::new());
            let gradient = rayon::in_place_scope(|scope| {
                if let (Some(refit), Some(posterior)) = (&mut refit, self.model.posterior()) {
                    let array = &self.state.array;
                    let (fitted, cancel) = (&mut fitted, &failed);
                    scope.spawn(move |_| *fitted = posterior.continue_fit(refit, array, due, cancel));
                }
                let evaluated =
                    evaluated.map_or(Ok(()), |array| self.evaluate_share(array, number, all, &mut gains, observer));
                let gradient = evaluated.and_then(|()| self.substep_gradient(substep, observer));
                if gradient.is_err() {
                    failed.cancel();
                }
                gradient
            })?;
            fitted?;
            self.take_substep(substep, &gradient, &mut partial)?;
            self.state.seconds = observer.seconds();
            if observer.notify(&self.state, None).is_break() {
                return Err(InformationError::Cancelled.into());
            }
        }
        self.state.steps_left_in_round = self.state.steps_left_in_round.saturating_sub(steps);
        if let Some(refit) = refit {
            self.model.install(refit);
            self.state.model_up_to_date = true;
        }
        Ok(gains)
    }

    /// Patches of a step.
    fn patches(&self) -> usize {
        let patches = self.settings.patches;
        self.model.posterior().map_or(patches, |posterior| posterior.equivalent_scenes(patches))
    }

    /// Extends the gains of the held-out scenes to the share `part / all` of them.
    fn evaluate_share(
        &self,
        array: &LensletArray,
        part: usize,
        all: usize,
        gains: &mut Vec<f64>,
        observer: &RunObserver<'_>,
    ) -> Result<(), IdealError> {
        let Some(posterior) = self.model.posterior() else { return Ok(()) };
        let due = posterior.scenes() * part / all / SCENES_AT_ONCE * SCENES_AT_ONCE;
        if gains.len() < due {
            let progress = &mut |_: &usize| observer.notify(&self.state, None);
            gains.extend(posterior.held_out_gains(array, gains.len()..due, progress)?);
        }
        Ok(())
    }

    /// Gradient of the information by the patches of one substep, weighted by their share of the step; zero where the substep has
    /// none.
    fn substep_gradient(
        &self,
        substep: Substep,
        observer: &RunObserver<'_>,
    ) -> Result<Vec<ParameterGradient>, IdealError> {
        let (array, patches) = (&self.state.array, self.patches());
        let due = |index: usize| {
            if index < substep.of { patches * index / substep.of / PATCHES_AT_ONCE * PATCHES_AT_ONCE } else { patches }
        };
        let share = due(substep.index + 1) - due(substep.index);
        if share == 0 {
            return Ok(vec![[0.0; PARAMETERS]; array.lenslets.len()]);
        }
        let stream = SeedStream::Step { substep: substep.index, step: self.state.step };
        let draw = GradientDraw {
            split: Split::Train,
            objects: (self.settings.objects * share / patches).max(1),
            patches: share,
            seed: stream.derive(self.settings.seed),
        };
        let progress = &mut |_: &usize| observer.notify(&self.state, None);
        let mut gradient = by_parameters(array, &self.model.gradient(array, &draw, progress)?);
        let weight = share as f64 / patches as f64;
        gradient.iter_mut().flatten().for_each(|derivative| *derivative *= weight);
        Ok(gradient)
    }

    /// Takes one substep. The last of a step updates Adam by the sum of the gradients; it takes all substeps back where that sum is
    /// not finite.
    fn take_substep(
        &mut self,
        substep: Substep,
        gradient: &[ParameterGradient],
        partial: &mut PartialStep,
    ) -> Result<(), IdealError> {
        if substep.index == 0 {
            *partial = PartialStep::new(&self.state.array);
        }
        for (sum, derivative) in partial.gradient.iter_mut().flatten().zip(gradient.iter().flatten()) {
            *sum += derivative;
        }
        let state = &mut self.state;
        let scale = state.step_scale * self.settings.rate(state.step + 1) / substep.of as f64;
        if substep.index + 1 == substep.of {
            state.step += 1;
            if partial.gradient.iter().flatten().any(|derivative| !derivative.is_finite()) {
                state.array.clone_from(&partial.before);
                state.events.push(IdealEvent::Refused { step: state.step });
                state.step_scale *= 0.5;
                let refused = state.events.iter().filter(|event| matches!(event, IdealEvent::Refused { .. })).count();
                return if refused < MAX_REFUSED { Ok(()) } else { Err(IdealError::Diverged { refused }) };
            }
            let free = self.settings.free_lenslets(state.array.lenslets.len(), &state.pruned);
            state.adam.update(&partial.gradient, &free);
        }
        state.adam.apply(&mut state.array, &self.settings, &self.limits, &state.pruned, scale);
        Ok(())
    }
}

/// A step of which some substeps are done.
struct PartialStep {
    /// The mask before the first substep.
    before: LensletArray,
    /// Sum of the gradients so far.
    gradient: Vec<ParameterGradient>,
}

impl PartialStep {
    fn new(before: &LensletArray) -> Self {
        Self { before: before.clone(), gradient: vec![[0.0; PARAMETERS]; before.lenslets.len()] }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::tests::{beads, few_beads, short, small, weights_in};
    use super::*;
    use crate::design::settings::{IdealSettings, Objective, Preset};
    use crate::design::state::{IdealProgress, Phase};
    use crate::forward::ForwardModel;
    use crate::optics::Lenslet;
    use crate::sensor::Noise;

    #[test]
    fn mask_is_reported_after_every_substep() {
        let set = few_beads();
        let forward = ForwardModel::new(set.clone(), (16, 16), 10.0, Noise::Shot).unwrap();
        let lenslets = [4.0, 11.0].map(|x| Lenslet::round(x, 7.5, 1.2, 0.5));
        let mut ideal = short(&forward, &lenslets, 4);
        (ideal.settings.substeps, ideal.settings.patches) = (3, 6);
        let mut seen = Vec::new();
        while !ideal.is_finished() {
            let on_progress = &mut |progress: &IdealProgress<'_>| {
                seen.push((progress.state.step, progress.state.array.clone()));
                ControlFlow::Continue(())
            };
            ideal.advance(on_progress).unwrap();
        }
        let at = |step: usize| {
            let mut masks: Vec<_> = seen.iter().filter(|seen| seen.0 == step).map(|seen| seen.1.clone()).collect();
            masks.dedup();
            masks.len()
        };
        // There is no gradient before the first step is over; from then on the mask moves by thirds of a step.
        assert_eq!((at(0), at(1), at(2), at(3)), (1, 3, 3, 3));
        let checkpoints = &ideal.state.checkpoints;
        assert_eq!(checkpoints.iter().map(|checkpoint| checkpoint.step).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        for (checkpoint, next) in checkpoints.iter().zip(&checkpoints[1..]) {
            let (one, other) = (checkpoint.array.lenslets[0], next.array.lenslets[0]);
            assert!((one.x - other.x).abs() <= ideal.settings.rates.position * 1.0001, "substeps add up to one step");
        }
    }

    #[test]
    fn step_with_a_gradient_that_is_not_finite_is_refused() {
        let set = few_beads();
        let forward = ForwardModel::new(set.clone(), (16, 16), 10.0, Noise::Shot).unwrap();
        let lenslets = [4.0, 11.0].map(|x| Lenslet::round(x, 7.5, 1.2, 0.5));
        let mut ideal = short(&forward, &lenslets, 4);
        let step = |ideal: &mut IdealOptimizer<'_>, derivatives: [f64; 3]| {
            let mut partial = PartialStep::new(&ideal.state.array);
            for (index, derivative) in derivatives.into_iter().enumerate() {
                ideal.take_substep(Substep { index, of: 3 }, &[[derivative; PARAMETERS]; 2], &mut partial).unwrap();
            }
        };
        step(&mut ideal, [0.1, 0.2, 0.1]);
        let (array, adam) = (ideal.state.array.clone(), ideal.state.adam.clone());
        step(&mut ideal, [0.1, f64::NAN, 0.1]);
        assert_eq!((&ideal.state.array, &ideal.state.adam), (&array, &adam));
        assert_eq!((ideal.state.step, ideal.state.step_scale), (2, 0.5));
        assert_eq!(ideal.state.events, [IdealEvent::Refused { step: 2 }]);
        step(&mut ideal, [0.1, 0.2, 0.1]);
        assert!(ideal.state.array != array);
    }

    #[test]
    fn density_model_trains_online_and_resumed_runs_do_the_same() {
        let set = beads();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((6, 6)),
            first_fit: 60,
            // More steps than one draw of patches has.
            refit: 70,
            last_fit: 2,
            steps: 3,
            patches: 4,
            substeps: 3,
            objects: 2,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let weights = |ideal: &IdealOptimizer<'_>| {
            let mut bytes = ideal.model.to_bytes(Vec::new()).unwrap();
            weights_in(&mut bytes).to_vec()
        };
        let advance = |ideal: &mut IdealOptimizer<'_>| ideal.advance(&mut CancelToken::new()).unwrap();
        let mut whole = small(&forward, &settings);
        advance(&mut whole);
        let (bytes, before) = (whole.to_bytes().unwrap(), weights(&whole));
        let mut fitted = 0;
        let on_progress = &mut |progress: &IdealProgress<'_>| {
            fitted += usize::from(progress.phase.is_some_and(|doing| doing.0 == Phase::Fitting));
            ControlFlow::Continue(())
        };
        whole.advance(on_progress).unwrap();
        assert_eq!(fitted, 0, "the mask does not wait");
        assert!(weights(&whole) != before, "for the fit");
        while !whole.is_finished() {
            advance(&mut whole);
        }
        let mut resumed = small(&forward, &settings).resumed(&bytes).unwrap();
        while !resumed.is_finished() {
            advance(&mut resumed);
        }
        assert_eq!(resumed.state.array, whole.state.array);
        assert!(weights(&resumed) == weights(&whole), "to the bit");
    }
}
