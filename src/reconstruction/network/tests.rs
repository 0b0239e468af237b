//! Training, files and use of networks on small fields.

use std::ops::ControlFlow;
use std::sync::Arc;

use ndarray::{Array2, Axis};

use super::*;
use crate::information::{InMemory, Protocol};
use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};
use crate::optics::{Diffuser, Encoder, heuristic_layout};
use crate::progress::CancelToken;
use crate::reconstruction::decoder::{Decoder, DecoderKind};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::linear::{Light, LinearMmse};
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::protocol::{DecoderScene, DecoderTest};
use crate::sensor::Noise;

fn scene(set: ObjectSet) -> DecoderScene {
    DecoderScene {
        set: Arc::new(set),
        light: Light::Scene,
        background: 5.0,
        noise: Noise::Shot,
        protocol: Protocol::Default,
    }
}

fn beads() -> DecoderScene {
    let options = ObjectOptions { field: (30, 36), ..ObjectOptions::default() };
    scene(ObjectSet::open(&ObjectSource::Beads { density: 0.02 }, &options).unwrap())
}

/// Mosaics of tiles of 16 px with one bright bar each, which a linear estimate cannot know.
fn bars() -> DecoderScene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bars.idx");
    let count = 40_u32;
    let axes = [count, 16, 16].into_iter().flat_map(u32::to_be_bytes);
    let pixel = |index: u32| {
        let (image, row, col) = (index / 256, index / 16 % 16, index % 16);
        let place = if image % 2 == 0 { row } else { col };
        if (place + image / 2).is_multiple_of(16) || (place + image / 2 + 1).is_multiple_of(16) { 255 } else { 0 }
    };
    let bytes: Vec<u8> = [0, 0, 8, 3].into_iter().chain(axes).chain((0..count * 256).map(pixel)).collect();
    std::fs::write(&path, bytes).unwrap();
    let options = ObjectOptions { field: (32, 32), ..ObjectOptions::default() };
    scene(ObjectSet::open(&ObjectSource::Idx(path), &options).unwrap())
}

/// A mask of two points.
fn model(scene: &DecoderScene, second: (usize, usize)) -> ImagingModel {
    let mut psf = Array2::zeros((9, 9));
    psf[(4, 4)] = 0.6;
    psf[second] = 0.4;
    scene.model(psf.view().insert_axis(Axis(0))).unwrap()
}

fn train(scene: &DecoderScene, masks: &TrainingMasks, steps: usize) -> TrainedNetwork {
    train_with(&NetworkTraining { budget: TrainingBudget::Steps(steps), seed: 3 }, scene, masks)
}

fn train_with(training: &NetworkTraining, scene: &DecoderScene, masks: &TrainingMasks) -> TrainedNetwork {
    training.train(scene, masks, None, None, &CancelToken::new(), &mut CancelToken::new()).unwrap()
}

impl TrainedNetwork {
    /// A network of one step on a small field, which counts as better than the linear estimate.
    pub(crate) fn of_one_step() -> Self {
        let scene = beads();
        let mut network = train(&scene, &TrainingMasks::One(model(&scene, (1, 6))), 1);
        network.training.psnr_db = network.linear_psnr_db + 1.0;
        network
    }
}

#[test]
fn equal_seeds_give_equal_weights_for_any_number_of_threads() {
    let scene = beads();
    let masks = TrainingMasks::One(model(&scene, (1, 6)));
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| train(&scene, &masks, 3))
    };
    let (one, three) = (with_threads(1), with_threads(3));
    assert!(one.weights == three.weights);
    assert_eq!((one.training.steps, one.training.psnr_db), (3, three.training.psnr_db));
}

