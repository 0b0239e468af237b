//! Waiting for computations without sleep: a window draws a frame when a frame was requested, as in a real event loop.

use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::{Window, click, studio};

/// Time after which a computation counts as stuck. No test waits so long unless it fails.
const PATIENCE: Duration = Duration::from_mins(5);
/// Longest delay of a frame that shows a new result. Blinking cursors and toasts request later ones.
const SOON: Duration = Duration::from_millis(100);

/// Requests of frames since they were last looked at.
#[derive(Clone)]
struct FrameRequests(Arc<Mutex<Receiver<()>>>);

fn place() -> egui::Id {
    egui::Id::unique("frame requests")
}

/// Collects the requests of frames from now on, for [`wait_for`].
pub fn collect_frame_requests(ctx: &egui::Context) {
    let (request, requests) = channel();
    ctx.set_request_repaint_callback(move |info| {
        if info.delay <= SOON {
            // The window that waited for it may be gone.
            let _ = request.send(());
        }
    });
    ctx.data_mut(|data| data.insert_temp(place(), FrameRequests(Arc::new(Mutex::new(requests)))));
}

/// Draws every requested frame until `done`, and three more for animations.
pub fn wait_for(window: &mut Window, what: &str, done: impl Fn(&Window) -> bool) {
    let requests: FrameRequests = window.ctx.data(|data| data.get_temp(place())).expect("collected from the start");
    let (requests, deadline) = (requests.0.lock().unwrap(), Instant::now() + PATIENCE);
    loop {
        // The next frame serves all requests so far; a later one leads to another frame.
        while requests.try_recv().is_ok() {}
        window.step();
        if done(window) {
            break;
        }
        let left = deadline.saturating_duration_since(Instant::now());
        assert!(requests.recv_timeout(left).is_ok(), "{what} did not come");
    }
    window.run_steps(3);
}

/// Waits until the worker has answered everything.
pub fn settle(window: &mut Window) {
    wait_for(window, "the answer of the worker", |window| {
        let session = studio(window).session();
        !session.is_computing() && !session.has_open_jobs()
    });
}

/// Stops the run by its button, and the score that follows, and waits until the run is no longer active.
pub fn stop_run(window: &mut Window) {
    click(window, "Stop run");
    wait_for_stop(window);
}

/// Stops the score of a run that was stopped, and waits until the run is no longer active.
pub fn wait_for_stop(window: &mut Window) {
    wait_for(window, "the end of the run", |window| {
        let run = studio(window).session().run().expect("it was started");
        if run.is_scoring {
            studio(window).session().stop_run();
        }
        !run.is_active()
    });
}
