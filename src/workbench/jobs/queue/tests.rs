use ndarray::Array3;

use crate::evaluation::scene::Measurements;
use crate::information::InformationError;
use crate::objects::ObjectSource;
use crate::sparsity::TamuraSummary;
use crate::workbench::background::activity::ActivityState;
use crate::workbench::live::inspection::InspectionKey;

use super::*;

fn wanted(revision: u64, objects: &str) -> Wanted {
    let design = Design { objects: ObjectSource::Stack(objects.into()), ..Design::default() };
    Wanted { revision, design: Arc::new(design), before: None }
}

fn save(contents: u64) -> Job {
    Job::SaveDesign { design: Arc::default(), document: 1, contents, network: None, path: "a.json".into() }
}

fn saved(contents: u64) -> Outcome {
    Outcome::Saved { document: 1, contents, network: None, path: "a.json".into() }
}

fn snapshot() -> Job {
    Job::MeasureSnapshot { number: 7, name: "Design 7".into(), design: Arc::default() }
}

fn inspection() -> InspectionRequest {
    let stack = || Array3::zeros((1, 2, 2));
    let tamura = TamuraSummary { mean: 0.0, sd: 0.0, count: 1 };
    let measurements = Arc::new(Measurements { noiseless: stack(), noisy: stack(), counts: None, tamura });
    let key = InspectionKey { revision: 1, sample: 0, noisy: true, steps: None };
    InspectionRequest { key, measurements, model: None }
}

/// A queue, its activities, and the task that runs.
struct Fixture {
    queue: JobQueue,
    activities: Activities,
    running: Option<WorkerTask>,
    cancel: CancelToken,
}

impl Fixture {
    fn new() -> Self {
        let activities = Activities::default();
        Self { queue: JobQueue::new(activities.clone()), activities, running: None, cancel: CancelToken::new() }
    }

    /// Begins the next task, and returns its revision or the number of its activity.
    fn begin(&mut self) -> Option<(&'static str, u64)> {
        self.cancel = CancelToken::new();
        self.running = self.queue.next(&self.cancel);
        Some(match self.running.as_ref()? {
            WorkerTask::Evaluate(wanted) => ("evaluation", wanted.revision),
            WorkerTask::Job(_, entry) => ("job", entry.number()),
            WorkerTask::Inspect(_) => ("inspection", 0),
        })
    }

    fn end(&mut self, answer: Result<WorkerAnswer, String>) {
        self.queue.end(self.running.take().unwrap(), answer);
    }

    /// Begins the next task, which succeeds.
    fn pass(&mut self) -> Option<(&'static str, u64)> {
        let begun = self.begin()?;
        self.end(Ok(match begun.0 {
            "evaluation" => WorkerAnswer::Evaluated(Ok(0.5)),
            "job" => WorkerAnswer::Job(Ok(saved(begun.1))),
            _ => WorkerAnswer::Inspected(None),
        }));
        Some(begun)
    }

    fn states(&self) -> Vec<ActivityState> {
        self.activities.all().iter().map(|activity| activity.state.clone()).collect()
    }
}

fn cancelled() -> WorkerAnswer {
    WorkerAnswer::Evaluated(Err(InformationError::Cancelled.into()))
}

#[test]
fn newest_design_is_evaluated_in_turn_with_jobs_and_inspections_come_last() {
    let mut fixture = Fixture::new();
    fixture.queue.inspect(inspection());
    fixture.queue.submit(save(1));
    fixture.queue.submit(save(2));
    fixture.queue.evaluate(wanted(1, "a"));
    fixture.queue.evaluate(wanted(2, "a"));
    assert_eq!(fixture.pass(), Some(("evaluation", 2)));
    fixture.queue.evaluate(wanted(3, "a"));
    assert_eq!(fixture.pass(), Some(("job", 1)));
    assert_eq!(fixture.pass(), Some(("evaluation", 3)));
    assert_eq!(fixture.pass(), Some(("job", 2)));
    assert_eq!(fixture.pass(), Some(("inspection", 0)));
    assert_eq!(fixture.pass(), None);
    let contents = |outcome: &Result<Outcome, String>| match outcome {
        Ok(Outcome::Saved { contents, .. }) => *contents,
        _ => 0,
    };
    assert!(fixture.queue.has_open_jobs());
    let outcomes: Vec<u64> = fixture.queue.take_outcomes().iter().map(contents).collect();
    assert!(outcomes == [1, 2] && !fixture.queue.has_open_jobs());
    assert!(fixture.states().iter().all(|state| matches!(state, ActivityState::Done(_))));
    assert_eq!(fixture.queue.live().seconds, 0.5);
}

