//! Queue of estimates that take longer than an edit may: the live estimate, refined while the design stays unchanged, and ordered
//! estimates, one at a time. Both run on one named thread, orders first.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use crate::evaluation::estimation::estimate;
use crate::evaluation::progress::{EstimateProgress, FitPoint, thin_out};
use crate::evaluation::request::{DensityModel, EstimateRequest};
use crate::evaluation::scene::Scene;
use crate::formats::{FormatError, create_folder};
use crate::workbench::background::activity::{Activities, ActivityKind, Entry};
use crate::workbench::background::threads::{SpareCores, Threads, Wake, Work, lock};
use crate::workbench::estimates::files::{EstimateFolder, EstimateOrder, FinishedEstimate};
use crate::workbench::live::estimate::LiveEstimate;
use crate::workbench::live::estimator::LiveEstimator;
use crate::workbench::live::published::{Revisioned, Wanted};

/// Most orders that may wait.
const MOST_ORDERS: usize = 50;
/// Time between two reports of progress.
const TELL_EVERY: Duration = Duration::from_millis(100);

/// The running order.
#[derive(Clone, Debug)]
pub struct RunningEstimate {
    /// Its number in the list of activities.
    pub number: u64,
    /// The density model.
    pub model: DensityModel,
    /// Revision of the design.
    pub revision: u64,
    /// Progress of the estimate.
    pub progress: EstimateProgress,
    /// Curves of the fits, oldest first.
    pub curve: Vec<FitPoint>,
}

/// Finished and running estimates of the thread.
#[derive(Clone, Default)]
pub struct Estimates {
    /// The newest live estimate.
    pub live: Option<Revisioned<LiveEstimate>>,
    /// Revision of the newest design, and why it has no live estimate.
    pub live_failure: Option<(u64, String)>,
    /// The running order.
    pub running: Option<RunningEstimate>,
    /// All finished orders, also of earlier sessions, oldest first.
    pub finished: Vec<Revisioned<FinishedEstimate>>,
    /// The finished order that was deleted last and can be brought back, and its place.
    pub gone: Option<(usize, Revisioned<FinishedEstimate>)>,
}

/// Handle of the thread. Dropping it stops the current estimate; the thread then ends by itself.
pub(crate) struct Estimator {
    shared: Arc<Shared>,
}

struct Shared {
    mailbox: Mutex<Mailbox>,
    arrived: Condvar,
    estimates: Mutex<Estimates>,
    /// Folder in which finished, running and waiting orders outlive the program.
    folder: Mutex<Option<EstimateFolder>>,
    /// Held while the waiting orders are written to the folder.
    noting: Mutex<()>,
    threads: Threads,
    activities: Activities,
    /// Newest known revision; a live estimate of an older one is given up.
    newest: AtomicU64,
    /// Flag that stops the running order.
    cancelled: AtomicBool,
    /// Whether live estimates are wanted. It changes while the mailbox is locked, so that no change is missed before a wait.
    live: AtomicBool,
    /// Whether live estimates are paused for something else; changed as `live` is.
    held: AtomicBool,
    /// Flag that ends the thread; changed as `live` is.
    quit: AtomicBool,
    wake: Wake,
}

#[derive(Default)]
struct Mailbox {
    /// Folder whose contents are to be read before anything else.
    read: Option<PathBuf>,
    refine: Option<Refine>,
    /// Waiting orders, oldest first.
    orders: VecDeque<(EstimateOrder, Entry)>,
    /// Whether the waiting orders differ from those in their file.
    is_to_be_noted: bool,
}

/// A request for the live estimate of a design.
#[derive(Clone)]
struct Refine {
    wanted: Wanted,
    scene: Arc<Scene>,
}