#[test]
fn network_learns_what_the_linear_estimate_cannot_know() {
    let scene = bars();
    let model = model(&scene, (1, 6));
    let network = Arc::new(train(&scene, &TrainingMasks::One(model.clone()), 60));
    assert!(
        network.training.psnr_db > network.linear_psnr_db + 1.0,
        "{} {}",
        network.training.psnr_db,
        network.linear_psnr_db
    );
    assert!(!network.is_linear());
    let prior = Arc::new(scene.prior(&CancelToken::new()).unwrap());
    let test = |decoder: &dyn Decoder| {
        let test = DecoderTest { objects: 24, seed: 1 };
        test.run::<ReconstructionError>(decoder, &scene, &model, &mut CancelToken::new(), &mut |_| Ok(())).unwrap()
    };
    let linear = test(&LinearMmse::new(prior.clone()));
    let better = test(&NetworkDecoder::new(network.clone(), &scene, prior).unwrap());
    assert_eq!((better.decoder, better.networks), (DecoderKind::Network, 0));
    assert!(better.psnr_db > linear.psnr_db + 1.0, "{} {}", better.psnr_db, linear.psnr_db);

    // Two networks on the same objects.
    let mut other = better.clone();
    (other.psnr_db, other.psnr_db_interval_95) =
        (better.psnr_db + 0.4, better.psnr_db_interval_95.map(|end| end + 0.4));
    let both = crate::reconstruction::DecoderQuality::over_networks(&[better.clone(), other]).unwrap().unwrap();
    assert!((both.psnr_db - better.psnr_db - 0.2).abs() < 1e-9 && both.networks == 2);
    let width = |interval: [f64; 2]| interval[1] - interval[0];
    assert!(width(both.psnr_db_interval_95) > width(better.psnr_db_interval_95) + 0.1);
    assert_eq!(both.mse, better.mse);
}

#[test]
fn files_bring_back_the_network_and_refuse_others() {
    let scene = beads();
    let model_of = |second| model(&scene, second);
    let network = train(&scene, &TrainingMasks::One(model_of((1, 6))), 1);
    let bytes = network.to_bytes().unwrap();
    assert_eq!(TrainedNetwork::from_bytes(&bytes).unwrap(), network);
    for cut in [0, 20, bytes.len() / 2] {
        assert!(
            TrainedNetwork::from_bytes(&bytes[..cut]).unwrap_err().to_string().contains("not weights of this network")
        );
    }
    let prior = Arc::new(scene.prior(&CancelToken::new()).unwrap());
    let network = Arc::new(network);
    let decoder = NetworkDecoder::new(network.clone(), &scene, prior.clone()).unwrap();
    assert!(decoder.prepare(&model_of((1, 6)), &CancelToken::new()).is_ok());
    let error = decoder.prepare(&model_of((2, 6)), &CancelToken::new()).err().unwrap().to_string();
    assert!(error.contains("expected the mask that it was trained for"), "{error}");
    let other = DecoderScene { background: 6.0, ..scene.clone() };
    let error = NetworkDecoder::new(network, &other, prior).err().unwrap().to_string();
    assert!(error.contains("expected the scene that it was trained for"), "{error}");
}

#[test]
fn network_for_any_mask_serves_all_of_its_grid() {
    let scene = beads();
    let network = Arc::new(train(&scene, &TrainingMasks::Any { psf: (9, 9) }, 2));
    let prior = Arc::new(scene.prior(&CancelToken::new()).unwrap());
    let decoder = NetworkDecoder::new(network.clone(), &scene, prior).unwrap();
    for second in [(1, 6), (7, 2)] {
        let prepared = decoder.prepare(&model(&scene, second), &CancelToken::new()).unwrap();
        let measured = scene.test_objects(&model(&scene, second), 0..2, 1).unwrap().measurements;
        assert_eq!(prepared.reconstruct(measured.view(), &mut CancelToken::new()).unwrap().dim(), (2, 30, 36));
    }
    let wide = scene.model(Array2::from_elem((11, 11), 1.0 / 121.0).view().insert_axis(Axis(0))).unwrap();
    let refusal = |model: &ImagingModel| decoder.prepare(model, &CancelToken::new()).err().unwrap().to_string();
    assert!(refusal(&wide).contains("on a grid of 9 x 9 px, found 11 x 11 px"), "{}", refusal(&wide));
    // What training refuses, use refuses.
    let lenslets = Encoder::Lenslets(heuristic_layout(3));
    let diffuser = Encoder::Diffuser(Diffuser::with_light_kept(8, 1));
    let two_points = model(&scene, (1, 6));
    assert!(decoder.prepare(&two_points.clone().of_mask(&lenslets), &CancelToken::new()).is_ok());
    for (mask, found) in [(diffuser, "found diffuser"), (lenslets.with_throughput(0.5), "lenslets, throughput 0.5;")] {
        assert!(TrainingMasks::any(&mask).is_err());
        let sentence = refusal(&two_points.clone().of_mask(&mask));
        assert!(sentence.contains(found), "{sentence}");
    }
    // Training for one mask begins there.
    let training = NetworkTraining { budget: TrainingBudget::Steps(1), seed: 4 };
    let masks = TrainingMasks::One(model(&scene, (1, 6)));
    let further =
        training.train(&scene, &masks, Some(&network), None, &CancelToken::new(), &mut CancelToken::new()).unwrap();
    assert_eq!(further.deviation, network.deviation);
    assert_ne!(further.training.mask, network.training.mask);
}

