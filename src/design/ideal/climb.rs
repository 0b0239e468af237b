//! The steps of a round. Each is made of moves that follow one another quickly, and what the guide has to learn meanwhile is done
//! little by little between them, so that whoever watches sees the mask move on.

use std::sync::atomic::{AtomicBool, Ordering};

use super::Ideal;
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::design::guide::{GuideFit, bound};
use crate::design::movement::{PARAMETERS, by_parameters};
use crate::design::state::IdealEvent;
use crate::design::watched::Watched;
use crate::information::InformationError;
use crate::objects::Split;
use crate::optics::LensletArray;
use crate::seeds::SeedStream;

/// Refused steps after which a run is given up.
const MAX_REFUSED: usize = 30;
/// Patches whose slopes are taken between two moves, if any, so that two cores are busy.
const PATCHES_AT_ONCE: usize = 2;
/// Scenes that a mask is valued on between two moves, if any.
const VALUED_AT_ONCE: usize = 8;

impl Ideal<'_> {
    /// Takes the steps of a round, and values the mask as it is now between them.
    pub(super) fn climb_and_value(&mut self, watch: &Watched<'_>) -> Result<(), IdealError> {
        let (step, array, seconds) = (self.state.step, self.state.array.clone(), watch.seconds());
        let savings = self.climb(Some(&array), watch)?;
        let frame = self.frame_of((step, array, seconds), bound(savings))?;
        self.state.frames.push(frame);
        self.take_back(watch)
    }

    /// Takes the steps of a round, or one step where the model stays as it is. A density model keeps up with the mask meanwhile; a
    /// decoder is fitted for the next round, and tells of the scenes of a value through a mask that is `valued`. What it told
    /// comes back.
    pub(super) fn climb(&mut self, valued: Option<&LensletArray>, watch: &Watched<'_>) -> Result<Vec<f64>, IdealError> {
        let steps = if self.settings.warm {
            self.settings.refit_every.min(self.settings.steps.saturating_sub(self.state.step))
        } else {
            self.steps_due().min(1)
        };
        let moves = self.settings.moves.min(self.patches());
        let turns = steps * moves;
        let seed = SeedStream::OnlineFit { step: self.state.step }.derive(self.settings.seed);
        let fit = GuideFit { steps: self.settings.refit_from(self.state.step), seed, warm: true };
        let (mut refit, mut savings) = (None, Vec::new());
        if let Some(posterior) = self.guide.posterior().filter(|_| self.settings.warm && steps > 0) {
            refit = Some(posterior.refit(&fit)?);
        }
        let mut done = Step::new(&self.state.array);
        for turn in 1..=turns {
            let (part, due) = ((turn - 1) % moves, fit.steps * turn / turns);
            if self.settings.warm {
                let go_on = || watch.tell(&self.state, None).is_continue();
                self.state.followed = self.guide.keep_up(&fit, (&self.state.array, due), &go_on)?;
            }
            let (mut fitted, is_given_up) = (Ok(()), AtomicBool::new(false));
            let slopes = rayon::in_place_scope(|scope| {
                if let (Some(refit), Some(posterior)) = (&mut refit, self.guide.posterior()) {
                    let due = (&self.state.array, due);
                    let (fitted, go_on) = (&mut fitted, || !is_given_up.load(Ordering::Relaxed));
                    scope.spawn(move |_| *fitted = posterior.fit_on(refit, due, &go_on));
                }
                let told = valued.map_or(Ok(()), |array| self.value_until(array, (turn, turns), &mut savings, watch));
                let slopes = told.and_then(|()| self.slopes((part, moves), watch));
                is_given_up.store(slopes.is_err(), Ordering::Relaxed);
                slopes
            })?;
            fitted?;
            self.go((part, moves), &slopes, &mut done)?;
            self.state.seconds = watch.seconds();
            if watch.tell(&self.state, None).is_break() {
                return Err(InformationError::Cancelled.into());
            }
        }
        self.state.due = self.state.due.saturating_sub(steps);
        if let Some(refit) = refit {
            self.guide.take(refit);
            self.state.followed = true;
        }
        Ok(savings)
    }

    /// Patches of a step.
    fn patches(&self) -> usize {
        let patches = self.settings.patches;
        self.guide.posterior().map_or(patches, |posterior| posterior.as_many(patches))
    }

    /// Adds to the savings of the scenes of a value what is due by a turn.
    fn value_until(
        &self,
        array: &LensletArray,
        (turn, turns): (usize, usize),
        savings: &mut Vec<f64>,
        watch: &Watched<'_>,
    ) -> Result<(), IdealError> {
        let Some(posterior) = self.guide.posterior() else { return Ok(()) };
        let due = posterior.scenes() * turn / turns / VALUED_AT_ONCE * VALUED_AT_ONCE;
        if savings.len() < due {
            let go_on = || watch.tell(&self.state, None).is_continue();
            savings.extend(posterior.value_savings(array, savings.len()..due, &go_on)?);
        }
        Ok(())
    }

    /// The slopes of the information by what can move, by a share of the patches of a step; none where it has none.
    fn slopes(&self, (part, moves): (usize, usize), watch: &Watched<'_>) -> Result<Vec<[f64; PARAMETERS]>, IdealError> {
        let (array, patches) = (&self.state.array, self.patches());
        let due = |part: usize| {
            if part < moves { patches * part / moves / PATCHES_AT_ONCE * PATCHES_AT_ONCE } else { patches }
        };
        let share = due(part + 1) - due(part);
        if share == 0 {
            return Ok(vec![[0.0; PARAMETERS]; array.lenslets.len()]);
        }
        let draw = GradientDraw {
            split: Split::Train,
            objects: (self.settings.objects * share / patches).max(1),
            patches: share,
            seed: SeedStream::Step { substep: part, step: self.state.step }.derive(self.settings.seed),
        };
        let go_on = || watch.tell(&self.state, None).is_continue();
        let mut slopes = by_parameters(array, &self.guide.slopes(array, &draw, &go_on)?);
        let weight = share as f64 / patches as f64;
        slopes.iter_mut().flatten().for_each(|slope| *slope *= weight);
        Ok(slopes)
    }

    /// One move of a step of several. `done` gathers what their slopes have told; the last of them learns from it, or takes all of
    /// them back where the slopes are no numbers.
    fn go(
        &mut self,
        (part, moves): (usize, usize),
        slopes: &[[f64; PARAMETERS]],
        done: &mut Step,
    ) -> Result<(), IdealError> {
        if part == 0 {
            *done = Step::new(&self.state.array);
        }
        for (sum, slope) in done.gradient.iter_mut().flatten().zip(slopes.iter().flatten()) {
            *sum += slope;
        }
        let state = &mut self.state;
        let rate = state.caution * self.settings.rate(state.step + 1) / moves as f64;
        if part + 1 == moves {
            state.step += 1;
            if done.gradient.iter().flatten().any(|slope| !slope.is_finite()) {
                state.array.clone_from(&done.before);
                state.events.push(IdealEvent::Refused { step: state.step });
                state.caution *= 0.5;
                let refused = state.events.iter().filter(|event| matches!(event, IdealEvent::Refused { .. })).count();
                return if refused < MAX_REFUSED { Ok(()) } else { Err(IdealError::Diverged { refused }) };
            }
            let free = self.settings.free_lenslets(state.array.lenslets.len(), &state.pruned);
            state.momentum.learn(&done.gradient, &free);
        }
        state.momentum.climb(&mut state.array, (&self.settings, &self.limits), &state.pruned, rate);
        Ok(())
    }
}

