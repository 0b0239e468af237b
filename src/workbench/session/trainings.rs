//! Trained networks of a session: their training and their files.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::reconstruction::{TrainedNetwork, TrainingBudget};
use crate::workbench::document::network_file::weights_beside;
use crate::workbench::jobs::job::Job;
use crate::workbench::reconstructions::networks::KnownNetwork;
use crate::workbench::reconstructions::queue::ReconstructionKey;
use crate::workbench::session::Session;
use crate::workbench::trainings::queue::{TrainingOrder, TrainingQueue, TrainingScope, Trainings};

/// Message where the objects are not read yet.
const NO_OBJECTS: &str = "the objects of this design are not read yet; train when they are";

impl Session {
    /// Trains a network for the design on view. It owns a copy of the design.
    ///
    /// # Errors
    /// One sentence where the objects are not read yet, and where a training is active.
    pub fn train(&self, scope: TrainingScope, budget: TrainingBudget) -> Result<(), String> {
        let scene = self.worker.live().scene.filter(|scene| scene.value.serves(&self.design));
        let scene = Arc::clone(&scene.ok_or(NO_OBJECTS)?.value);
        let (design, document) = (Arc::clone(&self.design), self.document);
        let order = TrainingOrder { design, scene, document, scope, budget };
        self.trainer.change(|queue| queue.order(order))
    }

    /// Pauses or resumes the training.
    pub fn pause_training(&self, pause: bool) {
        self.trainer.publish(|queue| queue.pause(pause));
    }

    /// Stops the training. The best weights so far are kept.
    pub fn stop_training(&self) {
        self.trainer.publish(TrainingQueue::stop);
    }

    /// The present or last training, and the trained networks.
    pub fn trainings(&self) -> Trainings {
        self.trainer.look(|queue| queue.trainings().clone())
    }

    /// Whether a trained network is in no file.
    pub fn has_unsaved_network(&self) -> bool {
        self.trainer.look(|queue| queue.trainings().networks.has_unsaved())
    }

    /// Reads a network from a file; it is refused where it does not serve the open design.
    pub fn open_network(&self, path: PathBuf) {
        let design = Arc::clone(self.open_design());
        let scene = self.worker.live().scene.filter(|scene| scene.value.serves(&design));
        let serves = Some((design, scene.map(|scene| Arc::clone(&scene.value.set))));
        self.submit(Job::OpenNetwork { serves, document: self.document, path });
    }

    /// Reads the network that lies beside the file of the design, if there is one.
    pub(crate) fn find_network(&self) {
        let weights = self.path().map(weights_beside).filter(|weights| weights.is_file());
        if let Some(path) = weights {
            self.submit(Job::OpenNetwork { serves: None, document: self.document, path });
        }
    }

    /// Adds a network that was read from a file, or was recovered and is in no file.
    pub(crate) fn add_network(&self, network: &Arc<TrainedNetwork>, document: u64, path: Option<&Path>) {
        let known = KnownNetwork { network: Arc::clone(network), document, path: path.map(Path::to_path_buf) };
        self.trainer.publish(|queue| queue.networks_mut().add(known));
    }

    /// The network of the open design that is in no file: a finished one, or else the best one so far of the active training.
    pub(crate) fn unsaved_network(&self) -> Option<Arc<TrainedNetwork>> {
        self.trainer.look(|queue| queue.trainings().unsaved(self.document).cloned())
    }

    /// The network that is saved with the open design: the one that is known to serve it, or else the newest one of this document.
    pub(crate) fn network_to_save(&self) -> Option<Arc<TrainedNetwork>> {
        let is_of_open = |key: ReconstructionKey| key.revision == self.revision && self.open.is_none();
        let shown = self.reconstructions().shown.filter(|shown| is_of_open(shown.key));
        let newest = || self.trainer.look(|queue| queue.trainings().networks.of_document(self.document).cloned());
        shown.and_then(|shown| shown.trained_network().cloned()).or_else(newest)
    }
}
