//! Work of the run thread, and the data that it shares with the window.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::design::{IdealOptimizer, IdealProgress, IdealSettings, time_left};
use crate::evaluation::{EstimateProgress, EvaluationError};
use crate::forward::Design;
use crate::information::Estimate;
use crate::objects::ReadProgress;
use crate::optics::LensletArray;
use crate::studies::{Study, StudyCell, StudyError, StudyEvent};
use crate::workbench::background::activity::{Activities, Entry};
use crate::workbench::background::threads::{SpareCores, Threads, Wake, Work, lock};
use crate::workbench::runs::design_run::{DesignRun, RankedStart, RunStatus, Start};
use crate::workbench::runs::record::IdealRecord;
use crate::workbench::runs::run::run_ideal;
use crate::workbench::runs::score::{comparison_summary, matches_mask, score_in_patches, score_settings, score_whole};
use crate::workbench::runs::store::{RunQueue, RunStore};

/// Time between two reports of the progress of a fit; every move of the mask is reported.
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Time for each fit of a comparison, two for each of eleven masks.
const COMPARED_FOR: Duration = Duration::from_secs(20);

/// Data that the run thread and the window share.
pub(super) struct Shared {
    pub run: Mutex<Option<DesignRun>>,
    /// All starts of the queue.
    pub starts: Mutex<Vec<Start>>,
    /// Newest state of each start.
    pub states: Mutex<Vec<Option<Vec<u8>>>>,
    /// The last mask of the run that was saved in a design file.
    pub saved: Mutex<Option<LensletArray>>,
    pub paused: Mutex<bool>,
    pub resumed: Condvar,
    /// Stops the optimizer; what there is then is scored.
    pub stopped: AtomicBool,
    /// Cancels scores and comparisons as well.
    pub cancelled: AtomicBool,
    /// Store of states between sessions.
    pub folder: Mutex<Option<RunStore>>,
    /// Held while the queue is written.
    pub order: Mutex<()>,
    /// Why the last state or queue could not be written.
    pub persistence_failure: Mutex<Option<String>>,
    pub threads: Threads,
    pub activities: Activities,
    /// The run's place among them.
    pub entry: Mutex<Option<Entry>>,
    pub wake: Wake,
}

/// Sorts the results of a run; drops a comparison that is not of the best one.
fn rank(run: &mut DesignRun) {
    RankedStart::rank(&mut run.ranked);
    run.comparison.take_if(|study| !matches_mask(study, &run.ranked[0].design.encoder));
}

impl Shared {
    pub fn change(&self, change: impl FnOnce(&mut DesignRun)) {
        if let Some(run) = lock(&self.run).as_mut() {
            change(run);
        }
        (self.wake)();
    }

    pub fn compute(&self, settings: &IdealSettings) {
        let done = SpareCores::new(Work::Run, self.threads.clone()).run(|| self.run_all(settings));
        let status = match done {
            Ok(Ok(())) => RunStatus::Finished,
            Ok(Err(error)) if error.is_cancelled() => RunStatus::Stopped,
            Ok(Err(error)) => RunStatus::Failed(error.to_string()),
            Err(panic) => RunStatus::Failed(panic),
        };
        let told = match &status {
            RunStatus::Finished => self.result_in_words().map(Ok),
            RunStatus::Failed(sentence) => Some(Err(sentence.clone())),
            _ => None,
        };
        self.end(status, told);
    }

    pub fn compute_comparison(&self, record: &IdealRecord, before: RunStatus) {
        let told = match SpareCores::new(Work::Run, self.threads.clone()).run(|| self.compare(record)) {
            Ok(Ok(words)) => Some(Ok(words)),
            Ok(Err(StudyError::Cancelled)) => None,
            Ok(Err(error)) => Some(Err(error.to_string())),
            Err(panic) => Some(Err(panic)),
        };
        if let Some(Err(sentence)) = &told {
            self.change(|run| run.comparison_failure = Some(sentence.clone()));
        }
        self.end(before, told);
    }

