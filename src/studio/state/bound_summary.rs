//! The numbers of the design that is shown, from all who know some.

use std::sync::Arc;

use crate::information::{Bracket, Estimate, NamedBound, Protocol};
use crate::studio::state::app_state::State;
use crate::workbench::{FinishedEstimate, LiveEstimate, LiveInformation, RunBounds, Stamped};

/// All that is known of the open design.
pub struct BoundSummary<'a> {
    pub bounds: &'a LiveInformation,
    /// Whether the bounds are those of the design as it is now.
    pub current: bool,
    pub live: Option<(Arc<LiveEstimate>, bool)>,
    /// What the run knows whose mask is shown, for the patch that the live numbers refer to.
    pub run: Option<RunBounds>,
    /// The same for whole measurements.
    pub run_of_sensor: Option<RunBounds>,
    /// All bounds that finished estimates and scores of runs know of the design as it is now, for the patch that the live numbers
    /// refer to.
    pub bracket: Option<Bracket>,
    /// The smallest upper bound by finished estimates of one density model, for that patch.
    pub fitted: Option<NamedBound>,
    /// The same as `bracket` for whole measurements, with their shape; estimates by one density model are bounds in it.
    pub sensor: Option<(Bracket, [usize; 2])>,
}

impl<'a> BoundSummary<'a> {
    pub fn of(state: &State, bounds: &'a LiveInformation, revision: u64) -> Self {
        // A design that was left and came back is the same design.
        let design = state.bench.design();
        let is_of = |result: &&Stamped<FinishedEstimate>| result.value.is_of(design, &state.live);
        let scores = || state.run.iter().flat_map(|run| run.scores_of(design, &state.live));
        let ordered = || state.estimates.finished.iter().rev().filter(is_of).map(|result| &result.value.estimate);
        let finished = || ordered().chain(scores());
        let live = state.estimates.live.as_ref();
        let live = live.map(|live| (Arc::clone(&live.value), state.is_current(live.revision)));
        let sensor = live.as_ref().filter(|(_, current)| *current).and_then(|(live, _)| live.sensor.as_ref());
        let sensor = sensor.map(|sensor| (sensor.bracket.clone(), <[usize; 2]>::from(sensor.patch)));
        let here = [bounds.patch.0, bounds.patch.1];
        let brackets: Vec<_> = finished()
            .filter_map(|estimate| {
                let alone = || Bracket::new(vec![bound_of(estimate)?], Vec::new());
                let of_whole = || alone().filter(|_| estimate.patch != here);
                Some((estimate.bracket.clone().or_else(of_whole)?, estimate.patch))
            })
            .chain(sensor)
            .collect();
        let of =
            |patch| Bracket::joined(brackets.iter().filter(|(_, other)| *other == patch).map(|(bracket, _)| bracket));
        let fitted = finished().filter(|estimate| estimate.patch == here).filter_map(bound_of);
        let bracket = of(here);
        let whole = brackets.iter().find(|(_, patch)| *patch != here);
        let sensor = whole.and_then(|(_, patch)| Some((of(*patch)?, *patch)));
        let has_live = live.as_ref().is_some_and(|(_, current)| *current);
        let of_run = |patch| {
            let run = state.run.as_ref().and_then(|run| run.bounds_of(design, patch));
            run.filter(|run| run.is_of_mask || !has_live)
        };
        let (run, run_of_sensor) = (of_run(Some(bounds.patch)), of_run(None));
        Self {
            bounds,
            current: state.is_current(revision),
            // Masks of a run are no edits of the design from before.
            live: live.filter(|(_, current)| *current || (run.is_none() && run_of_sensor.is_none())),
            run,
            run_of_sensor,
            bracket,
            fitted: fitted.min_by(|one, other| one.bits_per_pixel.total_cmp(&other.bits_per_pixel)),
            sensor,
        }
    }

    /// What is known of whole measurements from both sides, with their shape.
    pub fn sensor_bracket(&self) -> Option<(f64, &Bracket, [usize; 2])> {
        self.sensor.as_ref().and_then(|(bracket, patch)| Some((bracket.lower?, bracket, *patch)))
    }

    /// The largest lower bound for patches.
    pub fn lower(&self) -> Option<NamedBound> {
        let bracket = self.bracket.as_ref().and_then(|bracket| {
            let (bits_per_pixel, interval_95) = (bracket.lower?, bracket.lower_interval_95?);
            Some(NamedBound { from: bracket.lower_from.clone()?, bits_per_pixel, interval_95 })
        });
        let live = self.current_live().and_then(|live| live.lower.clone());
        let run = self.run.as_ref().and_then(|run| run.lower.clone());
        bracket
            .into_iter()
            .chain(live)
            .chain(run)
            .max_by(|one, other| one.bits_per_pixel.total_cmp(&other.bits_per_pixel))
    }

    /// The live estimate, if it is that of the design as it is now.
    pub fn current_live(&self) -> Option<&LiveEstimate> {
        self.live.as_ref().filter(|(_, current)| *current).map(|(live, _)| &**live)
    }

    pub fn gaussian(&self) -> f64 {
        self.bounds.gaussian.bits_per_pixel
    }

    /// The Gaussian's number, a bound or an approximation, and its name.
    pub fn named_gaussian(&self) -> (f64, String) {
        (self.gaussian(), self.bounds.gaussian_name().to_owned())
    }

    /// The smallest upper bound for patches and its name, or the approximation where there is no bound.
    pub fn upper(&self) -> (f64, String) {
        self.upper_bound().unwrap_or_else(|| self.named_gaussian())
    }

    /// The smallest upper bound for patches, where there is one, and its name.
    pub fn upper_bound(&self) -> Option<(f64, String)> {
        let mut bounds = Vec::from_iter(self.bounds.gaussian_is_bound.then(|| self.named_gaussian()));
        bounds.extend(self.bounds.ceiling_bits().map(|ceiling| (ceiling, "ceiling".to_owned())));
        if let Some((live, true)) = &self.live {
            bounds.push((live.bits_per_pixel, "density model".into()));
        }
        if let Some(upper) = self.current_live().and_then(|live| live.upper.as_ref()) {
            bounds.push((upper.bits_per_pixel, upper.from.clone()));
        }
        bounds.extend(self.fitted.as_ref().map(|fitted| (fitted.bits_per_pixel, fitted.from.clone())));
        if let Some(bracket) = &self.bracket {
            bounds.push((bracket.upper, bracket.upper_from.clone()));
        }
        if let Some(upper) = self.run.as_ref().and_then(|run| run.upper.as_ref()) {
            bounds.push((upper.bits_per_pixel, upper.from.clone()));
        }
        bounds.into_iter().min_by(|one, other| one.0.total_cmp(&other.0))
    }
}

/// The upper bound that an estimate by one density model alone is.
fn bound_of(estimate: &Estimate) -> Option<NamedBound> {
    let is_bound = estimate.is_of_one_model() && estimate.protocol == Protocol::Default;
    is_bound.then(|| NamedBound {
        from: format!("{} estimate", estimate.estimator),
        bits_per_pixel: estimate.bits_per_pixel,
        interval_95: estimate.interval_95,
    })
}
