//! IDEAL: the mask climbs the information of its measurements under a model that follows it (Kabuli et al. 2026).

mod audit;
mod climb;
mod prune;
mod returns;
mod search;

use std::ops::ControlFlow;

use ndarray::Array4;
use serde_json::json;

use super::error::IdealError;
use super::guide::{DensityGuide, Guide, GuideFit, PixelCnnGuide, PosteriorGuide, Valued};
use super::merge::merged;
use super::movement::project;
use super::settings::{IdealSettings, Objective};
use super::state::{Doing, Frame, IdealEvent, IdealProgress, IdealState};
use super::watched::Watched;
use crate::formats::{content_key, json_of};
use crate::forward::ForwardModel;
use crate::information::{CausalModel, InformationError, NUMBERS_VERSION, PretrainedLowerBound};
use crate::nn::read_detail;
use crate::objects::Split;
use crate::optics::{LensletArray, Limits, Spot, render_psf};
use crate::seeds::SeedStream;
use crate::sparsity::tamura_of_stack;

/// Held-out measurements that the Tamura coefficient is taken from.
const TAMURA_IMAGES: usize = 32;
/// Factor by which rates that were halved recover in a round.
const RECOVERY: f64 = 1.2;

/// Hears of every step of mask and model, and answers whether to go on; after `Break` the run ends in
/// [`InformationError::Cancelled`].
pub type OnIdeal<'a> = &'a mut dyn FnMut(&IdealProgress<'_>) -> ControlFlow<()>;

/// A run that goes on as long as it is told to [`advance`](Ideal::advance).
pub struct Ideal<'a> {
    imaging: &'a ForwardModel<'a>,
    /// The mask before the first step, within the limits.
    start: LensletArray,
    limits: Limits,
    settings: IdealSettings,
    patch: (usize, usize),
    /// Whose measurements the Tamura coefficient is taken from, shape (n, planes, rows, cols).
    held_out: Array4<f32>,
    guide: Box<dyn Guide + 'a>,
    state: IdealState,
}

