//! Progress and cancellation of long computations.

use std::ops::ControlFlow;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::information::{AisProgress, DecoderProgress, FitProgress, InformationError};
use crate::progress::Progress;

/// The current step of an estimate and its progress.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimateProgress {
    /// Name of the step, for people.
    pub step: String,
    /// Amount done.
    pub done: usize,
    /// Total amount: objects, patches, or seconds of a fit.
    pub total: usize,
    /// The newest point of the fit.
    pub fit: Option<FitPoint>,
    /// Summary of the files, once they were read.
    pub understood: Option<String>,
}

impl EstimateProgress {
    /// A step that is no fit.
    pub(crate) fn of_step(step: &str, done: usize, total: usize) -> Self {
        Self { step: step.to_owned(), done, total, fit: None, understood: None }
    }

    /// The same progress in system `index`, counted from 0, of `count`.
    pub(crate) fn of_system(&self, index: usize, count: usize) -> Self {
        if count < 2 {
            return self.clone();
        }
        let step = format!("System {} of {count}: {}", index + 1, self.step);
        Self { step, done: index * self.total + self.done, total: count * self.total, ..self.clone() }
    }

    /// The same progress in trial `index`, counted from 0, of `count`. The trial began after `began` seconds of the earlier fits.
    fn of_trial(&self, index: usize, count: usize, began: f64) -> Self {
        let Self { step, done, total, fit, understood } = self.clone();
        let fit = fit.map(|fit| FitPoint { seconds: began + fit.seconds, ..fit });
        Self {
            step: format!("Trial {} of {count}: {step}", index + 1),
            done: index * total + done,
            total: count * total,
            fit,
            understood,
        }
    }
}

/// Reports the progress of one trial as part of the progress of all trials; `seconds` are those of the fits so far.
pub(crate) fn in_trial<T>(
    index: usize,
    count: usize,
    seconds: &mut f64,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
    compute: impl FnOnce(&mut (dyn Progress<EstimateProgress> + Send)) -> T,
) -> T {
    if count < 2 {
        return compute(progress);
    }
    let (began, mut now) = (*seconds, *seconds);
    let result = compute(&mut |step: &EstimateProgress| {
        let step = step.of_trial(index, count, began);
        now = step.fit.map_or(now, |fit| fit.seconds);
        progress.report(&step)
    });
    *seconds = now;
    result
}

/// One point of the curve of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitPoint {
    /// The fitted model.
    pub model: FittedModel,
    /// Seconds of the fits since the estimate started or resumed, including those of earlier trials.
    pub seconds: f64,
    /// Bits per pixel: the cross-entropy of a density model, which falls, or the information gain of a decoder, which rises.
    pub bits: f64,
}

/// The kind of a fitted model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FittedModel {
    /// A density model of the measurements.
    Density,
    /// A decoder of the objects.
    Decoder,
}

