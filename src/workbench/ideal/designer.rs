//! Runs for the window: on a thread of their own, where they can be watched, paused and stopped.

use std::fs::File;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::design_run::{DesignRun, RankedStart, RunStatus, SCORED_PATCH, Start, score_request};
use super::record::IdealRecord;
use super::run::{KeptOrder, KeptRun, run_ideal, start_of};
use crate::design::{Ideal, IdealProgress, IdealSettings, merged_result, time_left};
use crate::information::Estimate;
use crate::optics::Encoder;
use crate::workbench::activity::{Activities, ActivityKind, Entry};
use crate::workbench::simulation::{imaging, open_set_with};
use crate::workbench::threads::{SpareCores, Threads, Wake, Work, lock};
use crate::workbench::{Design, EvaluationError, estimate};

/// Time between two tellings of a fit's progress; moves of the mask are all told.
const TELL_EVERY: Duration = Duration::from_millis(100);

/// Why a run is not started.
const BUSY: &str = "one run goes on at a time; stop it first";

/// The thread of runs; dropping it lets the run end at its next step.
pub(in crate::workbench) struct Designer {
    shared: Arc<Shared>,
    /// Held so that no other program keeps its runs in the same folder.
    lock: Mutex<Option<File>>,
}

struct Shared {
    run: Mutex<Option<DesignRun>>,
    /// The last state that a run can go on from.
    kept: Mutex<Option<Vec<u8>>>,
    /// All starts of the last order.
    starts: Mutex<Vec<Start>>,
    paused: Mutex<bool>,
    resumed: Condvar,
    stopped: AtomicBool,
    /// Where states survive the program.
    folder: Mutex<Option<KeptRun>>,
    /// Why the last state or order was not written there.
    keep_failure: Mutex<Option<String>>,
    threads: Threads,
    activities: Activities,
    /// The run's place among them.
    entry: Mutex<Option<Entry>>,
    wake: Wake,
}

impl Designer {
    pub fn new(wake: Wake, threads: Threads, activities: Activities) -> Self {
        Self {
            shared: Arc::new(Shared {
                run: Mutex::default(),
                kept: Mutex::default(),
                starts: Mutex::default(),
                paused: Mutex::default(),
                resumed: Condvar::new(),
                stopped: AtomicBool::new(false),
                folder: Mutex::default(),
                keep_failure: Mutex::default(),
                threads,
                activities,
                entry: Mutex::default(),
                wake,
            }),
            lock: Mutex::default(),
        }
    }

    /// Keeps the states of runs in a folder, and takes up the one that is there.
    ///
    /// # Errors
    /// Where another program keeps its runs there.
    pub fn keep_in(&self, folder: KeptRun) -> Result<(), EvaluationError> {
        *lock(&self.lock) = folder.lock()?;
        if let Some((KeptOrder { starts, settings, at, ranked }, state)) = folder.last() {
            let mut run = DesignRun::new(&starts[at].design, settings, starts.len());
            (run.start_number, run.ranked, run.doing) = ((at + 1, starts.len()), ranked, None);
            run.status = RunStatus::Stopped;
            if let Some((bytes, state)) = state {
                // One that was to go on after its score has more steps before it, or another mask by now.
                let found = Encoder::Lenslets(merged_result(&state.array, &run.settings));
                let has_ended = state.finished && state.step >= run.settings.steps;
                if has_ended && run.ranked.iter().any(|result| result.design.encoder == found) {
                    run.status = RunStatus::Finished;
                }
                run.take_up(&state);
                run.seconds = state.seconds();
                *lock(&self.shared.kept) = Some(bytes);
            }
            *lock(&self.shared.starts) = starts;
            *lock(&self.shared.run) = Some(run);
        }
        *lock(&self.shared.folder) = Some(folder);
        Ok(())
    }

    /// Whether the next program can take up the run.
    pub fn keeps(&self) -> bool {
        lock(&self.shared.folder).is_some() && self.keep_failure().is_none()
    }

    /// Why it cannot, where something was to be written and was not.
    pub fn keep_failure(&self) -> Option<String> {
        lock(&self.shared.keep_failure).clone()
    }

    /// The next program need not take up the run.
    pub fn forget(&self) {
        if let Some(folder) = &*lock(&self.shared.folder) {
            folder.end();
        }
    }

    /// The run, if there was one.
    pub fn run(&self) -> Option<DesignRun> {
        lock(&self.shared.run).clone()
    }

