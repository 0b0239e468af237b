//! The way back of a run whose mask has come to tell less than before. A decoder that does not see all that measurements tell
//! also errs about what would make them tell more, so that its slopes can lead down.

use super::Ideal;
use crate::design::error::IdealError;
use crate::design::state::{Doing, Frame, IdealEvent};
use crate::design::watched::Watched;
use crate::information::savings_gain;
use crate::optics::LensletArray;

/// Loss beyond which a mask is given up for the best one, bits per pixel.
const MOST_LOSS: f64 = 0.003;

impl Ideal<'_> {
    /// The best mask so far that has the lenslets which are left, where values can only be too low. Masks at which the run had
    /// ended before were measured more closely; they count by what they were worth when it went on. Masks that somebody told the
    /// run to leave do not count.
    fn best(&self) -> Option<&Frame> {
        if self.guide.can_overrate() {
            return None;
        }
        let (state, frames) = (&self.state, &self.state.frames);
        let is_whole = |frame: &Frame| state.pruned.iter().all(|&index| frame.array.lenslets[index].weight == 0.0);
        let went_on = |at: usize| frames.get(at + 1).is_some_and(|next| next.step == frames[at].step);
        let left = |event: &IdealEvent| event.given_up().filter(|_| matches!(event, IdealEvent::Rewound { .. }));
        let was_left = |frame: &Frame| state.events.iter().filter_map(left).any(|steps| steps.contains(&frame.step));
        let alike =
            frames.iter().enumerate().filter(|&(at, frame)| is_whole(frame) && !went_on(at) && !was_left(frame));
        alike.map(|(_, frame)| frame).max_by(|one, other| one.bits_per_pixel.total_cmp(&other.bits_per_pixel))
    }

    /// Goes on from the best mask where the last one tells clearly less, by the decoder as it is now: one fit of it knows more or
    /// less than another, which says nothing of the masks.
    pub(super) fn take_back(&mut self, watch: &Watched<'_>) -> Result<(), IdealError> {
        let (Some(best), Some(last)) = (self.best(), self.state.frames.last()) else { return Ok(()) };
        let is_same = best.array == last.array;
        if self.state.finished || is_same || best.bits_per_pixel - last.bits_per_pixel < MOST_LOSS {
            return Ok(());
        }
        let Some(posterior) = self.guide.posterior() else { return Ok(()) };
        let savings = |array: &LensletArray| {
            let go_on = || watch.tell(&self.state, Some((Doing::Measuring, 1.0))).is_continue();
            posterior.value_savings(array, 0..posterior.scenes(), &go_on)
        };
        let (loss, half_width) = savings_gain(&savings(&last.array)?, &savings(&best.array)?);
        if loss < MOST_LOSS.max(half_width) {
            return Ok(());
        }
        let (array, to) = (best.array.clone(), best.step);
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

    /// The best mask so far where it is better than the `last` one, measured as that was; the run is then there.
    pub(super) fn better_than(&mut self, last: &Frame, watch: &Watched<'_>) -> Result<Option<Frame>, IdealError> {
        let Some(best) = self.best().filter(|best| best.bits_per_pixel > last.bits_per_pixel) else { return Ok(None) };
        let (array, to) = (best.array.clone(), best.step);
        let (before, state) = (self.guide.to_bytes(Vec::new())?, self.state.clone());
        let again = self.return_to(array, to).and_then(|()| {
            self.fit((self.settings.last_fit, 1), watch)?;
            self.frame(true, watch)
        });
        match again {
            Ok(frame) if frame.bits_per_pixel > last.bits_per_pixel => Ok(Some(frame)),
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

    use super::super::tests::{few_beads, short};
    use super::*;
    use crate::design::imaging::Imaging;
    use crate::optics::{Lenslet, Spot};
    use crate::sensor::Noise;

    #[test]
    fn a_run_goes_on_from_the_mask_that_somebody_chose() {
        let set = few_beads();
        let imaging = Imaging::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
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
    fn a_mask_that_lost_information_is_given_up_for_the_best_one() {
        let set = few_beads();
        let imaging = Imaging::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
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
