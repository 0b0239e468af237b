//! The bounds of the shown design, from live estimate, finished estimates and run.

use std::sync::Arc;

use crate::evaluation::LiveInformation;
use crate::information::{BoundMethod, Bracket, Estimate, NamedBound, Protocol};
use crate::studio::state::view::View;
use crate::workbench::{FinishedEstimate, LiveEstimate, Revisioned, RunBounds};

/// All bounds of the shown design.
pub struct BoundSummary<'a> {
    /// Bounds that need no fit.
    pub bounds: &'a LiveInformation,
    /// Whether the bounds belong to the current revision of the design.
    pub current: bool,
    /// The live estimate, and whether it belongs to the current revision.
    pub live: Option<(Arc<LiveEstimate>, bool)>,
    /// Bounds of the previewed mask by its run, for the patch of the live numbers.
    pub run: Option<RunBounds>,
    /// Bounds of the previewed mask by its run, for whole measurements.
    pub run_of_sensor: Option<RunBounds>,
    /// Bracket of finished estimates and run scores of the current design, for the patch of the live numbers.
    pub bracket: Option<Bracket>,
    /// Smallest upper bound of finished estimates by one density model, for that patch.
    pub fitted: Option<NamedBound>,
    /// Bracket of whole measurements; includes estimates by one density model.
    pub sensor: Option<PatchBracket>,
}

/// Bracket of patches or whole measurements.
#[derive(Clone, Debug)]
pub struct PatchBracket {
    /// The bracket.
    pub bracket: Bracket,
    /// Their shape (rows, cols).
    pub patch: [usize; 2],
}

impl<'a> BoundSummary<'a> {
    /// All bounds of the shown design; `bounds` belong to `revision`.
    pub fn of(view: &View<'_>, bounds: &'a LiveInformation, revision: u64) -> Self {
        // Compared by value: undo may return to an estimated design.
        let design = view.design;
        let is_of = |result: &&Revisioned<FinishedEstimate>| result.value.is_of(design, view.live);
        let scores = || view.run.iter().flat_map(|run| run.scores_of(design, view.live));
        let ordered = || view.estimates.finished.iter().rev().filter(is_of).map(|result| &result.value.estimate);
        let finished = || ordered().chain(scores());
        let live = view.estimates.live.as_ref();
        let live = live.map(|live| (Arc::clone(&live.value), view.is_current(live.revision)));
        let sensor = live.as_ref().filter(|(_, current)| *current).and_then(|(live, _)| live.sensor.as_ref());
        let sensor = sensor.map(|sensor| PatchBracket { bracket: sensor.bracket.clone(), patch: sensor.patch.into() });
        let here = [bounds.patch.0, bounds.patch.1];
        let brackets: Vec<_> = finished()
            .filter_map(|estimate| {
                let alone = || Bracket::new(vec![bound_of(estimate)?], Vec::new());
                let of_whole = || alone().filter(|_| estimate.patch != here);
                Some(PatchBracket { bracket: estimate.bracket.clone().or_else(of_whole)?, patch: estimate.patch })
            })
            .chain(sensor)
            .collect();
        let of =
            |patch| Bracket::joined(brackets.iter().filter(|known| known.patch == patch).map(|known| &known.bracket));
        let fitted = finished().filter(|estimate| estimate.patch == here).filter_map(bound_of);
        let bracket = of(here);
        let whole = brackets.iter().map(|known| known.patch).find(|&patch| patch != here);
        let sensor = whole.and_then(|patch| Some(PatchBracket { bracket: of(patch)?, patch }));
        let has_live = live.as_ref().is_some_and(|(_, current)| *current);
        let of_run = |patch| {
            let run = view.run.and_then(|run| run.bounds_of(design, patch));
            run.filter(|run| run.is_of_mask || !has_live)
        };
        let (run, run_of_sensor) = (of_run(Some(bounds.patch)), of_run(None));
        Self {
            bounds,
            current: view.is_current(revision),
            // A live estimate of an earlier edit does not apply to a mask of a run.
            live: live.filter(|(_, current)| *current || (run.is_none() && run_of_sensor.is_none())),
            run,
            run_of_sensor,
            bracket,
            fitted: fitted.min_by(|one, other| one.bits_per_pixel.total_cmp(&other.bits_per_pixel)),
            sensor,
        }
    }