/// What there is of a step of several moves.
struct Step {
    /// The mask before its first move.
    before: LensletArray,
    /// The sum of the slopes so far.
    gradient: Vec<[f64; PARAMETERS]>,
}

impl Step {
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
    use crate::design::state::{Doing, IdealProgress};
    use crate::forward::ForwardModel;
    use crate::optics::Lenslet;
    use crate::sensor::Noise;

    #[test]
    fn the_mask_is_seen_after_every_move() {
        let set = few_beads();
        let imaging = ForwardModel::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
        let lenslets = [4.0, 11.0].map(|x| Lenslet::round(x, 7.5, 1.2, 0.5));
        let mut ideal = short(&imaging, &lenslets, 4);
        (ideal.settings.moves, ideal.settings.patches) = (3, 6);
        let mut seen = Vec::new();
        while !ideal.is_finished() {
            let watch = &mut |progress: &IdealProgress<'_>| {
                seen.push((progress.state.step, progress.state.array.clone()));
                ControlFlow::Continue(())
            };
            ideal.advance(watch).unwrap();
        }
        let at = |step: usize| {
            let mut masks: Vec<_> = seen.iter().filter(|seen| seen.0 == step).map(|seen| seen.1.clone()).collect();
            masks.dedup();
            masks.len()
        };
        // Nothing is known before the first step is over; from then on it moves after every third of one.
        assert_eq!((at(0), at(1), at(2), at(3)), (1, 3, 3, 3));
        let frames = &ideal.state.frames;
        assert_eq!(frames.iter().map(|frame| frame.step).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        for (frame, next) in frames.iter().zip(&frames[1..]) {
            let (one, other) = (frame.array.lenslets[0], next.array.lenslets[0]);
            assert!((one.x - other.x).abs() <= ideal.settings.rates.position * 1.0001, "a step is no longer than one");
        }
    }

