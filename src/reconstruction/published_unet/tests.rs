//! Training, files and use of the U-net on small fields.

use std::ops::ControlFlow;
use std::sync::Arc;

use ndarray::{Array2, Axis};

use super::objects::{image_of, padded};
use super::*;
use crate::information::{EngineChoice, InMemory, Protocol};
use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};
use crate::progress::CancelToken;
use crate::reconstruction::decoder::{Decoder, DecoderKind};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::linear::Light;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::network::{TrainingBudget, TrainingStep};
use crate::reconstruction::protocol::{DecoderScene, DecoderTest};
use crate::sensor::Noise;

fn scene(field: (usize, usize)) -> DecoderScene {
    let options = ObjectOptions { field, ..ObjectOptions::default() };
    let set = ObjectSet::open(&ObjectSource::Beads { density: 0.02 }, &options).unwrap();
    let light = Light::EachObject { mean_photons: 100.0 };
    DecoderScene { set: Arc::new(set), light, background: 0.0, noise: Noise::Shot, protocol: Protocol::Paper }
}

/// A mask of two points.
fn model(scene: &DecoderScene, second: (usize, usize)) -> ImagingModel {
    let mut psf = Array2::zeros((8, 8));
    psf[(4, 4)] = 0.6;
    psf[second] = 0.4;
    scene.model(psf.view().insert_axis(Axis(0))).unwrap()
}

fn train(scene: &DecoderScene, model: &ImagingModel, steps: usize) -> TrainedUnet {
    let training = UnetTraining { budget: TrainingBudget::Steps(steps), seed: 3, engine: EngineChoice::Cpu };
    training.train(scene, model, None, None, &CancelToken::new(), &mut CancelToken::new()).unwrap()
}

#[test]
fn measurement_is_scaled_by_its_maximum_and_lies_where_the_sensor_sees() {
    let scene = scene((96, 96));
    let psf = Array2::from_elem((32, 32), 1.0 / 1024.0);
    let model = scene.model(psf.view().insert_axis(Axis(0))).unwrap();
    let mut measurement = Array2::from_elem((65, 65), 5.0);
    measurement[(0, 1)] = 20.0;
    let image = Array2::from_shape_vec((96, 96), image_of(measurement.view(), &model)).unwrap();
    // 15 px before and 16 after.
    assert_eq!((image[(15, 15)], image[(15, 16)], image[(79, 79)]), (0.25, 1.0, 0.25));
    assert_eq!((image[(14, 40)], image[(80, 40)], image[(40, 14)], image[(40, 80)]), (0.0, 0.0, 0.0, 0.0));
    assert!(image_of(Array2::zeros((65, 65)).view(), &model).iter().all(|&value| value == 0.0));
    assert_eq!(padded((93, 96)), (96, 96));
}

#[test]
fn equal_seeds_give_equal_weights_for_any_number_of_threads() {
    let scene = scene((14, 17));
    let model = model(&scene, (1, 6));
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| train(&scene, &model, 2))
    };
    let (one, three) = (with_threads(1), with_threads(3));
    assert_eq!(one.weights, three.weights);
    assert_eq!((one.training.steps, one.training.psnr_db), (2, three.training.psnr_db));
}

#[test]
fn network_learns_and_serves_its_own_mask_and_scene() {
    let scene = scene((14, 17));
    let model = model(&scene, (1, 6));
    let mut losses = Vec::new();
    let mut note = |step: &TrainingStep| {
        losses.push(step.loss);
        ControlFlow::Continue(())
    };
    let training = UnetTraining { budget: TrainingBudget::Steps(20), seed: 3, engine: EngineChoice::Cpu };
    let network = training.train(&scene, &model, None, None, &CancelToken::new(), &mut note).unwrap();
    assert!(losses.len() == 20 && losses.iter().all(|loss| loss.is_finite()), "{losses:?}");
    let (first, best) = (network.training.curve[0], network.training.psnr_db);
    assert!(network.training.curve.len() == 10 && best > first.psnr_db, "{best} {:?}", network.training.curve);
    let bytes = network.to_bytes().unwrap();
    assert_eq!(TrainedUnet::from_bytes(&bytes).unwrap(), network);
    assert!(TrainedUnet::from_bytes(&bytes[..bytes.len() - 1]).is_err());

    let decoder = UnetDecoder::new(Arc::new(network), &scene).unwrap();
    assert_eq!(decoder.kind(), DecoderKind::Unet);
    let test = DecoderTest { objects: 20, seed: 5 };
    let cancel = &mut CancelToken::new();
    let quality = test.run::<ReconstructionError>(&decoder, &scene, &model, cancel, &mut |_| Ok(())).unwrap();
    assert!((quality.psnr_db - best).abs() < 3.0, "{} {best}", quality.psnr_db);
    let other = self::model(&scene, (1, 5));
    let error = decoder.prepare(&other, &CancelToken::new()).err().unwrap().to_string();
    assert!(error.contains("expected the mask that it was trained for"), "{error}");
    let dim = DecoderScene { light: Light::Scene, ..scene };
    let error = UnetDecoder::new(decoder.network.clone(), &dim).err().unwrap().to_string();
    assert!(error.contains("expected the scene that it was trained for"), "{error}");
}

#[test]
fn training_is_cancelled_and_too_large_fields_are_refused() {
    let scene = scene((14, 17));
    let mut steps = 0;
    let mut stop = |step: &TrainingStep| {
        steps = step.steps;
        if step.steps == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let training = UnetTraining { budget: TrainingBudget::Steps(9), seed: 3, engine: EngineChoice::Cpu };
    let result = training.train(&scene, &model(&scene, (1, 6)), None, None, &CancelToken::new(), &mut stop);
    assert!(matches!(result, Err(ReconstructionError::Cancelled)) && steps == 2);
    let large = self::scene((2000, 2000));
    let result =
        training.train(&large, &model(&large, (1, 6)), None, None, &CancelToken::new(), &mut CancelToken::new());
    assert!(matches!(result, Err(ReconstructionError::TooLarge { .. })));
}

#[test]
fn a_stopped_training_resumes_to_the_same_weights() {
    let scene = scene((14, 17));
    let model = model(&scene, (1, 6));
    // Before the first validation, and after some.
    for (steps, stop) in [(11, 1), (11, 6)] {
        let training = UnetTraining { budget: TrainingBudget::Steps(steps), seed: 3, engine: EngineChoice::Cpu };
        let keeper = InMemory::of_cancelled();
        let mut at = |step: &TrainingStep| {
            if step.steps == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let stopped = training.train(&scene, &model, None, Some(&keeper), &CancelToken::new(), &mut at);
        assert!(matches!(stopped, Err(ReconstructionError::Cancelled)));
        let cancel = &mut CancelToken::new();
        let resumed = training.train(&scene, &model, None, Some(&keeper), &CancelToken::new(), cancel).unwrap();
        let whole = train(&scene, &model, steps);
        assert!(resumed.weights == whole.weights);
        let psnrs =
            |network: &TrainedUnet| network.training.curve.iter().map(|point| point.psnr_db).collect::<Vec<_>>();
        assert_eq!(psnrs(&resumed), psnrs(&whole));
    }
}
