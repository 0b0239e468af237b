//! Computation of runs: the optimizer from each start, the scores of their results, and the comparison of the best one.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::design::{IdealOptimizer, IdealProgress, IdealSettings, time_left};
use crate::evaluation::{EstimateProgress, EvaluationError};
use crate::forward::Design;
use crate::information::Estimate;
use crate::objects::ReadProgress;
use crate::progress::CancelToken;
use crate::studies::{Study, StudyCell, StudyError, StudyEvent};
use crate::workbench::background::mailbox::Mailbox;
use crate::workbench::runs::design_run::{DesignRun, RankedStart, Start};
use crate::workbench::runs::record::IdealRecord;
use crate::workbench::runs::run::run_ideal;
use crate::workbench::runs::score::{comparison_summary, matches_mask, score_in_patches, score_settings, score_whole};
use crate::workbench::runs::slot::{RunAnswer, RunSlot, RunTask, RunWork};

/// Time between two reports of the progress of a fit; every move of the mask is reported.
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Time for each fit of a comparison, two for each of eleven masks.
const COMPARED_FOR: Duration = Duration::from_secs(20);

/// Computes a task of the run thread.
pub(super) fn compute(task: &RunTask, cancel: &CancelToken, mailbox: &Mailbox<RunSlot>) -> RunAnswer {
    match task {
        RunTask::Work { work: RunWork::Optimize(settings), stop } => {
            RunAnswer::Optimized(RunContext { mailbox, stop, cancel }.run_all(settings))
        }
        RunTask::Work { work: RunWork::Compare { record, .. }, stop } => {
            RunAnswer::Compared(RunContext { mailbox, stop, cancel }.compare(record))
        }
        RunTask::WriteQueue => {
            write_queue(mailbox);
            RunAnswer::Written
        }
    }
}

/// Writes the queue with all results so far.
fn write_queue(mailbox: &Mailbox<RunSlot>) {
    if let Some((folder, queue)) = mailbox.change(RunSlot::take_queue) {
        note_written(mailbox, folder.note(&queue));
    }
}

/// Notes a failure to write; the run continues.
fn note_written(mailbox: &Mailbox<RunSlot>, written: Result<(), EvaluationError>) {
    mailbox.publish(|slot| slot.persistence_failure = written.err().map(|error| error.to_string()));
}

/// Waits while the run is paused, and writes the queue if that is necessary; `Break` once `cancel` is cancelled.
pub(super) fn proceed(mailbox: &Mailbox<RunSlot>, cancel: &CancelToken) -> ControlFlow<()> {
    loop {
        mailbox.wait_while(cancel, |slot| slot.is_paused() && !slot.is_out_of_date())?;
        if !mailbox.look(RunSlot::is_out_of_date) {
            return ControlFlow::Continue(());
        }
        write_queue(mailbox);
    }
}

/// The work on a run: its mailbox, and the tokens that end it.
struct RunContext<'a> {
    mailbox: &'a Mailbox<RunSlot>,
    /// Ends the optimizer; what there is then is scored.
    stop: &'a CancelToken,
    /// Ends scores and comparisons as well.
    cancel: &'a CancelToken,
}

/// Sorts the results of a run; drops a comparison that is not of the best one.
fn rank(run: &mut DesignRun) {
    RankedStart::rank(&mut run.ranked);
    run.comparison.take_if(|study| !matches_mask(study, &run.ranked[0].design.encoder));
}

