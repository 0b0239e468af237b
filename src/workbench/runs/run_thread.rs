//! Thread of the optimizer runs of the window, which can be paused, stopped and resumed.

use std::fs::File;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};

use crate::design::{IdealOptimizer, IdealSettings, merged_result};
use crate::evaluation::EvaluationError;
use crate::optics::{Encoder, LensletArray};
use crate::workbench::background::activity::{Activities, ActivityKind};
use crate::workbench::background::threads::{Threads, Wake, lock};
use crate::workbench::runs::design_run::{DesignRun, RankedStart, RunStatus, Start};
use crate::workbench::runs::run::start_of;
use crate::workbench::runs::store::{RunQueue, RunStore};
use crate::workbench::runs::worker::Shared;

/// Message where nothing can be compared.
const NO_RESULT: &str = "there is no result to compare yet";
/// Message where no run can be started.
const BUSY: &str = "a run is active; stop it first";

/// Handle of the thread; dropping it cancels the run at its next step.
pub(in crate::workbench) struct RunThread {
    shared: Arc<Shared>,
    /// Held so that no other program keeps its runs in the same folder.
    lock: Mutex<Option<File>>,
}

impl RunThread {
    pub fn new(wake: Wake, threads: Threads, activities: Activities) -> Self {
        Self {
            shared: Arc::new(Shared {
                run: Mutex::default(),
                states: Mutex::default(),
                saved: Mutex::default(),
                starts: Mutex::default(),
                paused: Mutex::default(),
                resumed: Condvar::new(),
                stopped: AtomicBool::new(false),
                cancelled: AtomicBool::new(false),
                folder: Mutex::default(),
                order: Mutex::default(),
                persistence_failure: Mutex::default(),
                threads,
                activities,
                entry: Mutex::default(),
                wake,
            }),
            lock: Mutex::default(),
        }
    }

    /// Saves the states of runs in a folder, and loads the run that is there.
    ///
    /// # Errors
    /// Where another program has locked the folder.
    pub fn keep_in(&self, folder: RunStore) -> Result<(), EvaluationError> {
        *lock(&self.lock) = folder.lock()?;
        if let Some((order, states)) = folder.last() {
            let RunQueue { starts, settings, at, ranked, failures, saved, .. } = order;
            let mut run = DesignRun::new(&starts[at].design, settings, starts.len());
            (run.start_number, run.doing) = ((at + 1, starts.len()), None);
            (run.ranked, run.failures, run.status) = (ranked, failures, RunStatus::Stopped);
            run.comparison = run.ranked.first().and_then(|best| folder.compared(&best.design.encoder)).map(Arc::new);
            if let Some(state) = states[at].as_deref().and_then(|bytes| IdealOptimizer::state_in(bytes).ok()) {
                // A run that was extended after its score has steps left, or another mask.
                let found = Encoder::Lenslets(merged_result(&state.array, &run.settings));
                let has_ended = state.finished && state.step >= run.settings.steps;
                let scored = |result: &&RankedStart| result.is_scored && result.design.encoder == found;
                if let Some(result) = run.ranked.iter().find(scored).filter(|_| has_ended) {
                    (run.record, run.status) = (result.record.clone(), RunStatus::Finished);
                }
                run.sync(&state);
                run.seconds = state.seconds();
            }
            *lock(&self.shared.states) = states;
            *lock(&self.shared.starts) = starts;
            *lock(&self.shared.saved) = saved;
            *lock(&self.shared.run) = Some(run);
        }
        *lock(&self.shared.folder) = Some(folder);
        Ok(())
    }

    /// Whether the run is saved, so that the next session can load it.
    pub fn keeps(&self) -> bool {
        lock(&self.shared.folder).is_some() && self.persistence_failure().is_none()
    }

    /// Why the last state or queue could not be written.
    pub fn persistence_failure(&self) -> Option<String> {
        lock(&self.shared.persistence_failure).clone()
    }

