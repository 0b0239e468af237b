//! Whether a density model that follows the mask still knows it: one that lags behind gives the mask what it merely does not know.

use super::Ideal;
use crate::design::error::IdealError;
use crate::design::state::{Frame, IdealEvent};
use crate::design::watched::Watched;

/// Information that a mask can gain in one round, bits per pixel; a model that gives it more has lost track of it.
const MOST_GAIN: f64 = 0.015;
/// Factor by which its interval can widen in one round.
const MOST_WIDENING: f64 = 1.4;
/// Rounds from one comparison with a model that begins anew to the next.
pub(super) const AUDIT_EVERY: usize = 40;
/// Least factor of the rates, which are halved where a model that begins anew takes over.
pub(super) const SLOWEST: f64 = 0.25;

impl Ideal<'_> {
    /// Whether the guide is one that can give the mask too much because it was fitted to other masks.
    pub(super) fn can_lag_behind(&self) -> bool {
        self.guide.can_overrate() && self.settings.warm && !self.state.frames.is_empty()
    }

    /// Whether it is time to see whether a model that was fitted again and again still knows more than one that begins anew: a
    /// model that lags behind by a little more in every round is not found out otherwise, and neither is one that was fitted to
    /// the masks which the run has left for an earlier one.
    pub(super) fn is_due_for_audit(&self, is_last: bool) -> bool {
        let step = self.state.step;
        let is_back = |event: &IdealEvent| match event {
            IdealEvent::Rewound { step: at, .. } | IdealEvent::Returned { step: at, .. } => *at == step,
            _ => false,
        };
        is_last || self.state.events.iter().any(is_back) || self.state.frames.len().is_multiple_of(AUDIT_EVERY)
    }

    /// Whether a value says more of the model than of the mask: no mask gains so much in one round, or becomes so much more
    /// uneven from patch to patch. A mask that went on climbing would climb what the model does not know.
    pub(super) fn has_lost_track(&self, frame: &Frame) -> bool {
        let width = |frame: &Frame| frame.interval_95[1] - frame.interval_95[0];
        self.state.frames.last().is_some_and(|last| {
            frame.bits_per_pixel > last.bits_per_pixel + MOST_GAIN || width(frame) > MOST_WIDENING * width(last)
        })
    }

    /// The value of the mask by a model that begins anew, which takes over, where that knows more; the same one otherwise.
    pub(super) fn audited(&mut self, frame: Frame, is_last: bool, watch: &Watched<'_>) -> Result<Frame, IdealError> {
        let before = self.guide.to_bytes(Vec::new())?;
        self.guide.follow(&self.state.array, false)?;
        self.fit((self.settings.first_fit, 1), watch)?;
        let mut afresh = self.frame(is_last, watch)?;
        afresh.afresh = Some(afresh.bits_per_pixel);
        // Both are bounds from above: the lower one knows more.
        if afresh.bits_per_pixel < frame.bits_per_pixel {
            self.state.events.push(IdealEvent::Refitted { step: self.state.step });
            self.state.caution = (0.5 * self.state.caution).max(SLOWEST);
            // As a run has it that is taken up again in this round: with levels beside those that it was fitted to.
            self.guide.follow(&self.state.array, true)?;
            return Ok(afresh);
        }
        self.guide.restore(&before)?;
        self.guide.follow(&self.state.array, true)?;
        Ok(Frame { afresh: afresh.afresh, ..frame })
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::tests::{beads, small, without_weights};
    use super::*;
    use crate::design::gradient::GradientDraw;
    use crate::design::guide::{Guide, GuideFit, OnFit, Slopes, Valued};
    use crate::design::settings::{IdealSettings, Objective, Preset};
    use crate::forward::ForwardModel;
    use crate::optics::LensletArray;
    use crate::sensor::Noise;

    #[test]
    fn a_model_that_lost_track_makes_room_for_one_that_begins_anew() {
        let set = beads();
        let imaging = ForwardModel::new(&set, (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((6, 6)),
            first_fit: 40,
            refit: 1,
            steps: 2,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let mut ideal = small(&imaging, &settings);
        let advance = |ideal: &mut Ideal<'_>| ideal.advance(&mut |_| ControlFlow::Continue(())).unwrap();
        advance(&mut ideal);
        assert_eq!(ideal.state.events, []);
        // A model that knows nothing any more gives the mask far more than it can have gained.
        let bytes = ideal.guide.to_bytes(Vec::new()).unwrap();
        ideal.guide.restore(&without_weights(bytes)).unwrap();
        advance(&mut ideal);
        assert_eq!(ideal.state.events, [IdealEvent::Refitted { step: 1 }]);
        let [before, after] = &ideal.state.frames[..] else { panic!("two frames") };
        assert!((after.bits_per_pixel - before.bits_per_pixel).abs() < 0.1, "{before:?} {after:?}");
        assert_eq!(ideal.state.step, 2);
        // Where it is told to go back, the model was fitted to other masks.
        assert!(!ideal.is_due_for_audit(false));
        ideal.rewind_to(0).unwrap();
        assert!(ideal.is_due_for_audit(false));
    }

    /// A guide that knows nothing after a fit from the beginning.
    struct Forgetful<'a>(Box<dyn Guide + 'a>);

    impl Guide for Forgetful<'_> {
        fn follow(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError> {
            self.0.follow(array, warm)
        }

        fn fit(&mut self, fit: &GuideFit, watch: OnFit<'_>) -> Result<(), IdealError> {
            self.0.fit(fit, watch)?;
            if fit.warm { Ok(()) } else { self.0.restore(&without_weights(self.0.to_bytes(Vec::new())?)) }
        }

        fn keep_up(
            &mut self,
            fit: &GuideFit,
            due: (&LensletArray, usize),
            go_on: &dyn Fn() -> bool,
        ) -> Result<bool, IdealError> {
            self.0.keep_up(fit, due, go_on)
        }

        fn value(&self, array: &LensletArray, last: bool, go_on: &dyn Fn() -> bool) -> Result<Valued, IdealError> {
            self.0.value(array, last, go_on)
        }

        fn slopes(&self, array: &LensletArray, draw: &GradientDraw, go_on: &dyn Fn() -> bool) -> Slopes {
            self.0.slopes(array, draw, go_on)
        }

        fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
            self.0.to_bytes(details)
        }

        fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
            self.0.restore(bytes)
        }

        fn can_overrate(&self) -> bool {
            self.0.can_overrate()
        }
    }

    #[test]
    fn a_run_goes_on_bit_for_bit_across_an_audit() {
        let set = beads();
        let imaging = ForwardModel::new(&set, (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((5, 5)),
            first_fit: 1,
            refit: 4,
            steps: AUDIT_EVERY + 2,
            patches: 2,
            objects: 1,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let forgetful = || {
            let ideal = small(&imaging, &settings);
            Ideal { guide: Box::new(Forgetful(ideal.guide)), ..ideal }
        };
        let mut whole = forgetful();
        let mut kept = Vec::new();
        while !whole.is_finished() {
            whole.advance(&mut |_| ControlFlow::Continue(())).unwrap();
            if [AUDIT_EVERY, AUDIT_EVERY + 1].contains(&whole.state.frames.len()) {
                kept.push(whole.to_bytes().unwrap());
            }
        }
        assert_eq!(kept.len(), 2);
        let audited = IdealEvent::Refitted { step: AUDIT_EVERY };
        assert!(!whole.state.events.contains(&audited), "it went on with the model that it had");
        for bytes in kept {
            let mut resumed = forgetful().resumed(&bytes).unwrap();
            while !resumed.is_finished() {
                resumed.advance(&mut |_| ControlFlow::Continue(())).unwrap();
            }
            assert_eq!(resumed.state.array, whole.state.array);
            let bits = |ideal: &Ideal<'_>| -> Vec<f64> {
                ideal.state.frames.iter().map(|frame| frame.bits_per_pixel).collect()
            };
            assert_eq!(bits(&resumed), bits(&whole));
        }
    }
}
