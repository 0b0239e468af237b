//! The evaluator of the worker. It keeps results between designs and jobs, and recomputes only what has changed: PSF, objects,
//! measurements and bounds.

use std::cell::Cell;
use std::ops::ControlFlow;
use std::sync::Arc;

use crate::evaluation::scene::{EvaluationError, Optics, Scene, SceneTables};
use crate::forward::Design;
use crate::information::{NoiseEntropy, Protocol};
use crate::objects::ReadProgress;
use crate::progress::CancelToken;
use crate::sensor::{Convolution, Noise};
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::{Computation, Mailbox};
use crate::workbench::estimates::queue::{EstimateQueue, LiveRequest};
use crate::workbench::jobs::job::{Job, first_measurement};
use crate::workbench::jobs::outcome::Outcome;
use crate::workbench::jobs::queue::{JobQueue, WorkerAnswer, WorkerTask};
use crate::workbench::live::published::{Live, Revisioned, Wanted};

/// Reports the progress of reading objects.
fn report(entry: &ActivityHandle, progress: &ReadProgress) {
    entry.report(&progress.to_string(), Some(progress.done as f64 / progress.total.max(1) as f64), None);
}

/// PSF of a design for objects of so many planes.
struct KnownOptics {
    design: Arc<Design>,
    planes: usize,
    optics: Arc<Optics>,
}

/// Results that are kept between evaluations.
pub(crate) struct Evaluator {
    /// The queue that receives designs for their live estimate.
    estimates: Arc<Mailbox<EstimateQueue>>,
    activities: Activities,
    optics: Option<KnownOptics>,
    scene: Option<Arc<Scene>>,
    /// Objects that were opened for the design, which does not image them yet: an edit may come before.
    opened: Option<Arc<Scene>>,
    scene_tables: Option<(Arc<Scene>, SceneTables)>,
    noise_entropy: Option<(Noise, NoiseEntropy)>,
}

/// The token of the running task, and the mailbox that receives its results.
#[derive(Clone, Copy)]
struct Context<'a> {
    cancel: &'a CancelToken,
    mailbox: &'a Mailbox<JobQueue>,
}

impl Context<'_> {
    fn publish(&self, change: impl FnOnce(&mut Live)) {
        self.mailbox.publish(|queue| change(queue.live_mut()));
    }
}

impl Computation<JobQueue> for Evaluator {
    fn run(&mut self, task: &WorkerTask, cancel: &CancelToken, mailbox: &Mailbox<JobQueue>) -> WorkerAnswer {
        let context = Context { cancel, mailbox };
        match task {
            WorkerTask::Evaluate(wanted) => {
                let start = std::time::Instant::now();
                WorkerAnswer::Evaluated(self.steps(wanted, context).map(|()| start.elapsed().as_secs_f64()))
            }
            WorkerTask::Job(job, entry) => self.run_job(job, entry, context),
            WorkerTask::Inspect(request) => WorkerAnswer::Inspected(request.look(cancel)),
        }
    }
}

impl Evaluator {
    /// An evaluator without results.
    pub fn new(estimates: Arc<Mailbox<EstimateQueue>>, activities: Activities) -> Self {
        Self { estimates, activities, optics: None, scene: None, opened: None, scene_tables: None, noise_entropy: None }
    }