impl Estimator {
    /// Starts the thread.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start(wake: Wake, threads: Threads, activities: Activities) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            mailbox: Mutex::default(),
            arrived: Condvar::new(),
            estimates: Mutex::default(),
            folder: Mutex::default(),
            noting: Mutex::default(),
            threads,
            activities,
            newest: AtomicU64::new(0),
            cancelled: AtomicBool::new(false),
            live: AtomicBool::new(true),
            held: AtomicBool::new(false),
            quit: AtomicBool::new(false),
            wake,
        });
        let own = Arc::clone(&shared);
        std::thread::Builder::new().name("lenslet-estimator".into()).spawn(move || run(&own))?;
        Ok(Self { shared })
    }

    /// Stores orders in a folder. Existing orders are loaded outside the window's thread, and the interrupted one resumes.
    ///
    /// # Errors
    /// Where the folder cannot be created.
    pub fn keep_in(&self, folder: &Path) -> Result<(), FormatError> {
        create_folder(folder)?;
        lock(&self.shared.mailbox).read = Some(folder.to_path_buf());
        self.shared.arrived.notify_one();
        Ok(())
    }

    /// Whether the next session can resume the running order.
    pub fn keeps_orders(&self) -> bool {
        lock(&self.shared.folder).as_ref().is_some_and(EstimateFolder::keeps_orders)
    }

    /// Deletes a finished order and its file; it can be [brought back](Estimator::bring_back).
    pub fn delete(&self, finished: &Arc<FinishedEstimate>) {
        let mut estimates = lock(&self.shared.estimates);
        let Some(place) = estimates.finished.iter().position(|other| Arc::ptr_eq(&other.value, finished)) else {
            return;
        };
        let gone = estimates.finished.remove(place);
        estimates.gone = Some((place, gone));
        if let Some(folder) = &*lock(&self.shared.folder) {
            folder.delete(finished);
        }
    }

    /// Restores the finished order that was deleted last to its place.
    pub fn bring_back(&self) {
        let mut estimates = lock(&self.shared.estimates);
        let Some((place, finished)) = estimates.gone.take() else { return };
        if let Some(folder) = &*lock(&self.shared.folder) {
            folder.bring_back(&finished.value);
        }
        let place = place.min(estimates.finished.len());
        estimates.finished.insert(place, finished);
    }

    /// Notes a newer design, which makes the present live estimate useless.
    pub fn supersede(&self, revision: u64) {
        self.shared.newest.fetch_max(revision, Ordering::Relaxed);
    }

    /// Requests the live estimate of a design; replaces a waiting request.
    pub fn refine(&self, wanted: Wanted, scene: Arc<Scene>) {
        self.supersede(wanted.revision);
        lock(&self.shared.mailbox).refine = Some(Refine { wanted, scene });
        self.shared.arrived.notify_one();
    }

    /// Whether live estimates are computed.
    pub fn is_live(&self) -> bool {
        self.shared.live.load(Ordering::Relaxed)
    }

    /// Switches live estimates on or off.
    pub fn set_live(&self, live: bool) {
        self.shared.set(&self.shared.live, live);
    }

    /// Pauses live estimates while something more important computes.
    pub fn hold(&self, hold: bool) {
        if self.shared.held.load(Ordering::Relaxed) != hold {
            self.shared.set(&self.shared.held, hold);
        }
    }

    /// Orders an estimate; it is computed after earlier orders.
    ///
    /// # Errors
    /// One sentence where too many orders wait.
    pub fn order(&self, order: EstimateOrder) -> Result<(), String> {
        let mut mailbox = lock(&self.shared.mailbox);
        if mailbox.orders.len() >= MOST_ORDERS {
            return Err(format!("{MOST_ORDERS} estimates wait already; stop some, or let them come to their end"));
        }
        let entry = self.shared.activities.add(ActivityKind::Estimate, order.name());
        mailbox.orders.push_back((order, entry));
        mailbox.is_to_be_noted = true;
        drop(mailbox);
        self.shared.arrived.notify_one();
        Ok(())
    }

    /// Stops the running order.
    pub fn cancel(&self) {
        if let Some(running) = &mut lock(&self.shared.estimates).running {
            running.progress.step = "stopping".into();
            self.shared.cancelled.store(true, Ordering::Relaxed);
        }
    }

    /// Stops the order of this number in the list of activities, whether it is running or waiting.
    pub fn cancel_numbered(&self, number: u64) {
        let mut mailbox = lock(&self.shared.mailbox);
        let before = mailbox.orders.len();
        mailbox.orders.retain(|(_, entry)| entry.number() != number);
        let waited = mailbox.orders.len() < before;
        mailbox.is_to_be_noted |= waited;
        drop(mailbox);
        if !waited && lock(&self.shared.estimates).running.as_ref().is_some_and(|running| running.number == number) {
            self.cancel();
        }
    }

    /// A copy of all estimates.
    pub fn estimates(&self) -> Estimates {
        lock(&self.shared.estimates).clone()
    }
}

impl Drop for Estimator {
    fn drop(&mut self) {
        // There is no need to wait for the thread: its files are complete or absent, and it ends at its next step.
        self.shared.set(&self.shared.quit, true);
        let is_computing = lock(&self.shared.estimates).running.is_some();
        if let Some(folder) = lock(&self.shared.folder).as_ref().filter(|_| is_computing) {
            folder.leave();
        }
        self.shared.note_waiting();
    }
}

enum Task {
    Read(PathBuf),
    Order(Box<EstimateOrder>, Entry),
    Refine(Refine),
}

