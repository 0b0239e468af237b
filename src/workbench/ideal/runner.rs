//! The thread of runs: what goes on there, and what others see of it.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::design::{Ideal, IdealProgress, IdealSettings, time_left};
use crate::evaluation::{EstimateProgress, EvaluationError};
use crate::forward::Design;
use crate::information::Estimate;
use crate::optics::LensletArray;
use crate::studies::{Study, StudyCell, StudyError, StudyEvent};
use crate::workbench::background::activity::{Activities, Entry};
use crate::workbench::background::threads::{SpareCores, Threads, Wake, Work, lock};
use crate::workbench::ideal::design_run::{DesignRun, RankedStart, RunStatus, Start};
use crate::workbench::ideal::record::IdealRecord;
use crate::workbench::ideal::run::{GoOn, KeptOrder, KeptRun, run_ideal};
use crate::workbench::ideal::score::{is_about, score_in_patches, score_settings, score_whole, verdict};

/// Time between two tellings of a fit's progress; moves of the mask are all told.
const TELL_EVERY: Duration = Duration::from_millis(100);

/// Time for each fit of a comparison, two for each of eleven masks.
const COMPARED_FOR: Duration = Duration::from_secs(20);

/// What the thread of runs and the window have in common.
pub(super) struct Shared {
    pub run: Mutex<Option<DesignRun>>,
    /// All starts of the last order.
    pub starts: Mutex<Vec<Start>>,
    /// The last state of each that it can go on from.
    pub states: Mutex<Vec<Option<Vec<u8>>>>,
    /// The last mask of the run that is in a file of a person's.
    pub saved: Mutex<Option<LensletArray>>,
    pub paused: Mutex<bool>,
    pub resumed: Condvar,
    pub stopped: AtomicBool,
    /// The frame of an earlier mask that the run is to go on from, by whoever runs it.
    pub rewind_to: Mutex<Option<usize>>,
    /// Where states survive the program.
    pub folder: Mutex<Option<KeptRun>>,
    /// Held while the order is written there.
    pub order: Mutex<()>,
    /// Why the last state or order was not written there.
    pub keep_failure: Mutex<Option<String>>,
    pub threads: Threads,
    pub activities: Activities,
    /// The run's place among them.
    pub entry: Mutex<Option<Entry>>,
    pub wake: Wake,
}

