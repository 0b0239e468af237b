//! Backtracking: a run reverts to its best checkpoint when the mask has lost information. The gradient of an inexact model can
//! point downwards.

use super::IdealOptimizer;
use super::refit_check::LEAST_STEP_SCALE;
use crate::design::error::IdealError;
use crate::design::observer::RunObserver;
use crate::design::state::{Checkpoint, IdealEvent, Phase};
use crate::information::paired_gain;
use crate::optics::LensletArray;

/// Loss beyond which a run reverts to its best checkpoint, bits per pixel.
const MOST_LOSS: f64 = 0.003;
/// The same loss by cold fits of density models, which differ among each other by less.
const MOST_LOSS_OF_COLD_FITS: f64 = 0.02;

impl IdealOptimizer<'_> {
    /// The best checkpoint by numbers that can be compared, among those with the lenslets that are left.
    ///
    /// The last lower bound before an extension rests on more scenes than others. It is left out; the checkpoint of the same mask
    /// after the extension counts.
    fn best(&self) -> Option<&Checkpoint> {
        let (state, checkpoints) = (&self.state, &self.state.checkpoints);
        let is_whole =
            |checkpoint: &Checkpoint| state.pruned.iter().all(|&index| checkpoint.array.lenslets[index].weight == 0.0);
        let was_extended = |at: usize| {
            !self.model.is_upper_bound()
                && checkpoints.get(at + 1).is_some_and(|next| next.step == checkpoints[at].step)
        };
        let comparable =
            checkpoints.iter().enumerate().filter(|&(at, checkpoint)| is_whole(checkpoint) && !was_extended(at));
        let scored = comparable.filter_map(|(_, checkpoint)| Some((checkpoint, self.score(checkpoint)?)));
        scored.max_by(|(_, one), (_, other)| one.total_cmp(other)).map(|(checkpoint, _)| checkpoint)
    }

    /// Information of a checkpoint by a number that can be compared: a lower bound, or an upper bound by a cold fit. None where all
    /// fits are cold, as published.
    fn score(&self, checkpoint: &Checkpoint) -> Option<f64> {
        if self.model.is_upper_bound() {
            checkpoint.cold_fit_bits.filter(|_| self.settings.warm)
        } else {
            Some(checkpoint.bits_per_pixel)
        }
    }

    /// The best checkpoint, where it exceeds another one by more than `least` bits per pixel; by more than the uncertainty for
    /// cold fits.
    fn better(&self, checkpoint: &Checkpoint, least: f64) -> Option<&Checkpoint> {
        let best = self.best().filter(|best| best.array != checkpoint.array)?;
        let half_width = |checkpoint: &Checkpoint| 0.5 * (checkpoint.interval_95[1] - checkpoint.interval_95[0]);
        let uncertainty = || MOST_LOSS_OF_COLD_FITS.max(half_width(best).hypot(half_width(checkpoint)));
        let least = if self.model.is_upper_bound() { uncertainty() } else { least };
        (self.score(best)? - self.score(checkpoint)? > least).then_some(best)
    }

    /// Reverts to the best checkpoint where the last one has clearly less information.
    ///
    /// A decoder is asked for both masks again, with the weights that it has now: values by different fits differ for reasons
    /// beside the masks.
    pub(super) fn backtrack(&mut self, observer: &RunObserver<'_>) -> Result<(), IdealError> {
        let Some(last) = self.state.checkpoints.last().filter(|_| !self.state.finished) else { return Ok(()) };
        let Some(best) = self.better(last, MOST_LOSS) else { return Ok(()) };
        if let Some(posterior) = self.model.posterior() {
            let gains = |array: &LensletArray| {
                let progress = &mut |_: &usize| observer.notify(&self.state, Some((Phase::Measuring, 1.0)));
                posterior.held_out_gains(array, 0..posterior.scenes(), progress)
            };
            let (loss, half_width) = paired_gain(&gains(&last.array)?, &gains(&best.array)?);
            if loss < MOST_LOSS.max(half_width) {
                return Ok(());
            }
        }
        let (array, to) = (best.array.clone(), best.step);
        if self.model.is_upper_bound() {
            self.state.step_scale = (0.5 * self.state.step_scale).max(LEAST_STEP_SCALE);
        }
        self.revert_to(array, to)
    }

    /// Puts an earlier mask in place of the current one; the model has to be refitted to it.
    fn revert_to(&mut self, array: LensletArray, to: usize) -> Result<(), IdealError> {
        self.model.retarget(&array, true)?;
        let state = &mut self.state;
        state.array = array;
        state.adam.reset_all();
        state.model_up_to_date = false;
        state.events.push(IdealEvent::Reverted { step: state.step, to });
        Ok(())
    }

    /// The best checkpoint with a new fit, where it is still better than the `last` one of the run; the run has then reverted to it.
    pub(super) fn better_final(
        &mut self,
        last: &Checkpoint,
        observer: &RunObserver<'_>,
    ) -> Result<Option<Checkpoint>, IdealError> {
        let Some(best) = self.better(last, 0.0) else { return Ok(None) };
        let (array, to) = (best.array.clone(), best.step);
        let (is_cold, least) = (self.model.is_upper_bound(), self.score(last));
        let (before, state) = (self.model.to_bytes(Vec::new())?, self.state.clone());
        let again = self.revert_to(array, to).and_then(|()| {
            if is_cold {
                self.model.retarget(&self.state.array, false)?;
            }
            let (steps, part) = if is_cold { (self.settings.first_fit, 2) } else { (self.settings.last_fit, 1) };
            self.fit(steps, part, observer)?;
            self.checkpoint(true, observer)
        });
        match again {
            Ok(mut checkpoint) if Some(checkpoint.bits_per_pixel) > least => {
                checkpoint.cold_fit_bits = is_cold.then_some(checkpoint.bits_per_pixel);
                Ok(Some(checkpoint))
            }
            again => {
                self.state = state;
                self.model.restore(&before)?;
                self.model.retarget(&self.state.array, true)?;
                again.map(|_| None)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::refit_check::COLD_FIT_EVERY;
    use super::super::tests::{beads, few_beads, short, small};
    use super::*;
    use crate::design::settings::{IdealSettings, Objective, Preset};
    use crate::forward::ForwardModel;
    use crate::optics::{Lenslet, Spot};
    use crate::progress::CancelToken;
    use crate::sensor::Noise;

    #[test]
    fn run_reverts_after_a_loss_by_cold_fits() {
        let set = beads();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((6, 6)),
            first_fit: 60,
            refit: 1,
            steps: COLD_FIT_EVERY + 2,
            patches: 2,
            objects: 1,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let mut ideal = small(&forward, &settings);
        let advance = |ideal: &mut IdealOptimizer<'_>| ideal.advance(&mut CancelToken::new()).unwrap();
        let blur = |ideal: &mut IdealOptimizer<'_>| ideal.state.array.lenslets[0].spot = Spot::Isotropic(5.0);
        let reverts = |ideal: &IdealOptimizer<'_>| -> Vec<IdealEvent> {
            let is_revert = |event: &&IdealEvent| matches!(event, IdealEvent::Reverted { .. });
            ideal.state.events.iter().filter(is_revert).cloned().collect()
        };
        while ideal.state.checkpoints.len() < COLD_FIT_EVERY {
            advance(&mut ideal);
            blur(&mut ideal);
        }
        advance(&mut ideal);
        let step = ideal.state.step;
        assert_eq!(reverts(&ideal).last(), Some(&IdealEvent::Reverted { step, to: 0 }));
        assert_eq!(ideal.state.array, ideal.state.checkpoints[0].array);
        // The model is fitted to that mask before the next step.
        let bytes = ideal.to_bytes().unwrap();
        advance(&mut ideal);
        let last = ideal.state.checkpoints.last().unwrap();
        assert_eq!((last.step, &last.array), (step, &ideal.state.checkpoints[0].array));
        assert!(ideal.state.step == step + 1 && ideal.state.array != last.array);
        let mut resumed = small(&forward, &settings).resumed(&bytes).unwrap();
        advance(&mut resumed);
        assert_eq!(resumed.state.array, ideal.state.array);
        // A run does not end with a worse mask than an earlier one.
        while ideal.state.step < ideal.settings.steps {
            advance(&mut ideal);
        }
        blur(&mut ideal);
        while !ideal.is_finished() {
            advance(&mut ideal);
        }
        assert_eq!(ideal.state.array, ideal.state.checkpoints[0].array);
        assert!(
            matches!(reverts(&ideal).last(), Some(IdealEvent::Reverted { step, .. }) if *step == COLD_FIT_EVERY + 2)
        );
        let (first, last) = (&ideal.state.checkpoints[0], ideal.state.checkpoints.last().unwrap());
        assert!((last.bits_per_pixel - first.bits_per_pixel).abs() < 0.1, "measured again: {last:?}");
    }

    #[test]
    fn run_reverts_after_a_loss_by_lower_bounds() {
        let set = few_beads();
        let forward = ForwardModel::new(set.clone(), (16, 16), 10.0, Noise::Shot).unwrap();
        let lenslets = [4.0, 11.0].map(|x| Lenslet::round(x, 7.5, 0.8, 0.5));
        let mut ideal = short(&forward, &lenslets, 3);
        let advance = |ideal: &mut IdealOptimizer<'_>| ideal.advance(&mut CancelToken::new()).unwrap();
        let blur = |ideal: &mut IdealOptimizer<'_>| {
            for lenslet in &mut ideal.state.array.lenslets {
                lenslet.spot = Spot::Isotropic(5.0);
            }
        };
        advance(&mut ideal);
        assert_eq!(ideal.state.events, []);
        blur(&mut ideal);
        advance(&mut ideal);
        let [good, blurred] = &ideal.state.checkpoints[..] else { panic!("two checkpoints") };
        assert!(blurred.bits_per_pixel < good.bits_per_pixel - MOST_LOSS);
        // A step was taken in the course of the checkpoint.
        assert_eq!(ideal.state.events, [IdealEvent::Reverted { step: 2, to: 0 }]);
        let (good, bits) = (good.array.clone(), good.bits_per_pixel);
        assert_eq!(ideal.state.array, good);
        advance(&mut ideal);
        let (now, then) = (ideal.state.array.lenslets[0], good.lenslets[0]);
        assert!(now != then && (now.x - then.x).abs() <= ideal.settings.rates.position, "{now:?}");
        blur(&mut ideal);
        advance(&mut ideal);
        assert!(ideal.is_finished());
        let last = ideal.state.checkpoints.last().unwrap();
        assert_eq!((&last.array, &ideal.state.array), (&good, &good));
        assert!((last.bits_per_pixel - bits).abs() < 0.02, "measured again: {} {bits}", last.bits_per_pixel);
        assert!(matches!(ideal.state.events[1..], [IdealEvent::Reverted { step: 3, to: 0 | 2 }]));
    }
}