    fn steps(&mut self, wanted: &Wanted, context: Context<'_>) -> Result<(), EvaluationError> {
        let (revision, design) = (wanted.revision, &wanted.design);
        let planes = self.scene.as_ref().filter(|scene| scene.serves(design)).map_or(1, |scene| scene.set.planes());
        let optics = self.optics(design, planes, revision, context)?;
        let activities = self.activities.clone();
        let entry = std::cell::OnceCell::new();
        let on_read = |progress: &ReadProgress| {
            let entry = entry.get_or_init(|| {
                let entry = activities.add(ActivityKind::Objects, format!("Read {}", design.objects));
                entry.begin();
                entry
            });
            report(entry, progress);
        };
        let scene = self.scene(design, revision, context, &on_read);
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
            self.optics(design, scene.set.planes(), revision, context)?
        } else {
            optics
        };
        context.publish(|live| live.scene = Some(Revisioned { revision, value: Arc::clone(&scene) }));
        let shape = design.encoder.grid();
        let known = self.scene_tables.as_ref();
        if !known.is_some_and(|(of, prepared)| Arc::ptr_eq(of, &scene) && prepared.serves(shape)) {
            self.scene_tables = Some((Arc::clone(&scene), SceneTables::new(&scene, shape)?));
        }
        let Some((_, prepared)) = &self.scene_tables else { return Ok(()) };
        let measurements = Arc::new(prepared.measure(design, &optics, &scene)?);
        context.publish(|live| live.measurements = Some(Revisioned { revision, value: Arc::clone(&measurements) }));
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
        context.publish(|live| {
            live.information = Some(Revisioned { revision, value: Arc::clone(&information) });
            live.failure = None;
        });
        self.estimates.change(|queue| queue.refine(LiveRequest { wanted: wanted.clone(), scene }));
        Ok(())
    }

    /// Renders and publishes the PSF, unless the last one is of the same mask.
    fn optics(
        &mut self,
        design: &Arc<Design>,
        planes: usize,
        revision: u64,
        context: Context<'_>,
    ) -> Result<Arc<Optics>, EvaluationError> {
        let optics = match &self.optics {
            Some(known) if known.design.encoder == design.encoder && known.planes == planes => {
                Arc::clone(&known.optics)
            }
            _ => {
                let optics = Arc::new(Optics::of(design, planes)?);
                self.optics = Some(KnownOptics { design: Arc::clone(design), planes, optics: Arc::clone(&optics) });
                optics
            }
        };
        context.publish(|live| live.optics = Some(Revisioned { revision, value: Arc::clone(&optics) }));
        Ok(optics)
    }

    /// The objects of the design, opened where they are not open yet.
    fn scene(
        &mut self,
        design: &Design,
        revision: u64,
        Context { cancel, mailbox }: Context<'_>,
        on_read: &dyn Fn(&ReadProgress),
    ) -> Result<Arc<Scene>, EvaluationError> {
        if let Some(opened) = self.opened.take_if(|scene| scene.serves(design)) {
            self.scene = Some(opened);
        }
        if let Some(scene) = self.scene.as_ref().filter(|scene| scene.serves(design)) {
            return Ok(Arc::clone(scene));
        }
        let newest = Cell::new(revision);
        let mut on_progress = |progress: &ReadProgress| {
            on_read(progress);
            mailbox.change(|queue| queue.live_mut().busy = Some(progress.to_string()));
            // The mask may be edited while objects are read: its PSF appears at once.
            let waiting = mailbox.look(|queue| queue.waiting_evaluation().cloned());
            if let Some(newer) = waiting.filter(|newer| newer.revision > newest.get() && !cancel.is_cancelled()) {
                newest.set(newer.revision);
                if let Ok(optics) = Optics::of(&newer.design, 1) {
                    let (revision, value) = (newer.revision, Arc::new(optics));
                    mailbox.change(|queue| queue.live_mut().optics = Some(Revisioned { revision, value }));
                }
            }
            mailbox.wake();
            cancel.check()
        };
        let scene = Scene::open(design, &mut on_progress);
        mailbox.change(|queue| queue.live_mut().busy = None);
        let scene = Arc::new(scene?);
        self.scene = Some(Arc::clone(&scene));
        Ok(scene)
    }

    fn run_job(&mut self, job: &Job, entry: &ActivityHandle, context: Context<'_>) -> WorkerAnswer {
        match job {
            // The only job with a result for evaluations: the objects, if they can be opened.
            Job::OpenObjects { design, document } => {
                WorkerAnswer::Job(self.open_objects(design, *document, entry, context))
            }
            Job::MeasureSnapshot { number, name, design } => {
                let known = self.scene.clone().filter(|scene| scene.serves(design));
                let Some(scene) = known.map_or_else(|| other_scene(design, entry, context), |scene| Some(Ok(scene)))
                else {
                    return WorkerAnswer::GaveWay;
                };
                let measurement = first_measurement(design, scene.as_deref().map_err(Clone::clone));
                WorkerAnswer::Job(Ok(Outcome::SnapshotMeasured { number: *number, name: name.clone(), measurement }))
            }
            other => WorkerAnswer::Job(other.run()),
        }
    }

    fn open_objects(
        &mut self,
        design: &Design,
        document: u64,
        entry: &ActivityHandle,
        context: Context<'_>,
    ) -> Result<Outcome, String> {
        let shown = |queue: &JobQueue| queue.live().optics.as_ref().map_or(0, |optics| optics.revision);
        let revision = context.mailbox.look(shown);
        let earlier = self.scene.clone();
        // A person who opens a file again wants its present contents.
        self.opened = None;
        self.scene.take_if(|_| design.objects.is_read());
        // Edits may come while objects are read; they do not make them useless.
        let scene = self.scene(design, revision, context, &|progress| report(entry, progress));
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
fn other_scene(
    design: &Design,
    entry: &ActivityHandle,
    Context { cancel, mailbox }: Context<'_>,
) -> Option<Result<Arc<Scene>, String>> {
    let has_given_way = Cell::new(false);
    let mut on_progress = |progress: &ReadProgress| {
        report(entry, progress);
        let is_waiting = mailbox.publish(|queue| {
            queue.live_mut().busy = Some(progress.to_string());
            queue.waiting_evaluation().is_some()
        });
        // Objects that were read completely are not read again.
        has_given_way.set(!cancel.is_cancelled() && progress.done < progress.total && is_waiting);
        if has_given_way.get() { ControlFlow::Break(()) } else { cancel.check() }
    };
    let scene = Scene::open(design, &mut on_progress);
    match scene {
        Err(_) if has_given_way.get() => None,
        scene => Some(scene.map(Arc::new).map_err(|error| error.to_string())),
    }
}