    /// Starts a run from each of `starts`, one after the other; each is scored in the end.
    ///
    /// # Errors
    /// One sentence where another run goes on or the first start allows none.
    pub fn start(&self, starts: Vec<Start>, settings: IdealSettings) -> Result<(), String> {
        let Some(first) = starts.first() else { return Err("there is no mask to start from".into()) };
        let array = start_of(&first.design).map_err(|error| error.to_string())?;
        settings.check(array).map_err(|error| error.to_string())?;
        let run = DesignRun::new(&first.design, settings, starts.len());
        if self.is_active() {
            return Err(BUSY.into());
        }
        self.forget();
        *lock(&self.shared.kept) = None;
        *lock(&self.shared.starts) = starts;
        self.spawn(run)
    }

    /// Lets a run go on: one that was stopped to its end, one that came to its end for so many more steps.
    ///
    /// # Errors
    /// One sentence where there is none, or it still goes on.
    pub fn extend(&self, steps: usize) -> Result<(), String> {
        let Some(mut run) = self.run() else { return Err("there is no run to go on with".into()) };
        // One that was stopped first takes the steps that it was to take, and is scored.
        if run.status == RunStatus::Finished {
            run.settings.steps += steps;
        }
        run.status = RunStatus::Running;
        self.spawn(run)
    }

    fn is_active(&self) -> bool {
        lock(&self.shared.run).as_ref().is_some_and(DesignRun::is_active)
    }

    /// Computes the start that the run is at, and those after it.
    fn spawn(&self, run: DesignRun) -> Result<(), String> {
        if self.is_active() {
            return Err(BUSY.into());
        }
        let settings = run.settings.clone();
        let starts = run.start_number.1;
        let from = if starts > 1 { format!("{starts} starts") } else { run.start.encoder.describe() };
        let entry = self.shared.activities.add(ActivityKind::Run, format!("Optimize {from}"));
        entry.begin();
        *lock(&self.shared.entry) = Some(entry);
        *lock(&self.shared.run) = Some(run);
        self.shared.stopped.store(false, Ordering::Relaxed);
        *lock(&self.shared.paused) = false;
        let shared = Arc::clone(&self.shared);
        let spawned =
            std::thread::Builder::new().name("lenslet-designer".into()).spawn(move || shared.compute(&settings));
        spawned.map(|_| ()).map_err(|error| {
            let sentence = format!("no thread for the run: {error}");
            self.shared.change(|run| run.status = RunStatus::Failed(sentence.clone()));
            if let Some(entry) = lock(&self.shared.entry).take() {
                entry.end(Err(sentence.clone()));
            }
            sentence
        })
    }

    /// Lets the run wait, or go on.
    pub fn pause(&self, pause: bool) {
        *lock(&self.shared.paused) = pause;
        self.shared.resumed.notify_all();
        let status = if pause { RunStatus::Paused } else { RunStatus::Running };
        self.shared.change(|run| {
            if run.is_active() {
                run.status = status;
            }
        });
        if let Some(entry) = &*lock(&self.shared.entry) {
            entry.pause(pause);
        }
    }

    /// Ends the run at its next step; it can go on later.
    pub fn stop(&self) {
        self.shared.stopped.store(true, Ordering::Relaxed);
        *lock(&self.shared.paused) = false;
        self.shared.resumed.notify_all();
    }
}

impl Drop for Designer {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Shared {
    fn change(&self, change: impl FnOnce(&mut DesignRun)) {
        if let Some(run) = lock(&self.run).as_mut() {
            change(run);
        }
        (self.wake)();
    }

    fn compute(&self, settings: &IdealSettings) {
        let done = SpareCores::new(Work::Run, self.threads.clone()).run(|| self.run_all(settings));
        let status = match done {
            Ok(Ok(())) => RunStatus::Finished,
            Ok(Err(error)) if error.is_cancelled() => RunStatus::Stopped,
            Ok(Err(error)) => RunStatus::Failed(error.to_string()),
            Err(panic) => RunStatus::Failed(panic),
        };
        // Whoever sees the end may begin another run at once.
        let (entry, words) = (lock(&self.entry).take(), self.result_in_words());
        self.change(|run| {
            run.status = status.clone();
            run.doing = None;
            run.left = None;
        });
        if let Some(entry) = entry {
            match (status, words) {
                (RunStatus::Finished, Some(text)) => entry.end(Ok(text)),
                (RunStatus::Failed(sentence), _) => entry.end(Err(sentence)),
                // Without an end, it was stopped.
                _ => drop(entry),
            }
        }
        (self.wake)();
    }