impl RunContext<'_> {
    fn change(&self, change: impl FnOnce(&mut DesignRun)) {
        self.mailbox.publish(|slot| slot.run.as_mut().map(change));
    }

    /// The run as it is.
    fn run(&self) -> Option<DesignRun> {
        self.mailbox.look(|slot| slot.run.clone())
    }

    /// Compares the result of a run with others, and returns a summary.
    fn compare(&self, record: &IdealRecord) -> Result<String, StudyError> {
        let layouts: Vec<usize> = (1..=9).collect();
        let settings = score_settings(record, &layouts, COMPARED_FOR)?;
        let folder = self.mailbox.look(|slot| slot.folder.clone());
        let mut study =
            folder.map_or_else(|| Study::begin(settings.clone()), |kept| kept.comparison(settings.clone()))?;
        let mut compared = study.record().clone();
        self.change(|run| run.comparison = Some(Arc::new(compared.clone())));
        study.run(&mut |event: &StudyEvent<'_>| {
            match event {
                StudyEvent::Step(step) => {
                    let share = (step.number - 1) as f64 / step.cells.max(1) as f64;
                    let doing = format!("Comparing masks: {}", step.name);
                    self.report(&doing, share, Some(step.left));
                    self.change(|run| (run.doing, run.left) = (Some((doing, share)), Some(step.left)));
                }
                StudyEvent::Done { cell, .. } => {
                    compared.put(StudyCell::clone(cell));
                    self.change(|run| run.comparison = Some(Arc::new(compared.clone())));
                }
            }
            self.proceed_scoring()
        })?;
        Ok(comparison_summary(study.record()).join("; "))
    }

    fn run_all(&self, settings: &IdealSettings) -> Result<(), EvaluationError> {
        let starts = self.mailbox.look(|slot| slot.starts.clone());
        let at = self.run().map_or(0, |run| run.start_number.0 - 1);
        let mut failed = None;
        for (index, start) in starts.iter().enumerate().skip(at) {
            if index > at {
                self.change(|run| {
                    let fresh = DesignRun::new(&start.design, run.settings.clone(), starts.len());
                    *run = DesignRun {
                        // The run may have been paused between two starts.
                        status: run.status.clone(),
                        start_number: (index + 1, starts.len()),
                        ranked: std::mem::take(&mut run.ranked),
                        failures: std::mem::take(&mut run.failures),
                        comparison: run.comparison.take(),
                        ..fresh
                    };
                });
            }
            match self.run_one((index, start), settings) {
                Err(error) if !error.is_cancelled() => {
                    self.note_failure(format!("{} failed: {error}", start.name));
                    failed = Some(error);
                }
                done => done?,
            }
        }
        // Results of other starts stay useful.
        let has_results = self.run().is_some_and(|run| !run.ranked.is_empty());
        failed.filter(|_| !has_results).map_or(Ok(()), Err)
    }

    fn note_failure(&self, sentence: String) {
        self.change(|run| {
            run.failures.retain(|other| *other != sentence);
            run.failures.push(sentence);
        });
        write_queue(self.mailbox);
    }

    fn run_one(&self, (at, start): (usize, &Start), settings: &IdealSettings) -> Result<(), EvaluationError> {
        let (mut reported, mut shown) = (Instant::now(), None);
        let mut on_progress = |progress: &IdealProgress<'_>| {
            if shown.as_ref() != Some(&progress.state.array) || reported.elapsed() >= REPORT_EVERY {
                shown = Some(progress.state.array.clone());
                reported = Instant::now();
                self.publish(progress, settings);
            }
            self.proceed()
        };
        let folder = self.mailbox.look(|slot| slot.folder.clone());
        write_queue(self.mailbox);
        let mut keep = |ideal: &IdealOptimizer<'_>| {
            let state = ideal.to_bytes()?;
            let record = Arc::new(IdealRecord::new(&start.design, ideal));
            self.change(|run| {
                run.record = Some(record);
                run.sync(ideal.state());
            });
            if let Some(folder) = &folder {
                note_written(self.mailbox, folder.store(at, &state));
            }
            self.mailbox.change(|slot| slot.states[at] = Some(state));
            Ok(())
        };
        let mut reading = |_: &ReadProgress| self.proceed();
        let state = self.mailbox.look(|slot| slot.states[at].clone());
        let run = run_ideal(&start.design, settings, state.as_deref(), &mut reading, &mut keep, &mut on_progress);
        let stopped = match run {
            Ok(record) => {
                let record = Arc::new(record);
                self.change(|run| {
                    run.record = Some(Arc::clone(&record));
                    run.left = None;
                });
                return self.score(start, &record);
            }
            Err(error) => error,
        };
        if stopped.is_cancelled() && !self.cancel.is_cancelled() {
            // The mask of the newest checkpoint is scored; the run can still be resumed.
            let record = self.run().and_then(|run| run.record);
            if let Some(record) = record.filter(|record| record.steps() > 0) {
                self.score(start, &record)?;
            }
        }
        Err(stopped)
    }

    /// Scores the result of a run in patches and for the whole sensor, where that is not done yet.
    fn score(&self, start: &Start, record: &Arc<IdealRecord>) -> Result<(), EvaluationError> {
        self.change(|run| run.is_scoring = true);
        let done = self.add_score(start, record);
        self.change(|run| run.is_scoring = false);
        done
    }

    fn add_score(&self, start: &Start, record: &Arc<IdealRecord>) -> Result<(), EvaluationError> {
        let design = Arc::new(record.design());
        // A score may have been stopped before.
        let is_this = |result: &RankedStart| result.name == start.name && result.design == design;
        let known = self.run().and_then(|run| run.ranked.into_iter().find(|known| is_this(known)));
        let known = if let Some(known) = known {
            known
        } else {
            let (name, estimate) = (start.name.clone(), self.score_in_patches(&design)?);
            let (design, record) = (Arc::clone(&design), Some(Arc::clone(record)));
            let result =
                RankedStart { name, design, estimate, sensor: None, is_scored: false, sensor_failure: None, record };
            self.change(|run| {
                run.ranked.push(result.clone());
                rank(run);
            });
            write_queue(self.mailbox);
            result
        };
        if !known.is_scored {
            self.change(|run| {
                run.ranked.iter_mut().filter(|result| is_this(result)).for_each(|result| result.sensor_failure = None);
            });
            let scored = match known.sensor {
                Some(sensor) => Ok(Some(sensor)),
                None => self.score_whole(&design, &known.estimate),
            };
            if scored.as_ref().is_err_and(EvaluationError::is_cancelled) {
                return scored.map(|_| ());
            }
            self.change(|run| {
                if let Some(result) = run.ranked.iter_mut().find(|result| is_this(result)) {
                    // The result keeps the error.
                    let _ = result.set_sensor(scored);
                }
                rank(run);
            });
            write_queue(self.mailbox);
        }
        Ok(())
    }

    /// Scores a design in patches.
    fn score_in_patches(&self, design: &Design) -> Result<Estimate, EvaluationError> {
        score_in_patches(design, None, &mut |progress: &EstimateProgress| self.report_score("", progress))
    }

    /// Scores a design for whole measurements, where these are larger than patches.
    fn score_whole(&self, design: &Design, patches: &Estimate) -> Result<Option<Estimate>, EvaluationError> {
        score_whole(design, patches, None, &mut |progress: &EstimateProgress| {
            self.report_score(" for the whole sensor", progress)
        })
    }

    fn report_score(&self, place: &str, progress: &EstimateProgress) -> ControlFlow<()> {
        let share = progress.done as f64 / progress.total.max(1) as f64;
        let step = format!("Scoring the result{place}: {}", progress.step);
        self.report(&step, share, None);
        self.change(|run| run.doing = Some((step, share)));
        self.proceed_scoring()
    }

    /// Waits while the run is paused; `Break` where the optimizer is to stop.
    fn proceed(&self) -> ControlFlow<()> {
        proceed(self.mailbox, self.stop)
    }

    /// Waits in the same way for scores and comparisons; `Break` where they are cancelled.
    fn proceed_scoring(&self) -> ControlFlow<()> {
        proceed(self.mailbox, self.cancel)
    }

    fn report(&self, step: &str, share: f64, left: Option<Duration>) {
        self.mailbox.look(|slot| slot.entry().map(|entry| entry.report(step, Some(share), left)));
    }

    fn publish(&self, progress: &IdealProgress<'_>, settings: &IdealSettings) {
        let state = progress.state;
        let bits = state.checkpoints.last().map_or(String::new(), |checkpoint| {
            format!(", at {} {:.3} bits per pixel", settings.objective.side(), checkpoint.bits_per_pixel)
        });
        let step = format!("Step {} of {}{bits}", state.step, settings.steps);
        let left = time_left(state, settings, progress.seconds);
        self.report(&step, state.step as f64 / settings.steps.max(1) as f64, left);
        self.change(|run| {
            run.sync(state);
            run.doing = progress.phase.map(|(doing, share)| (doing.to_string(), share));
            run.seconds = progress.seconds;
            run.left = left;
        });
    }
}
