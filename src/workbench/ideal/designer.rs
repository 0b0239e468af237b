//! Runs for the window: on a thread of their own, where they can be watched, paused and stopped.

use std::fs::File;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};

use crate::design::{Ideal, IdealSettings, merged_result};
use crate::evaluation::EvaluationError;
use crate::optics::{Encoder, LensletArray};
use crate::workbench::background::activity::{Activities, ActivityKind};
use crate::workbench::background::threads::{Threads, Wake, lock};
use crate::workbench::ideal::design_run::{DesignRun, RankedStart, RunStatus, Start};
use crate::workbench::ideal::run::{KeptOrder, KeptRun, start_of};
use crate::workbench::ideal::runner::Shared;

/// Why nothing is compared.
const NO_RESULT: &str = "there is no result to compare yet";
/// Why a run is not started.
const BUSY: &str = "one run goes on at a time; stop it first";

/// Why a run does not go on from an earlier mask.
const UNSCORED: &str = "the run has come to its end, and its result is being scored; let that come to its end first";

/// The thread of runs; dropping it lets the run end at its next step.
pub(in crate::workbench) struct Designer {
    shared: Arc<Shared>,
    /// Held so that no other program keeps its runs in the same folder.
    lock: Mutex<Option<File>>,
}

impl Designer {
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
                rewind_to: Mutex::default(),
                folder: Mutex::default(),
                order: Mutex::default(),
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
        if let Some((order, states)) = folder.last() {
            let KeptOrder { starts, settings, at, alone, ranked, failures, saved, .. } = order;
            let mut run = DesignRun::new(&starts[at].design, settings, starts.len());
            (run.start_number, run.alone, run.doing) = ((at + 1, starts.len()), alone, None);
            (run.ranked, run.failures, run.status) = (ranked, failures, RunStatus::Stopped);
            run.comparison = run.ranked.first().and_then(|best| folder.compared(&best.design.encoder)).map(Arc::new);
            if let Some(state) = states[at].as_deref().and_then(|bytes| Ideal::state_in(bytes).ok()) {
                // One that was to go on after its score has more steps before it, or another mask by now.
                let found = Encoder::Lenslets(merged_result(&state.array, &run.settings));
                let has_ended = state.finished && state.step >= run.settings.steps;
                let scored = |result: &&RankedStart| result.is_scored && result.design.encoder == found;
                if let Some(result) = run.ranked.iter().find(scored).filter(|_| has_ended) {
                    (run.record, run.status) = (result.record.clone(), RunStatus::Finished);
                }
                run.take_up(&state);
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

    /// Whether the next program can take up the run.
    pub fn keeps(&self) -> bool {
        lock(&self.shared.folder).is_some() && self.keep_failure().is_none()
    }

    /// Why it cannot, where something was to be written and was not.
    pub fn keep_failure(&self) -> Option<String> {
        lock(&self.shared.keep_failure).clone()
    }

    /// Notes that a mask of the run is in a file of a person's.
    pub fn note_saved(&self, mask: &LensletArray) {
        *lock(&self.shared.saved) = Some(mask.clone());
        let shared = Arc::clone(&self.shared);
        // The window does not wait for it. Where there is no thread the mask is asked about once more.
        let _ = std::thread::Builder::new().name("lenslet-order".into()).spawn(move || shared.keep_order());
    }

    /// The last of its masks that is in a file of a person's.
    pub fn saved(&self) -> Option<LensletArray> {
        lock(&self.shared.saved).clone()
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
        if let Some(folder) = &*lock(&self.shared.folder) {
            folder.end();
        }
        *lock(&self.shared.states) = vec![None; starts.len()];
        *lock(&self.shared.rewind_to) = None;
        *lock(&self.shared.saved) = None;
        *lock(&self.shared.starts) = starts;
        self.run_on(run)
    }

    /// Lets a run go on: one that was stopped to its end, one that came to its end for so many more steps. Of several starts that
    /// came to their end the one goes on that led to the result at this place. It goes on from its newest mask, or from that of an
    /// earlier frame (`rewind_to`).
    ///
    /// # Errors
    /// One sentence where there is none, or it still goes on.
    pub fn extend(&self, steps: usize, place: usize, rewind_to: Option<usize>) -> Result<(), String> {
        let Some(mut run) = self.run() else { return Err("there is no run to go on with".into()) };
        if rewind_to.is_some() && run.is_being_scored() {
            return Err(UNSCORED.into());
        }
        // One that was stopped first takes the steps that it was to take, and is scored.
        if run.status == RunStatus::Finished {
            if run.start_number.1 > 1 {
                run = self.that_can_go_on(&run, place)?;
            }
            run.settings.steps = run.step + steps;
        }
        run.status = RunStatus::Running;
        if self.is_active() {
            return Err(BUSY.into());
        }
        *lock(&self.shared.rewind_to) = rewind_to;
        self.run_on(run)
    }

    /// Lets a run that was stopped come to its end at its last refit: one more fit to the mask that it had there, and the score of
    /// that. Starts after it are left out.
    ///
    /// # Errors
    /// One sentence where there is none, it has no steps, or it still goes on.
    pub fn end_here(&self) -> Result<(), String> {
        let run = self.run().filter(DesignRun::can_end_here);
        let mut run = run.ok_or("there is no run that was stopped after a step")?;
        // Steps since then would be taken again, as the last ones of a run that is shorter than it was.
        let bytes = lock(&self.shared.states).get(run.start_number.0 - 1).cloned().flatten();
        let kept = bytes.and_then(|bytes| Ideal::state_in(&bytes).ok()).filter(|state| state.step > 0);
        if let Some(state) = kept {
            run.take_up(&state);
        }
        run.settings.steps = run.step;
        (run.alone, run.status) = (true, RunStatus::Running);
        *lock(&self.shared.rewind_to) = None;
        self.run_on(run)
    }

    /// Lets a run that waits go on from the mask of an earlier frame.
    ///
    /// # Errors
    /// One sentence where none waits, or its result is being scored.
    pub fn resume_from(&self, frame: usize) -> Result<(), String> {
        let run = self.run().filter(|run| run.status == RunStatus::Paused).ok_or("no run waits")?;
        if run.is_being_scored() {
            return Err(UNSCORED.into());
        }
        *lock(&self.shared.rewind_to) = Some(frame);
        self.pause(false);
        Ok(())
    }

    /// Of several starts the one that led to a result.
    fn that_can_go_on(&self, run: &DesignRun, place: usize) -> Result<DesignRun, String> {
        let name = run.ranked.get(place).map(|result| &result.name);
        let at = lock(&self.shared.starts).iter().position(|start| name == Some(&start.name));
        let bytes = at.and_then(|at| lock(&self.shared.states).get(at).cloned().flatten());
        let state = bytes.and_then(|bytes| Ideal::state_in(&bytes).ok());
        let (Some(at), Some(state), Some(mut chosen)) = (at, state, run.that_led_to(place)) else {
            return Err("where this result came from is not kept any more; accept it and start a run from it".into());
        };
        if Encoder::Lenslets(merged_result(&state.array, &chosen.settings)) != run.ranked[place].design.encoder {
            return Err("this run has gone on already; go on with its later result".into());
        }
        (chosen.start_number.0, chosen.alone) = (at + 1, true);
        chosen.take_up(&state);
        Ok(chosen)
    }

    /// Estimates the best result, its start and the nine heuristic layouts alike; what was computed of that before is taken up.
    ///
    /// # Errors
    /// One sentence where there is no result yet, or a run goes on.
    pub fn compare(&self) -> Result<(), String> {
        let Some(mut run) = self.run() else { return Err(NO_RESULT.into()) };
        let Some(record) = run.ranked.first().and_then(|best| best.record.clone()) else {
            return Err(NO_RESULT.into());
        };
        let before = std::mem::replace(&mut run.status, RunStatus::Running);
        (run.comparison_failure, run.doing) = (None, Some(("Comparing masks".into(), 0.0)));
        self.spawn(run, "Compare the result".into(), move |shared| shared.compute_comparison(&record, before))
    }

    fn is_active(&self) -> bool {
        lock(&self.shared.run).as_ref().is_some_and(DesignRun::is_active)
    }

    /// Computes the start that the run is at, and those after it.
    fn run_on(&self, run: DesignRun) -> Result<(), String> {
        let settings = run.settings.clone();
        let starts = run.start_number.1;
        let from = if starts > 1 && !run.alone { format!("{starts} starts") } else { run.start.encoder.describe() };
        self.spawn(run, format!("Optimize {from}"), move |shared| shared.compute(&settings))
    }

    /// Lets a thread of its own work on the run.
    fn spawn(&self, run: DesignRun, name: String, work: impl FnOnce(&Shared) + Send + 'static) -> Result<(), String> {
        if self.is_active() {
            return Err(BUSY.into());
        }
        let entry = self.shared.activities.add(ActivityKind::Run, name);
        entry.begin();
        *lock(&self.shared.entry) = Some(entry);
        *lock(&self.shared.run) = Some(run);
        self.shared.stopped.store(false, Ordering::Relaxed);
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

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;
    use std::time::{Duration, Instant};

    use super::*;
    use crate::design::{IdealEvent, IdealProgress, Objective, Preset};
    use crate::evaluation::{DensityModel, EstimateRequest, estimate};
    use crate::forward::Design;
    use crate::information::FitLength;
    use crate::objects::ObjectSource;
    use crate::optics::random_layout;
    use crate::workbench::estimate_command;
    use crate::workbench::ideal::design_run::{BRACKET_STEPS, LIVE_STEPS, score_request};
    use crate::workbench::ideal::run::run_ideal;

    #[test]
    fn results_are_scored_by_what_a_command_can_repeat() {
        let beads = Design::default();
        let pictures = Design { objects: ObjectSource::Idx("digits".into()), ..Design::default() };
        for (design, estimator, steps) in [(beads, "bracket", BRACKET_STEPS), (pictures, "causal", LIVE_STEPS)] {
            let request = score_request(&design, Some((32, 32)));
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

    /// The run once it is as wanted, or after five minutes.
    fn wait(designer: &Designer, done: &dyn Fn(&DesignRun) -> bool) -> DesignRun {
        let deadline = Instant::now() + Duration::from_mins(5);
        while !designer.run().is_some_and(|run| done(&run)) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        designer.run().unwrap()
    }

    #[test]
    fn a_run_that_waited_ends_as_one_that_did_not() {
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
        let go = |_: &IdealProgress<'_>| ControlFlow::Continue(());
        let reading = |_| ControlFlow::Continue(());
        let whole = run_ideal(&start.design, &settings, None, &reading, &mut |_| Ok(()), &mut { go }).unwrap();

        let designer = Designer::new(Arc::new(|| ()), Threads::default(), Activities::default());
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
        designer.stop();
        let record = run.record.unwrap();
        assert_eq!((&record.result, record.frames.len()), (&whole.result, whole.frames.len()));
        for (one, other) in record.frames.iter().zip(&whole.frames) {
            assert_eq!((one.step, &one.array, one.bits_per_pixel), (other.step, &other.array, other.bits_per_pixel));
        }
        wait_for(&|run| !run.is_active());
    }

    #[test]
    fn a_run_goes_on_from_an_earlier_mask_where_it_waits_or_was_stopped() {
        let start = Start::random(&Design::default(), 3, 1);
        let settings = IdealSettings {
            patch: Some((6, 6)),
            steps: 4_000,
            refit_every: 2,
            first_fit: 30,
            refit: 4,
            ..IdealSettings::new(Preset::Default, Objective::Density, 1)
        };
        let designer = Designer::new(Arc::new(|| ()), Threads::default(), Activities::default());
        designer.start(vec![start], settings).unwrap();
        let wait_for = |done: &dyn Fn(&DesignRun) -> bool| wait(&designer, done);
        let rewinds = |run: &DesignRun| {
            let to = run.events.iter().filter_map(|event| match event {
                IdealEvent::Rewound { to, .. } => Some(*to),
                _ => None,
            });
            to.collect::<Vec<_>>()
        };
        assert!(designer.resume_from(0).is_err(), "it does not wait");
        wait_for(&|run| run.frames.len() > 3);
        designer.pause(true);
        let paused = wait_for(&|run| run.status == RunStatus::Paused);
        designer.resume_from(1).unwrap();
        let run = wait_for(&|run| !rewinds(run).is_empty() && run.step > paused.step + 2);
        assert_eq!((rewinds(&run), &run.status), (vec![paused.frames[1].step], &RunStatus::Running));
        assert_eq!(run.frames[..3], paused.frames[..3], "nothing of the way is lost");
        let again = |run: &DesignRun, index: usize| {
            let mask = &run.frames[index].array;
            run.frames.iter().filter(|frame| frame.array == *mask).count()
        };
        assert_eq!(again(&run, 1), 2, "the mask is measured again");

        designer.stop();
        let stopped = wait_for(&|run| !run.is_active());
        assert_eq!(stopped.status, RunStatus::Stopped);
        designer.extend(1, 0, Some(0)).unwrap();
        let run = wait_for(&|run| rewinds(run).len() > 1 && run.step > stopped.step);
        assert_eq!((rewinds(&run)[1], run.settings.steps, again(&run, 0)), (0, 4_000, 2));
        assert!(designer.end_here().is_err(), "it goes on");
        designer.stop();
        let stopped = wait_for(&|run| !run.is_active());
        // It comes to its end with the mask that is kept, and would be scored.
        let kept = lock(&designer.shared.states)[0].clone().unwrap();
        let kept = Ideal::state_in(&kept).unwrap();
        designer.end_here().unwrap();
        let run = wait_for(&|run| run.record.as_ref().is_some_and(|record| record.finished));
        let record = run.record.as_ref().unwrap();
        let end = record.frames.last().unwrap();
        assert_eq!((record.settings.steps, end.step, &end.array), (kept.step, kept.step, &kept.array));
        for (one, other) in record.frames.iter().zip(stopped.frames.iter()) {
            assert_eq!((one.step, &one.array, one.bits_per_pixel), (other.step, &other.array, other.bits_per_pixel));
        }
        designer.stop();
        wait_for(&|run| !run.is_active());
    }

    #[test]
    fn what_several_starts_have_found_outlives_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let kept = KeptRun::in_folder(folder.path()).unwrap();
        let starts: Vec<Start> = (1..=3).map(|seed| Start::random(&Design::default(), 3, seed)).collect();
        let design = Arc::clone(&starts[0].design);
        let request = EstimateRequest {
            model: DensityModel::Stationary,
            patches_train: 80,
            patches_test: 20,
            ..score_request(&design, Some((32, 32)))
        };
        let found = estimate(&design, &request, &mut |_| ControlFlow::Continue(())).unwrap();
        let name = starts[0].name.clone();
        let ranked = vec![RankedStart { name, design, estimate: found, sensor: None, is_scored: true, record: None }];
        let settings =
            IdealSettings { patch: Some((6, 6)), ..IdealSettings::new(Preset::Default, Objective::Density, 1) };

        // It ended when the first had been scored and the second had not begun.
        let order = KeptOrder { ranked: ranked.clone(), ..KeptOrder::new(starts, settings) };
        kept.note(&order).unwrap();
        let designer = self::designer(&kept);
        let run = designer.run().unwrap();
        assert_eq!((run.start_number, run.step, &run.status), ((2, 3), 0, &RunStatus::Stopped));
        assert!(run.can_go_on());
        assert_eq!(run.start.encoder, Encoder::Lenslets(random_layout(3, 2)));

        // It goes on with the second, and ends in the midst of it.
        designer.extend(1, 0, None).unwrap();
        let deadline = Instant::now() + Duration::from_mins(5);
        while kept.load(1).unwrap().is_none() && Instant::now() < deadline {
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
        drop(designer);
        kept.end();
        assert!(self::designer(&kept).run().is_none());
    }
}