/// Failure of an order.
struct Failed {
    text: String,
    /// Whether it is about a file that may be there another time; the order's checkpoint is then kept.
    may_pass: bool,
}

fn run(shared: &Shared) {
    let mut cores = SpareCores::new(Work::Estimate, shared.threads.clone());
    let mut refiner = LiveEstimator::default();
    while let Some(task) = next_task(shared) {
        let done = cores.run(|| match &task {
            Task::Read(folder) => {
                shared.take_up(EstimateFolder::open(folder.clone()));
                Ok(None)
            }
            Task::Order(order, entry) => shared.compute(order, entry).map(Some),
            Task::Refine(wanted) => {
                shared.refine(&mut refiner, wanted);
                Ok(None)
            }
        });
        let done = done.unwrap_or_else(|text| Err(Some(Failed { text, may_pass: false })));
        if let (Task::Order(..), Some(folder)) = (&task, lock(&shared.folder).as_ref()) {
            match &done {
                Err(Some(failed)) if failed.may_pass => folder.leave(),
                // An order interrupted by the end of the program is left for the next session.
                Err(_) if shared.quit.load(Ordering::Relaxed) => {}
                _ => folder.end(),
            }
        }
        match (task, done) {
            (Task::Order(_, entry), Ok(Some(text))) => entry.end(Ok(text)),
            (Task::Order(_, entry), Err(Some(failed))) => entry.end(Err(failed.text)),
            (Task::Refine(Refine { wanted, .. }), Err(Some(failed))) => {
                refiner = LiveEstimator::default();
                lock(&shared.estimates).live_failure = Some((wanted.revision, failed.text));
            }
            _ => {}
        }
        lock(&shared.estimates).running = None;
        if !shared.quit.load(Ordering::Relaxed) {
            shared.note_waiting();
        }
        (shared.wake)();
    }
}

/// Waits for the next task; `None` ends the thread.
fn next_task(shared: &Shared) -> Option<Task> {
    let mut mailbox = lock(&shared.mailbox);
    loop {
        if shared.quit.load(Ordering::Relaxed) {
            return None;
        }
        if let Some(folder) = mailbox.read.take() {
            return Some(Task::Read(folder));
        }
        if let Some((order, entry)) = mailbox.orders.pop_front() {
            mailbox.is_to_be_noted = true;
            shared.cancelled.store(false, Ordering::Relaxed);
            lock(&shared.estimates).running = Some(RunningEstimate {
                number: entry.number(),
                model: order.request.model,
                revision: order.revision,
                progress: EstimateProgress { step: "Waiting".into(), done: 0, total: 1, fit: None, understood: None },
                curve: Vec::new(),
            });
            return Some(Task::Order(Box::new(order), entry));
        }
        if shared.wants_live()
            && let Some(refine) = mailbox.refine.take()
        {
            return Some(Task::Refine(refine));
        }
        mailbox = shared.arrived.wait(mailbox).unwrap_or_else(std::sync::PoisonError::into_inner);
    }
}

impl Shared {
    /// Changes a flag that the thread checks before it waits.
    fn set(&self, flag: &AtomicBool, value: bool) {
        let mailbox = lock(&self.mailbox);
        flag.store(value, Ordering::Relaxed);
        drop(mailbox);
        self.arrived.notify_one();
    }

    fn wants_live(&self) -> bool {
        self.live.load(Ordering::Relaxed) && !self.held.load(Ordering::Relaxed)
    }