impl<'a> Ideal<'a> {
    /// A run from a mask, which is brought within the limits.
    ///
    /// # Errors
    /// Where settings, mask, objects and noise do not allow one.
    pub fn new(
        imaging: &'a ForwardModel<'a>,
        start: &LensletArray,
        limits: Limits,
        settings: IdealSettings,
    ) -> Result<Self, IdealError> {
        start.check()?;
        settings.check(start)?;
        let patch = imaging.patch(settings.patch);
        // What is told of the run is the patch that it has: none is larger than the measurement.
        let settings = IdealSettings { patch: settings.patch.map(|_| patch), ..settings };
        let mut array = start.clone().with_unit_weight();
        if settings.anisotropic {
            for lenslet in &mut array.lenslets {
                let (xx, xy, yy) = lenslet.spot.covariance();
                lenslet.spot = Spot::Anisotropic { xx, xy, yy };
            }
        }
        project(&mut array, &settings, &limits);
        let as_seen = (patch, settings.seed);
        let guide: Box<dyn Guide + 'a> = match settings.objective {
            Objective::Density => Box::new(DensityGuide::new(imaging, &array, &limits, as_seen)?),
            Objective::PixelCnn => Box::new(PixelCnnGuide::new(imaging, &array, as_seen)?),
            Objective::Posterior => Box::new(PosteriorGuide::new(imaging, &array, as_seen)?),
        };
        let (start, state) = (array.clone(), IdealState::new(array, settings.steps));
        let held_out =
            imaging.set.objects(Split::Test, TAMURA_IMAGES, SeedStream::HeldOutObjects.derive(settings.seed))?;
        Ok(Self { imaging, start, limits, settings, patch, held_out, guide, state })
    }

    /// The same run where [`Ideal::to_bytes`] was called; it goes on bit for bit as it would have then.
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
        if let Some(frame) = state.frames.last() {
            if state.due > 0 {
                // In the midst of its round it looks at the measurements of the mask that it was fitted to.
                self.guide.follow(&frame.array, false)?;
            }
            self.guide.restore(bytes)?;
            if state.followed {
                // As it was turned to the mask of the round before.
                self.guide.follow(&frame.array, true)?;
            }
        }
        self.state = state;
        Ok(self)
    }

    /// Where the run had come to whose state these bytes are.
    ///
    /// # Errors
    /// For bytes that are no state of a run.
    pub fn state_in(bytes: &[u8]) -> Result<IdealState, IdealError> {
        let text = read_detail(bytes, "run").map_err(InformationError::from)?;
        serde_json::from_str(&text).map_err(|error| IdealError::OtherRun { reason: error.to_string() })
    }

    /// Everything that decides how this run goes on, as the bytes of a safetensors file.
    ///
    /// # Errors
    /// Where the weights fit no file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, IdealError> {
        let run =
            serde_json::to_string(&self.state).map_err(|error| IdealError::OtherRun { reason: error.to_string() })?;
        self.guide.to_bytes(vec![("key", self.key()), ("run", run)])
    }

    /// Tells runs apart that would go another way; their length may change.
    fn key(&self) -> String {
        content_key(&json!([NUMBERS_VERSION, {
            "settings": self.settings.identity(),
            "start": json_of(&self.start),
            "limits": json_of(&self.limits),
            "objects": self.imaging.set.fingerprint(),
            "bias_photons": self.imaging.bias,
            "noise": self.imaging.noise.to_string(),
            "patch": [self.patch.0, self.patch.1],
        }]))
    }

    /// The key of the same run by the program before it hashed JSON. It holds the version of the numbers, so that it can go with their
    /// next change.
    fn earlier_key(&self) -> String {
        let (settings, start) = (self.settings.earlier_identity(), &self.start);
        let imaging = (self.imaging.set.fingerprint(), self.imaging.bias, self.imaging.noise, self.patch);
        blake3::hash(format!("{NUMBERS_VERSION} {settings} {start:?} {imaging:?} {:?}", self.limits).as_bytes())
            .to_hex()
            .to_string()
    }

    /// Where the run has come to.
    pub fn state(&self) -> &IdealState {
        &self.state
    }

    /// What it does.
    pub fn settings(&self) -> &IdealSettings {
        &self.settings
    }

    /// Fingerprint of the objects.
    pub fn objects_fingerprint(&self) -> String {
        self.imaging.set.fingerprint()
    }

    /// The density model as it was fitted last, where the run climbs one.
    pub fn density_model(&self) -> Option<&CausalModel> {
        self.guide.density_model()
    }

    /// Whether there is nothing left to do.
    pub fn is_finished(&self) -> bool {
        self.state.finished
    }

    /// Lets the run go on to `steps` steps of the mask, or end where it is if it has as many.
    pub fn extend_to(&mut self, steps: usize) {
        let step = self.state.step;
        self.settings.steps = steps.clamp(step, IdealSettings::MOST.max(step));
        let before = std::mem::replace(&mut self.state.planned, self.settings.steps);
        if steps > step && std::mem::take(&mut self.state.finished) {
            self.state.events.push(IdealEvent::Extended { step });
        } else if self.settings.steps != before && !self.state.finished {
            self.state.events.push(IdealEvent::Replanned { step, before });
        }
    }

    /// One round: makes the guide ready for the mask as it is, values the mask on held-out objects, and takes the steps
    /// up to the next round. A guide that can is fitted beside these steps for the next round; bounds from below are then taken
    /// beside them, too. Where models begin anew, whose fits and steps take long, a call does a part of that: fit and value, or one
    /// step. States for [`Ideal::to_bytes`] lie between two calls.
    ///
    /// # Errors
    /// Where objects or model fail, steps are refused again and again, or `watch` breaks off; the mask then stays where
    /// the steps so far have brought it.
    pub fn advance(&mut self, watch: OnIdeal<'_>) -> Result<(), IdealError> {
        let watch = Watched::new(watch, self.state.seconds);
        if self.steps_due() > 0 {
            self.climb(None, &watch)?;
            self.state.seconds = watch.seconds();
            return Ok(());
        }
        self.prune();
        self.search(&watch)?;
        let (is_first, is_last) = (self.state.frames.is_empty(), self.state.step >= self.settings.steps);
        // The mask moves as fast as the model can follow.
        self.state.caution = (self.state.caution * RECOVERY).min(1.0);
        let followed = std::mem::take(&mut self.state.followed) && !is_last;
        match (followed, self.guide.can_overrate()) {
            (false, _) => {
                let steps = match (is_last, is_first || !self.settings.warm) {
                    (true, _) => self.settings.last_fit,
                    (false, true) => self.settings.first_fit,
                    (false, false) => self.settings.refit,
                };
                self.guide.follow(&self.state.array, self.settings.warm)?;
                self.fit((steps, 0), &watch)?;
                self.value(is_last, &watch)?;
                if self.settings.warm {
                    self.climb_unless_taken_back(&watch)?;
                } else {
                    self.state.due = self.settings.refit_every;
                }
            }
            // What can be too high is looked into before the mask climbs on, and before the model turns to other far places,
            // which it does not know at once.
            (true, true) => {
                self.value(is_last, &watch)?;
                self.guide.follow(&self.state.array, true)?;
                self.climb_unless_taken_back(&watch)?;
            }
            (true, false) => {
                self.guide.follow(&self.state.array, true)?;
                self.climb_and_value(&watch)?;
            }
        }
        self.state.seconds = watch.seconds();
        Ok(())
    }

    /// The steps of a round, unless an earlier mask has just been taken up which a density model has to learn of first.
    fn climb_unless_taken_back(&mut self, watch: &Watched<'_>) -> Result<(), IdealError> {
        let step = self.state.step;
        let is_back = matches!(self.state.events.last(), Some(IdealEvent::Returned { step: at, .. }) if *at == step);
        let has_learned = self.state.frames.last().is_some_and(|last| last.array == self.state.array);
        if is_back && !has_learned && self.guide.can_overrate() {
            return Ok(());
        }
        self.climb(None, watch).map(|_| ())
    }

    /// Steps that are left of the round, where its model stays as it is.
    fn steps_due(&self) -> usize {
        self.state.due.min(self.settings.steps.saturating_sub(self.state.step))
    }

    /// Adds what the mask is worth now, by the guide as it is.
    fn value(&mut self, is_last: bool, watch: &Watched<'_>) -> Result<(), IdealError> {
        let mut frame = self.frame(is_last, watch)?;
        if self.can_lag_behind() && (self.has_lost_track(&frame) || self.is_due_for_audit(is_last)) {
            frame = self.audited(frame, is_last, watch)?;
        } else if self.state.frames.is_empty() && self.guide.can_overrate() && self.settings.warm {
            frame.afresh = Some(frame.bits_per_pixel);
        }
        if is_last && let Some(better) = self.better_than(&frame, watch)? {
            frame = better;
        }
        if self.guide.can_overrate() && (is_last || self.state.frames.len().is_multiple_of(LOWER_EVERY)) {
            frame.lower = self.lower(&frame.array, watch)?;
        }
        self.state.frames.push(frame);
        self.state.finished = is_last;
        self.take_back(watch)
    }

    /// Fits the guide to the mask as it is: so many steps, each part of a round with draws of its own.
    fn fit(&mut self, (steps, part): (usize, u64), watch: &Watched<'_>) -> Result<(), IdealError> {
        let round = self.state.frames.len();
        let seed = SeedStream::RoundFit { part, round }.derive(self.settings.seed);
        let fit = GuideFit { steps, seed, warm: part == 0 && self.settings.warm && round > 0 };
        let state = &self.state;
        self.guide.fit(&fit, &mut |share| watch.tell(state, Some((Doing::Fitting, share))))
    }

    /// What the mask is worth on objects that neither guide nor mask has seen; the same ones every time.
    fn frame(&self, last: bool, watch: &Watched<'_>) -> Result<Frame, IdealError> {
        let (step, array) = (self.state.step, &self.state.array);
        let go_on = || watch.tell(&self.state, Some((Doing::Measuring, 1.0))).is_continue();
        let value = self.guide.value(array, last, &go_on)?;
        self.frame_of((step, array.clone(), watch.seconds()), value)
    }

    /// A mask that was there after so many steps and seconds, and its value.
    fn frame_of(
        &self,
        (step, array, seconds): (usize, LensletArray, f64),
        (bits_per_pixel, interval_95): Valued,
    ) -> Result<Frame, IdealError> {
        let psf = render_psf(&array, self.imaging.set.planes())?;
        let encoded = self.imaging.convolver(psf.view())?.measure(self.held_out.view(), self.imaging.bias)?;
        let measured = self.imaging.noise.draw(encoded.view(), SeedStream::TamuraNoise.derive(self.settings.seed));
        let distinct = merged(&array);
        Ok(Frame {
            step,
            array,
            bits_per_pixel,
            interval_95,
            lower: None,
            afresh: None,
            tamura: tamura_of_stack(measured.view()).mean().unwrap_or(0.0),
            distinct_lenslets: distinct.lenslets.len(),
            effective_lenslets: distinct.effective_count(),
            seconds,
        })
    }

    /// What a decoder tells of fresh scenes through a mask, where the prior of the objects is known.
    fn lower(&self, array: &LensletArray, watch: &Watched<'_>) -> Result<Option<PretrainedLowerBound>, IdealError> {
        let psf = render_psf(array, self.imaging.set.planes())?;
        let Some(channel) = self.imaging.bead_channel(psf.view(), self.patch) else { return Ok(None) };
        let seed = SeedStream::RunLowerBound.derive(self.settings.seed);
        let go_on = || watch.tell(&self.state, Some((Doing::Measuring, 1.0))).is_continue();
        Ok(PretrainedLowerBound::new(&channel, (LOWER_SAMPLES, 0.0), seed, &go_on)?)
    }
}