/// Puts the results of a run in their order; a comparison of another than the best goes.
fn rank(run: &mut DesignRun) {
    RankedStart::rank(&mut run.ranked);
    run.comparison.take_if(|study| !is_about(study, &run.ranked[0].design.encoder));
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

    /// Compares the result of a run with others; what comes back says what came of it.
    fn compare(&self, record: &IdealRecord) -> Result<String, StudyError> {
        let layouts: Vec<usize> = (1..=9).collect();
        let settings = score_settings(record, &layouts, COMPARED_FOR)?;
        let folder = lock(&self.folder).clone();
        let mut study =
            folder.map_or_else(|| Study::begin(settings.clone()), |kept| kept.comparison(settings.clone()))?;
        let mut compared = study.record().clone();
        self.change(|run| run.comparison = Some(Arc::new(compared.clone())));
        study.run(&mut |event| {
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
            self.go_on()
        })?;
        Ok(verdict(study.record()).join("; "))
    }

    /// Notes how work on the run ended; without a word, it was stopped.
    fn end(&self, status: RunStatus, told: Option<Result<String, String>>) {
        // Whoever sees the end may begin another run at once.
        let entry = lock(&self.entry).take();
        self.change(|run| {
            run.status = status;
            run.pulls = Arc::default();
            run.doing = None;
            run.left = None;
        });
        if let (Some(entry), Some(told)) = (entry, told) {
            entry.end(told);
        }
        (self.wake)();
    }

    /// The best result so far.
    fn result_in_words(&self) -> Option<String> {
        let run = lock(&self.run);
        let best = run.as_ref()?.ranked.first()?;
        Some(format!("{}: {}", best.design.encoder.describe(), best.estimate.summary()))
    }

    fn run_all(&self, settings: &IdealSettings) -> Result<(), EvaluationError> {
        let starts = lock(&self.starts).clone();
        let (at, alone) = lock(&self.run).as_ref().map_or((0, false), |run| (run.start_number.0 - 1, run.alone));
        let end = if alone { at + 1 } else { starts.len() };
        let mut failed = None;
        for (index, start) in starts.iter().enumerate().take(end).skip(at) {
            if index > at {
                self.change(|run| {
                    let fresh = DesignRun::new(&start.design, run.settings.clone(), starts.len());
                    *run = DesignRun {
                        // Between two starts it may just have been paused.
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
        // What the others have found is worth showing.
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
            if shown.as_ref() != Some(&progress.state.array) || told.elapsed() >= TELL_EVERY {
                shown = Some(progress.state.array.clone());
                told = Instant::now();
                self.publish(progress, settings);
            }
            self.go_on_unless_rewound()
        };
        let folder = lock(&self.folder).clone();
        self.keep_order();
        let mut keep = |ideal: &Ideal<'_>| {
            let state = ideal.to_bytes()?;
            let record = Arc::new(IdealRecord::new(&start.design, ideal));
            self.change(|run| {
                run.record = Some(record);
                run.take_up(ideal.state());
            });
            if let Some(folder) = &folder {
                self.note_kept(folder.store(at, &state));
            }
            lock(&self.states)[at] = Some(state);
            Ok(())
        };
        let reading = |_| self.go_on_unless_rewound();
        let record = loop {
            let (state, rewind_to) = (lock(&self.states)[at].clone(), lock(&self.rewind_to).take());
            let from = state.as_deref().map(|state| GoOn { state, rewind_to });
            match run_ideal(&start.design, settings, from, &reading, &mut keep, &mut watch) {
                Err(error) if error.is_cancelled() && self.is_to_rewind() => {}
                done => break done?,
            }
        };
        let (design, record) = (Arc::new(record.design()), Arc::new(record));
        self.change(|run| {
            run.record = Some(Arc::clone(&record));
            run.left = None;
        });
        // It may have been stopped when it was scored in part.
        let is_this = |result: &RankedStart| result.name == start.name && result.design == design;
        let known = lock(&self.run).as_ref().and_then(|run| run.ranked.iter().find(|known| is_this(known)).cloned());
        let known = if let Some(known) = known {
            known
        } else {
            let (name, estimate) = (start.name.clone(), self.score_in_patches(&design)?);
            let (design, record) = (Arc::clone(&design), Some(record));
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
                if let Some(Err(error)) = result.map(|result| result.take_sensor(scored)) {
                    run.failures.push(format!("{unscored}: {error}"));
                }
                rank(run);
            });
            self.keep_order();
        }
        Ok(())
    }

    /// Writes what was ordered and what came of it so far, but for the state of the start that the run is at.
    pub fn keep_order(&self) {
        // Whoever writes last writes what is newest.
        let _turn = lock(&self.order);
        let (folder, run) = (lock(&self.folder).clone(), lock(&self.run).clone());
        if let (Some(folder), Some(DesignRun { settings, start_number, alone, ranked, failures, .. })) = (folder, run) {
            let (starts, saved) = (lock(&self.starts).clone(), lock(&self.saved).clone());
            let (at, budget_seconds) = (start_number.0 - 1, None);
            let order = KeptOrder { starts, settings, at, alone, ranked, failures, saved, budget_seconds };
            self.note_kept(folder.note(&order));
        }
    }

    /// A run is worth more than its copy: it goes on where nothing can be written, and tells so.
    fn note_kept(&self, written: Result<(), EvaluationError>) {
        *lock(&self.keep_failure) = written.err().map(|error| error.to_string());
    }

    /// What a design is worth in patches, by models of its own.
    fn score_in_patches(&self, design: &Design) -> Result<Estimate, EvaluationError> {
        score_in_patches(design, None, &mut |progress| self.tell_score("", progress))
    }

    /// The same for whole measurements, where these are larger.
    fn score_whole(&self, design: &Design, patches: &Estimate) -> Result<Option<Estimate>, EvaluationError> {
        score_whole(design, patches, None, &mut |progress| self.tell_score(" for the whole sensor", progress))
    }

    fn tell_score(&self, place: &str, progress: &EstimateProgress) -> ControlFlow<()> {
        let share = progress.done as f64 / progress.total.max(1) as f64;
        let step = format!("Scoring the result{place}: {}", progress.step);
        self.tell(&step, share, None);
        self.change(|run| run.doing = Some((step, share)));
        self.go_on()
    }

    /// Waits while the run is paused; breaks off where it is to stop.
    fn go_on(&self) -> ControlFlow<()> {
        let mut paused = lock(&self.paused);
        while *paused && !self.stopped.load(Ordering::Relaxed) {
            paused = self.resumed.wait(paused).unwrap_or_else(PoisonError::into_inner);
        }
        if self.stopped.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// The same for what a run does, which is left as well where it is to go on from an earlier mask.
    fn go_on_unless_rewound(&self) -> ControlFlow<()> {
        match self.go_on() {
            ControlFlow::Continue(()) if self.is_to_rewind() => ControlFlow::Break(()),
            answer => answer,
        }
    }

    /// Whether it is to go on from an earlier mask, rather than to end.
    fn is_to_rewind(&self) -> bool {
        lock(&self.rewind_to).is_some() && !self.stopped.load(Ordering::Relaxed)
    }

    fn tell(&self, step: &str, share: f64, left: Option<Duration>) {
        if let Some(entry) = &*lock(&self.entry) {
            entry.tell(step, Some(share), left);
        }
    }

    fn publish(&self, progress: &IdealProgress<'_>, settings: &IdealSettings) {
        let state = progress.state;
        let bits = state.frames.last().map_or(String::new(), |frame| {
            format!(", at {} {:.3} bits per pixel", settings.objective.side(), frame.bits_per_pixel)
        });
        let step = format!("Step {} of {}{bits}", state.step, settings.steps);
        let left = time_left(state, settings, progress.seconds);
        self.tell(&step, state.step as f64 / settings.steps.max(1) as f64, left);
        self.change(|run| {
            run.take_up(state);
            run.doing = progress.doing.map(|(doing, share)| (doing.to_string(), share));
            run.seconds = progress.seconds;
            run.left = left;
        });
    }
}