    /// Compares the result of a run with others, and returns a summary.
    fn compare(&self, record: &IdealRecord) -> Result<String, StudyError> {
        let layouts: Vec<usize> = (1..=9).collect();
        let settings = score_settings(record, &layouts, COMPARED_FOR)?;
        let folder = lock(&self.folder).clone();
        let mut study =
            folder.map_or_else(|| Study::begin(settings.clone()), |kept| kept.comparison(settings.clone()))?;
        let mut compared = study.record().clone();
        self.change(|run| run.comparison = Some(Arc::new(compared.clone())));
        study.run(&mut |event: &StudyEvent<'_>| {
            match event {
                StudyEvent::Step(step) => {
                    let share = (step.number - 1) as f64 / step.cells.max(1) as f64;
                    let doing = format!("Comparing masks: {}", step.name);
                    self.tell(&doing, share, Some(step.left));
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

    /// Sets the status at the end of the work; no `outcome` where it was stopped.
    fn end(&self, status: RunStatus, told: Option<Result<String, String>>) {
        // The window may start another run as soon as it sees the new status.
        let entry = lock(&self.entry).take();
        self.change(|run| {
            run.status = status;
            run.position_gradients = Arc::default();
            run.doing = None;
            run.is_scoring = false;
            run.left = None;
        });
        if let (Some(entry), Some(told)) = (entry, told) {
            entry.end(told);
        }
        (self.wake)();
    }

    /// Summary of the best result so far.
    fn result_in_words(&self) -> Option<String> {
        let run = lock(&self.run);
        let best = run.as_ref()?.ranked.first()?;
        Some(format!("{}: {}", best.design.encoder.describe(), best.estimate.summary()))
    }

    fn run_all(&self, settings: &IdealSettings) -> Result<(), EvaluationError> {
        let starts = lock(&self.starts).clone();
        let at = lock(&self.run).as_ref().map_or(0, |run| run.start_number.0 - 1);
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
        let has_results = lock(&self.run).as_ref().is_some_and(|run| !run.ranked.is_empty());
        failed.filter(|_| !has_results).map_or(Ok(()), Err)
    }

    fn note_failure(&self, sentence: String) {
        self.change(|run| {
            run.failures.retain(|other| *other != sentence);
            run.failures.push(sentence);
        });
        self.keep_order();
    }

    fn run_one(&self, (at, start): (usize, &Start), settings: &IdealSettings) -> Result<(), EvaluationError> {
        let (mut told, mut shown) = (Instant::now(), None);
        let mut watch = |progress: &IdealProgress<'_>| {
            if shown.as_ref() != Some(&progress.state.array) || told.elapsed() >= REPORT_EVERY {
                shown = Some(progress.state.array.clone());
                told = Instant::now();
                self.publish(progress, settings);
            }
            self.proceed()
        };
        let folder = lock(&self.folder).clone();
        self.keep_order();
        let mut keep = |ideal: &IdealOptimizer<'_>| {
            let state = ideal.to_bytes()?;
            let record = Arc::new(IdealRecord::new(&start.design, ideal));
            self.change(|run| {
                run.record = Some(record);
                run.sync(ideal.state());
            });
            if let Some(folder) = &folder {
                self.note_kept(folder.store(at, &state));
            }
            lock(&self.states)[at] = Some(state);
            Ok(())
        };
        let mut reading = |_: &ReadProgress| self.proceed();
        let state = lock(&self.states)[at].clone();
        let run = run_ideal(&start.design, settings, state.as_deref(), &mut reading, &mut keep, &mut watch);
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
        if stopped.is_cancelled() && !self.cancelled.load(Ordering::Relaxed) {
            // The mask of the newest checkpoint is scored; the run can still be resumed.
            let record = lock(&self.run).as_ref().and_then(|run| run.record.clone());
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
        let known = lock(&self.run).as_ref().and_then(|run| run.ranked.iter().find(|known| is_this(known)).cloned());
        let known = if let Some(known) = known {
            known
        } else {
            let (name, estimate) = (start.name.clone(), self.score_in_patches(&design)?);
            let (design, record) = (Arc::clone(&design), Some(Arc::clone(record)));
            let result = RankedStart { name, design, estimate, sensor: None, is_scored: false, record };
            self.change(|run| {
                run.ranked.push(result.clone());
                rank(run);
            });
            self.keep_order();
            result
        };
        if !known.is_scored {
            let unscored = format!("{} has no number for the whole sensor", start.name);
            self.change(|run| run.failures.retain(|sentence| !sentence.starts_with(&unscored)));
            let scored = match known.sensor {
                Some(sensor) => Ok(Some(sensor)),
                None => self.score_whole(&design, &known.estimate),
            };
            if scored.as_ref().is_err_and(EvaluationError::is_cancelled) {
                return scored.map(|_| ());
            }
            self.change(|run| {
                let result = run.ranked.iter_mut().find(|result| is_this(result));
                if let Some(Err(error)) = result.map(|result| result.set_sensor(scored)) {
                    run.failures.push(format!("{unscored}: {error}"));
                }
                rank(run);
            });
            self.keep_order();
        }
        Ok(())
    }

    /// Writes the queue with all results so far.
    pub fn keep_order(&self) {
        // The last writer writes the newest queue.
        let _turn = lock(&self.order);
        let (folder, run) = (lock(&self.folder).clone(), lock(&self.run).clone());
        if let (Some(folder), Some(DesignRun { settings, start_number, ranked, failures, .. })) = (folder, run) {
            let (starts, saved) = (lock(&self.starts).clone(), lock(&self.saved).clone());
            let (at, budget_seconds) = (start_number.0 - 1, None);
            let order = RunQueue { starts, settings, at, ranked, failures, saved, budget_seconds };
            self.note_kept(folder.note(&order));
        }
    }

    /// Notes a failure to write; the run continues.
    fn note_kept(&self, written: Result<(), EvaluationError>) {
        *lock(&self.persistence_failure) = written.err().map(|error| error.to_string());
    }

    /// Scores a design in patches.
    fn score_in_patches(&self, design: &Design) -> Result<Estimate, EvaluationError> {
        score_in_patches(design, None, &mut |progress: &EstimateProgress| self.tell_score("", progress))
    }

    /// Scores a design for whole measurements, where these are larger than patches.
    fn score_whole(&self, design: &Design, patches: &Estimate) -> Result<Option<Estimate>, EvaluationError> {
        score_whole(design, patches, None, &mut |progress: &EstimateProgress| {
            self.tell_score(" for the whole sensor", progress)
        })
    }

    fn tell_score(&self, place: &str, progress: &EstimateProgress) -> ControlFlow<()> {
        let share = progress.done as f64 / progress.total.max(1) as f64;
        let step = format!("Scoring the result{place}: {}", progress.step);
        self.tell(&step, share, None);
        self.change(|run| run.doing = Some((step, share)));
        self.proceed_scoring()
    }

    /// Waits while the run is paused; `Break` where the optimizer is to stop.
    fn proceed(&self) -> ControlFlow<()> {
        self.proceed_unless(&self.stopped)
    }

    /// Waits in the same way for scores and comparisons; `Break` where they are cancelled.
    fn proceed_scoring(&self) -> ControlFlow<()> {
        self.proceed_unless(&self.cancelled)
    }

    fn proceed_unless(&self, ended: &AtomicBool) -> ControlFlow<()> {
        let mut paused = lock(&self.paused);
        while *paused && !ended.load(Ordering::Relaxed) {
            paused = self.resumed.wait(paused).unwrap_or_else(PoisonError::into_inner);
        }
        if ended.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn tell(&self, step: &str, share: f64, left: Option<Duration>) {
        if let Some(entry) = &*lock(&self.entry) {
            entry.tell(step, Some(share), left);
        }
    }

    fn publish(&self, progress: &IdealProgress<'_>, settings: &IdealSettings) {
        let state = progress.state;
        let bits = state.checkpoints.last().map_or(String::new(), |checkpoint| {
            format!(", at {} {:.3} bits per pixel", settings.objective.side(), checkpoint.bits_per_pixel)
        });
        let step = format!("Step {} of {}{bits}", state.step, settings.steps);
        let left = time_left(state, settings, progress.seconds);
        self.tell(&step, state.step as f64 / settings.steps.max(1) as f64, left);
        self.change(|run| {
            run.sync(state);
            run.doing = progress.phase.map(|(doing, share)| (doing.to_string(), share));
            run.seconds = progress.seconds;
            run.left = left;
        });
    }
}