/// Frames from one bound from below to the next, and the samples that it rests on.
const LOWER_EVERY: usize = 5;
const LOWER_SAMPLES: usize = 512;

#[cfg(test)]
mod tests {
    use super::super::settings::Preset;
    use super::*;
    use crate::objects::{ObjectOptions, ObjectSet};
    use crate::optics::Lenslet;
    use crate::sensor::Noise;

    pub(super) fn beads() -> ObjectSet {
        let options = ObjectOptions { field: (27, 27), mean_photons: 100.0 };
        ObjectSet::open(&"beads:0.05".parse().unwrap(), &options).unwrap()
    }

    /// One lenslet before a small sensor, and a step of it in every round.
    pub(super) fn small<'a>(imaging: &'a ForwardModel<'a>, settings: &IdealSettings) -> Ideal<'a> {
        let start = LensletArray { rows: 12, cols: 12, lenslets: vec![Lenslet::round(5.0, 5.0, 1.0, 1.0)] };
        let settings = IdealSettings { refit_every: 1, ..settings.clone() };
        Ideal::new(imaging, &start, Limits::default(), settings).unwrap()
    }

    /// Beads that are so few that a small sensor sees more of them through more lenslets.
    pub(super) fn few_beads() -> ObjectSet {
        let options = ObjectOptions { field: (31, 31), mean_photons: 100.0 };
        ObjectSet::open(&"beads:0.01".parse().unwrap(), &options).unwrap()
    }

