//! A panic of a computation is reported in one sentence; design, window and later work survive.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use lenslet_studio::workbench::{ActivityState, RunStatus};

use super::runs::{TALL, shorten_run, start_run};
use super::waiting::wait_for;
use super::*;

/// Makes the next computation on threads of this name panic when it requests a frame for its result. This is the only
/// window function that computations call. Returns whether the panic is still to come.
fn break_once(window: &mut Window, threads: &'static str) -> Arc<AtomicBool> {
    // The shown computation may still be about to request its frame.
    wait_for(window, "its end", |window| studio(window).session().live().seconds > 0.0);
    let armed = Arc::new(AtomicBool::new(true));
    let still = Arc::clone(&armed);
    window.ctx.set_repaint_observer(move |_| {
        let here = std::thread::current().name().is_some_and(|name| name.starts_with(threads));
        assert!(!(here && still.swap(false, Ordering::SeqCst)), "no light");
    });
    armed
}

/// State of the last job.
fn state(window: &Window) -> Option<ActivityState> {
    studio(window).session().activities().last().map(|activity| activity.state.clone())
}

#[test]
fn failed_edit_stays_and_next_one_is_computed() {
    let mut window = open(Design::default());
    let armed = break_once(&mut window, "lenslet-computation");
    click(&mut window, "Add lenslet");
    settle(&mut window);
    assert!(!armed.load(Ordering::SeqCst), "it has panicked");
    let (revision, message) = studio(&window).session().live().failure.unwrap();
    assert_eq!(
        (revision, message.as_str()),
        (studio(&window).session().revision(), "an internal error stopped this computation: no light")
    );
    assert!(window.query_all_by_label(&message).next().is_some(), "the window says it");
    assert_eq!(lenslets(&window).len(), 10);

    click(&mut window, "Add lenslet");
    settle(&mut window);
    let live = studio(&window).session().live();
    assert!(live.failure.is_none() && window.query_all_by_label(&message).next().is_none());
    assert_eq!(live.information.unwrap().revision, studio(&window).session().revision());
    assert_eq!(live.measurements.unwrap().revision, studio(&window).session().revision());
    for left in [10, 9] {
        window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
        settle(&mut window);
        assert_eq!(lenslets(&window).len(), left);
    }
    assert!(studio(&window).session().live().failure.is_none());
}

#[test]
fn unreadable_objects_leave_design_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("digits-idx3-ubyte");
    let mut bytes = vec![0, 0, 8, 3, 0, 0, 0, 20, 0, 0, 0, 28, 0, 0, 0, 28];
    bytes.extend((0..20 * 28 * 28).map(|pixel| (pixel * 7 % 251) as u8));
    std::fs::write(&file, bytes).unwrap();
    let mut window = open(Design::default());
    let before = Arc::clone(studio(&window).session().design());
    let armed = break_once(&mut window, "lenslet-computation");
    click(&mut window, "Open objects...");
    answer(&mut window, &file, "Open");
    assert!(!armed.load(Ordering::SeqCst), "it has panicked");
    window.get_by_label("Dismiss");
    let message = "an internal error stopped this computation: no light";
    assert!(window.query_all_by_label(message).count() >= 2, "in the strip and in the status line");
    assert_eq!(*studio(&window).session().design(), before);
    assert_eq!(state(&window), Some(ActivityState::Failed(message.into())));

    click(&mut window, "Open objects...");
    answer(&mut window, &file, "Open");
    assert_eq!(studio(&window).session().design().objects, ObjectSource::Idx(file));
    assert!(studio(&window).session().live().failure.is_none());
}

#[test]
fn panics_of_estimates_and_runs_are_reported() {
    let mut window = open_sized(Design::default(), TALL);
    let before = Arc::clone(studio(&window).session().design());
    break_once(&mut window, "lenslet-estimate");
    click(&mut window, "Estimates");
    click(&mut window, "Start estimate");
    let message = "an internal error stopped this estimate: no light";
    wait_for(&mut window, "the end of the estimate", |window| {
        state(window) == Some(ActivityState::Failed(message.into()))
    });
    assert!(window.query_all_by_label(message).count() >= 2, "in the strip and in the status line");
    click(&mut window, "Dismiss");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "a fit", |window| window.query_by_label_contains("Fitting").is_some());
    click(&mut window, "Cancel estimate");
    wait_for(&mut window, "the end of it", |window| studio(window).session().estimates().running.is_none());

    break_once(&mut window, "lenslet-run");
    shorten_run(&mut window, "16 px");
    click(&mut window, "Start run");
    let message = "an internal error stopped this run: no light";
    wait_for(&mut window, "the end of the run", |window| state(window) == Some(ActivityState::Failed(message.into())));
    assert_eq!(studio(&window).session().run().unwrap().status, RunStatus::Failed(message.into()));
    assert!(window.query_all_by_label(message).count() >= 2, "in the strip and in the status line");
    assert_eq!(*studio(&window).session().design(), before);
    start_run(&mut window);
    wait_for(&mut window, "a step of the next run", |window| {
        studio(window).session().run().is_some_and(|run| !run.checkpoints.is_empty())
    });
}
