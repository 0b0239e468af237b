//! Tests of estimates from hand-made trials.

use crate::information::{
    BoundMethod, EngineChoice, Estimate, Estimator, InformationError, NamedBound, Protocol, Provenance, Trial,
    TrialSettings,
};
use crate::sensor::Noise;

#[test]
fn lower_bound_leaves_the_number_unchanged() {
    let below = NamedBound { from: BoundMethod::Decoder, bits_per_pixel: 0.2, interval_95: [0.1, 0.3] };
    let provenance = || Provenance { ceiling: Some(0.5), ..Provenance::default() };
    let estimate = Estimate::new(&[trial(0.75, 1, Protocol::Default)], provenance()).unwrap();
    assert!((estimate.bits_per_patch - 0.75 * 16.0 * 24.0).abs() < 1e-9);
    let bounded = estimate.clone().with_lower_bound(below.clone());
    let bracket = bounded.bracket.clone().unwrap();
    assert_eq!((bounded.bits_per_pixel, bounded.lower()), (estimate.bits_per_pixel, Some(0.2)));
    assert_eq!((bracket.upper, bracket.upper_from), (0.5, BoundMethod::EntropyBound));
    let own = &bracket.upper_bounds[1];
    assert_eq!(
        (own.from, own.bits_per_pixel),
        (BoundMethod::Estimator(Estimator::GaussianFull), estimate.bits_per_pixel)
    );
    let higher = NamedBound { bits_per_pixel: 0.4, ..below.clone() };
    let both = bounded.with_lower_bound(higher);
    assert_eq!((both.lower(), both.bracket.unwrap().lower_bounds.len()), (Some(0.4), 2));
    // Published numbers can lie below the truth and are not bounds.
    let paper = Estimate::new(&[trial(0.75, 1, Protocol::Paper)], provenance()).unwrap();
    assert_eq!(paper.clone().with_lower_bound(below), paper);
}

fn trial(bits: f64, seed: u64, protocol: Protocol) -> Trial {
    let settings = TrialSettings {
        estimator: Estimator::GaussianFull,
        protocol,
        noise: Noise::ShotRead { sigma: 2.5 },
        patch: (16, 24),
        patches_train: 1000,
        seed,
    };
    let entropy_y = [5.0 + bits, 5.2 + bits, 4.8 + bits];
    Trial::from_patches(settings, &entropy_y, &[5.0, 5.0, 5.0], 0.5, vec![format!("note {seed}")]).unwrap()
}

fn provenance() -> Provenance {
    Provenance {
        bias: 10.0,
        objects: "beads, density 0.02".to_owned(),
        objects_fingerprint: "abc".to_owned(),
        encoder: "4 lenslets".to_owned(),
        throughput: None,
        ceiling: Some(0.45),
        notes: Vec::new(),
    }
}

#[test]
fn the_smallest_trial_is_reported_with_its_own_interval_and_the_spread() {
    let trials =
        [trial(0.5, 1, Protocol::Default), trial(0.4, 2, Protocol::Default), trial(0.43, 3, Protocol::Default)];
    let estimate = Estimate::new(&trials, provenance()).unwrap();
    assert!((estimate.bits_per_pixel - 0.4).abs() < 1e-12);
    assert!((estimate.trial_spread - 0.1).abs() < 1e-12);
    assert_eq!((estimate.seed, estimate.trials, estimate.patches_test), (1, 3, 3), "the seed that was asked for");
    assert_eq!(estimate.smallest_trial, Some(2));
    let alone = serde_json::to_string(&Estimate::new(&trials[1..2], provenance()).unwrap()).unwrap();
    assert!(!alone.contains("smallest_trial") && Estimate::from_json(&alone).unwrap().smallest_trial.is_none());
    assert_eq!(estimate.interval_95.map(f64::to_bits), trials[1].interval_95().map(f64::to_bits));
    assert!((estimate.seconds - 1.5).abs() < 1e-12);
    assert!(!estimate.above_ceiling());
    assert_eq!(estimate.notes, ["note 2"]);
}

#[test]
fn estimate_above_entropy_bound_gets_a_note() {
    let estimate = Estimate::new(&[trial(0.5, 1, Protocol::Default)], provenance()).unwrap();
    assert!(estimate.above_ceiling());
    assert!(estimate.notes[1].starts_with("the estimate 0.500 exceeds the object-entropy bound 0.450"));
}

#[test]
fn the_smallest_of_several_bounds_is_named() {
    let trials = [trial(0.5, 1, Protocol::Default)];
    let estimate = Estimate::with_bounds(&trials, Vec::new(), Vec::new(), provenance()).unwrap();
    assert_eq!(estimate.summary(), "at most 0.4500 bits per pixel [0.4500, 0.4500] (gaussian-full: entropy bound)");
    assert_eq!(Estimate::new(&trials, provenance()).unwrap().upper_from(), "gaussian-full");
}

#[test]
fn timed_trials_may_differ_in_patches() {
    let of = |estimator, patches_train, bits: f64| {
        let settings = TrialSettings { estimator, patches_train, ..*trial(0.5, 1, Protocol::Default).settings() };
        Trial::from_patches(settings, &[5.0 + bits; 3], &[5.0; 3], 0.5, Vec::new()).unwrap()
    };
    let live = [of(Estimator::Causal, 400, 0.4), of(Estimator::Causal, 404, 0.3)];
    let estimate = Estimate::new(&live, provenance()).unwrap();
    assert_eq!((estimate.trials, estimate.patches_train), (2, 404), "those of the smallest");
    let network = [of(Estimator::PixelCnn, 400, 0.4), of(Estimator::PixelCnn, 404, 0.3)];
    let what = "the number of patches";
    assert_eq!(Estimate::new(&network, provenance()), Err(InformationError::TrialsDiffer { what }));
}