#[test]
fn progress_is_reported_after_each_step_and_ends_training() {
    let scene = beads();
    let masks = TrainingMasks::One(model(&scene, (1, 6)));
    let training = NetworkTraining { budget: TrainingBudget::Steps(50), seed: 1 };
    let mut seen = Vec::new();
    let mut progress = |step: &TrainingStep| {
        seen.push((step.steps, step.done));
        if step.steps == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let result = training.train(&scene, &masks, None, None, &CancelToken::new(), &mut progress);
    assert!(matches!(result, Err(ReconstructionError::Cancelled)));
    assert_eq!(seen, [(1, 0.02), (2, 0.04)]);
    let cancelled = CancelToken::new();
    cancelled.cancel();
    let result = training.train(&scene, &masks, None, None, &cancelled, &mut CancelToken::new());
    assert!(matches!(result, Err(ReconstructionError::Cancelled)));
}

/// The state of each step is written while a training is at work, so that one whose program is killed resumes.
#[test]
fn a_killed_training_resumes_from_its_last_state() {
    let scene = beads();
    let masks = TrainingMasks::One(model(&scene, (1, 6)));
    let training = NetworkTraining { budget: TrainingBudget::Steps(4), seed: 5 };
    // It is always time for a state.
    let (keeper, killed) = (InMemory::default(), InMemory::of_cancelled());
    let mut at = |step: &TrainingStep| {
        if step.steps == 3 {
            killed.state.lock().unwrap().clone_from(&keeper.state.lock().unwrap());
        }
        ControlFlow::Continue(())
    };
    let whole = training.train(&scene, &masks, None, Some(&keeper), &CancelToken::new(), &mut at).unwrap();
    let mut first = None;
    let mut note = |step: &TrainingStep| {
        first.get_or_insert(step.steps);
        ControlFlow::Continue(())
    };
    let resumed = training.train(&scene, &masks, None, Some(&killed), &CancelToken::new(), &mut note).unwrap();
    assert_eq!(first, Some(3));
    assert!(resumed.weights == whole.weights);
}

#[test]
fn a_stopped_training_resumes_to_the_same_weights() {
    let scene = beads();
    // A mask of any is replaced after 24 steps, and objects are drawn for eight.
    for (masks, steps, stop) in
        [(TrainingMasks::One(model(&scene, (1, 6))), 9, 5), (TrainingMasks::Any { psf: (9, 9) }, 34, 33)]
    {
        let training = NetworkTraining { budget: TrainingBudget::Steps(steps), seed: 5 };
        let keeper = InMemory::of_cancelled();
        let mut at = |step: &TrainingStep| {
            if step.steps == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let stopped = training.train(&scene, &masks, None, Some(&keeper), &CancelToken::new(), &mut at);
        assert!(matches!(stopped, Err(ReconstructionError::Cancelled)));
        let mut first = None;
        let mut note = |step: &TrainingStep| {
            first.get_or_insert(step.steps);
            ControlFlow::Continue(())
        };
        let resumed = training.train(&scene, &masks, None, Some(&keeper), &CancelToken::new(), &mut note).unwrap();
        assert_eq!(first, Some(stop + 1));
        let whole = train_with(&training, &scene, &masks);
        assert!(resumed.weights == whole.weights, "{masks:?}");
        let psnrs =
            |network: &TrainedNetwork| network.training.curve.iter().map(|point| point.psnr_db).collect::<Vec<_>>();
        assert_eq!((psnrs(&resumed), resumed.training.steps), (psnrs(&whole), steps));
    }
}
