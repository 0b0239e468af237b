//! Queue of trainings: one at a time, its curves, and the networks that trainings and files gave.

use std::sync::Arc;
use std::time::Duration;

use crate::evaluation::scene::Scene;
use crate::forward::Design;
use crate::progress::CancelToken;
use crate::reconstruction::{TrainedNetwork, TrainingBudget, TrainingPoint, TrainingStep};
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::Queue;
use crate::workbench::reconstructions::networks::{KnownNetwork, Networks};

/// Message where no training can be started.
const BUSY: &str = "a training is active; stop it first";

/// Most points of the curve of losses: beyond, every second one is dropped.
const MOST_LOSSES: usize = 600;

/// Masks that a network is trained for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrainingScope {
    /// The mask of the design.
    #[default]
    ThisMask,
    /// Any mask of lenslets on its grid.
    AnyMask,
}

/// A network to be trained. It holds a copy of its design.
#[derive(Clone)]
pub struct TrainingOrder {
    /// The design.
    pub design: Arc<Design>,
    /// Its objects.
    pub scene: Arc<Scene>,
    /// Number of the document.
    pub document: u64,
    /// Masks of the network.
    pub scope: TrainingScope,
    /// When training ends.
    pub budget: TrainingBudget,
}

impl TrainingOrder {
    /// Name for people.
    pub fn name(&self) -> String {
        let masks = match self.scope {
            TrainingScope::ThisMask => self.design.encoder.describe(),
            TrainingScope::AnyMask => "any mask".into(),
        };
        format!("Train a network for {masks}, {}", self.design.objects)
    }
}

/// State of a training.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TrainingStatus {
    /// Priors and masks are prepared.
    Preparing,
    /// It is running.
    Running,
    /// It is paused.
    Paused,
    /// It is complete.
    Done,
    /// A person stopped it.
    Stopped,
    /// It failed, for this reason.
    Failed(String),
}

/// Mean squared errors of recent training objects, in units of the squared peak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossPoint {
    /// Steps so far.
    pub steps: usize,
    /// That of the network.
    pub network: f64,
    /// That of the linear estimate of the same objects.
    pub linear: f64,
}

/// The present or last training.
#[derive(Clone)]
pub struct Training {
    /// What was ordered.
    pub order: TrainingOrder,
    /// State of the training.
    pub status: TrainingStatus,
    /// Steps so far.
    pub steps: usize,
    /// Share of the budget, 0 to 1.
    pub done: f64,
    /// Remaining time of work, once it is known.
    pub left: Option<Duration>,
    /// Losses in the order of their steps.
    pub losses: Arc<Vec<LossPoint>>,
    /// Validations in the order of their steps.
    pub validations: Arc<Vec<TrainingPoint>>,
    /// PSNR of the linear estimate on the validation objects, dB.
    pub linear_psnr_db: Option<f64>,
    /// The network of the best weights so far.
    pub best: Option<Arc<TrainedNetwork>>,
    /// Steps between two points of the losses.
    stride: usize,
}

impl Training {
    fn new(order: TrainingOrder) -> Self {
        Self {
            order,
            status: TrainingStatus::Preparing,
            steps: 0,
            done: 0.0,
            left: None,
            losses: Arc::default(),
            validations: Arc::default(),
            linear_psnr_db: None,
            best: None,
            stride: 1,
        }
    }

    /// Whether it computes or is paused.
    pub fn is_active(&self) -> bool {
        matches!(self.status, TrainingStatus::Preparing | TrainingStatus::Running | TrainingStatus::Paused)
    }

    /// The network of the best weights so far, where they are better than the linear estimate.
    fn better(&self) -> Option<&Arc<TrainedNetwork>> {
        self.best.as_ref().filter(|network| !network.is_linear())
    }

    /// Receives a step. Returns whether it brings a validation.
    fn note(&mut self, step: &TrainingStep) -> bool {
        (self.steps, self.done) = (step.steps, step.done);
        let left = match self.order.budget {
            TrainingBudget::Seconds(budget) => budget - step.seconds,
            TrainingBudget::Steps(steps) => steps.saturating_sub(step.steps) as f64 / step.steps_per_second.max(1e-9),
        };
        self.left = Duration::try_from_secs_f64(left.max(0.0)).ok();
        self.linear_psnr_db = step.linear_psnr_db;
        if let Some(linear) = step.linear_loss.filter(|_| step.steps.is_multiple_of(self.stride)) {
            let losses = Arc::make_mut(&mut self.losses);
            losses.push(LossPoint { steps: step.steps, network: step.loss, linear });
            if losses.len() > MOST_LOSSES {
                self.stride *= 2;
                losses.retain(|point| point.steps.is_multiple_of(self.stride));
            }
        }
        let validation = step.validation.filter(|point| self.validations.last() != Some(point));
        if let Some(validation) = validation {
            Arc::make_mut(&mut self.validations).push(validation);
            self.best.clone_from(&step.best);
        }
        validation.is_some()
    }
}

/// The present or last training, and the networks of the session.
#[derive(Clone, Default)]
pub struct Trainings {
    /// The present or last training.
    pub newest: Option<Training>,
    /// The networks of the session.
    pub networks: Networks,
}

