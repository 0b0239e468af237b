use crate::evaluation::request::EstimateRequest;
use crate::forward::Design;
use crate::information::{Estimate, InformationError};
use crate::workbench::background::activity::ActivityState;

use super::*;

fn order() -> EstimateOrder {
    let (design, request) = (Arc::new(Design::default()), EstimateRequest::default());
    EstimateOrder { design, revision: 1, request, measured: None }
}

fn live_request(revision: u64) -> LiveRequest {
    let design = Design::default();
    let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
    LiveRequest { wanted: Wanted { revision, design: Arc::new(design), before: None }, scene }
}

fn finished() -> Box<FinishedEstimate> {
    let text = include_str!("../../../../tests/data/golden/estimate-v1-gaussian.json");
    Box::new(FinishedEstimate::new(order(), Estimate::from_json(text).unwrap(), Vec::new()))
}

fn cancelled() -> EstimateAnswer {
    EstimateAnswer::Live(Err(InformationError::Cancelled.into()))
}

/// A queue, its activities, and the task that runs.
struct Fixture {
    queue: EstimateQueue,
    activities: Activities,
    running: Option<EstimateTask>,
    cancel: CancelToken,
}

impl Fixture {
    fn new() -> Self {
        let activities = Activities::default();
        let queue = EstimateQueue::new(activities.clone());
        Self { queue, activities, running: None, cancel: CancelToken::new() }
    }

    /// Begins the next task, and returns its number or revision.
    fn begin(&mut self) -> Option<(&'static str, u64)> {
        self.cancel = CancelToken::new();
        self.running = self.queue.next(&self.cancel);
        Some(match self.running.as_ref()? {
            EstimateTask::Read(_) => ("read", 0),
            EstimateTask::Order(_, entry) => ("order", entry.number()),
            EstimateTask::WriteWaiting => ("write", 0),
            EstimateTask::Live(request) => ("live", request.wanted.revision),
        })
    }

    fn end(&mut self, answer: Result<EstimateAnswer, String>) {
        self.queue.end(self.running.take().unwrap(), answer);
    }

    fn states(&self) -> Vec<ActivityState> {
        self.activities.all().iter().map(|activity| activity.state.clone()).collect()
    }
}

#[test]
fn orders_are_first_come_first_served_and_live_estimate_resumes_between_them() {
    let mut fixture = Fixture::new();
    fixture.queue.refine(live_request(1));
    assert_eq!(fixture.begin(), Some(("live", 1)));
    for _ in 0..2 {
        fixture.queue.order(order()).unwrap();
    }
    assert!(fixture.cancel.is_cancelled());
    fixture.end(Ok(cancelled()));
    assert_eq!(fixture.begin(), Some(("order", 1)));
    assert_eq!(fixture.states(), [ActivityState::Running, ActivityState::Waiting]);
    assert_eq!(fixture.queue.estimates().running.as_ref().unwrap().number, 1);
    fixture.end(Ok(EstimateAnswer::Finished(finished(), "done".into())));
    assert_eq!(fixture.begin(), Some(("order", 2)));
    fixture.end(Ok(EstimateAnswer::Failed("too bright".into())));
    assert_eq!(fixture.states(), [ActivityState::Done("done".into()), ActivityState::Failed("too bright".into())]);
    assert_eq!((fixture.queue.estimates().finished.len(), fixture.queue.estimates().finished[0].revision), (1, 1));
    assert_eq!(fixture.begin(), Some(("live", 1)));
    fixture.end(Ok(EstimateAnswer::Live(Ok(()))));
    assert_eq!(fixture.begin(), None, "it has converged");
}

#[test]
fn too_many_orders_are_refused() {
    let mut fixture = Fixture::new();
    for _ in 0..MOST_ORDERS {
        fixture.queue.order(order()).unwrap();
    }
    assert!(fixture.queue.order(order()).unwrap_err().contains("50 estimates wait already"));
    assert_eq!(fixture.states().len(), MOST_ORDERS);
}

#[test]
fn superseded_live_estimate_still_gives_its_first_number() {
    let mut fixture = Fixture::new();
    fixture.queue.refine(live_request(1));
    assert_eq!(fixture.begin(), Some(("live", 1)));
    fixture.queue.supersede(2);
    assert!(!fixture.cancel.is_cancelled());
    fixture.queue.note_published();
    assert!(fixture.cancel.is_cancelled());
    fixture.end(Ok(cancelled()));
    assert_eq!(fixture.begin(), None, "it is of an older design");
    fixture.queue.refine(live_request(2));
    assert_eq!(fixture.begin(), Some(("live", 2)));
    fixture.queue.note_published();
    assert!(!fixture.cancel.is_cancelled());
    fixture.queue.refine(live_request(3));
    assert!(fixture.cancel.is_cancelled());
    fixture.end(Ok(cancelled()));
    assert_eq!(fixture.begin(), Some(("live", 3)));
    fixture.end(Ok(EstimateAnswer::Live(Err(InformationError::Empty.into()))));
    let failure = fixture.queue.estimates().live_failure.clone().unwrap();
    assert_eq!(failure, (3, InformationError::Empty.to_string()));
    fixture.queue.refine(live_request(4));
    fixture.queue.supersede(5);
    assert_eq!(fixture.begin(), None, "a newer design is known");
}

