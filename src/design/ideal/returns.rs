//! The way back of a run whose mask has come to tell less than before. A model that does not see all that measurements tell
//! also errs about what would make them tell more, so that its slopes can lead down.

use super::Ideal;
use super::audit::SLOWEST;
use crate::design::error::IdealError;
use crate::design::state::{Doing, Frame, IdealEvent};
use crate::design::watched::Watched;
use crate::information::paired_gain;
use crate::optics::LensletArray;

/// Loss beyond which a mask is given up for the best one, bits per pixel.
const MOST_LOSS: f64 = 0.003;
/// The same by density models that begin anew, which differ by less before one mask.
const MOST_LOSS_AFRESH: f64 = 0.02;

impl Ideal<'_> {
    /// The best mask so far that has the lenslets which are left, by what can be compared. Bounds from below at which the run had
    /// ended before were measured more closely; those masks count by what they were worth when it went on. Masks that somebody told
    /// the run to leave do not count.
    fn best(&self) -> Option<&Frame> {
        let (state, frames) = (&self.state, &self.state.frames);
        let is_whole = |frame: &Frame| state.pruned.iter().all(|&index| frame.array.lenslets[index].weight == 0.0);
        let went_on = |at: usize| {
            !self.guide.can_overrate() && frames.get(at + 1).is_some_and(|next| next.step == frames[at].step)
        };
        let alike = frames.iter().enumerate().filter(|&(at, frame)| {
            is_whole(frame) && !went_on(at) && !state.events.iter().any(|event| self.left(frame, event))
        });
        let worth = alike.filter_map(|(_, frame)| Some((frame, self.worth(frame)?)));
        worth.max_by(|(_, one), (_, other)| one.total_cmp(other)).map(|(frame, _)| frame)
    }

    /// Whether somebody told the run to leave the mask of a frame by this; the one that was chosen instead is there once more after it.
    fn left(&self, frame: &Frame, event: &IdealEvent) -> bool {
        let (IdealEvent::Rewound { to, .. }, Some(steps)) = (event, event.given_up()) else { return false };
        let is_chosen = |chosen: &Frame| chosen.step == *to && chosen.array == frame.array;
        steps.contains(&frame.step) && !self.state.frames.iter().any(is_chosen)
    }

    /// What a mask is worth by a number that can be compared: a bound from below, or a density model that had begun anew. None where
    /// all models do, as published.
    fn worth(&self, frame: &Frame) -> Option<f64> {
        if self.guide.can_overrate() { frame.afresh.filter(|_| self.settings.warm) } else { Some(frame.bits_per_pixel) }
    }

    /// The best mask so far, where it tells more than that of a frame: by at least so much, or by more than chance where models that
    /// began anew tell.
    fn better(&self, frame: &Frame, least: f64) -> Option<&Frame> {
        let best = self.best().filter(|best| best.array != frame.array)?;
        let half_width = |frame: &Frame| 0.5 * (frame.interval_95[1] - frame.interval_95[0]);
        let chance = || MOST_LOSS_AFRESH.max(half_width(best).hypot(half_width(frame)));
        let least = if self.guide.can_overrate() { chance() } else { least };
        (self.worth(best)? - self.worth(frame)? > least).then_some(best)
    }

    /// Goes on from the best mask where the last one tells clearly less: by the decoder as it is now, since one fit of it knows more
    /// or less than another, which says nothing of the masks; or by density models that began anew.
    pub(super) fn take_back(&mut self, watch: &Watched<'_>) -> Result<(), IdealError> {
        let Some(last) = self.state.frames.last().filter(|_| !self.state.finished) else { return Ok(()) };
        let Some(best) = self.better(last, MOST_LOSS) else { return Ok(()) };
        if let Some(posterior) = self.guide.posterior() {
            let savings = |array: &LensletArray| {
                let go_on = || watch.tell(&self.state, Some((Doing::Measuring, 1.0))).is_continue();
                posterior.value_savings(array, 0..posterior.scenes(), &go_on)
            };
            let (loss, half_width) = paired_gain(&savings(&last.array)?, &savings(&best.array)?);
            if loss < MOST_LOSS.max(half_width) {
                return Ok(());
            }
        }
        let (array, to) = (best.array.clone(), best.step);
        if self.guide.can_overrate() {
            self.state.caution = (0.5 * self.state.caution).max(SLOWEST);
        }
        self.return_to(array, to)
    }

    /// Lets the run go on from the mask of an earlier frame, counted from 0; where the run stands at that mask, or there is no such
    /// frame, it stays where it is. Steps count on, so that nothing of the way is lost and none of its draws come again.
    ///
    /// # Errors
    /// Where the guide does not turn to that mask.
    pub fn rewind_to(&mut self, frame: usize) -> Result<(), IdealError> {
        let Some(Frame { array, step: to, .. }) = self.state.frames.get(frame).cloned() else { return Ok(()) };
        if to == self.state.step && array == self.state.array {
            return Ok(());
        }
        self.take_up(array)?;
        let state = &mut self.state;
        // The rest of its round was for another mask; what was taken out after this one is there again.
        state.due = 0;
        state.pruned.retain(|&index| state.array.lenslets[index].weight == 0.0);
        state.events.push(IdealEvent::Rewound { step: state.step, to });
        Ok(())
    }

    fn return_to(&mut self, array: LensletArray, to: usize) -> Result<(), IdealError> {
        self.take_up(array)?;
        self.state.events.push(IdealEvent::Returned { step: self.state.step, to });
        Ok(())
    }

    /// Puts a mask in place of that of the run, which has to learn of it anew.
    fn take_up(&mut self, array: LensletArray) -> Result<(), IdealError> {
        self.guide.follow(&array, true)?;
        let state = &mut self.state;
        state.array = array;
        state.momentum.forget_all();
        state.followed = false;
        Ok(())
    }

    /// The best mask so far where it is better than the `last` one, measured anew; the run is then there.
    pub(super) fn better_than(&mut self, last: &Frame, watch: &Watched<'_>) -> Result<Option<Frame>, IdealError> {
        let Some(best) = self.better(last, 0.0) else { return Ok(None) };
        let (array, to) = (best.array.clone(), best.step);
        let (afresh, least) = (self.guide.can_overrate(), self.worth(last));
        let (before, state) = (self.guide.to_bytes(Vec::new())?, self.state.clone());
        let again = self.return_to(array, to).and_then(|()| {
            if afresh {
                self.guide.follow(&self.state.array, false)?;
            }
            self.fit(if afresh { (self.settings.first_fit, 2) } else { (self.settings.last_fit, 1) }, watch)?;
            self.frame(true, watch)
        });
        match again {
            Ok(mut frame) if Some(frame.bits_per_pixel) > least => {
                frame.afresh = afresh.then_some(frame.bits_per_pixel);
                Ok(Some(frame))
            }
            again => {
                self.state = state;
                self.guide.restore(&before)?;
                self.guide.follow(&self.state.array, true)?;
                again.map(|_| None)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::audit::AUDIT_EVERY;
    use super::super::tests::{beads, few_beads, short, small};
    use super::*;
    use crate::design::settings::{IdealSettings, Objective, Preset};
    use crate::forward::ForwardModel;
    use crate::optics::{Lenslet, Spot};
    use crate::sensor::Noise;

    #[test]
    fn a_run_goes_on_from_the_mask_that_somebody_chose() {
        let set = few_beads();
        let imaging = ForwardModel::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
        let lenslets = [4.0, 11.0].map(|x| Lenslet::round(x, 7.5, 0.8, 0.5));
        let begun = || short(&imaging, &lenslets, 6);
        let advance = |ideal: &mut Ideal<'_>| ideal.advance(&mut |_| ControlFlow::Continue(())).unwrap();
        let mut ideal = begun();
        (0..3).for_each(|_| advance(&mut ideal));
        let (step, frames) = (ideal.state.step, ideal.state.frames.clone());
        let blurred = {
            let mut array = frames[0].array.clone();
            array.lenslets.iter_mut().for_each(|lenslet| lenslet.spot = Spot::Isotropic(5.0));
            array
        };
        // There is no mask beyond the newest one.
        ideal.rewind_to(frames.len()).unwrap();
        assert_eq!(ideal.state.events, []);
        // The run has moved on from the last one that was valued.
        let mut back = begun().resumed(&ideal.to_bytes().unwrap()).unwrap();
        let last = frames.last().unwrap();
        assert!(back.state.step > last.step && back.state.array != last.array);
        back.rewind_to(frames.len() - 1).unwrap();
        assert_eq!(back.state.array, last.array);
        assert_eq!(back.state.events, [IdealEvent::Rewound { step, to: last.step }]);
        // One that tells less than those after it: whoever chose it has left those.
        (ideal.state.frames[0].array, ideal.state.frames[0].bits_per_pixel) = (blurred.clone(), 0.0);
        ideal.state.pruned = vec![1];
        ideal.rewind_to(0).unwrap();
        let rewound = IdealEvent::Rewound { step, to: frames[0].step };
        assert_eq!((&ideal.state.array, ideal.state.step), (&blurred, step));
        assert_eq!((&ideal.state.events[..], ideal.state.pruned.len()), (std::slice::from_ref(&rewound), 0));
        let bytes = ideal.to_bytes().unwrap();
        advance(&mut ideal);
        let [.., before, now] = &ideal.state.frames[..] else { panic!("more than one frame") };
        assert_eq!((before, &now.array, now.step), (frames.last().unwrap(), &blurred, step));
        assert!(now.bits_per_pixel < before.bits_per_pixel - MOST_LOSS, "and it is not taken back to them");
        assert_eq!(ideal.state.events, std::slice::from_ref(&rewound));
        assert!(ideal.state.array != blurred && ideal.state.step > step, "it climbs from there");
        // However much the same mask was said to tell before, there is no way back to it.
        let mut again = begun().resumed(&bytes).unwrap();
        again.state.frames[0].bits_per_pixel = 9.0;
        advance(&mut again);
        assert_eq!(again.state.events, [rewound]);
        // Between two states it does the same.
        let mut resumed = begun().resumed(&bytes).unwrap();
        advance(&mut resumed);
        assert_eq!(resumed.state.array, ideal.state.array);
    }

    #[test]
    fn a_mask_that_lost_information_is_given_up_by_a_density_model_that_begins_anew() {
        let set = beads();
        let imaging = ForwardModel::new(&set, (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((6, 6)),
            first_fit: 60,
            refit: 1,
            steps: AUDIT_EVERY + 2,
            patches: 2,
            objects: 1,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let mut ideal = small(&imaging, &settings);
        let advance = |ideal: &mut Ideal<'_>| ideal.advance(&mut |_| ControlFlow::Continue(())).unwrap();
        let blur = |ideal: &mut Ideal<'_>| ideal.state.array.lenslets[0].spot = Spot::Isotropic(5.0);
        let returned = |ideal: &Ideal<'_>| -> Vec<IdealEvent> {
            let is_return = |event: &&IdealEvent| matches!(event, IdealEvent::Returned { .. });
            ideal.state.events.iter().filter(is_return).cloned().collect()
        };
        while ideal.state.frames.len() < AUDIT_EVERY {
            advance(&mut ideal);
            blur(&mut ideal);
        }
        advance(&mut ideal);
        let step = ideal.state.step;
        assert_eq!(returned(&ideal).last(), Some(&IdealEvent::Returned { step, to: 0 }));
        assert_eq!(ideal.state.array, ideal.state.frames[0].array);
        // Before it climbs on, its model learns of that mask.
        let bytes = ideal.to_bytes().unwrap();
        advance(&mut ideal);
        let last = ideal.state.frames.last().unwrap();
        assert_eq!((last.step, &last.array), (step, &ideal.state.frames[0].array));
        assert!(ideal.state.step == step + 1 && ideal.state.array != last.array);
        let mut resumed = small(&imaging, &settings).resumed(&bytes).unwrap();
        advance(&mut resumed);
        assert_eq!(resumed.state.array, ideal.state.array);
        // A run does not end with a worse mask than it had.
        while ideal.state.step < ideal.settings.steps {
            advance(&mut ideal);
        }
        blur(&mut ideal);
        while !ideal.is_finished() {
            advance(&mut ideal);
        }
        assert_eq!(ideal.state.array, ideal.state.frames[0].array);
        assert!(matches!(returned(&ideal).last(), Some(IdealEvent::Returned { step, .. }) if *step == AUDIT_EVERY + 2));
        let (first, last) = (&ideal.state.frames[0], ideal.state.frames.last().unwrap());
        assert!((last.bits_per_pixel - first.bits_per_pixel).abs() < 0.1, "measured anew: {last:?}");
    }

    #[test]
    fn a_mask_that_lost_information_is_given_up_for_the_best_one() {
        let set = few_beads();
        let imaging = ForwardModel::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
        let lenslets = [4.0, 11.0].map(|x| Lenslet::round(x, 7.5, 0.8, 0.5));
        let mut ideal = short(&imaging, &lenslets, 3);
        let advance = |ideal: &mut Ideal<'_>| ideal.advance(&mut |_| ControlFlow::Continue(())).unwrap();
        let blur = |ideal: &mut Ideal<'_>| {
            for lenslet in &mut ideal.state.array.lenslets {
                lenslet.spot = Spot::Isotropic(5.0);
            }
        };
        advance(&mut ideal);
        assert_eq!(ideal.state.events, []);
        blur(&mut ideal);
        advance(&mut ideal);
        let [good, blurred] = &ideal.state.frames[..] else { panic!("two frames") };
        assert!(blurred.bits_per_pixel < good.bits_per_pixel - MOST_LOSS);
        // A step was taken while it was valued.
        assert_eq!(ideal.state.events, [IdealEvent::Returned { step: 2, to: 0 }]);
        let (good, bits) = (good.array.clone(), good.bits_per_pixel);
        assert_eq!(ideal.state.array, good);
        advance(&mut ideal);
        let (now, then) = (ideal.state.array.lenslets[0], good.lenslets[0]);
        assert!(now != then && (now.x - then.x).abs() <= ideal.settings.rates.position, "{now:?}");
        blur(&mut ideal);
        advance(&mut ideal);
        assert!(ideal.is_finished());
        let last = ideal.state.frames.last().unwrap();
        assert_eq!((&last.array, &ideal.state.array), (&good, &good));
        assert!((last.bits_per_pixel - bits).abs() < 0.02, "measured anew: {} {bits}", last.bits_per_pixel);
        assert!(matches!(ideal.state.events[1..], [IdealEvent::Returned { step: 3, to: 0 | 2 }]));
    }
}
