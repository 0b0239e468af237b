//! Check of a warm density model by a cold refit: a stale model overestimates the information of masks that it does not know.

use super::IdealOptimizer;
use crate::design::error::IdealError;
use crate::design::observer::RunObserver;
use crate::design::state::{Checkpoint, IdealEvent};

/// Largest plausible gain of one round, bits per pixel; a larger one means that the model is stale.
const MOST_GAIN: f64 = 0.015;
/// Largest plausible factor by which the interval widens in one round.
const MOST_WIDENING: f64 = 1.4;
/// Rounds from one cold refit to the next.
pub(super) const COLD_FIT_EVERY: usize = 40;
/// Least step scale.
pub(super) const LEAST_STEP_SCALE: f64 = 0.25;

impl IdealOptimizer<'_> {
    /// Whether the model can overestimate the mask, because it was fitted to earlier masks.
    pub(super) fn can_be_stale(&self) -> bool {
        self.model.is_upper_bound() && self.settings.warm && !self.state.checkpoints.is_empty()
    }

    /// Whether a cold refit is due: at the end, every 40 rounds, and after the run has reverted to an earlier mask. It finds models
    /// that have become stale a little in every round.
    pub(super) fn is_due_for_cold_fit(&self, is_last: bool) -> bool {
        let step = self.state.step;
        let is_revert = |event: &IdealEvent| matches!(event, IdealEvent::Reverted { step: at, .. } if *at == step);
        is_last
            || self.state.events.iter().any(is_revert)
            || self.state.checkpoints.len().is_multiple_of(COLD_FIT_EVERY)
    }

    /// Whether the value of a checkpoint is implausible: too large a gain over the last one, or too wide an interval.
    pub(super) fn is_stale(&self, checkpoint: &Checkpoint) -> bool {
        let width = |checkpoint: &Checkpoint| checkpoint.interval_95[1] - checkpoint.interval_95[0];
        self.state.checkpoints.last().is_some_and(|last| {
            checkpoint.bits_per_pixel > last.bits_per_pixel + MOST_GAIN
                || width(checkpoint) > MOST_WIDENING * width(last)
        })
    }

    /// The checkpoint by a cold fit, which replaces the model, where its upper bound is lower; the same checkpoint with the cold bound
    /// beside it otherwise.
    pub(super) fn checked_by_cold_fit(
        &mut self,
        checkpoint: Checkpoint,
        is_last: bool,
        observer: &RunObserver<'_>,
    ) -> Result<Checkpoint, IdealError> {
        let before = self.model.to_bytes(Vec::new())?;
        self.model.retarget(&self.state.array, false)?;
        self.fit(self.settings.first_fit, 1, observer)?;
        let mut cold = self.checkpoint(is_last, observer)?;
        cold.cold_fit_bits = Some(cold.bits_per_pixel);
        // Both are upper bounds: the lower one is tighter.
        if cold.bits_per_pixel < checkpoint.bits_per_pixel {
            self.state.events.push(IdealEvent::Refitted { step: self.state.step });
            self.state.step_scale = (0.5 * self.state.step_scale).max(LEAST_STEP_SCALE);
            // A run that is resumed in this round has the model with the same intensity grid.
            self.model.retarget(&self.state.array, true)?;
            return Ok(cold);
        }
        self.model.restore(&before)?;
        self.model.retarget(&self.state.array, true)?;
        Ok(Checkpoint { cold_fit_bits: cold.cold_fit_bits, ..checkpoint })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{beads, small, without_weights};
    use super::*;
    use crate::design::gradient::GradientDraw;
    use crate::design::objective_model::{MaskGradient, ModelFit, ModelValue, ObjectiveModel};
    use crate::design::settings::{IdealSettings, Objective, Preset};
    use crate::forward::ForwardModel;
    use crate::optics::LensletArray;
    use crate::progress::{CancelToken, Progress};
    use crate::sensor::Noise;

    #[test]
    fn cold_fit_replaces_a_stale_model() {
        let set = beads();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((6, 6)),
            first_fit: 40,
            refit: 1,
            steps: 2,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let mut ideal = small(&forward, &settings);
        let advance = |ideal: &mut IdealOptimizer<'_>| ideal.advance(&mut CancelToken::new()).unwrap();
        advance(&mut ideal);
        assert_eq!(ideal.state.events, []);
        // A model without weights overestimates the mask by far.
        let bytes = ideal.model.to_bytes(Vec::new()).unwrap();
        ideal.model.restore(&without_weights(bytes)).unwrap();
        advance(&mut ideal);
        assert_eq!(ideal.state.events, [IdealEvent::Refitted { step: 1 }]);
        let [before, after] = &ideal.state.checkpoints[..] else { panic!("two checkpoints") };
        assert!((after.bits_per_pixel - before.bits_per_pixel).abs() < 0.1, "{before:?} {after:?}");
        assert_eq!(ideal.state.step, 2);
        // After a revert the model was fitted to other masks.
        assert!(!ideal.is_due_for_cold_fit(false));
        ideal.state.events.push(IdealEvent::Reverted { step: 2, to: 0 });
        assert!(ideal.is_due_for_cold_fit(false));
    }

    /// A model without weights after every cold fit.
    struct ForgetsColdFits<'a>(Box<dyn ObjectiveModel + 'a>);

    impl ObjectiveModel for ForgetsColdFits<'_> {
        fn retarget(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError> {
            self.0.retarget(array, warm)
        }

        fn fit(&mut self, fit: &ModelFit, progress: &mut dyn Progress<f64>) -> Result<(), IdealError> {
            self.0.fit(fit, progress)?;
            if fit.warm { Ok(()) } else { self.0.restore(&without_weights(self.0.to_bytes(Vec::new())?)) }
        }

        fn fit_online(
            &mut self,
            fit: &ModelFit,
            array: &LensletArray,
            steps: usize,
            progress: &mut dyn Progress<usize>,
        ) -> Result<bool, IdealError> {
            self.0.fit_online(fit, array, steps, progress)
        }

        fn value(
            &self,
            array: &LensletArray,
            last: bool,
            progress: &mut dyn Progress<usize>,
        ) -> Result<ModelValue, IdealError> {
            self.0.value(array, last, progress)
        }

        fn gradient(
            &self,
            array: &LensletArray,
            draw: &GradientDraw,
            progress: &mut dyn Progress<usize>,
        ) -> MaskGradient {
            self.0.gradient(array, draw, progress)
        }

        fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
            self.0.to_bytes(details)
        }

        fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
            self.0.restore(bytes)
        }

        fn is_upper_bound(&self) -> bool {
            self.0.is_upper_bound()
        }
    }

    #[test]
    #[ignore = "takes a minute or more; run with --ignored"]
    fn run_resumes_bit_for_bit_across_a_cold_fit() {
        let set = beads();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((5, 5)),
            first_fit: 1,
            refit: 4,
            steps: COLD_FIT_EVERY + 2,
            patches: 2,
            objects: 1,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let begun = || {
            let ideal = small(&forward, &settings);
            IdealOptimizer { model: Box::new(ForgetsColdFits(ideal.model)), ..ideal }
        };
        let mut whole = begun();
        let mut kept = Vec::new();
        while !whole.is_finished() {
            whole.advance(&mut CancelToken::new()).unwrap();
            if [COLD_FIT_EVERY, COLD_FIT_EVERY + 1].contains(&whole.state.checkpoints.len()) {
                kept.push(whole.to_bytes().unwrap());
            }
        }
        assert_eq!(kept.len(), 2);
        let refitted = IdealEvent::Refitted { step: COLD_FIT_EVERY };
        assert!(!whole.state.events.contains(&refitted), "the warm model stays");
        for bytes in kept {
            let mut resumed = begun().resumed(&bytes).unwrap();
            while !resumed.is_finished() {
                resumed.advance(&mut CancelToken::new()).unwrap();
            }
            assert_eq!(resumed.state.array, whole.state.array);
            let bits = |ideal: &IdealOptimizer<'_>| -> Vec<f64> {
                ideal.state.checkpoints.iter().map(|checkpoint| checkpoint.bits_per_pixel).collect()
            };
            assert_eq!(bits(&resumed), bits(&whole));
        }
    }
}
