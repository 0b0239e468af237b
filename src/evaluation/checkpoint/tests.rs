//! Checkpoints are resumed, refused, and removed.

use std::fs::File;

use ndarray::Array2;

use super::*;
use crate::evaluation::estimation::identity;
use crate::evaluation::{DensityModel, EstimateRequest, Scene, WeightsFiles};
use crate::formats::json_of;
use crate::forward::Design;
use crate::information::{DecoderKind, EngineChoice, Estimator, Protocol, TrialSettings};
use crate::optics::{Encoder, PsfImage, heuristic_layout};
use crate::progress::CancelToken;
use crate::sensor::Noise;

#[test]
fn estimates_of_psf_images_that_differ_in_one_pixel_have_different_keys() {
    let mut psf = Array2::<f32>::zeros((64, 64));
    psf[[1, 1]] = 1.0;
    let design = |psf: &Array2<f32>| Design {
        encoder: Encoder::Image(PsfImage { psf: psf.clone(), origin: "psf".into(), throughput: 1.0, photograph: None }),
        ..Design::default()
    };
    let key = |psf: &Array2<f32>| content_key(&json_of(&design(psf)));
    let first = key(&psf);
    psf[[32, 32]] = 1.0;
    assert_ne!(first, key(&psf));
}

fn named(name: &str) -> Identity {
    Identity { content: json!(name), earlier: Vec::new() }
}

/// The files of an estimate in progress as earlier versions wrote them; version 0 is that without a format.
#[test]
fn checkpoints_of_earlier_programs_are_resumed() {
    for version in ["v0", "v1"] {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden");
        let folder = tempfile::tempdir().unwrap();
        let copied = |name: &str| {
            let path = folder.path().join(Path::new(name).file_name().unwrap());
            std::fs::copy(golden.join(name), &path).unwrap();
            path
        };
        let order = std::fs::read(golden.join(format!("window-{version}/estimates/pending/order.json"))).unwrap();
        let order: Value = serde_json::from_slice(&order).unwrap();
        let design: Design = serde_json::from_value(order["order"]["design"].clone()).unwrap();
        let request: EstimateRequest = serde_json::from_value(order["order"]["request"].clone()).unwrap();
        let objects = objects_of(&design);
        let state = copied(&format!("window-{version}/estimates/pending/state"));
        let had_no_format = version == "v0";
        // A file without a format is written again with its format and its new key, and is still the same estimate.
        for _ in 0..2 {
            let kept = EstimateCheckpoint::open(Some(&state), || identity(&design, &objects, &request)).unwrap();
            assert!(kept.parts.trials.len() == 1 && kept.parts.decoder.is_some(), "{version}");
            assert_eq!(kept.parts.earlier_key.is_some(), had_no_format, "{version}");
            drop(kept);
            let text = std::fs::read_to_string(&state).unwrap();
            assert!(text.starts_with("{\"format\":\"lenslet-studio/estimate-checkpoint\",\"format_version\":1,"));
        }
        let other = EstimateRequest { patches_test: 1499, ..request.clone() };
        assert!(EstimateCheckpoint::open(Some(&state), || identity(&design, &objects, &other)).is_err());

        // An estimate that was stopped during its first fit, whose state has a key of its own.
        let name = format!("resume-{version}");
        let path = copied(&name);
        let mut packed = flate2::read::GzDecoder::new(File::open(golden.join(format!("{name}.fit-1.gz"))).unwrap());
        let mut fit = File::create(folder.path().join(format!("{name}.fit-1"))).unwrap();
        std::io::copy(&mut packed, &mut fit).unwrap();
        drop(fit);
        let encoder = Encoder::Lenslets(heuristic_layout(2));
        let design = Design { encoder, seed: 3, ..Design::default() };
        let request = EstimateRequest {
            model: DensityModel::new(Estimator::Causal, None, EngineChoice::default()).of_steps(30_000),
            protocol: Protocol::Default,
            patch: Some((8, 8)),
            patches_train: 10_000,
            patches_test: 32,
            fresh: false,
            trials: 1,
            keep: None,
            weights: WeightsFiles::default(),
        };
        let kept = EstimateCheckpoint::open(Some(&path), || identity(&design, &objects_of(&design), &request)).unwrap();
        let fit = kept.fit("1").unwrap();
        let key = crate::nn::read_detail(&fit.load().unwrap().unwrap(), "key").unwrap();
        assert_eq!(fit.key(), key, "{version}");
    }
}

fn objects_of(design: &Design) -> String {
    Scene::open(design, &mut CancelToken::new()).unwrap().set.fingerprint()
}