    /// The best result so far.
    fn result_in_words(&self) -> Option<String> {
        let run = lock(&self.run);
        let best = run.as_ref()?.ranked.first()?;
        Some(format!("{}: {}", best.design.encoder.describe(), best.estimate.in_words()))
    }

    fn run_all(&self, settings: &IdealSettings) -> Result<(), EvaluationError> {
        let starts = lock(&self.starts).clone();
        let at = lock(&self.run).as_ref().map_or(0, |run| run.start_number.0 - 1);
        let mut failed = None;
        for (index, start) in starts.iter().enumerate().skip(at) {
            if index > at {
                *lock(&self.kept) = None;
                self.change(|run| {
                    let (ranked, settings) = (std::mem::take(&mut run.ranked), run.settings.clone());
                    // Between two starts it may just have been paused.
                    let (start_number, status) = ((index + 1, starts.len()), run.status.clone());
                    let fresh = DesignRun::new(&start.design, settings, starts.len());
                    *run = DesignRun { status, start_number, ranked, ..fresh };
                });
            }
            match self.run_one(start, settings) {
                Err(error) if !error.is_cancelled() => failed = Some((start.name.clone(), error)),
                done => done?,
            }
        }
        // What the others have found is worth showing.
        let has_results = lock(&self.run).as_ref().is_some_and(|run| !run.ranked.is_empty());
        match failed {
            Some((name, error)) if has_results => {
                self.tell(&format!("{name} failed: {error}"), 1.0, None);
                Ok(())
            }
            Some((_, error)) => Err(error),
            None => Ok(()),
        }
    }