    /// Notes that a mask of the run was saved in a design file.
    pub fn note_saved(&self, mask: &LensletArray) {
        *lock(&self.shared.saved) = Some(mask.clone());
        let shared = Arc::clone(&self.shared);
        // The window does not wait for it. Where there is no thread the mask is asked about once more.
        let _ = std::thread::Builder::new().name("lenslet-order".into()).spawn(move || shared.keep_order());
    }

    /// The last mask of the run that was saved in a design file.
    pub fn saved(&self) -> Option<LensletArray> {
        lock(&self.shared.saved).clone()
    }

    /// The present or last run.
    pub fn run(&self) -> Option<DesignRun> {
        lock(&self.shared.run).clone()
    }

    /// Starts a run from each of `starts`, one after the other; each result is scored.
    ///
    /// # Errors
    /// One sentence where another run is active or the first start allows none.
    pub fn start(&self, starts: Vec<Start>, settings: IdealSettings) -> Result<(), String> {
        let Some(first) = starts.first() else { return Err("there is no mask to start from".into()) };
        let array = start_of(&first.design).map_err(|error| error.to_string())?;
        settings.check(array).map_err(|error| error.to_string())?;
        let run = DesignRun::new(&first.design, settings, starts.len());
        if self.is_active() {
            return Err(BUSY.into());
        }
        if let Some(folder) = &*lock(&self.shared.folder) {
            folder.remove();
        }
        *lock(&self.shared.states) = vec![None; starts.len()];
        *lock(&self.shared.saved) = None;
        *lock(&self.shared.starts) = starts;
        self.run_on(run)
    }

    /// Resumes a stopped run, or extends a finished one by `steps` steps.
    ///
    /// # Errors
    /// One sentence where there is no run, it is active, or several starts are finished.
    pub fn extend(&self, steps: usize) -> Result<(), String> {
        let Some(mut run) = self.run() else { return Err("there is no run to resume".into()) };
        if run.status == RunStatus::Finished {
            if run.start_number.1 > 1 {
                return Err("several starts are finished; open a result as a design and start a run from it".into());
            }
            run.settings.steps = run.step + steps;
        }
        run.status = RunStatus::Running;
        self.run_on(run)
    }

    /// Compares the best result with its start and the nine heuristic layouts, by one estimator; an earlier comparison is continued.
    ///
    /// # Errors
    /// One sentence where there is no result yet, or a run is active.
    pub fn compare(&self) -> Result<(), String> {
        let Some(mut run) = self.run() else { return Err(NO_RESULT.into()) };
        let Some(record) = run.ranked.first().and_then(|best| best.record.clone()) else {
            return Err(NO_RESULT.into());
        };
        let before = std::mem::replace(&mut run.status, RunStatus::Running);
        (run.comparison_failure, run.is_scoring, run.doing) = (None, true, Some(("Comparing masks".into(), 0.0)));
        self.spawn(run, "Compare the result".into(), move |shared| shared.compute_comparison(&record, before))
    }

    fn is_active(&self) -> bool {
        lock(&self.shared.run).as_ref().is_some_and(DesignRun::is_active)
    }

    /// Runs the current start and those after it.
    fn run_on(&self, run: DesignRun) -> Result<(), String> {
        let settings = run.settings.clone();
        let starts = run.start_number.1;
        let from = if starts > 1 { format!("{starts} starts") } else { run.start.encoder.describe() };
        self.spawn(run, format!("Optimize {from}"), move |shared| shared.compute(&settings))
    }

    /// Starts the thread for one piece of work on the run.
    fn spawn(&self, run: DesignRun, name: String, work: impl FnOnce(&Shared) + Send + 'static) -> Result<(), String> {
        if self.is_active() {
            return Err(BUSY.into());
        }
        let entry = self.shared.activities.add(ActivityKind::Run, name);
        entry.begin();
        *lock(&self.shared.entry) = Some(entry);
        *lock(&self.shared.run) = Some(run);
        self.shared.stopped.store(false, Ordering::Relaxed);
        self.shared.cancelled.store(false, Ordering::Relaxed);
        *lock(&self.shared.paused) = false;
        let shared = Arc::clone(&self.shared);
        let spawned = std::thread::Builder::new().name("lenslet-designer".into()).spawn(move || work(&shared));
        spawned.map(|_| ()).map_err(|error| {
            let sentence = format!("no thread for the run: {error}");
            self.shared.change(|run| run.status = RunStatus::Failed(sentence.clone()));
            if let Some(entry) = lock(&self.shared.entry).take() {
                entry.end(Err(sentence.clone()));
            }
            sentence
        })
    }

