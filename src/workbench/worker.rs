//! The worker: one named thread on which everything is computed and every file is read or written.
//!
//! Evaluations of the design are latest-wins: a newer design takes the place of one that still waits, and what was
//! computed from an older one carries its revision, so nobody mistakes it for current. Jobs (files) are done one after
//! the other, in between. A panic is caught at the thread's edge and told as a failure; the thread goes on.

use std::cell::Cell;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

use super::activity::{Activities, ActivityKind, Entry};
use super::closer::{Closer, CloserOrder};
use super::design::Design;
use super::estimator::Estimator;
use super::evaluation::{EvaluationError, LiveInformation, Measurements, Optics, Scene, SceneOptics};
use super::jobs::{Job, Outcome, measured_snapshot};
use super::threads::{SpareCores, Threads, Wake, Work, lock};
use crate::information::{NoiseEntropy, Protocol};
use crate::objects::{ObjectError, Progress};
use crate::sensor::{Convolution, Noise};

/// A result and the revision of the design it was computed from.
#[derive(Debug)]
pub struct Stamped<T> {
    /// The revision.
    pub revision: u64,
    /// The result, shared.
    pub value: Arc<T>,
}

impl<T> Clone for Stamped<T> {
    fn clone(&self) -> Self {
        Self { revision: self.revision, value: Arc::clone(&self.value) }
    }
}

/// The latest result of every step; steps arrive one by one.
#[derive(Clone, Default)]
pub struct Live {
    /// PSF and transfer function.
    pub optics: Option<Stamped<Optics>>,
    /// The objects.
    pub scene: Option<Stamped<Scene>>,
    /// The measurements.
    pub measurements: Option<Stamped<Measurements>>,
    /// The information.
    pub information: Option<Stamped<LiveInformation>>,
    /// What was computed of the one measurement that is looked at.
    pub closer: Option<Arc<Closer>>,
    /// Why the newest design has no numbers.
    pub failure: Option<(u64, String)>,
    /// What takes long at the moment ("Reading objects: 1200 of 10000").
    pub busy: Option<String>,
    /// Seconds that the last complete evaluation took.
    pub seconds: f64,
}

/// Handle of the worker thread; dropping it ends the thread after the job in hand.
pub struct Worker {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    mailbox: Mutex<Mailbox>,
    arrived: Condvar,
    results: Mutex<Results>,
    /// Reading objects is to stop.
    cancelled: AtomicBool,
    /// Where designs go for their live estimate.
    estimator: Estimator,
    threads: Threads,
    activities: Activities,
    wake: Wake,
}

#[derive(Default)]
struct Mailbox {
    evaluate: Option<(u64, Arc<Design>)>,
    jobs: VecDeque<(Job, Entry)>,
    closer: Option<CloserOrder>,
    quit: bool,
}

#[derive(Default)]
struct Results {
    live: Live,
    outcomes: Vec<Result<Outcome, String>>,
    /// Jobs handed over whose answers have not been taken.
    open_jobs: usize,
}

