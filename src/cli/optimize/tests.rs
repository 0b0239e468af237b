//! Tests of the command `optimize`.

use super::*;
use crate::information::Estimator;
use crate::objects::ObjectSource;
use crate::progress::CancelToken;
use crate::sensor::Noise;
use crate::studies::{StudyDesign, StudyKind, StudyObjects};

#[test]
fn comparison_of_another_result_is_renamed() {
    let run = tempfile::tempdir().unwrap();
    let settings = |lenslets| StudySettings {
        kind: StudyKind::Grid,
        objects: vec![StudyObjects::new(ObjectSource::Beads { density: 0.05 }, None)],
        designs: vec![StudyDesign::heuristic(lenslets)],
        patches: vec![Some((4, 4))],
        estimator: Estimator::GaussianStationary,
        budget_seconds: None,
        patches_train: 60,
        patches_test: 20,
        fresh: false,
        noise: Noise::Shot,
        mean_photons: 100.0,
        bias_photons: 10.0,
        seed: 1,
        field: (96, 96),
        placement: crate::objects::Placement::Scaled,
    };
    let score = |lenslets| {
        let mut study = open_score(settings(lenslets), run.path()).unwrap();
        study.run(&mut CancelToken::new()).unwrap();
        study.record().clone()
    };
    let names = || {
        let folders = std::fs::read_dir(run.path()).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<String> = folders.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    };
    let first = score(2);
    assert_eq!((score(2), names()), (first, vec!["score".to_owned()]), "it is the same comparison");
    score(3);
    score(4);
    assert_eq!(names(), ["score", "score-1", "score-2"]);
    let kept = std::fs::read_to_string(run.path().join("score-1/study.json")).unwrap();
    assert!(kept.contains("heuristic:2"), "the earliest is the first");
    // A damaged comparison is renamed as well.
    std::fs::write(run.path().join("score/study.json"), "{").unwrap();
    score(4);
    assert_eq!(names(), ["score", "score-1", "score-2", "score-3"]);
}

#[test]
fn free_parameters_are_read_by_name() {
    let free: FreeChoice = "positions, weights".parse().unwrap();
    assert_eq!(free.0, Free { positions: true, widths: false, weights: true });
    assert!("all".parse::<FreeChoice>().is_err() && "".parse::<FreeChoice>().is_err());
}