    /// Pauses or resumes the run.
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

    /// Stops the run at its next step and scores the mask of its newest checkpoint; stops a score or comparison that is under way. The
    /// run can be resumed later.
    pub fn stop(&self) {
        let is_optimizing = self.run().is_some_and(|run| !run.is_scoring);
        self.shared.stopped.store(true, Ordering::Relaxed);
        self.end_pause(!is_optimizing);
    }

    /// Stops the run at its next step without a score.
    pub fn cancel(&self) {
        self.shared.stopped.store(true, Ordering::Relaxed);
        self.end_pause(true);
    }

    fn end_pause(&self, cancel: bool) {
        if cancel {
            self.shared.cancelled.store(true, Ordering::Relaxed);
        }
        *lock(&self.shared.paused) = false;
        self.shared.resumed.notify_all();
    }
}

impl Drop for RunThread {
    fn drop(&mut self) {
        self.cancel();
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::design::{Objective, Preset};
    use crate::evaluation::{DensityModel, EstimateRequest, estimate};
    use crate::forward::Design;
    use crate::information::FitLength;
    use crate::objects::ObjectSource;
    use crate::optics::random_layout;
    use crate::progress::CancelToken;
    use crate::workbench::estimate_command;
    use crate::workbench::runs::design_run::{BRACKET_STEPS, LIVE_STEPS, score_request};
    use crate::workbench::runs::run::run_ideal;

    #[test]
    fn scores_are_reproducible_by_a_command() {
        let beads = Design::default();
        let pictures = Design { objects: ObjectSource::Idx("digits".into()), ..Design::default() };
        for (design, estimator, steps) in [(beads, "bracket", BRACKET_STEPS), (pictures, "causal", LIVE_STEPS)] {
            let request = score_request(&design, Some((32, 32)));
            assert_eq!(request.model.length(), Some(FitLength::Steps(steps)));
            let command = estimate_command(&design, &request).unwrap();
            assert!(command.contains(&format!("--estimator {estimator} --patch 32x32 --steps {steps} ")), "{command}");
        }
    }

    fn designer(kept: &RunStore) -> RunThread {
        let designer = RunThread::new(Arc::new(|| ()), Threads::default(), Activities::default());
        designer.keep_in(kept.clone()).unwrap();
        designer
    }

    /// The run once it is as wanted, or after five minutes.
    fn wait(designer: &RunThread, done: &dyn Fn(&DesignRun) -> bool) -> DesignRun {
        let deadline = Instant::now() + Duration::from_mins(5);
        while !designer.run().is_some_and(|run| done(&run)) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        designer.run().unwrap()
    }

    #[test]
    fn paused_run_ends_as_one_without_a_pause() {
        let start = Start::random(&Design::default(), 3, 1);
        let settings = IdealSettings {
            patch: Some((6, 6)),
            steps: 8,
            refit_every: 2,
            first_fit: 30,
            refit: 20,
            last_fit: 30,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let never = CancelToken::new();
        let (mut reading, mut progress) = (never.clone(), never);
        let whole = run_ideal(&start.design, &settings, None, &mut reading, &mut |_| Ok(()), &mut progress).unwrap();

        let designer = RunThread::new(Arc::new(|| ()), Threads::default(), Activities::default());
        designer.start(vec![start], settings).unwrap();
        let wait_for = |done: &dyn Fn(&DesignRun) -> bool| wait(&designer, done);
        for step in [1, 4] {
            wait_for(&|run| run.step >= step);
            designer.pause(true);
            let before = wait_for(&|run| run.status == RunStatus::Paused).step;
            std::thread::sleep(Duration::from_millis(100));
            let after = designer.run().unwrap();
            assert!(after.step <= before + 1 && after.status == RunStatus::Paused, "{} {before}", after.step);
            designer.pause(false);
        }
        let run = wait_for(&|run| run.record.as_ref().is_some_and(|record| record.finished));
        designer.cancel();
        let record = run.record.unwrap();
        assert_eq!((&record.result, record.checkpoints.len()), (&whole.result, whole.checkpoints.len()));
        for (one, other) in record.checkpoints.iter().zip(&whole.checkpoints) {
            assert_eq!((one.step, &one.array, one.bits_per_pixel), (other.step, &other.array, other.bits_per_pixel));
        }
        wait_for(&|run| !run.is_active());
    }

    #[test]
    fn stopped_run_is_scored_and_can_be_resumed() {
        let start = Start::random(&Design::default(), 3, 1);
        let settings = IdealSettings {
            patch: Some((6, 6)),
            steps: 4_000,
            refit_every: 2,
            first_fit: 30,
            refit: 4,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let thread = RunThread::new(Arc::new(|| ()), Threads::default(), Activities::default());
        thread.start(vec![start], settings).unwrap();
        let wait_for = |done: &dyn Fn(&DesignRun) -> bool| wait(&thread, done);
        wait_for(&|run| run.checkpoints.len() > 3);
        thread.stop();
        let scoring = wait_for(&|run| run.is_scoring || !run.is_active());
        assert!(scoring.is_scoring && scoring.status == RunStatus::Running, "{:?}", scoring.status);
        thread.stop();
        let stopped = wait_for(&|run| !run.is_active());
        assert_eq!((&stopped.status, stopped.settings.steps), (&RunStatus::Stopped, 4_000));
        assert!(stopped.can_resume());
        thread.extend(1).unwrap();
        let run = wait_for(&|run| run.step > stopped.step);
        assert_eq!((run.settings.steps, &run.status), (4_000, &RunStatus::Running));
        thread.cancel();
        assert_eq!(wait_for(&|run| !run.is_active()).status, RunStatus::Stopped);
    }

    #[test]
    fn results_of_several_starts_are_loaded_again() {
        let folder = tempfile::tempdir().unwrap();
        let kept = RunStore::in_folder(folder.path()).unwrap();
        let starts: Vec<Start> = (1..=3).map(|seed| Start::random(&Design::default(), 3, seed)).collect();
        let design = Arc::clone(&starts[0].design);
        let request = EstimateRequest {
            model: DensityModel::Stationary,
            patches_train: 80,
            patches_test: 20,
            ..score_request(&design, Some((32, 32)))
        };
        let found = estimate(&design, &request, &mut CancelToken::new()).unwrap();
        let name = starts[0].name.clone();
        let ranked = vec![RankedStart { name, design, estimate: found, sensor: None, is_scored: true, record: None }];
        let settings =
            IdealSettings { patch: Some((6, 6)), ..IdealSettings::new(Preset::Default, Objective::Density, 1) };

        // It ended when the first had been scored and the second had not begun.
        let order = RunQueue { ranked: ranked.clone(), ..RunQueue::new(starts, settings) };
        kept.note(&order).unwrap();
        let designer = self::designer(&kept);
        let run = designer.run().unwrap();
        assert_eq!((run.start_number, run.step, &run.status), ((2, 3), 0, &RunStatus::Stopped));
        assert!(run.can_resume());
        assert_eq!(run.start.encoder, Encoder::Lenslets(random_layout(3, 2)));

        // It continues with the second start, and ends in the middle of it.
        designer.extend(1).unwrap();
        let deadline = Instant::now() + Duration::from_mins(5);
        while kept.load(1).unwrap().is_none() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(20));
        }
        designer.cancel();
        while designer.is_active() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(20));
        }
        let before = designer.run().unwrap();
        // Nobody else keeps runs in the folder meanwhile.
        let other = RunThread::new(Arc::new(|| ()), Threads::default(), Activities::default());
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
        // A run that was given up is not restored.
        drop(designer);
        kept.remove();
        assert!(self::designer(&kept).run().is_none());
    }
}