impl Worker {
    /// Starts the thread. `wake` is called from it whenever there is something new to show.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub(super) fn start(wake: Wake, threads: &Threads, activities: Activities) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            mailbox: Mutex::default(),
            arrived: Condvar::new(),
            results: Mutex::default(),
            cancelled: AtomicBool::new(false),
            estimator: Estimator::start(Arc::clone(&wake), threads.clone(), activities.clone())?,
            threads: threads.clone(),
            activities,
            wake,
        });
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("lenslet-worker".into()).spawn(move || run(&own))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Asks for the numbers of a design; takes the place of a request that still waits.
    pub fn evaluate(&self, revision: u64, design: Arc<Design>) {
        self.shared.estimator.supersede(revision);
        lock(&self.shared.mailbox).evaluate = Some((revision, design));
        self.shared.arrived.notify_one();
    }

    /// Asks for what is computed of one measurement alone; takes the place of a request that still waits.
    pub fn look_closer(&self, order: CloserOrder) {
        lock(&self.shared.mailbox).closer = Some(order);
        self.shared.arrived.notify_one();
    }

    /// Hands over a job.
    pub fn submit(&self, job: Job) {
        lock(&self.shared.results).open_jobs += 1;
        let kind = if matches!(job, Job::OpenObjects { .. } | Job::MeasureSnapshot { .. }) {
            ActivityKind::Objects
        } else {
            ActivityKind::File
        };
        let entry = self.shared.activities.add(kind, job.name());
        lock(&self.shared.mailbox).jobs.push_back((job, entry));
        self.shared.arrived.notify_one();
    }

    /// Stops reading objects, if that is going on.
    pub fn cancel(&self) {
        self.shared.cancelled.store(true, Ordering::Relaxed);
    }

    /// Stops the reading of objects of this number, which goes on or waits.
    pub fn cancel_numbered(&self, number: u64) {
        let waiting = {
            let jobs = &mut lock(&self.shared.mailbox).jobs;
            jobs.iter().position(|(_, entry)| entry.number() == number).and_then(|index| jobs.remove(index))
        };
        match waiting {
            Some((job, _)) => {
                let sentence = format!("{} was stopped before it began", job.name());
                let outcome = match job {
                    // Who waits for it is to know.
                    Job::MeasureSnapshot { number, name, .. } => {
                        Ok(Outcome::SnapshotMeasured { number, name, measurement: Err(sentence) })
                    }
                    _ => Err(sentence),
                };
                lock(&self.shared.results).outcomes.push(outcome);
                (self.shared.wake)();
            }
            None => self.cancel(),
        }
    }

    /// The thread of longer estimates.
    pub(super) fn estimator(&self) -> &Estimator {
        &self.shared.estimator
    }

    /// The latest results.
    pub fn live(&self) -> Live {
        lock(&self.shared.results).live.clone()
    }

    /// Answers to jobs since the last call, oldest first.
    pub fn take_outcomes(&self) -> Vec<Result<Outcome, String>> {
        let mut results = lock(&self.shared.results);
        results.open_jobs -= results.outcomes.len();
        std::mem::take(&mut results.outcomes)
    }

    /// Whether a job has not been answered yet, or its answer not been taken.
    pub fn has_open_jobs(&self) -> bool {
        lock(&self.shared.results).open_jobs > 0
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        lock(&self.shared.mailbox).quit = true;
        self.shared.arrived.notify_one();
        if let Some(thread) = self.thread.take() {
            // The thread catches its own panics, so joining fails only where the system killed it.
            let _ = thread.join();
        }
    }
}

#[allow(clippy::large_enum_variant, reason = "one task at a time")]
enum Task {
    Evaluate(u64, Arc<Design>),
    Job(Job, Entry),
    Closer(CloserOrder),
}

fn run(shared: &Shared) {
    let mut cores = SpareCores::new(Work::Computation, shared.threads.clone());
    let mut evaluator = Evaluator::default();
    let mut job_is_due = false;
    while let Some(task) = next_task(shared, &mut job_is_due) {
        let done = cores.run(|| match &task {
            Task::Evaluate(revision, design) => {
                evaluator.evaluate(*revision, design, shared);
                None
            }
            Task::Job(job, entry) => {
                entry.begin();
                evaluator.run_job(job, entry, shared)
            }
            Task::Closer(order) => {
                let edited = || lock(&shared.mailbox).evaluate.is_some();
                if let Some(closer) = order.look(&|| !edited()) {
                    lock(&shared.results).live.closer = Some(Arc::new(closer));
                }
                None
            }
        });
        let answer = done.unwrap_or_else(|text| {
            // What the computation had built may be half done.
            evaluator = Evaluator::default();
            let mut results = lock(&shared.results);
            results.live.busy = None;
            match task {
                Task::Evaluate(revision, _) => {
                    results.live.failure = Some((revision, text));
                    None
                }
                Task::Job(..) => Some(Err(text)),
                Task::Closer(_) => {
                    results.live.closer = None;
                    None
                }
            }
        });
        if let Task::Job(job, entry) = task {
            match answer {
                Some(answer) => {
                    entry.end(answer.as_ref().map(Outcome::sentence).map_err(Clone::clone));
                    lock(&shared.results).outcomes.push(answer);
                }
                None => lock(&shared.mailbox).jobs.push_back((job, entry)),
            }
        }
        (shared.wake)();
    }
}