impl Trainings {
    /// The network of a document that is in no file: a finished one, or else the best one so far of the active training.
    pub(crate) fn unsaved(&self, document: u64) -> Option<&Arc<TrainedNetwork>> {
        let active =
            self.newest.as_ref().filter(|training| training.is_active() && training.order.document == document);
        self.networks.unsaved_of(document).or(active.and_then(Training::better))
    }
}

/// End of a training.
pub(crate) enum TrainingEnd {
    Done(Arc<TrainedNetwork>),
    Stopped,
    Failed(String),
}

/// The waiting and the running order, and the results.
pub(crate) struct TrainingQueue {
    activities: Activities,
    /// The place of the active training among them.
    entry: Option<ActivityHandle>,
    waiting: Option<TrainingOrder>,
    running: Option<CancelToken>,
    trainings: Trainings,
}

impl TrainingQueue {
    /// An empty queue.
    pub fn new(activities: Activities) -> Self {
        Self { activities, entry: None, waiting: None, running: None, trainings: Trainings::default() }
    }

    /// Orders a training.
    ///
    /// # Errors
    /// One sentence where one is active.
    pub fn order(&mut self, order: TrainingOrder) -> Result<(), String> {
        if self.trainings.newest.as_ref().is_some_and(Training::is_active) {
            return Err(BUSY.into());
        }
        let entry = self.activities.add(ActivityKind::Training, order.name());
        entry.begin();
        entry.report("Preparing", None, None);
        self.entry = Some(entry);
        self.trainings.newest = Some(Training::new(order.clone()));
        self.waiting = Some(order);
        Ok(())
    }

    /// Pauses or resumes the training, from its next step on.
    pub fn pause(&mut self, pause: bool) {
        let Some(training) = self.trainings.newest.as_mut().filter(|training| training.is_active()) else { return };
        training.status = match (pause, training.steps) {
            (true, _) => TrainingStatus::Paused,
            (false, 0) => TrainingStatus::Preparing,
            (false, _) => TrainingStatus::Running,
        };
        if let Some(entry) = &self.entry {
            entry.pause(pause);
        }
    }

    /// Whether the training waits until it is resumed.
    pub fn is_paused(&self) -> bool {
        self.trainings.newest.as_ref().is_some_and(|training| training.status == TrainingStatus::Paused)
    }

    /// Stops the training. The best weights so far are kept.
    pub fn stop(&mut self) {
        if let Some(cancel) = &self.running {
            cancel.cancel();
        }
        self.waiting = None;
        self.finish(TrainingEnd::Stopped);
    }

    /// Receives a step. Returns whether it brings a validation.
    pub fn note(&mut self, step: &TrainingStep) -> bool {
        let Some(training) = self.trainings.newest.as_mut().filter(|training| training.is_active()) else {
            return false;
        };
        let is_validation = training.note(step);
        if training.status != TrainingStatus::Paused {
            training.status = TrainingStatus::Running;
        }
        if let Some(entry) = &self.entry {
            let validated = step.validation.map_or(String::new(), |point| format!(", {:.2} dB", point.psnr_db));
            entry.report(&format!("Step {}{validated}", step.steps), Some(step.done), training.left);
        }
        is_validation
    }

    /// The networks of the session, to change them.
    pub fn networks_mut(&mut self) -> &mut Networks {
        &mut self.trainings.networks
    }

    /// The present or last training, and the networks.
    pub fn trainings(&self) -> &Trainings {
        &self.trainings
    }

    /// Notes the end of the training, once.
    fn finish(&mut self, end: TrainingEnd) {
        let Some(training) = self.trainings.newest.as_mut().filter(|training| training.is_active()) else { return };
        training.left = None;
        let entry = self.entry.take();
        let better = training.better().cloned();
        let (status, outcome, network) = match end {
            TrainingEnd::Done(network) => (TrainingStatus::Done, Some(Ok(network.summary())), Some(network)),
            // The dropped entry counts as stopped.
            TrainingEnd::Stopped => (TrainingStatus::Stopped, None, better),
            TrainingEnd::Failed(sentence) => (TrainingStatus::Failed(sentence.clone()), Some(Err(sentence)), better),
        };
        training.status = status;
        let document = training.order.document;
        if let Some(network) = network {
            self.trainings.networks.add(KnownNetwork { network, document, path: None });
        }
        if let (Some(entry), Some(outcome)) = (entry, outcome) {
            entry.end(outcome);
        }
    }
}

impl Queue for TrainingQueue {
    type Task = TrainingOrder;
    type Answer = TrainingEnd;

    fn next(&mut self, cancel: &CancelToken) -> Option<TrainingOrder> {
        let order = self.waiting.take()?;
        self.running = Some(cancel.clone());
        Some(order)
    }

    fn end(&mut self, _: TrainingOrder, answer: Result<TrainingEnd, String>) {
        self.running = None;
        // While an order waits, the answer is that of one that was stopped before.
        if self.waiting.is_none() {
            self.finish(answer.unwrap_or_else(TrainingEnd::Failed));
        }
    }

    fn close(&mut self) {
        self.waiting = None;
    }
}

#[cfg(test)]
mod tests;
