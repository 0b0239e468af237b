//! Activities of the workbench beside the edits, as a list for people: name, progress, log and outcome.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::workbench::background::threads::lock;

/// Finished activities that are kept; the oldest ones are dropped.
const KEPT: usize = 100;
/// Least share of a step from which its remaining time is extrapolated.
const LEAST_SHARE: f64 = 0.02;
/// Lines of a log that are kept.
const LINES: usize = 60;

/// Kind of an activity, which decides where it runs and how it is stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActivityKind {
    /// Writing the file of a design; it ends before it could be stopped.
    Save,
    /// Reading or writing another file; it ends before it could be stopped.
    File,
    /// Reading objects.
    Objects,
    /// An estimate that was ordered.
    Estimate,
    /// The reconstruction of a capture.
    Capture,
    /// A run that optimizes the mask.
    Run,
    /// The training of a network.
    Training,
    /// The cells of a study.
    Study,
    /// The calibration of a camera.
    Calibration,
    /// The comparison of systems.
    Comparison,
}

/// State of an activity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ActivityState {
    /// It waits for others.
    Waiting,
    /// It is running.
    Running,
    /// It is paused.
    Paused,
    /// It is done, with its outcome.
    Done(String),
    /// It failed, with the reason.
    Failed(String),
    /// A person stopped it, or closed the program.
    Stopped,
}

/// One activity of the workbench, running or finished.
#[derive(Clone, Debug)]
pub struct Activity {
    /// Identifies the activity.
    pub number: u64,
    /// Kind of the activity.
    pub kind: ActivityKind,
    /// Name for people.
    pub name: String,
    /// State of the activity.
    pub state: ActivityState,
    /// The current step.
    pub step: String,
    /// Share of the current step that is done, 0 to 1, where it is known.
    pub share: Option<f64>,
    /// Remaining time, where it is known.
    pub left: Option<Duration>,
    /// Log: seconds since the start, and the last report of each step.
    pub log: Vec<(f64, String)>,
    began: Instant,
    /// Start of the current step, and the share that was done then.
    step_began: Option<(Instant, f64)>,
    /// Start of the present pause.
    paused: Option<Instant>,
    /// Duration, once the activity is over.
    took: Option<Duration>,
}

impl Activity {
    /// Whether it is waiting or running.
    pub fn is_open(&self) -> bool {
        matches!(self.state, ActivityState::Waiting | ActivityState::Running | ActivityState::Paused)
    }

    /// Whether it can be stopped.
    pub fn can_stop(&self) -> bool {
        self.is_open() && !matches!(self.kind, ActivityKind::Save | ActivityKind::File)
    }

    /// Time since its start, or from its start to its end.
    pub fn time(&self) -> Duration {
        self.took.unwrap_or_else(|| self.began.elapsed())
    }

    /// Remaining time of the current step, at its pace so far. `left` is that of the whole activity, where it is known.
    pub fn step_left(&self) -> Option<Duration> {
        let (began, from) = self.step_began?;
        let share = self.share.filter(|_| self.state == ActivityState::Running)?;
        let done = share - from;
        (done >= LEAST_SHARE).then(|| began.elapsed().mul_f64((1.0 - share) / done))
    }

    /// Adds a line to the log. Lines with the same beginning, up to their first number or comma, are one step, of which the last line
    /// stays.
    fn note(&mut self, text: &str) {
        let seconds = self.began.elapsed().as_secs_f64();
        let full = self.log.len() >= LINES;
        match self.log.last_mut() {
            Some((_, last)) if full || step_of(last) == step_of(text) => text.clone_into(last),
            _ => self.log.push((seconds, text.to_owned())),
        }
    }
}

/// The common beginning of the lines of one step: all up to their first number or comma.
pub(crate) fn step_of(text: &str) -> &str {
    text.split(|c: char| c == ',' || c.is_ascii_digit()).next().unwrap_or_default()
}

#[derive(Default)]
struct List {
    /// Oldest first; shared, so that a copy of the list is cheap.
    entries: Vec<Arc<Activity>>,
    /// Long activities that ended since the last query.
    ended: Vec<Arc<Activity>>,
    last: u64,
}

/// All activities of a workbench. Clones are the same list.
#[derive(Clone, Default)]
pub(crate) struct Activities(Arc<Mutex<List>>);

impl Activities {
    /// Adds an activity that waits.
    pub fn add(&self, kind: ActivityKind, name: impl Into<String>) -> ActivityHandle {
        let mut list = lock(&self.0);
        list.last += 1;
        let number = list.last;
        if list.entries.len() >= KEPT
            && let Some(oldest) = list.entries.iter().position(|activity| !activity.is_open())
        {
            list.entries.remove(oldest);
        }
        list.entries.push(Arc::new(Activity {
            number,
            kind,
            name: name.into(),
            state: ActivityState::Waiting,
            step: String::new(),
            share: None,
            left: None,
            log: Vec::new(),
            began: Instant::now(),
            step_began: None,
            paused: None,
            took: None,
        }));
        ActivityHandle { list: self.clone(), number }
    }

    /// All that are kept, oldest first.
    pub fn all(&self) -> Vec<Arc<Activity>> {
        lock(&self.0).entries.clone()
    }

    /// Long activities that ended since the last call, oldest first.
    pub fn take_ended(&self) -> Vec<Arc<Activity>> {
        std::mem::take(&mut lock(&self.0).ended)
    }