/// Receives the steps of a fit or a bound as steps of an estimate.
pub(crate) fn converting<Step>(
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> impl FnMut(&Step) -> ControlFlow<()> + Send
where
    for<'a> EstimateProgress: From<&'a Step>,
{
    |step| progress.report(&step.into())
}

/// Reports a step that is no fit.
pub(crate) fn report_step(
    progress: &mut dyn Progress<EstimateProgress>,
    step: &str,
    done: usize,
    total: usize,
) -> Result<(), InformationError> {
    report(progress, &EstimateProgress::of_step(step, done, total))
}

/// Reports the summary of the files that were read.
pub(crate) fn report_understood(
    progress: &mut dyn Progress<EstimateProgress>,
    understood: &str,
) -> Result<(), InformationError> {
    let understood = Some(understood.to_owned());
    report(progress, &EstimateProgress { step: "Files are read".into(), done: 1, total: 1, fit: None, understood })
}

fn report(progress: &mut dyn Progress<EstimateProgress>, step: &EstimateProgress) -> Result<(), InformationError> {
    if progress.report(step).is_break() { Err(InformationError::Cancelled) } else { Ok(()) }
}

impl From<&FitProgress> for EstimateProgress {
    fn from(fit: &FitProgress) -> Self {
        if let Some((done, total)) = fit.scored {
            return Self { step: "Scoring test patches".into(), done, total, fit: None, understood: None };
        }
        let left = fit.remaining.map_or(0, |left| left.as_secs_f64().ceil() as usize);
        let done = fit.elapsed.as_secs() as usize;
        let step = match fit.best_bits {
            Some(bits) => format!("Fitting, H(Y) {bits:.3} bits per pixel, {left} s left at most"),
            None => format!("Fitting, {left} s left at most"),
        };
        let seconds = fit.elapsed.as_secs_f64();
        let fit = fit.validation_bits.map(|bits| FitPoint { model: FittedModel::Density, seconds, bits });
        Self { step, done, total: done + left, fit, understood: None }
    }
}

impl From<&DecoderProgress> for EstimateProgress {
    fn from(fit: &DecoderProgress) -> Self {
        if let Some(tested) = fit.tested {
            return Self {
                step: "Testing the decoder".into(),
                done: tested,
                total: tested + 1,
                fit: None,
                understood: None,
            };
        }
        let left = fit.remaining.map_or(0, |left| left.as_secs_f64().ceil() as usize);
        let done = fit.elapsed.as_secs() as usize;
        let (seconds, bits) = (fit.elapsed.as_secs_f64(), fit.training_bits);
        let step = format!("Fitting a decoder, {bits:.3} bits per pixel saved, {left} s left");
        Self {
            step,
            done,
            total: done + left,
            fit: Some(FitPoint { model: FittedModel::Decoder, seconds, bits }),
            understood: None,
        }
    }
}

impl From<&AisProgress> for EstimateProgress {
    fn from(found: &AisProgress) -> Self {
        let bits =
            if found.samples == 0 { String::new() } else { format!(", {:.3} bits per pixel", found.bits_per_pixel) };
        let seconds = |time: Duration| time.as_secs_f64().ceil() as usize;
        let Some(left) = found.remaining.map(seconds) else {
            let step = format!("Annealed importance sampling{bits}");
            return Self { step, done: found.samples, total: found.most, fit: None, understood: None };
        };
        let (step, done) = (format!("Annealed importance sampling{bits}, {left} s left"), seconds(found.elapsed));
        Self { step, done, total: done + left, fit: None, understood: None }
    }
}

/// Returns a time in its two largest units, for people.
pub fn format_duration(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    let minutes = (seconds / 60.0).round() as u64;
    match minutes {
        _ if seconds < 9.95 => format!("{} s", (seconds * 10.0).round() / 10.0),
        _ if seconds < 99.5 => format!("{seconds:.0} s"),
        ..120 => format!("{minutes} min"),
        _ if minutes.is_multiple_of(60) => format!("{} h", minutes / 60),
        _ => format!("{} h {} min", minutes / 60, minutes % 60),
    }
}

/// Most points of a fit's curve; beyond, every second one is dropped.
const CURVE_POINTS: usize = 600;

/// Drops every second point of a curve that has grown long.
pub(crate) fn thin_out(curve: &mut Vec<FitPoint>) {
    if curve.len() > CURVE_POINTS {
        let mut index = 0;
        curve.retain(|_| {
            index += 1;
            index % 2 == 1
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn following_the_posterior_tells_the_time_that_is_left() {
        let found = |samples, remaining| AisProgress {
            samples,
            most: 40,
            elapsed: Duration::from_secs(3),
            remaining,
            bits_per_pixel: 0.25,
        };
        let reported = EstimateProgress::from(&found(0, None));
        assert_eq!((reported.step.as_str(), reported.done, reported.total), ("Annealed importance sampling", 0, 40));
        let reported = EstimateProgress::from(&found(10, Some(Duration::from_millis(8_200))));
        let step = "Annealed importance sampling, 0.250 bits per pixel, 9 s left";
        assert_eq!((reported.step.as_str(), reported.done, reported.total), (step, 3, 12));
    }

    #[test]
    fn trials_are_parts_of_one_whole_and_their_curves_follow_each_other() {
        let mut reported: Vec<EstimateProgress> = Vec::new();
        let mut receive = |progress: &EstimateProgress| {
            reported.push(progress.clone());
            ControlFlow::Continue(())
        };
        let mut seconds = 0.0;
        for index in 0..2 {
            in_trial(index, 2, &mut seconds, &mut receive, |progress| {
                for elapsed in [1.0, 4.0] {
                    let fit = Some(FitPoint { model: FittedModel::Density, seconds: elapsed, bits: 5.0 });
                    let (step, done) = ("Fitting".to_owned(), elapsed as usize);
                    let _ = progress.report(&EstimateProgress { step, done, total: 4, fit, understood: None });
                }
                report_step(progress, "Scoring test patches", 3, 4).unwrap();
            });
        }
        let seconds: Vec<f64> = reported.iter().filter_map(|reported| Some(reported.fit?.seconds)).collect();
        assert_eq!(seconds, [1.0, 4.0, 5.0, 8.0]);
        let shares: Vec<(usize, usize)> = reported.iter().map(|reported| (reported.done, reported.total)).collect();
        assert_eq!(shares, [(1, 8), (4, 8), (3, 8), (5, 8), (8, 8), (7, 8)]);
        assert_eq!(reported[4].step, "Trial 2 of 2: Fitting");
        // A single trial is reported unchanged.
        let mut alone = None;
        let mut receive = |progress: &EstimateProgress| {
            alone = Some(progress.step.clone());
            ControlFlow::Continue(())
        };
        in_trial(0, 1, &mut 0.0, &mut receive, |progress| report_step(progress, "Fitting", 0, 1)).unwrap();
        assert_eq!(alone.as_deref(), Some("Fitting"));
    }

    #[test]
    fn durations_have_their_two_largest_units() {
        for (seconds, text) in [
            (0.25, "0.3 s"),
            (9.0, "9 s"),
            (60.0, "60 s"),
            (300.0, "5 min"),
            (1200.0, "20 min"),
            (7200.0, "2 h"),
            (16_200.0, "4 h 30 min"),
        ] {
            assert_eq!(format_duration(Duration::from_secs_f64(seconds)), text);
        }
    }

    #[test]
    fn long_curves_keep_their_first_point_and_their_span() {
        let point = |seconds| FitPoint { model: FittedModel::Density, seconds, bits: 1.0 };
        let mut curve: Vec<FitPoint> = Vec::new();
        for second in 0..5000 {
            curve.push(point(f64::from(second)));
            thin_out(&mut curve);
        }
        assert!(curve.len() <= CURVE_POINTS && curve.len() > CURVE_POINTS / 4);
        assert_eq!(curve.first(), Some(&point(0.0)));
        assert!(curve.last().unwrap().seconds > 4990.0);
    }
}