#[test]
fn crossing_bounds_get_a_note() {
    let below = |bits: f64| {
        let bound =
            NamedBound { from: BoundMethod::Decoder, bits_per_pixel: bits, interval_95: [bits - 0.02, bits + 0.02] };
        Estimate::with_bounds(&[trial(0.5, 1, Protocol::Default)], Vec::new(), vec![bound], provenance()).unwrap()
    };
    assert_eq!(below(0.44).summary(), "between 0.4400 [0.4200, 0.4600] and 0.4500 [0.4500, 0.4500] bits per pixel");
    let crossed = below(0.46);
    assert_eq!(crossed.summary(), "between 0.4500 [0.4500, 0.4500] and 0.4600 [0.4400, 0.4800] bits per pixel");
    let warnings =
        |estimate: &Estimate| estimate.notes.iter().filter(|note| note.contains("within their intervals")).count();
    assert_eq!((warnings(&below(0.44)), warnings(&crossed)), (0, 1), "{:?}", crossed.notes);
    // Later lower bounds are not reported twice either.
    let bound = |bits: f64, half_width: f64| NamedBound {
        from: BoundMethod::Decoder,
        bits_per_pixel: bits,
        interval_95: [bits - half_width, bits + half_width],
    };
    assert_eq!([0.1, 0.46, 0.47].map(|bits| warnings(&below(0.44).with_lower_bound(bound(bits, 0.03)))), [0, 1, 1]);
    // Chance does not explain every crossing.
    let wrong = below(0.44).with_lower_bound(bound(0.46, 0.003));
    assert!(wrong.notes.iter().any(|note| note.contains("one of them is wrong")) && warnings(&wrong) == 0, "{wrong:?}");
    assert_eq!(warnings(&crossed.with_lower_bound(bound(0.47, 0.03))), 1);
    let none =
        Estimate::new(&[trial(-0.01, 1, Protocol::Default)], provenance()).unwrap().with_lower_bound(bound(0.0, 0.0));
    assert!(warnings(&none) == 1 && none.notes.iter().any(|note| note.contains("is negative")), "{:?}", none.notes);
}

#[test]
fn different_trials_are_not_mixed() {
    let mixed = [trial(0.5, 1, Protocol::Default), trial(0.4, 2, Protocol::Paper)];
    assert_eq!(Estimate::new(&mixed, provenance()), Err(InformationError::TrialsDiffer { what: "protocol" }));
    assert_eq!(Estimate::new(&[], provenance()), Err(InformationError::Empty));
}

#[test]
fn json_comes_back_and_starts_with_its_format() {
    let estimate = Estimate::new(&[trial(1.0 / 3.0, u64::MAX, Protocol::Paper)], provenance()).unwrap();
    let text = serde_json::to_string(&estimate).unwrap();
    assert!(text.starts_with("{\"format\":\"lenslet-studio/estimate\",\"format_version\":1,\"bits_per_pixel\":"));
    assert!(text.contains("\"estimator\":\"gaussian-full\"") && text.contains("\"protocol\":\"paper\""));
    assert_eq!(Estimate::from_json(&text).unwrap(), estimate);
    assert_eq!(serde_json::to_string(&estimate.estimator).unwrap(), format!("\"{}\"", estimate.estimator));
}

#[test]
fn engine_is_recorded_and_optional_in_old_files() {
    let engine: EngineChoice = "burn:ndarray".parse().unwrap();
    let trial = trial(0.3, 1, Protocol::Default);
    let bare = Estimate::new(std::slice::from_ref(&trial), provenance()).unwrap();
    let text = serde_json::to_string(&bare).unwrap();
    assert!(!text.contains("engine") && Estimate::from_json(&text).unwrap().engine.is_none());
    let named = Estimate::new(&[trial.clone().on_engine(engine)], provenance()).unwrap();
    let text = serde_json::to_string(&named).unwrap();
    assert!(text.contains("\"engine\":\"burn:ndarray\""), "{text}");
    assert_eq!(Estimate::from_json(&text).unwrap(), named);
    let unknown = text.replace("burn:ndarray", "abacus");
    assert!(Estimate::from_json(&unknown).unwrap_err().to_string().contains("abacus"));
    let mixed = [trial.clone(), trial.on_engine(engine)];
    assert_eq!(Estimate::new(&mixed, provenance()), Err(InformationError::TrialsDiffer { what: "engine" }));
}

#[test]
fn other_and_newer_formats_are_refused() {
    let estimate = Estimate::new(&[trial(0.3, 1, Protocol::Default)], provenance()).unwrap();
    let text = serde_json::to_string(&estimate).unwrap();
    let newer = text.replace("\"format_version\":1", "\"format_version\":9");
    let message = Estimate::from_json(&newer).unwrap_err().to_string();
    assert!(message.contains("version 9") && message.contains("newer Lenslet Studio"), "{message}");
    let other = text.replace("lenslet-studio/estimate", "lenslet-studio/project");
    assert!(Estimate::from_json(&other).unwrap_err().to_string().contains("lenslet-studio/project"));
    assert!(Estimate::from_json("[1, 2").is_err());
    assert!(Estimate::from_json("{\"format\":\"lenslet-studio/estimate\",\"format_version\":1}").is_err());
}