    /// A short run up the posterior of such beads, a step in every round.
    pub(super) fn short<'a>(imaging: &'a ForwardModel<'a>, lenslets: &[Lenslet], steps: usize) -> Ideal<'a> {
        let start = LensletArray { rows: 16, cols: 16, lenslets: lenslets.to_vec() };
        let settings = IdealSettings {
            patch: Some((16, 16)),
            refit_every: 1,
            first_fit: 1,
            refit: 1,
            last_fit: 1,
            patches: 2,
            tried: 0,
            steps,
            ..IdealSettings::new(Preset::Default, Objective::Posterior, 1)
        };
        Ideal::new(imaging, &start, Limits::default(), settings).unwrap()
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
    fn a_run_with_a_limit_on_lenslets_knows_its_own_state() {
        let set = beads();
        let imaging = ForwardModel::new(&set, (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((500, 500)),
            lenslets: Some(2),
            steps: 3,
            ..IdealSettings::new(Preset::Default, Objective::Posterior, 1)
        };
        let lenslet =
            |index: usize| Lenslet::round(2.0 + (index % 3) as f64 * 3.0, 2.0 + (index / 3) as f64 * 3.0, 1.0, 1.0);
        let start = LensletArray { rows: 12, cols: 12, lenslets: (0..9).map(lenslet).collect() };
        let begun = || Ideal::new(&imaging, &start, Limits::default(), settings.clone()).unwrap();
        let mut ideal = begun();
        ideal.advance(&mut |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(begun().resumed(&ideal.to_bytes().unwrap()).unwrap().state.array, ideal.state.array);
        // What is told of its patch is what it has.
        assert_eq!(ideal.settings().patch, Some((16, 16)));
    }

    #[test]
    fn a_run_is_left_in_the_midst_of_a_step() {
        let set = beads();
        let imaging = ForwardModel::new(&set, (12, 12), 10.0, Noise::Shot).unwrap();
        let settings = IdealSettings {
            patch: Some((5, 5)),
            first_fit: 1,
            patches: 4096,
            ..IdealSettings::new(Preset::Paper, Objective::PixelCnn, 1)
        };
        let mut ideal = small(&imaging, &settings);
        let mut asked_in_step = 0;
        let mut watch = |progress: &IdealProgress<'_>| {
            asked_in_step += usize::from(progress.doing.is_none());
            if asked_in_step < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        // The fit, which begins anew, and the value come before.
        ideal.advance(&mut watch).unwrap();
        let left = ideal.advance(&mut watch);
        assert!(matches!(left, Err(IdealError::Information(InformationError::Cancelled))));
        assert_eq!(ideal.state.step, 0);
    }
}