/// Waits for the next task; evaluations and jobs take turns where both wait. `None` ends the thread.
fn next_task(shared: &Shared, job_is_due: &mut bool) -> Option<Task> {
    let mut mailbox = lock(&shared.mailbox);
    loop {
        // A job was promised an answer, a save above all: the thread ends only when there is none left.
        if mailbox.quit && mailbox.jobs.is_empty() {
            return None;
        }
        if mailbox.quit || *job_is_due || mailbox.evaluate.is_none() {
            *job_is_due = false;
            if let Some((job, entry)) = mailbox.jobs.pop_front() {
                return Some(Task::Job(job, entry));
            }
        }
        if let Some((revision, design)) = mailbox.evaluate.take() {
            *job_is_due = true;
            return Some(Task::Evaluate(revision, design));
        }
        if let Some(order) = mailbox.closer.take() {
            return Some(Task::Closer(order));
        }
        mailbox = shared.arrived.wait(mailbox).unwrap_or_else(PoisonError::into_inner);
    }
}

/// Tells how far the reading of objects is.
fn tell(entry: &Entry, progress: Progress) {
    entry.tell(&progress.to_string(), Some(progress.done as f64 / progress.total.max(1) as f64), None);
}

/// What is kept between evaluations.
#[derive(Default)]
struct Evaluator {
    optics: Option<(Arc<Design>, usize, Arc<Optics>)>,
    scene: Option<Arc<Scene>>,
    /// Objects that were opened for the design, which does not image them yet: an edit may come before.
    opened: Option<Arc<Scene>>,
    scene_optics: Option<(Arc<Scene>, SceneOptics)>,
    noise_entropy: Option<(Noise, NoiseEntropy)>,
}

impl Evaluator {
    fn evaluate(&mut self, revision: u64, design: &Arc<Design>, shared: &Shared) {
        let start = std::time::Instant::now();
        let outcome = self.steps(revision, design, shared);
        let is_stopped =
            shared.cancelled.load(Ordering::Relaxed) && outcome.as_ref().is_err_and(EvaluationError::is_cancelled);
        // An edit that waits would begin again what has just been stopped.
        let same = |(_, newer): &mut (u64, Arc<Design>)| is_stopped && Scene::same_objects(design, newer);
        let newest = lock(&shared.mailbox).evaluate.take_if(same).map_or(revision, |(newer, _)| newer);
        let mut results = lock(&shared.results);
        match outcome {
            Ok(()) => results.live.seconds = start.elapsed().as_secs_f64(),
            // A newer design, which waits in the mailbox, looks at other objects.
            Err(error) if error.is_cancelled() && !is_stopped => {}
            Err(error) => results.live.failure = Some((newest, error.to_string())),
        }
    }

