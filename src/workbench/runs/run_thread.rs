//! Thread of the optimizer runs of the window, which can be paused, stopped and resumed.

use std::fs::File;
use std::sync::{Arc, Mutex};

use crate::design::{IdealOptimizer, IdealSettings, merged_result};
use crate::evaluation::EvaluationError;
use crate::optics::{Encoder, LensletArray};
use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{Computation, MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work, lock};
use crate::workbench::runs::computation::compute;
use crate::workbench::runs::design_run::{DesignRun, RankedStart, RunStatus, Start};
use crate::workbench::runs::run::start_of;
use crate::workbench::runs::slot::{RunSlot, RunWork};
use crate::workbench::runs::store::{RunQueue, RunStore, StoredRun};

/// Message where nothing can be compared.
const NO_RESULT: &str = "there is no result to compare yet";

/// Handle of the thread; dropping it cancels the run and waits for its last step.
pub(in crate::workbench) struct RunThread {
    thread: MailboxThread<RunSlot>,
    /// Held so that no other program keeps its runs in the same folder.
    lock: Mutex<Option<File>>,
}

impl RunThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start_thread(wake: Wake, threads: Threads, activities: Activities) -> std::io::Result<Self> {
        Self::with_computation(wake, threads, activities, || compute)
    }

    /// Starts the thread with another computation.
    fn with_computation<C: Computation<RunSlot>>(
        wake: Wake,
        threads: Threads,
        activities: Activities,
        make: impl Fn() -> C + Send + 'static,
    ) -> std::io::Result<Self> {
        let settings = ThreadSettings { name: "lenslet-designer", work: Work::Run, threads, wake };
        let thread = MailboxThread::start(settings, RunSlot::new(activities), make)?;
        Ok(Self { thread, lock: Mutex::default() })
    }

    /// Saves the states of runs in a folder, and loads the run that is there.
    ///
    /// # Errors
    /// Where another program has locked the folder.
    pub fn keep_in(&self, folder: RunStore) -> Result<(), EvaluationError> {
        *lock(&self.lock) = folder.lock()?;
        if let Some(StoredRun { queue, states }) = folder.last() {
            let RunQueue { starts, settings, at, ranked, failures, saved, .. } = queue;
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
            self.thread.change(|slot| {
                (slot.states, slot.starts, slot.saved, slot.run) = (states, starts, saved, Some(run));
            });
        }
        self.thread.change(|slot| slot.folder = Some(folder));
        Ok(())
    }

    /// Whether the run is saved, so that the next session can load it.
    pub fn keeps(&self) -> bool {
        self.thread.look(|slot| slot.folder.is_some() && slot.persistence_failure.is_none())
    }

    /// Why the last state or queue could not be written.
    pub fn persistence_failure(&self) -> Option<String> {
        self.thread.look(|slot| slot.persistence_failure.clone())
    }

    /// Notes that a mask of the run was saved in a design file.
    pub fn note_saved(&self, mask: &LensletArray) {
        self.thread.change(|slot| slot.note_saved(mask.clone()));
    }

    /// The last mask of the run that was saved in a design file.
    pub fn saved(&self) -> Option<LensletArray> {
        self.thread.look(|slot| slot.saved.clone())
    }

    /// The present or last run.
    pub fn run(&self) -> Option<DesignRun> {
        self.thread.look(|slot| slot.run.clone())
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
        self.thread.look(RunSlot::check_idle)?;
        if let Some(folder) = self.thread.look(|slot| slot.folder.clone()) {
            folder.remove();
        }
        self.thread.change(|slot| {
            (slot.states, slot.saved, slot.starts) = (vec![None; starts.len()], None, starts);
        });
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
        self.begin(run, "Compare the result".into(), RunWork::Compare { record, before })
    }

    /// Runs the current start and those after it.
    fn run_on(&self, run: DesignRun) -> Result<(), String> {
        let settings = run.settings.clone();
        let starts = run.start_number.1;
        let from = if starts > 1 { format!("{starts} starts") } else { run.start.encoder.describe() };
        self.begin(run, format!("Optimize {from}"), RunWork::Optimize(Box::new(settings)))
    }

    fn begin(&self, run: DesignRun, name: String, work: RunWork) -> Result<(), String> {
        self.thread.publish(|slot| slot.begin(run, name, work))
    }

    /// Pauses or resumes the run.
    pub fn pause(&self, pause: bool) {
        self.thread.publish(|slot| slot.pause(pause));
    }

    /// Stops the run at its next step and scores the mask of its newest checkpoint; stops a score or comparison that is under way. The
    /// run can be resumed later.
    pub fn stop(&self) {
        self.thread.change(RunSlot::stop);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::*;
    use crate::design::{Objective, Preset};
    use crate::evaluation::{DensityModel, EstimateRequest, estimate};
    use crate::forward::Design;
    use crate::information::{FitLength, InformationError};
    use crate::objects::ObjectSource;
    use crate::optics::random_layout;
    use crate::progress::CancelToken;
    use crate::workbench::background::activity::ActivityState;
    use crate::workbench::background::mailbox::Mailbox;
    use crate::workbench::estimate_command;
    use crate::workbench::runs::computation::proceed;
    use crate::workbench::runs::design_run::{BRACKET_STEPS, LIVE_STEPS, score_request};
    use crate::workbench::runs::slot::{RunAnswer, RunTask};

    #[test]
    fn scores_are_reproducible_by_a_command() {
        let beads = Design::default();
        let images = Design { objects: ObjectSource::Idx("digits".into()), ..Design::default() };
        for (design, estimator, steps) in [(beads, "bracket", BRACKET_STEPS), (images, "causal", LIVE_STEPS)] {
            let request = score_request(&design, Some((32, 32)));
            assert_eq!(request.model.length(), Some(FitLength::Steps(steps)));
            let command = estimate_command(&design, &request).unwrap();
            assert!(command.contains(&format!("--estimator {estimator} --patch 32x32 --steps {steps} ")), "{command}");
        }
    }

    /// A thread whose news can be waited for.
    struct Fixture {
        thread: RunThread,
        activities: Activities,
        news: Receiver<()>,
    }

    impl Fixture {
        fn new<C: Computation<RunSlot>>(make: impl Fn() -> C + Send + 'static) -> Self {
            let (wake, news) = channel();
            let wake = Mutex::new(wake);
            let wake: Wake = Arc::new(move || lock(&wake).send(()).unwrap_or_default());
            let activities = Activities::default();
            let thread = RunThread::with_computation(wake, Threads::default(), activities.clone(), make).unwrap();
            Self { thread, activities, news }
        }

        fn real(kept: Option<&RunStore>) -> Self {
            let fixture = Self::new(|| compute);
            if let Some(kept) = kept {
                fixture.thread.keep_in(kept.clone()).unwrap();
            }
            fixture
        }

        fn run(&self) -> DesignRun {
            self.thread.run().unwrap()
        }

        /// Waits until the run is as wanted.
        fn wait(&self, done: impl Fn(&DesignRun) -> bool) -> DesignRun {
            while !done(&self.run()) {
                self.news.recv().unwrap();
            }
            self.run()
        }

        /// Stops the optimizer, and then the score of what there is.
        fn stop(&self) -> DesignRun {
            self.thread.stop();
            self.wait(|run| run.is_scoring || !run.is_active());
            self.thread.stop();
            self.wait(|run| !run.is_active())
        }

        fn activity(&self) -> ActivityState {
            self.activities.all().last().unwrap().state.clone()
        }
    }

    /// A computation that takes one step per message, and one that panics for the message 0.
    struct Stepping {
        fixture: Fixture,
        steps: Sender<usize>,
    }

    fn stepping() -> Stepping {
        let (steps, requested) = channel();
        let requested = Arc::new(Mutex::new(requested));
        let fixture = Fixture::new(move || {
            let requested: Arc<Mutex<Receiver<usize>>> = Arc::clone(&requested);
            move |task: &RunTask, cancel: &CancelToken, mailbox: &Mailbox<RunSlot>| {
                let RunTask::Work { stop, .. } = task else { return compute(task, cancel, mailbox) };
                while let Ok(step) = lock(&requested).recv() {
                    assert!(step > 0, "no light");
                    mailbox.publish(|slot| slot.run.as_mut().unwrap().doing = Some(("waiting".into(), step as f64)));
                    if proceed(mailbox, stop).is_break() {
                        return RunAnswer::Optimized(Err(InformationError::Cancelled.into()));
                    }
                    mailbox.publish(|slot| slot.run.as_mut().unwrap().step = step);
                }
                RunAnswer::Optimized(Ok(()))
            }
        });
        let start = Start::random(&Design::default(), 3, 1);
        fixture.thread.start(vec![start], IdealSettings::new(Preset::Default, Objective::Density, 1)).unwrap();
        Stepping { fixture, steps }
    }

    /// Whether a step of the fake computation was begun.
    fn begun(step: usize) -> impl Fn(&DesignRun) -> bool {
        move |run| run.doing.as_ref().is_some_and(|(_, share)| *share == step as f64)
    }

    #[test]
    fn paused_run_takes_no_step_until_it_is_resumed() {
        let Stepping { fixture, steps } = stepping();
        steps.send(1).unwrap();
        fixture.wait(|run| run.step == 1);
        fixture.thread.pause(true);
        assert_eq!((fixture.run().status, fixture.activity()), (RunStatus::Paused, ActivityState::Paused));
        steps.send(2).unwrap();
        assert_eq!(fixture.wait(begun(2)).step, 1);
        assert!(fixture.thread.extend(1).unwrap_err().contains("stop it first"));
        fixture.thread.pause(false);
        assert_eq!(fixture.wait(|run| run.step == 2).status, RunStatus::Running);
        drop(steps);
        assert_eq!(fixture.wait(|run| !run.is_active()).status, RunStatus::Finished);
    }

    #[test]
    fn mask_that_is_saved_during_a_pause_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let kept = RunStore::in_folder(folder.path()).unwrap();
        let Stepping { fixture, steps } = stepping();
        fixture.thread.keep_in(kept.clone()).unwrap();
        fixture.thread.pause(true);
        steps.send(1).unwrap();
        fixture.wait(begun(1));
        let mask = random_layout(3, 9);
        fixture.thread.note_saved(&mask);
        let is_written = || kept.last().is_some_and(|run| run.queue.saved.as_ref() == Some(&mask));
        assert_eq!(fixture.wait(|_| is_written()).status, RunStatus::Paused);
    }

    #[test]
    fn stop_ends_pause_and_run_and_panic_fails_it() {
        let Stepping { fixture, steps } = stepping();
        fixture.thread.pause(true);
        steps.send(1).unwrap();
        fixture.wait(begun(1));
        fixture.thread.stop();
        let stopped = fixture.wait(|run| !run.is_active());
        assert_eq!((stopped.step, stopped.status), (0, RunStatus::Stopped));
        assert_eq!(fixture.activity(), ActivityState::Stopped);
        fixture.thread.extend(1).unwrap();
        steps.send(0).unwrap();
        let message = "an internal error stopped this run: no light".to_owned();
        assert_eq!(fixture.wait(|run| !run.is_active()).status, RunStatus::Failed(message.clone()));
        assert_eq!(fixture.activity(), ActivityState::Failed(message));
    }

    #[test]
    fn drop_ends_a_paused_run() {
        let Stepping { fixture, steps } = stepping();
        fixture.thread.pause(true);
        steps.send(1).unwrap();
        fixture.wait(begun(1));
        let activities = fixture.activities.clone();
        drop(fixture);
        assert_eq!(activities.all()[0].state, ActivityState::Stopped);
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
        let fixture = Fixture::real(None);
        fixture.thread.start(vec![start], settings).unwrap();
        fixture.wait(|run| run.checkpoints.len() > 3);
        fixture.thread.stop();
        let scoring = fixture.wait(|run| run.is_scoring || !run.is_active());
        assert!(scoring.is_scoring && scoring.status == RunStatus::Running, "{:?}", scoring.status);
        let stopped = fixture.stop();
        assert_eq!((&stopped.status, stopped.settings.steps), (&RunStatus::Stopped, 4_000));
        assert!(stopped.can_resume());
        fixture.thread.extend(1).unwrap();
        let run = fixture.wait(|run| run.step > stopped.step);
        assert_eq!((run.settings.steps, &run.status), (4_000, &RunStatus::Running));
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
        let ranked = vec![RankedStart {
            name,
            design,
            estimate: found,
            sensor: None,
            is_scored: true,
            sensor_failure: None,
            record: None,
        }];
        let settings = IdealSettings {
            patch: Some((6, 6)),
            first_fit: 30,
            refit: 4,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };

        // It ended when the first had been scored and the second had not begun.
        let order = RunQueue { ranked: ranked.clone(), ..RunQueue::new(starts, settings) };
        kept.note(&order).unwrap();
        let designer = Fixture::real(Some(&kept));
        let run = designer.run();
        assert_eq!((run.start_number, run.step, &run.status), ((2, 3), 0, &RunStatus::Stopped));
        assert!(run.can_resume());
        assert_eq!(run.start.encoder, Encoder::Lenslets(random_layout(3, 2)));

        // It continues with the second start, and ends in the middle of it.
        designer.thread.extend(1).unwrap();
        designer.wait(|_| kept.load(1).unwrap().is_some());
        let before = designer.stop();
        // Nobody else keeps runs in the folder meanwhile.
        let other = Fixture::real(None);
        assert!(other.thread.keep_in(kept.clone()).is_err() && !other.thread.keeps());
        drop(designer);
        let designer = Fixture::real(Some(&kept));
        let left = designer.run();
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
        assert!(Fixture::real(Some(&kept)).thread.run().is_none());
    }
}