    fn change(&self, number: u64, change: impl FnOnce(&mut Activity)) {
        let mut list = lock(&self.0);
        let List { entries, ended, .. } = &mut *list;
        let Some(entry) = entries.iter_mut().find(|activity| activity.number == number) else { return };
        let was_open = entry.is_open();
        change(Arc::make_mut(entry));
        if was_open && !entry.is_open() {
            let activity = Arc::make_mut(entry);
            activity.took = Some(activity.began.elapsed());
            activity.left = None;
            let is_long = matches!(
                activity.kind,
                ActivityKind::Estimate
                    | ActivityKind::Capture
                    | ActivityKind::Run
                    | ActivityKind::Training
                    | ActivityKind::Study
                    | ActivityKind::Calibration
                    | ActivityKind::Comparison
            );
            if is_long {
                ended.push(Arc::clone(entry));
            }
        }
    }
}

/// Handle of an activity for its reports. Dropping it without an end means that the activity was stopped.
pub(crate) struct ActivityHandle {
    list: Activities,
    number: u64,
}

impl ActivityHandle {
    /// Number of the activity in the list.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Marks the activity as running.
    pub fn begin(&self) {
        self.list.change(self.number, |activity| {
            activity.began = Instant::now();
            activity.state = ActivityState::Running;
        });
    }

    /// Marks the activity as paused or running.
    pub fn pause(&self, pause: bool) {
        self.pause_at(Instant::now(), pause);
    }

    fn pause_at(&self, now: Instant, pause: bool) {
        self.list.change(self.number, |activity| {
            if !activity.is_open() {
                return;
            }
            activity.state = if pause { ActivityState::Paused } else { ActivityState::Running };
            if pause {
                activity.paused.get_or_insert(now);
            } else if let (Some(since), Some((began, _))) = (activity.paused.take(), &mut activity.step_began) {
                // A pause does not count for the pace.
                *began += now.duration_since(since);
            }
        });
    }

    /// Reports the current step, its share that is done, and the remaining time.
    pub fn report(&self, step: &str, share: Option<f64>, left: Option<Duration>) {
        self.list.change(self.number, |activity| {
            activity.note(step);
            let share = share.map(|share| share.clamp(0.0, 1.0));
            if step_of(step) != step_of(&activity.step) || share < activity.share || activity.step_began.is_none() {
                activity.step_began = Some((Instant::now(), share.unwrap_or(0.0)));
            }
            step.clone_into(&mut activity.step);
            (activity.share, activity.left) = (share, left);
        });
    }

    /// Ends the activity with its outcome.
    pub fn end(self, outcome: Result<String, String>) {
        self.list.change(self.number, |activity| {
            let (Ok(text) | Err(text)) = &outcome;
            activity.note(text);
            activity.state = match outcome {
                Ok(text) => ActivityState::Done(text),
                Err(text) => ActivityState::Failed(text),
            };
        });
    }
}

impl Drop for ActivityHandle {
    fn drop(&mut self) {
        self.list.change(self.number, |activity| {
            if activity.is_open() {
                activity.state = ActivityState::Stopped;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_activity_goes_from_waiting_to_its_end_and_keeps_the_last_word_of_each_step() {
        let list = Activities::default();
        let entry = list.add(ActivityKind::Estimate, "Bracket");
        assert_eq!(list.all()[0].state, ActivityState::Waiting);
        entry.begin();
        for (step, share) in [("Reading objects", 0.0), ("Fitting, 9 s left", 0.1), ("Fitting, 1 s left", 1.7)] {
            entry.report(step, Some(share), Some(Duration::from_secs(1)));
        }
        let now = &list.all()[0];
        assert!(now.can_stop() && now.share == Some(1.0) && now.left.is_some());
        assert_eq!(now.step_left(), Some(Duration::ZERO), "the fit has come from 0.1 to its end");
        entry.pause(true);
        assert_eq!(list.all()[0].state, ActivityState::Paused);
        assert!(list.take_ended().is_empty());
        entry.end(Err("too bright".into()));
        let ended = list.take_ended();
        assert_eq!(ended[0].state, ActivityState::Failed("too bright".into()));
        assert!(!ended[0].is_open() && ended[0].left.is_none() && ended[0].time() == list.all()[0].time());
        let log: Vec<&str> = ended[0].log.iter().map(|(_, text)| text.as_str()).collect();
        assert_eq!(log, ["Reading objects", "Fitting, 1 s left", "too bright"]);
        assert!(list.take_ended().is_empty(), "reported once");
    }

    #[test]
    fn a_pause_says_nothing_of_the_pace() {
        let list = Activities::default();
        let entry = list.add(ActivityKind::Run, "Run");
        entry.begin();
        entry.report("Step 0", Some(0.0), None);
        let began = || list.all()[0].step_began.unwrap().0;
        let before = began();
        let (start, pause) = (Instant::now(), Duration::from_secs(20));
        for since in [start, start + pause / 2] {
            entry.pause_at(since, true);
        }
        entry.pause_at(start + pause, false);
        assert_eq!(began(), before + pause);
        entry.pause_at(start + 2 * pause, false);
        assert_eq!(began(), before + pause, "it was over");
    }

    #[test]
    fn what_is_dropped_was_stopped_and_open_ones_are_never_forgotten() {
        let list = Activities::default();
        let open = list.add(ActivityKind::Run, "Run");
        for _ in 0..2 * KEPT {
            drop(list.add(ActivityKind::File, "Save"));
        }
        let all = list.all();
        assert_eq!((all.len(), all[0].number, &all[1].state), (KEPT, open.number(), &ActivityState::Stopped));
        assert!(list.take_ended().is_empty(), "files answer by themselves");
    }
}