    /// Computes an order. Returns a summary of its result, the reason of its failure, or nothing where it was stopped.
    fn compute(&self, order: &EstimateOrder, entry: &Entry) -> Result<String, Option<Failed>> {
        entry.begin();
        let began = Instant::now();
        let mut told = began;
        let mut watch = |progress: &EstimateProgress| {
            if self.quit.load(Ordering::Relaxed) || self.cancelled.load(Ordering::Relaxed) {
                return ControlFlow::Break(());
            }
            if told.elapsed() >= TELL_EVERY {
                told = Instant::now();
                self.note_waiting();
                if let Some(running) = &mut lock(&self.estimates).running {
                    running.curve.extend(progress.fit);
                    thin_out(&mut running.curve);
                    running.progress = progress.clone();
                }
                let share = progress.done as f64 / progress.total.max(1) as f64;
                entry.tell(&progress.step, Some(share), order.request.time_left(began.elapsed(), share));
                (self.wake)();
            }
            ControlFlow::Continue(())
        };
        let EstimateOrder { design, measured, .. } = order;
        let folder = lock(&self.folder).clone();
        let keep = folder.as_ref().and_then(|folder| folder.begin(order));
        // The order no longer waits.
        self.note_waiting();
        let request = &EstimateRequest { keep, ..order.request.clone() };
        let told = |text: String, is_cancelled: bool, may_pass: bool| {
            let is_kept = may_pass && request.keep.is_some();
            let later =
                if is_kept { "; the estimate goes on in the next window, or when it is started again" } else { "" };
            (!is_cancelled).then(|| Failed { text: format!("{text}{later}"), may_pass })
        };
        let estimated = match measured {
            Some(measured) => measured
                .estimate(request, design.noise, design.seed, &mut watch)
                .map_err(|error| told(error.to_string(), error.is_cancelled(), error.may_pass())),
            None => estimate(design, request, &mut watch)
                .map_err(|error| told(error.to_string(), error.is_cancelled(), error.may_pass())),
        };
        let estimate = estimated?;
        let curve = lock(&self.estimates).running.take().map(|running| running.curve).unwrap_or_default();
        let mut text = estimate.summary();
        let mut finished = FinishedEstimate::new(order.clone(), estimate, curve);
        if let Some(folder) = folder
            && let Err(error) = folder.keep(&mut finished)
        {
            text = format!("{text}; it is not kept for another day: {error}");
        }
        lock(&self.estimates).finished.push(Revisioned { revision: order.revision, value: Arc::new(finished) });
        Ok(text)
    }

    /// Writes the waiting orders, where their file is out of date.
    fn note_waiting(&self) {
        // The last writer writes the newest orders.
        let _turn = lock(&self.noting);
        let Some(folder) = lock(&self.folder).clone() else { return };
        let orders: Vec<EstimateOrder> = {
            let mut mailbox = lock(&self.mailbox);
            if !std::mem::take(&mut mailbox.is_to_be_noted) {
                return;
            }
            mailbox.orders.iter().map(|(order, _)| order.clone()).collect()
        };
        folder.note_waiting(&orders);
    }

    /// Loads the finished orders of earlier sessions, the interrupted one and the waiting ones.
    fn take_up(&self, folder: EstimateFolder) {
        let earlier = folder.read().into_iter().map(|finished| Revisioned { revision: 0, value: Arc::new(finished) });
        lock(&self.estimates).finished.splice(0..0, earlier);
        let mut orders = VecDeque::new();
        if let Some((order, given_up)) = folder.interrupted() {
            let entry = self.activities.add(ActivityKind::Estimate, format!("{}, which was interrupted", order.name()));
            match given_up {
                None => orders.push_back((order, entry)),
                Some(why) => {
                    entry.begin();
                    entry.end(Err(why));
                }
            }
        }
        for order in folder.waiting() {
            let entry = self.activities.add(ActivityKind::Estimate, order.name());
            orders.push_back((order, entry));
        }
        let mut mailbox = lock(&self.mailbox);
        // Orders since then come later.
        orders.append(&mut mailbox.orders);
        mailbox.orders = orders;
        drop(mailbox);
        *lock(&self.folder) = Some(folder);
    }

    fn refine(&self, refiner: &mut LiveEstimator, order: &Refine) {
        let Refine { wanted: Wanted { revision, design, before }, scene } = order;
        let revision = *revision;
        if revision < self.newest.load(Ordering::Relaxed) {
            return;
        }
        let published = AtomicBool::new(false);
        let mut publish = |estimate: LiveEstimate| {
            published.store(true, Ordering::Relaxed);
            let mut estimates = lock(&self.estimates);
            estimates.live_failure = None;
            estimates.live = Some(Revisioned { revision, value: Arc::new(estimate) });
            drop(estimates);
            (self.wake)();
        };
        // While edits come quickly, each estimate that was started still gives its first number.
        let stop = || {
            let superseded = revision < self.newest.load(Ordering::Relaxed) && published.load(Ordering::Relaxed);
            let unwanted = self.quit.load(Ordering::Relaxed) || !self.wants_live();
            superseded || unwanted || !lock(&self.mailbox).orders.is_empty()
        };
        match refiner.refine((design, before.as_ref()), scene, &mut publish, &stop) {
            Ok(()) => {}
            Err(error) if error.is_cancelled() => {
                // An order or the switch interrupted it: it resumes afterwards, unless there is a newer design.
                let mut mailbox = lock(&self.mailbox);
                if revision >= self.newest.load(Ordering::Relaxed) && mailbox.refine.is_none() {
                    mailbox.refine = Some(order.clone());
                }
            }
            Err(error) => lock(&self.estimates).live_failure = Some((revision, error.to_string())),
        }
    }
}