    #[test]
    fn a_step_without_numbers_leaves_the_mask_where_it_was() {
        let set = few_beads();
        let imaging = ForwardModel::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
        let lenslets = [4.0, 11.0].map(|x| Lenslet::round(x, 7.5, 1.2, 0.5));
        let mut ideal = short(&imaging, &lenslets, 4);
        let step = |ideal: &mut Ideal<'_>, slopes: [f64; 3]| {
            let mut done = Step::new(&ideal.state.array);
            for (part, slope) in slopes.into_iter().enumerate() {
                ideal.go((part, slopes.len()), &[[slope; PARAMETERS]; 2], &mut done).unwrap();
            }
        };
        step(&mut ideal, [0.1, 0.2, 0.1]);
        let (array, momentum) = (ideal.state.array.clone(), ideal.state.momentum.clone());
        step(&mut ideal, [0.1, f64::NAN, 0.1]);
        assert_eq!((&ideal.state.array, &ideal.state.momentum), (&array, &momentum));
        assert_eq!((ideal.state.step, ideal.state.caution), (2, 0.5));
        assert_eq!(ideal.state.events, [IdealEvent::Refused { step: 2 }]);
        step(&mut ideal, [0.1, 0.2, 0.1]);
        assert!(ideal.state.array != array);
    }

    #[test]
    fn a_density_model_keeps_up_with_the_mask_and_resumed_runs_do_the_same() {
        let set = beads();
        let imaging = ForwardModel::new(&set, (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((6, 6)),
            first_fit: 60,
            // More than the patches that are drawn at a time are enough for.
            refit: 70,
            last_fit: 2,
            steps: 3,
            patches: 4,
            moves: 3,
            objects: 2,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let weights = |ideal: &Ideal<'_>| {
            let mut bytes = ideal.guide.to_bytes(Vec::new()).unwrap();
            weights_in(&mut bytes).to_vec()
        };
        let advance = |ideal: &mut Ideal<'_>| ideal.advance(&mut |_| ControlFlow::Continue(())).unwrap();
        let mut whole = small(&imaging, &settings);
        advance(&mut whole);
        let (bytes, before) = (whole.to_bytes().unwrap(), weights(&whole));
        let mut fitted = 0;
        let watch = &mut |progress: &IdealProgress<'_>| {
            fitted += usize::from(progress.doing.is_some_and(|doing| doing.0 == Doing::Fitting));
            ControlFlow::Continue(())
        };
        whole.advance(watch).unwrap();
        assert_eq!(fitted, 0, "the mask does not wait");
        assert!(weights(&whole) != before, "for what the model learns");
        while !whole.is_finished() {
            advance(&mut whole);
        }
        let mut resumed = small(&imaging, &settings).resumed(&bytes).unwrap();
        while !resumed.is_finished() {
            advance(&mut resumed);
        }
        assert_eq!(resumed.state.array, whole.state.array);
        assert!(weights(&resumed) == weights(&whole), "to the bit");
    }
}