#[test]
fn live_estimate_waits_while_it_is_held_or_off_and_orders_do_not() {
    let switches: [fn(&mut EstimateQueue, bool); 2] = [|queue, on| queue.set_live(on), |queue, on| queue.hold(!on)];
    for set in switches {
        let mut fixture = Fixture::new();
        fixture.queue.refine(live_request(1));
        assert_eq!(fixture.begin(), Some(("live", 1)));
        set(&mut fixture.queue, false);
        assert!(fixture.cancel.is_cancelled());
        fixture.end(Ok(cancelled()));
        assert_eq!(fixture.begin(), None);
        fixture.queue.order(order()).unwrap();
        assert_eq!(fixture.begin(), Some(("order", 1)));
        set(&mut fixture.queue, true);
        set(&mut fixture.queue, false);
        assert!(!fixture.cancel.is_cancelled());
        fixture.end(Ok(EstimateAnswer::Stopped));
        set(&mut fixture.queue, true);
        assert_eq!(fixture.begin(), Some(("live", 1)));
    }
}

#[test]
fn orders_are_stopped_by_number() {
    let mut fixture = Fixture::new();
    for _ in 0..3 {
        fixture.queue.order(order()).unwrap();
    }
    assert_eq!(fixture.begin(), Some(("order", 1)));
    fixture.queue.cancel_numbered(2);
    assert!(!fixture.cancel.is_cancelled());
    assert_eq!(fixture.states(), [ActivityState::Running, ActivityState::Stopped, ActivityState::Waiting]);
    fixture.queue.cancel_numbered(1);
    assert!(fixture.cancel.is_cancelled());
    assert_eq!(fixture.queue.estimates().running.as_ref().unwrap().progress.step, "stopping");
    fixture.end(Ok(EstimateAnswer::Stopped));
    assert_eq!(fixture.states()[0], ActivityState::Stopped);
    assert_eq!(fixture.begin(), Some(("order", 3)));
    fixture.queue.cancel();
    assert!(fixture.cancel.is_cancelled());
}

#[test]
fn panic_is_reported_where_its_task_is_shown() {
    let mut fixture = Fixture::new();
    fixture.queue.order(order()).unwrap();
    fixture.queue.refine(live_request(1));
    fixture.begin();
    fixture.end(Err("no light".into()));
    assert_eq!(fixture.states(), [ActivityState::Failed("no light".into())]);
    assert!(fixture.queue.estimates().running.is_none());
    fixture.begin();
    fixture.end(Err("no light".into()));
    assert_eq!(fixture.queue.estimates().live_failure, Some((1, "no light".into())));
    assert_eq!(fixture.begin(), None);
}

#[test]
fn orders_of_a_folder_come_before_newer_ones_and_waiting_ones_are_written_at_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let mut fixture = Fixture::new();
    fixture.queue.order(order()).unwrap();
    fixture.queue.read(folder.path().to_path_buf());
    assert_eq!(fixture.begin(), Some(("read", 0)));
    let contents = FolderContents {
        folder: EstimateFolder::open(folder.path().to_path_buf()),
        finished: vec![*finished()],
        interrupted: Some(InterruptedOrder { order: order(), given_up: Some("it crashed".into()) }),
        waiting: vec![order()],
    };
    fixture.end(Ok(EstimateAnswer::Read(Box::new(contents))));
    assert_eq!(fixture.queue.estimates().finished.len(), 1);
    let failed = ActivityState::Failed("it crashed".into());
    assert_eq!(fixture.states(), [ActivityState::Waiting, failed, ActivityState::Waiting]);
    assert_eq!(fixture.begin(), Some(("order", 3)));
    assert_eq!(fixture.queue.take_out_of_date().unwrap().1.len(), 1);
    assert!(fixture.queue.take_out_of_date().is_none());
    fixture.queue.order(order()).unwrap();
    fixture.queue.close();
    fixture.end(Ok(EstimateAnswer::Stopped));
    assert_eq!(fixture.begin(), Some(("write", 0)));
    assert_eq!(fixture.queue.take_out_of_date().unwrap().1.len(), 2);
    fixture.end(Ok(EstimateAnswer::Written));
    assert_eq!(fixture.begin(), None);
}

#[test]
fn deleted_estimate_returns_to_its_place() {
    let mut fixture = Fixture::new();
    for _ in 0..3 {
        fixture.queue.order(order()).unwrap();
        fixture.begin();
        fixture.end(Ok(EstimateAnswer::Finished(finished(), String::new())));
    }
    let all: Vec<_> = fixture.queue.estimates().finished.iter().map(|known| Arc::clone(&known.value)).collect();
    fixture.queue.delete(&all[1]);
    assert_eq!(fixture.queue.estimates().finished.len(), 2);
    fixture.queue.bring_back();
    fixture.queue.bring_back();
    let again = &fixture.queue.estimates().finished;
    assert!(again.len() == 3 && again.iter().zip(&all).all(|(one, other)| Arc::ptr_eq(&one.value, other)));
}
