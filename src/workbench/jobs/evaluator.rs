//! The evaluator of the worker. It keeps results between designs and jobs, and recomputes only what has changed: PSF, objects,
//! measurements and bounds.

use std::cell::Cell;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::worker::Shared;
use crate::evaluation::scene::{EvaluationError, Optics, Scene, SceneTables};
use crate::forward::Design;
use crate::information::{NoiseEntropy, Protocol};
use crate::objects::Progress;
use crate::sensor::{Convolution, Noise};
use crate::workbench::background::activity::{ActivityKind, Entry};
use crate::workbench::background::threads::lock;
use crate::workbench::jobs::job::{Job, Outcome, measured_snapshot};
use crate::workbench::live::published::{Live, Revisioned, Wanted};

/// Reports the progress of reading objects.
fn tell(entry: &Entry, progress: Progress) {
    entry.tell(&progress.to_string(), Some(progress.done as f64 / progress.total.max(1) as f64), None);
}

/// Results that are kept between evaluations.
#[derive(Default)]
pub(crate) struct Evaluator {
    optics: Option<(Arc<Design>, usize, Arc<Optics>)>,
    scene: Option<Arc<Scene>>,
    /// Objects that were opened for the design, which does not image them yet: an edit may come before.
    opened: Option<Arc<Scene>>,
    scene_tables: Option<(Arc<Scene>, SceneTables)>,
    noise_entropy: Option<(Noise, NoiseEntropy)>,
}

impl Evaluator {
    pub(super) fn evaluate(&mut self, wanted: &Wanted, shared: &Shared) {
        let start = std::time::Instant::now();
        let outcome = self.steps(wanted, shared);
        let is_stopped =
            shared.cancelled.load(Ordering::Relaxed) && outcome.as_ref().is_err_and(EvaluationError::is_cancelled);
        // A waiting edit would restart what was just stopped.
        let same = |newer: &mut Wanted| is_stopped && Scene::same_objects(&wanted.design, &newer.design);
        let newest = lock(&shared.mailbox).evaluate.take_if(same).map_or(wanted.revision, |newer| newer.revision);
        let mut results = lock(&shared.results);
        match outcome {
            Ok(()) => results.live.seconds = start.elapsed().as_secs_f64(),
            // A newer design waits in the mailbox, and images other objects.
            Err(error) if error.is_cancelled() && !is_stopped => {}
            Err(error) => results.live.failure = Some((newest, error.to_string())),
        }
    }

    fn steps(&mut self, wanted: &Wanted, shared: &Shared) -> Result<(), EvaluationError> {
        let (revision, design) = (wanted.revision, &wanted.design);
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
                // The entry was dropped without an end: it counts as stopped.
                Err(error) if error.is_cancelled() => {}
                Err(error) => entry.end(Err(error.to_string())),
            }
        }
        let scene = scene?;
        // Opening the objects may have shown that they have more planes.
        let optics = if scene.set.planes() > planes {
            self.optics(design, scene.set.planes(), revision, shared)?
        } else {
            optics
        };
        publish(&|live| live.scene = Some(Revisioned { revision, value: Arc::clone(&scene) }));
        let shape = design.encoder.grid();
        let known = self.scene_tables.as_ref();
        if !known.is_some_and(|(of, prepared)| Arc::ptr_eq(of, &scene) && prepared.serves(shape)) {
            self.scene_tables = Some((Arc::clone(&scene), SceneTables::new(&scene, shape)?));
        }
        let Some((_, prepared)) = &self.scene_tables else { return Ok(()) };
        let measurements = Arc::new(prepared.measure(design, &optics, &scene)?);
        publish(&|live| live.measurements = Some(Revisioned { revision, value: Arc::clone(&measurements) }));
        // Tables of the noise's entropy are kept while the noise stays the same.
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
            live.information = Some(Revisioned { revision, value: Arc::clone(&information) });
            live.failure = None;
        });
        shared.estimator.refine(wanted.clone(), scene);
        Ok(())
    }

    /// Renders and publishes the PSF, unless the last one is of the same mask.
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
        lock(&shared.results).live.optics = Some(Revisioned { revision, value: Arc::clone(&optics) });
        (shared.wake)();
        Ok(optics)
    }

    /// The objects of the design, opened where they are not open yet. `superseded` returns whether a newer design, which waits for its
    /// numbers, makes these objects useless.
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
            // The mask may be edited while objects are read: its PSF appears at once.
            let waiting = lock(&shared.mailbox).evaluate.clone();
            if let Some(newer) = waiting.filter(|newer| newer.revision > newest.get()) {
                if superseded(&newer.design) {
                    return ControlFlow::Break(());
                }
                newest.set(newer.revision);
                if let Ok(optics) = Optics::of(&newer.design, 1) {
                    let (revision, value) = (newer.revision, Arc::new(optics));
                    lock(&shared.results).live.optics = Some(Revisioned { revision, value });
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

    /// Runs a job; none where it gave way to an edit and is to be restarted.
    pub(super) fn run_job(&mut self, job: &Job, entry: &Entry, shared: &Shared) -> Option<Result<Outcome, String>> {
        match job {
            // The only job with a result for evaluations: the objects, if they can be opened.
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
        // A person who opens a file again wants its present contents.
        self.opened = None;
        self.scene.take_if(|_| design.objects.is_read());
        // Edits may come while objects are read; they do not make them useless.
        let scene = self.scene(design, revision, shared, &|_| false, &|progress| tell(entry, progress));
        let source = &design.objects;
        let opened = scene.map_err(|error| error.to_string()).and_then(|scene| {
            let fits = Convolution::new(scene.set.field(), design.encoder.grid());
            fits.map_err(|error| format!("{source}: {error}"))?;
            Ok(Outcome::ObjectsOpened {
                source: source.clone(),
                document,
                understood: scene.set.understood().map(Into::into),
                notices: scene.set.notices().to_vec(),
            })
        });
        // The open design keeps its own objects until it images the new ones.
        let scene = std::mem::replace(&mut self.scene, earlier);
        self.opened = scene.filter(|_| opened.is_ok());
        opened
    }
}

/// The objects of a design that is not open. Reading them ends on cancellation and at the end of the program. None where reading gave way
/// to an edit, whose numbers do not wait for it.
fn other_scene(design: &Design, entry: &Entry, shared: &Shared) -> Option<Result<Arc<Scene>, String>> {
    shared.cancelled.store(false, Ordering::Relaxed);
    let has_given_way = Cell::new(false);
    let watch = |progress: Progress| {
        let (done, total) = (progress.done, progress.total);
        lock(&shared.results).live.busy = Some(progress.to_string());
        tell(entry, progress);
        (shared.wake)();
        let mailbox = lock(&shared.mailbox);
        let stop = mailbox.quit || shared.cancelled.load(Ordering::Relaxed);
        // Objects that were read completely are not read again.
        has_given_way.set(!stop && done < total && mailbox.evaluate.is_some());
        if stop || has_given_way.get() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let scene = Scene::open(design, &watch);
    lock(&shared.results).live.busy = None;
    match scene {
        Err(_) if has_given_way.get() => None,
        scene => Some(scene.map(Arc::new).map_err(|error| error.to_string())),
    }
}