#[test]
fn edits_cancel_inspections_and_evaluations_of_other_objects_only() {
    let mut fixture = Fixture::new();
    fixture.queue.inspect(inspection());
    fixture.begin();
    fixture.queue.evaluate(wanted(1, "a"));
    assert!(fixture.cancel.is_cancelled());
    fixture.end(Ok(WorkerAnswer::Inspected(None)));
    fixture.begin();
    fixture.queue.evaluate(wanted(2, "a"));
    assert!(!fixture.cancel.is_cancelled());
    fixture.queue.evaluate(wanted(3, "b"));
    assert!(fixture.cancel.is_cancelled());
    fixture.end(Ok(cancelled()));
    assert!(fixture.queue.live().failure.is_none(), "a newer design waits");
    fixture.queue.submit(save(1));
    assert_eq!(fixture.pass(), Some(("job", 1)));
    fixture.queue.submit(save(1));
    assert_eq!(fixture.pass(), Some(("evaluation", 3)));
    fixture.begin();
    fixture.queue.evaluate(wanted(4, "c"));
    assert!(!fixture.cancel.is_cancelled(), "a job ends by itself");
}

#[test]
fn reading_that_a_person_stopped_is_not_started_again_by_a_waiting_edit() {
    let mut fixture = Fixture::new();
    fixture.queue.cancel();
    fixture.queue.evaluate(wanted(1, "a"));
    fixture.begin();
    assert!(!fixture.cancel.is_cancelled());
    fixture.queue.evaluate(wanted(2, "a"));
    fixture.queue.cancel();
    assert!(fixture.cancel.is_cancelled());
    fixture.end(Ok(cancelled()));
    assert_eq!(fixture.queue.live().failure.as_ref().unwrap().0, 2);
    assert_eq!(fixture.begin(), None);
}

#[test]
fn measurement_gives_way_and_waiting_one_is_stopped_with_an_answer() {
    let mut fixture = Fixture::new();
    fixture.queue.submit(snapshot());
    assert_eq!(fixture.begin(), Some(("job", 1)));
    fixture.queue.evaluate(wanted(1, "a"));
    fixture.end(Ok(WorkerAnswer::GaveWay));
    assert_eq!(fixture.begin(), Some(("evaluation", 1)));
    fixture.queue.cancel_numbered(1);
    assert!(!fixture.cancel.is_cancelled());
    let outcomes = fixture.queue.take_outcomes();
    let [Ok(Outcome::SnapshotMeasured { number: 7, measurement: Err(message), .. })] = outcomes.as_slice() else {
        panic!("{outcomes:?}")
    };
    assert_eq!(message, "Measure Design 7 was stopped before it began");
    assert_eq!(fixture.states(), [ActivityState::Stopped]);
    fixture.queue.cancel_numbered(1);
    assert!(fixture.cancel.is_cancelled(), "what reads objects is not in the list of waiting jobs");
}

#[test]
fn panic_is_a_failure_of_its_task() {
    let mut fixture = Fixture::new();
    fixture.queue.live_mut().busy = Some("Reading".into());
    fixture.queue.evaluate(wanted(4, "a"));
    fixture.begin();
    fixture.end(Err("no light".into()));
    assert_eq!(fixture.queue.live().failure, Some((4, "no light".into())));
    assert_eq!(fixture.queue.live().busy, None);
    fixture.queue.submit(save(1));
    fixture.begin();
    fixture.end(Err("no light".into()));
    assert_eq!(fixture.states(), [ActivityState::Failed("no light".into())]);
    assert!(matches!(fixture.queue.take_outcomes().as_slice(), [Err(message)] if message == "no light"));
}

#[test]
fn every_job_is_answered_before_the_end() {
    let mut fixture = Fixture::new();
    fixture.queue.submit(save(1));
    fixture.queue.submit(save(2));
    fixture.queue.evaluate(wanted(1, "a"));
    fixture.queue.inspect(inspection());
    fixture.queue.close();
    assert_eq!([fixture.pass(), fixture.pass(), fixture.pass()], [Some(("job", 1)), Some(("job", 2)), None]);
}
