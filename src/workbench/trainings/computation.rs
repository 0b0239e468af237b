//! Computation of trainings: the scene and the masks of an order, and its steps.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::forward::{ForwardError, ForwardModel};
use crate::information::Protocol;
use crate::progress::CancelToken;
use crate::reconstruction::{
    DecoderScene, NetworkTraining, ReconstructionError, TrainedNetwork, TrainingMasks, TrainingStep,
};
use crate::workbench::background::mailbox::Mailbox;
use crate::workbench::trainings::queue::{TrainingEnd, TrainingOrder, TrainingQueue, TrainingScope};

/// Time between two frames of the window for steps.
const WAKE_EVERY: Duration = Duration::from_millis(100);

/// Trains a network.
pub(crate) fn run(order: &TrainingOrder, cancel: &CancelToken, mailbox: &Mailbox<TrainingQueue>) -> TrainingEnd {
    match train(order, cancel, mailbox) {
        Ok(network) => TrainingEnd::Done(Arc::new(network)),
        Err(ReconstructionError::Cancelled) => TrainingEnd::Stopped,
        Err(error) => TrainingEnd::Failed(error.to_string()),
    }
}

fn train(
    TrainingOrder { design, scene, scope, budget, .. }: &TrainingOrder,
    cancel: &CancelToken,
    mailbox: &Mailbox<TrainingQueue>,
) -> Result<TrainedNetwork, ReconstructionError> {
    let forward = ForwardModel::of_objects(design, Arc::clone(&scene.set))?;
    let scene = DecoderScene::new(&forward, Protocol::Default)?;
    let masks = match scope {
        TrainingScope::ThisMask => {
            let psf = forward.psf(design).map_err(ForwardError::from)?;
            TrainingMasks::One(scene.model(psf.view())?)
        }
        TrainingScope::AnyMask => TrainingMasks::any(&design.encoder)?,
    };
    let mut woken = Instant::now();
    let mut on_step = |step: &TrainingStep| {
        // A stopped training has ended for the window, which may have ordered another one.
        let is_validation = mailbox.change(|queue| !cancel.is_cancelled() && queue.note(step));
        if is_validation || woken.elapsed() >= WAKE_EVERY {
            woken = Instant::now();
            mailbox.wake();
        }
        mailbox.wait_while(cancel, |queue| queue.is_paused())
    };
    NetworkTraining { budget: *budget, seed: design.seed }.train(&scene, &masks, None, None, cancel, &mut on_step)
}