    fn run_one(&self, start: &Start, settings: &IdealSettings) -> Result<(), EvaluationError> {
        let from = lock(&self.kept).clone();
        let (mut told, mut shown) = (Instant::now(), None);
        let mut watch = |progress: &IdealProgress<'_>| {
            if shown.as_ref() != Some(&progress.state.array) || told.elapsed() >= TELL_EVERY {
                shown = Some(progress.state.array.clone());
                told = Instant::now();
                self.publish(progress, settings);
            }
            self.go_on()
        };
        let folder = lock(&self.folder).clone();
        if let Some(folder) = &folder
            && from.is_none()
        {
            folder.forget_state();
        }
        self.keep_order();
        let mut keep = |ideal: &Ideal<'_>| {
            *lock(&self.kept) = Some(ideal.to_bytes()?);
            let record = Arc::new(IdealRecord::new(&start.design, ideal));
            self.change(|run| {
                run.record = Some(record);
                run.take_up(ideal.state());
            });
            if let Some(folder) = &folder {
                self.note_kept(folder.store(ideal));
            }
            Ok(())
        };
        let record = run_ideal(&start.design, settings, from.as_deref(), &|_| self.go_on(), &mut keep, &mut watch)?;
        let design = Arc::new(record.design());
        self.change(|run| {
            run.record = Some(Arc::new(record));
            run.left = None;
        });
        let estimate = self.score(&design)?;
        self.change(|run| {
            let name = start.name.clone();
            run.ranked.push(RankedStart { name, design, estimate });
            run.ranked.sort_by(|one, other| other.worth().total_cmp(&one.worth()));
        });
        self.keep_order();
        Ok(())
    }

    /// Writes what was ordered and what came of it so far, but for the state of the start that the run is at.
    fn keep_order(&self) {
        let (folder, run) = (lock(&self.folder).clone(), lock(&self.run).clone());
        if let (Some(folder), Some(DesignRun { settings, start_number, ranked, .. })) = (folder, run) {
            let starts = lock(&self.starts).clone();
            self.note_kept(folder.note(&KeptOrder { starts, settings, at: start_number.0 - 1, ranked }));
        }
    }

    /// A run is worth more than its copy: it goes on where nothing can be written, and tells so.
    fn note_kept(&self, written: Result<(), EvaluationError>) {
        *lock(&self.keep_failure) = written.err().map(|error| error.to_string());
    }

    /// What a design is worth, by models of its own.
    fn score(&self, design: &Design) -> Result<Estimate, EvaluationError> {
        let set = open_set_with(design, &|_| self.go_on())?;
        let patch = imaging(design, &set)?.patch(Some(SCORED_PATCH));
        drop(set);
        estimate(design, &score_request(design, patch), &mut |progress| {
            let share = progress.done as f64 / progress.total.max(1) as f64;
            let step = format!("Scoring the result: {}", progress.step);
            self.tell(&step, share, None);
            self.change(|run| run.doing = Some((step, share)));
            self.go_on()
        })
    }

    /// Waits while the run is paused; breaks off where it is to stop.
    fn go_on(&self) -> ControlFlow<()> {
        let mut paused = lock(&self.paused);
        while *paused && !self.stopped.load(Ordering::Relaxed) {
            paused = self.resumed.wait(paused).unwrap_or_else(PoisonError::into_inner);
        }
        if self.stopped.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
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

#[cfg(test)]
mod tests {
    use super::super::design_run::{BRACKET_STEPS, LIVE_STEPS};
    use super::*;
    use crate::design::{Objective, Preset};
    use crate::information::FitLength;
    use crate::objects::ObjectSource;
    use crate::optics::random_layout;
    use crate::workbench::{DensityModel, EstimateRequest, estimate_command};

    #[test]
    fn results_are_scored_by_what_a_command_can_repeat() {
        let beads = Design::default();
        let pictures = Design { objects: ObjectSource::Idx("digits".into()), ..Design::default() };
        for (design, estimator, steps) in [(beads, "bracket", BRACKET_STEPS), (pictures, "live", LIVE_STEPS)] {
            let request = score_request(&design, SCORED_PATCH);
            assert_eq!(request.model.length(), Some(FitLength::Steps(steps)));
            let command = estimate_command(&design, &request).unwrap();
            assert!(command.contains(&format!("--estimator {estimator} --patch 32x32 --steps {steps} ")), "{command}");
        }
    }

    fn designer(kept: &KeptRun) -> Designer {
        let designer = Designer::new(Arc::new(|| ()), Threads::default(), Activities::default());
        designer.keep_in(kept.clone()).unwrap();
        designer
    }

    #[test]
    fn what_several_starts_have_found_outlives_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let kept = KeptRun::in_folder(folder.path()).unwrap();
        let start = |seed| {
            let encoder = Encoder::Lenslets(random_layout(3, seed));
            Start { name: format!("random {seed}"), design: Arc::new(Design { encoder, ..Design::default() }) }
        };
        let starts: Vec<Start> = (1..=3).map(start).collect();
        let design = Arc::clone(&starts[0].design);
        let request = EstimateRequest {
            model: DensityModel::Stationary,
            patches_train: 80,
            patches_test: 20,
            ..score_request(&design, SCORED_PATCH)
        };
        let found = estimate(&design, &request, &mut |_| ControlFlow::Continue(())).unwrap();
        let ranked = vec![RankedStart { name: starts[0].name.clone(), design, estimate: found }];
        let settings =
            IdealSettings { patch: Some((6, 6)), ..IdealSettings::new(Preset::Default, Objective::Density, 1) };

        // It ended when the first had been scored and the second had not begun.
        kept.note(&KeptOrder { starts, settings, at: 0, ranked: ranked.clone() }).unwrap();
        let designer = self::designer(&kept);
        let run = designer.run().unwrap();
        assert_eq!((run.start_number, run.step, &run.status), ((2, 3), 0, &RunStatus::Stopped));
        assert!(run.can_go_on());
        assert_eq!(run.start.encoder, Encoder::Lenslets(random_layout(3, 2)));

        // It goes on with the second, and ends in the midst of it.
        designer.extend(1).unwrap();
        let deadline = Instant::now() + Duration::from_mins(5);
        while kept.load().unwrap().is_none() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(20));
        }
        designer.stop();
        while designer.is_active() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(20));
        }
        let before = designer.run().unwrap();
        // Nobody else keeps runs in the folder meanwhile.
        let other = Designer::new(Arc::new(|| ()), Threads::default(), Activities::default());
        assert!(other.keep_in(kept.clone()).is_err() && !other.keeps());
        drop(designer);
        let designer = self::designer(&kept);
        let left = designer.run().unwrap();
        assert_eq!((left.start_number, &left.status), ((2, 3), &RunStatus::Stopped));
        assert!((1..=before.step).contains(&left.step), "{} {}", left.step, before.step);
        assert_eq!(left.settings, run.settings, "what was stopped takes no more steps than it was to take");
        for found in [&run.ranked, &left.ranked] {
            assert_eq!((found.len(), &found[0].name), (1, &ranked[0].name));
            assert_eq!((&found[0].design, &found[0].estimate), (&ranked[0].design, &ranked[0].estimate));
        }
        // Given up, it does not come back.
        designer.forget();
        drop(designer);
        assert!(self::designer(&kept).run().is_none());
    }
}