    fn steps(&mut self, revision: u64, design: &Arc<Design>, shared: &Shared) -> Result<(), EvaluationError> {
        let publish = |change: &dyn Fn(&mut Live)| {
            change(&mut lock(&shared.results).live);
            (shared.wake)();
        };
        let planes = self.scene.as_ref().filter(|scene| scene.serves(design)).map_or(1, |scene| scene.set.planes());
        let optics = self.optics(design, planes, revision, shared)?;
        let superseded = |newer: &Design| !Scene::same_objects(design, newer);
        let entry = std::cell::OnceCell::new();
        let told = |progress: Progress| {
            let entry = entry.get_or_init(|| {
                let entry = shared.activities.add(ActivityKind::Objects, format!("Read {}", design.objects));
                entry.begin();
                entry
            });
            tell(entry, progress);
        };
        let scene = self.scene(design, revision, shared, &superseded, &told);
        if let Some(entry) = entry.into_inner() {
            match &scene {
                Ok(scene) => entry.end(Ok(scene.set.describe())),
                // Dropped without an end, it was stopped.
                Err(EvaluationError::Objects(ObjectError::Cancelled)) => {}
                Err(error) => entry.end(Err(error.to_string())),
            }
        }
        let scene = scene?;
        // Opening the objects may have told that they have more planes.
        let optics = if scene.set.planes() > planes {
            self.optics(design, scene.set.planes(), revision, shared)?
        } else {
            optics
        };
        publish(&|live| live.scene = Some(Stamped { revision, value: Arc::clone(&scene) }));
        let shape = design.encoder.grid();
        let known = self.scene_optics.as_ref();
        if !known.is_some_and(|(of, prepared)| Arc::ptr_eq(of, &scene) && prepared.serves(shape)) {
            self.scene_optics = Some((Arc::clone(&scene), SceneOptics::new(&scene, shape)?));
        }
        let Some((_, prepared)) = &self.scene_optics else { return Ok(()) };
        let measurements = Arc::new(prepared.measure(design, &optics, &scene)?);
        publish(&|live| live.measurements = Some(Stamped { revision, value: Arc::clone(&measurements) }));
        // Tables of the noise's entropy are worth keeping while the noise stays the same.
        let bounding = design.noise.bounding();
        let noise_entropy = match &self.noise_entropy {
            Some((noise, known)) if *noise == bounding => known,
            _ => {
                let entropy = NoiseEntropy::new(bounding, Protocol::Default)?;
                &self.noise_entropy.insert((bounding, entropy)).1
            }
        };
        let information = Arc::new(prepared.information(design, &optics, &scene, &measurements, noise_entropy)?);
        publish(&|live| {
            live.information = Some(Stamped { revision, value: Arc::clone(&information) });
            live.failure = None;
        });
        shared.estimator.refine(revision, Arc::clone(design), scene);
        Ok(())
    }

    /// Renders and publishes the PSF, unless the last one is of this very mask.
    fn optics(
        &mut self,
        design: &Arc<Design>,
        planes: usize,
        revision: u64,
        shared: &Shared,
    ) -> Result<Arc<Optics>, EvaluationError> {
        let optics = match &self.optics {
            Some((of, known, optics)) if of.encoder == design.encoder && *known == planes => Arc::clone(optics),
            _ => {
                let optics = Arc::new(Optics::of(design, planes)?);
                self.optics = Some((Arc::clone(design), planes, Arc::clone(&optics)));
                optics
            }
        };
        lock(&shared.results).live.optics = Some(Stamped { revision, value: Arc::clone(&optics) });
        (shared.wake)();
        Ok(optics)
    }