    /// Bracket of whole measurements with its lower bound, bits per pixel, if both sides are known.
    pub fn sensor_bracket(&self) -> Option<(f64, &PatchBracket)> {
        self.sensor.as_ref().and_then(|sensor| Some((sensor.bracket.lower?, sensor)))
    }

    /// Largest lower bound for patches.
    pub fn lower(&self) -> Option<NamedBound> {
        let bracket = self.bracket.as_ref().and_then(|bracket| {
            let (bits_per_pixel, interval_95) = (bracket.lower?, bracket.lower_interval_95?);
            Some(NamedBound { from: bracket.lower_from?, bits_per_pixel, interval_95 })
        });
        let live = self.current_live().and_then(|live| live.lower.clone());
        let run = self.run.as_ref().and_then(|run| run.lower.clone());
        bracket
            .into_iter()
            .chain(live)
            .chain(run)
            .max_by(|one, other| one.bits_per_pixel.total_cmp(&other.bits_per_pixel))
    }

    /// The live estimate, if it belongs to the current revision.
    pub fn current_live(&self) -> Option<&LiveEstimate> {
        self.live.as_ref().filter(|(_, current)| *current).map(|(live, _)| &**live)
    }

    /// Gaussian information, bits per pixel.
    pub fn gaussian(&self) -> f64 {
        self.bounds.gaussian.bits_per_pixel
    }

    /// Gaussian information, bits per pixel, and its name: bound or approximation.
    pub fn named_gaussian(&self) -> (f64, String) {
        (self.gaussian(), self.bounds.gaussian_name().to_owned())
    }

    /// Smallest upper bound for patches and its name; the Gaussian approximation if there is none.
    pub fn upper(&self) -> (f64, String) {
        self.upper_bound().unwrap_or_else(|| self.named_gaussian())
    }

    /// Smallest upper bound for patches and its name, if any.
    pub fn upper_bound(&self) -> Option<(f64, String)> {
        let mut bounds = Vec::from_iter(self.bounds.gaussian_is_bound.then(|| self.named_gaussian()));
        bounds.extend(self.bounds.ceiling_bits().map(|ceiling| (ceiling, "entropy bound".to_owned())));
        if let Some((live, true)) = &self.live {
            bounds.push((live.bits_per_pixel, "density model".into()));
        }
        if let Some(upper) = self.current_live().and_then(|live| live.upper.as_ref()) {
            bounds.push((upper.bits_per_pixel, upper.from.to_string()));
        }
        bounds.extend(self.fitted.as_ref().map(|fitted| (fitted.bits_per_pixel, fitted.from.to_string())));
        if let Some(bracket) = &self.bracket {
            bounds.push((bracket.upper, bracket.upper_from.to_string()));
        }
        if let Some(upper) = self.run.as_ref().and_then(|run| run.upper.as_ref()) {
            bounds.push((upper.bits_per_pixel, upper.from.to_string()));
        }
        bounds.into_iter().min_by(|one, other| one.0.total_cmp(&other.0))
    }
}

/// Upper bound of an estimate by one density model.
fn bound_of(estimate: &Estimate) -> Option<NamedBound> {
    let is_bound = estimate.is_of_one_model() && estimate.protocol == Protocol::Default;
    is_bound.then_some(NamedBound {
        from: BoundMethod::Estimator(estimate.estimator),
        bits_per_pixel: estimate.bits_per_pixel,
        interval_95: estimate.interval_95,
    })
}