#[cfg(target_os = "linux")]
#[test]
fn two_estimates_do_not_share_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept");
    let open = || EstimateCheckpoint::open(Some(&path), || named("one"));
    let kept = open().unwrap();
    let message = open().err().unwrap().to_string();
    assert!(message.contains("kept: expected a file of this estimate alone"), "{message}");
    // It does not remove a checkpoint that another estimate uses, either.
    end(&path);
    assert!(path.exists());
    drop(kept);
    assert!(open().is_ok());
    end(&path);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn parts_that_are_there_are_not_computed_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept");
    let open = |what: &str| EstimateCheckpoint::open(Some(&path), || named(what));
    let bound = |bits_per_pixel| AisBound {
        bits_per_pixel,
        interval_95: [0.1, 1.0 / 3.0],
        patch: [4, 4],
        groups: 4,
        particles: 1,
        levels: 9,
        samples: 5,
        seconds: 0.25,
        seed: 1,
    };
    let mut first = open("one").unwrap();
    assert_eq!(first.above(|_| Ok(bound(0.2))), Ok(bound(0.2)));
    let stopped = first.below(|keeper| {
        keeper.unwrap().store(b"half of it").unwrap();
        Err(InformationError::Cancelled)
    });
    assert_eq!(stopped, Err(InformationError::Cancelled));
    let decoder = Decoder::new(2, 1).unwrap();
    let lower = LowerBound {
        bits_per_pixel: 0.1,
        interval_95: [0.1; 2],
        bits_per_measurement: 1.6,
        decoder: DecoderKind::Factorised,
        patch: [4, 4],
        sites: 9,
        probability: 0.1,
        bias: 1.0,
        noise: Noise::Shot,
        test_patches: 4,
        steps: 3,
        batch: 2,
        unrolled: 2,
        seconds: 1.0,
        seed: 1,
        notes: Vec::new(),
    };
    first.decoder(|_| Ok((lower.clone(), decoder.clone()))).unwrap();
    let trial = || {
        let settings = TrialSettings {
            estimator: Estimator::Causal,
            protocol: Protocol::Default,
            noise: Noise::Shot,
            patch: (4, 4),
            patches_train: 0,
            seed: 1,
        };
        Trial::from_patches(settings, &[1.0 / 3.0, 0.5], &[0.1, 0.2], 1.0, Vec::new())
    };
    let computed = first.trial(0, |keeper| {
        keeper.unwrap().store(b"a state").unwrap();
        trial()
    });
    assert_eq!(computed, trial());
    let fit = folder.path().join("kept.fit-1");
    assert!(!fit.exists(), "it is done");
    // Killed before it was removed.
    std::fs::write(&fit, "a state").unwrap();
    drop(first);

    let refusal = open("other").err().unwrap().to_string();
    assert!(refusal.contains("kept"), "{refusal}");
    let mut again = open("one").unwrap();
    assert_eq!(again.above(|_| Err(InformationError::Empty)), Ok(bound(0.2)));
    let half = folder.path().join("kept.fit-below");
    let resumed = again.below(|keeper| {
        assert!(half.exists());
        assert_eq!(keeper.unwrap().load(), Ok(Some(b"half of it".to_vec())));
        Ok(bound(0.1))
    });
    assert_eq!((resumed, half.exists()), (Ok(bound(0.1)), false));
    let (found, weights) = again.decoder(|_| Err(InformationError::Empty)).unwrap();
    assert_eq!((found, weights.weights()), (lower, decoder.weights()));
    let unasked = |_: Option<&dyn FitCheckpoint>| -> Result<Trial, InformationError> { panic!("it is there") };
    assert_eq!((again.trial(0, unasked), again.smallest()), (trial(), trial().ok().map(|one| one.bits_per_pixel())));
    assert!(again.seconds() >= 2.5, "a trial and a decoder of 1 s, two bounds of 0.25 s");
    drop(again);
    std::fs::write(&half, "half of it").unwrap();
    end(&path);
    assert!(!path.exists() && !fit.exists() && !half.exists());
    // States of an estimate whose file was removed do no harm.
    let others =
        ["kept.fit-4", "kept.fit-above", "kept.fit-letter", "other.fit-1"].map(|name| folder.path().join(name));
    for file in &others {
        std::fs::write(file, "a state").unwrap();
    }
    drop(open("other").unwrap());
    // One without any result gives way, unless a fit is running beside it.
    let going = folder.path().join("kept.fit-1");
    std::fs::write(&going, "a state").unwrap();
    assert!(open("one").is_err());
    std::fs::remove_file(&going).unwrap();
    assert!((0..2).all(|_| open("one").is_ok()));
    assert_eq!(others.map(|file| file.exists()), [false, false, true, true]);
    end(&path);
    // Another file is not written over.
    std::fs::write(&path, "a letter").unwrap();
    assert!(open("one").err().unwrap().to_string().contains("another file"));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "a letter");
}