    /// The objects of the design, opened where they are not at hand. `superseded` tells whether a newer design, which
    /// waits for its numbers, makes these objects useless.
    fn scene(
        &mut self,
        design: &Design,
        revision: u64,
        shared: &Shared,
        superseded: &dyn Fn(&Design) -> bool,
        told: &dyn Fn(Progress),
    ) -> Result<Arc<Scene>, EvaluationError> {
        if let Some(opened) = self.opened.take_if(|scene| scene.serves(design)) {
            self.scene = Some(opened);
        }
        if let Some(scene) = self.scene.as_ref().filter(|scene| scene.serves(design)) {
            return Ok(Arc::clone(scene));
        }
        shared.cancelled.store(false, Ordering::Relaxed);
        let newest = Cell::new(revision);
        let watch = |progress: Progress| {
            lock(&shared.results).live.busy = Some(progress.to_string());
            told(progress);
            // The mask may be edited while objects are read: the PSF follows at once.
            let waiting = lock(&shared.mailbox).evaluate.clone();
            if let Some((newer, wanted)) = waiting.filter(|(newer, _)| *newer > newest.get()) {
                if superseded(&wanted) {
                    return ControlFlow::Break(());
                }
                newest.set(newer);
                if let Ok(optics) = Optics::of(&wanted, 1) {
                    lock(&shared.results).live.optics = Some(Stamped { revision: newer, value: Arc::new(optics) });
                }
            }
            (shared.wake)();
            let stop = lock(&shared.mailbox).quit || shared.cancelled.load(Ordering::Relaxed);
            if stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let scene = Scene::open(design, &watch);
        lock(&shared.results).live.busy = None;
        let scene = Arc::new(scene?);
        self.scene = Some(Arc::clone(&scene));
        Ok(scene)
    }

    /// Does a job; none where it gave way to an edit and is to be begun again.
    fn run_job(&mut self, job: &Job, entry: &Entry, shared: &Shared) -> Option<Result<Outcome, String>> {
        match job {
            // The one job that leaves something behind for evaluations: the objects, if they can be opened.
            Job::OpenObjects { design, document } => Some(self.open_objects((design, *document), entry, shared)),
            Job::MeasureSnapshot { number, name, design } => {
                let known = self.scene.clone().filter(|scene| scene.serves(design));
                let scene = known.map_or_else(|| other_scene(design, entry, shared), |scene| Some(Ok(scene)))?;
                Some(Ok(measured_snapshot((*number, name), design, scene.as_deref().map_err(Clone::clone))))
            }
            other => Some(other.run()),
        }
    }

    fn open_objects(
        &mut self,
        (design, document): (&Design, u64),
        entry: &Entry,
        shared: &Shared,
    ) -> Result<Outcome, String> {
        let revision = lock(&shared.results).live.optics.as_ref().map_or(0, |optics| optics.revision);
        let earlier = self.scene.clone();
        // Who opens a file again wants what is in it now.
        self.opened = None;
        self.scene.take_if(|_| design.objects.is_read());
        // Edits go on while objects are read; they do not make them useless.
        let scene = self.scene(design, revision, shared, &|_| false, &|progress| tell(entry, progress));
        let source = &design.objects;
        let opened = scene.map_err(|error| error.to_string()).and_then(|scene| {
            let fits = Convolution::new(scene.set.field(), design.encoder.grid());
            fits.map_err(|error| format!("{source}: {error}"))?;
            Ok(Outcome::ObjectsOpened { source: source.clone(), document, notices: scene.set.notices().to_vec() })
        });
        // Until it images others the open design goes on with its own.
        let scene = std::mem::replace(&mut self.scene, earlier);
        self.opened = scene.filter(|_| opened.is_ok());
        opened
    }
}

/// The objects of a design that is not open; reading them ends where it is cancelled or the program does. None where it
/// gave way to an edit, whose numbers do not wait for it.
fn other_scene(design: &Design, entry: &Entry, shared: &Shared) -> Option<Result<Arc<Scene>, String>> {
    shared.cancelled.store(false, Ordering::Relaxed);
    let has_given_way = Cell::new(false);
    let watch = |progress: Progress| {
        lock(&shared.results).live.busy = Some(progress.to_string());
        tell(entry, progress);
        (shared.wake)();
        let mailbox = lock(&shared.mailbox);
        let stop = mailbox.quit || shared.cancelled.load(Ordering::Relaxed);
        // What has been read is not read again.
        has_given_way.set(!stop && progress.done < progress.total && mailbox.evaluate.is_some());
        if stop || has_given_way.get() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let scene = Scene::open(design, &watch);
    lock(&shared.results).live.busy = None;
    match scene {
        Err(_) if has_given_way.get() => None,
        scene => Some(scene.map(Arc::new).map_err(|error| error.to_string())),
    }
}
