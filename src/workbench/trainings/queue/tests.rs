//! Orders, steps and ends of trainings, by plain calls.

use super::*;
use crate::workbench::background::activity::ActivityState;

fn queue() -> (TrainingQueue, Activities) {
    let activities = Activities::default();
    (TrainingQueue::new(activities.clone()), activities)
}

fn order() -> TrainingOrder {
    let design = Arc::new(Design::default());
    let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
    TrainingOrder { design, scene, document: 4, scope: TrainingScope::ThisMask, budget: TrainingBudget::Steps(1000) }
}

fn network() -> Arc<TrainedNetwork> {
    Arc::new(TrainedNetwork::of_one_step())
}

fn step(steps: usize, best: Option<&Arc<TrainedNetwork>>) -> TrainingStep {
    TrainingStep {
        steps,
        done: steps as f64 / 1000.0,
        seconds: steps as f64 / 10.0,
        steps_per_second: 10.0,
        loss: 0.01,
        linear_loss: Some(0.02),
        linear_psnr_db: Some(20.0),
        validation: best.map(|_| TrainingPoint { steps, seconds: 1.0, psnr_db: 21.0 }),
        restarts: 0,
        best: best.cloned(),
    }
}

#[test]
fn training_goes_from_preparation_to_a_network_of_its_document() {
    let (mut queue, activities) = queue();
    queue.order(order()).unwrap();
    assert_eq!(queue.order(order()).unwrap_err(), BUSY);
    let task = queue.next(&CancelToken::new()).unwrap();
    let newest = |queue: &TrainingQueue| queue.trainings().newest.clone().unwrap();
    assert_eq!(newest(&queue).status, TrainingStatus::Preparing);
    queue.note(&step(100, None));
    let training = newest(&queue);
    assert_eq!((training.status, training.left), (TrainingStatus::Running, Some(Duration::from_secs(90))));
    assert_eq!(*training.losses, [LossPoint { steps: 100, network: 0.01, linear: 0.02 }]);
    queue.pause(true);
    assert!(queue.is_paused() && activities.all()[0].state == ActivityState::Paused);
    queue.pause(false);
    let network = network();
    queue.end(task, Ok(TrainingEnd::Done(Arc::clone(&network))));
    assert_eq!(newest(&queue).status, TrainingStatus::Done);
    assert_eq!(activities.all()[0].state, ActivityState::Done(network.summary()));
    let networks = &queue.trainings().networks;
    assert!(Arc::ptr_eq(networks.of_document(4).unwrap(), &network) && networks.of_document(5).is_none());
    assert!(networks.has_unsaved() && networks.serial() == 1);
    assert!(queue.trainings().unsaved(4).is_some() && queue.trainings().unsaved(5).is_none());
    queue.networks_mut().note_file(&network, std::path::Path::new("a.safetensors"));
    assert!(!queue.trainings().networks.has_unsaved() && queue.trainings().unsaved(4).is_none());
}

#[test]
fn stop_ends_at_once_and_keeps_the_best_weights() {
    let network = network();
    for (best, kept) in [(None, false), (Some(&network), true)] {
        let (mut queue, activities) = queue();
        queue.order(order()).unwrap();
        let cancel = CancelToken::new();
        let task = queue.next(&cancel).unwrap();
        queue.note(&step(100, best));
        assert_eq!(queue.trainings().unsaved(4).is_some(), kept, "a crash would lose it");
        queue.stop();
        assert!(cancel.is_cancelled());
        assert_eq!(queue.trainings().newest.as_ref().unwrap().status, TrainingStatus::Stopped);
        assert_eq!(queue.trainings().networks.of_document(4).is_some(), kept);
        // The next one is ordered before the thread has left the last step.
        queue.order(order()).unwrap();
        queue.end(task, Ok(TrainingEnd::Stopped));
        assert_eq!(queue.trainings().newest.as_ref().unwrap().status, TrainingStatus::Preparing);
        assert_eq!(activities.all()[0].state, ActivityState::Stopped);
        queue.stop();
        assert!(queue.next(&CancelToken::new()).is_none(), "it was stopped before it began");
        assert_eq!(queue.trainings().newest.as_ref().unwrap().status, TrainingStatus::Stopped);
    }
}

#[test]
fn failure_is_a_sentence_and_long_curves_are_thinned_out() {
    let (mut queue, activities) = queue();
    queue.order(order()).unwrap();
    let task = queue.next(&CancelToken::new()).unwrap();
    for steps in 1..=3 * MOST_LOSSES {
        queue.note(&step(steps, None));
    }
    let losses = Arc::clone(&queue.trainings().newest.as_ref().unwrap().losses);
    assert!((MOST_LOSSES / 2..=MOST_LOSSES).contains(&losses.len()), "{}", losses.len());
    assert!(losses.windows(2).all(|pair| pair[1].steps - pair[0].steps == 4));
    queue.end(task, Err("no light".into()));
    assert_eq!(queue.trainings().newest.as_ref().unwrap().status, TrainingStatus::Failed("no light".into()));
    assert_eq!(activities.all()[0].state, ActivityState::Failed("no light".into()));
    assert!(queue.trainings().networks.of_document(4).is_none(), "no weights were validated");
}

#[test]
fn a_failed_training_leaves_its_best_weights_if_they_beat_the_linear_estimate() {
    let better = network();
    let mut worse = TrainedNetwork::clone(&better);
    worse.linear_psnr_db = worse.training.psnr_db + 1.0;
    let worse = Arc::new(worse);
    for (best, is_left) in [(&better, true), (&worse, false)] {
        let (mut queue, _) = queue();
        queue.order(order()).unwrap();
        let task = queue.next(&CancelToken::new()).unwrap();
        queue.note(&step(100, Some(best)));
        queue.end(task, Err("no memory".into()));
        assert_eq!(queue.trainings().newest.as_ref().unwrap().status, TrainingStatus::Failed("no memory".into()));
        assert_eq!(queue.trainings().networks.of_document(4).is_some_and(|left| Arc::ptr_eq(left, best)), is_left);
        assert_eq!(queue.trainings().networks.has_unsaved(), is_left);
    }
}
