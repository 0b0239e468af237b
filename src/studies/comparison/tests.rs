//! Resuming, refusing and tabulating, with estimates that cost nothing.

use std::cell::Cell;
use std::ops::ControlFlow;
use std::path::Path;

use crate::evaluation::{EstimateProgress, EstimateRequest, EvaluationError};
use crate::formats::FormatError;
use crate::forward::{Design, open_set};
use crate::information::{
    Estimate, Estimator, PairedDifference, Protocol, Provenance, TestPatches, Trial, TrialSettings,
};
use crate::optics::{Encoder, heuristic_layout};
use crate::progress::{CancelToken, Progress};
use crate::sensor::{Noise, SensorError};
use crate::studies::comparison::record::StudyRecord;
use crate::studies::comparison::run::{Study, StudyEvent};
use crate::studies::comparison::settings::{StudyDesign, StudyObjects, StudySettings};
use crate::studies::error::StudyError;

/// An estimate of this many bits per pixel.
pub(super) fn estimated(bits: f64, ceiling: Option<f64>) -> Estimate {
    let settings = TrialSettings {
        estimator: Estimator::Causal,
        protocol: Protocol::Default,
        noise: Noise::Shot,
        patch: (32, 32),
        patches_train: 0,
        seed: 1,
    };
    let around = [5.0 + bits, 5.01 + bits, 4.99 + bits];
    let trial = Trial::from_patches(settings, &around, &[5.0; 3], 2.0, Vec::new()).unwrap();
    Estimate::new(&[trial], Provenance { ceiling, ..Provenance::default() }).unwrap()
}

/// The same of the objects of a design, without test patches.
fn of(design: &Design, mut estimate: Estimate) -> (Estimate, TestPatches) {
    estimate.objects_fingerprint = open_set(design).unwrap().fingerprint();
    (estimate, TestPatches::default())
}

/// Two layouts imaging two kinds of beads.
fn four_cells() -> StudySettings {
    let beads = |text: &str| StudyObjects::new(text.parse().unwrap(), None);
    StudySettings {
        objects: vec![beads("beads:0.008"), beads("beads:0.02")],
        designs: vec![StudyDesign::heuristic(1), StudyDesign::heuristic(4)],
        ..StudySettings::grid()
    }
}

/// Runs a study whose every estimate is `bits`; returns how many were computed.
fn run(settings: StudySettings, folder: &Path, bits: f64) -> Result<usize, StudyError> {
    let computed = Cell::new(0);
    let mut study = Study::open(settings, folder)?;
    study.run_with(
        &|design, _, _| {
            computed.set(computed.get() + 1);
            Ok(of(design, estimated(bits, Some(0.3))))
        },
        &mut CancelToken::new(),
    )?;
    Ok(computed.get())
}

fn saved(folder: &Path) -> StudyRecord {
    StudyRecord::open(&folder.join("study.json")).unwrap()
}

#[test]
fn only_missing_cells_are_computed() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(run(four_cells(), folder.path(), 0.25).unwrap(), 4);
    assert_eq!(run(four_cells(), folder.path(), 0.5).unwrap(), 0);
    // A run that was killed after two cells.
    let mut record = saved(folder.path());
    record.cells.remove(1);
    record.cells.remove(2);
    record.save(&folder.path().join("study.json")).unwrap();
    assert_eq!(run(four_cells(), folder.path(), 0.5).unwrap(), 2);
    let record = saved(folder.path());
    let bits: Vec<f64> = record.cells.iter().map(|cell| (cell.bits_per_pixel().unwrap() * 100.0).round()).collect();
    assert_eq!(bits, [25.0, 50.0, 25.0, 50.0], "cells stand in the order of the settings");
    let names: Vec<String> = record.cells.iter().map(crate::studies::StudyCell::name).collect();
    assert_eq!(names[1], "beads:0.008, heuristic:4, 32 x 32 px");
    for name in ["study.json", "study.md", "study.csv"] {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
}

#[test]
fn a_study_that_is_stopped_keeps_its_finished_cells() {
    let folder = tempfile::tempdir().unwrap();
    let mut study = Study::open(four_cells(), folder.path()).unwrap();
    let mut steps = 0;
    let progress = EstimateProgress { step: "Fitting".into(), done: 0, total: 1, fit: None, understood: None };
    let stopped = study.run_with(
        &|design, _, receiver| match receiver.report(&progress) {
            ControlFlow::Continue(()) => Ok(of(design, estimated(0.25, None))),
            ControlFlow::Break(()) => Err(crate::information::InformationError::Cancelled.into()),
        },
        &mut |event: &StudyEvent<'_>| match event {
            StudyEvent::Step(step) => {
                steps += 1;
                assert_eq!((step.number, step.cells), (steps, 4));
                // A cell is expected to take its budget, and then what those before it took.
                let most = if step.number == 1 { 4.0 * 60.0 } else { 2.0 * (5 - step.number) as f64 };
                assert!(step.left.as_secs_f64() <= most && step.left.as_secs_f64() > most - 2.0, "{:?}", step.left);
                if step.number == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            }
            StudyEvent::Done { .. } => ControlFlow::Continue(()),
        },
    );
    assert!(matches!(stopped, Err(StudyError::Cancelled)));
    drop(study);
    assert_eq!(saved(folder.path()).cells.len(), 2);
    assert_eq!(run(four_cells(), folder.path(), 0.5).unwrap(), 2);
}

#[test]
fn a_cell_that_fails_is_recorded_and_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let fails = |design: &Design,
                 _: &EstimateRequest,
                 _: &mut (dyn Progress<EstimateProgress> + Send)|
     -> Result<_, EvaluationError> {
        if design.objects.to_string() == "beads:0.02" {
            return Err(SensorError::PatchTooLarge { patch_rows: 32, patch_cols: 32, rows: 5, cols: 5 }.into());
        }
        let mut endless = estimated(0.25, None);
        endless.interval_95[1] = f64::INFINITY;
        Ok(of(design, endless))
    };
    let mut study = Study::open(four_cells(), folder.path()).unwrap();
    study.run_with(&fails, &mut CancelToken::new()).unwrap();
    assert_eq!((study.missing(), study.record().summary.failed), (4, 4));
    let table = study.markdown();
    assert!(table.contains("failed: beads:0.02, heuristic:4, 32 x 32 px: "), "{table}");
    assert!(table.contains("not a finite number"), "{table}");
    drop(study);
    assert_eq!(run(four_cells(), folder.path(), 0.25).unwrap(), 4);
    assert_eq!(saved(folder.path()).summary.failed, 0);
}

#[test]
fn estimates_of_objects_that_changed_meanwhile_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let mut study = Study::open(four_cells(), folder.path()).unwrap();
    study.run_with(&|_, _, _| Ok((estimated(0.25, None), TestPatches::default())), &mut CancelToken::new()).unwrap();
    assert_eq!((study.missing(), study.record().summary.failed), (4, 4));
    assert!(study.markdown().contains("its objects changed while the study ran"));
    drop(study);
    assert_eq!(run(four_cells(), folder.path(), 0.25).unwrap(), 4);
    // Nor do those that are there.
    let mut record = saved(folder.path());
    record.cells[1].estimate.as_mut().unwrap().objects_fingerprint = "another".into();
    record.save(&folder.path().join("study.json")).unwrap();
    assert_eq!(run(four_cells(), folder.path(), 0.25).unwrap(), 1);
}

#[test]
fn another_study_in_the_folder_is_refused_by_the_setting_that_differs() {
    let folder = tempfile::tempdir().unwrap();
    run(four_cells(), folder.path(), 0.25).unwrap();
    let before = std::fs::read(folder.path().join("study.json")).unwrap();
    let refusal = |change: &dyn Fn(&mut StudySettings)| {
        let mut settings = four_cells();
        change(&mut settings);
        run(settings, folder.path(), 0.5).unwrap_err().to_string()
    };
    let mut moved = StudyDesign::heuristic(4);
    if let crate::optics::Encoder::Lenslets(array) = &mut moved.encoder {
        array.lenslets[0].x += 1.0;
    }
    for (message, part) in [
        (refusal(&|study| study.seed = 2), "seed 2, found one with 1"),
        (refusal(&|study| study.budget_seconds = Some(30.0)), "budget 30 s, found one with 60 s"),
        (refusal(&|study| study.noise = Noise::Read { sigma: 5.0 }), "noise read:5, found one with shot"),
        (refusal(&|study| study.designs.truncate(1)), "designs heuristic:1, found one with heuristic:1, heuristic:4"),
        (refusal(&|study| study.designs[1] = moved.clone()), "the masks"),
        (refusal(&|study| study.patches = vec![None]), "patches sensor"),
        (refusal(&|study| study.estimator = Estimator::PixelCnn), "estimator pixelcnn, found one with causal"),
        (refusal(&|study| study.bias_photons = 5.0), "background photons per pixel 5"),
    ] {
        assert!(
            message.contains(part) && message.contains("study.json") && message.contains("another folder"),
            "{message}"
        );
    }
    // Changed objects, and another version of the program.
    for (entry, value, part) in [
        ("fingerprint", "abc", "fingerprint"),
        ("program_version", "0.0.0-none", "of the program, found one by 0.0.0-none"),
    ] {
        let mut record = saved(folder.path());
        match entry {
            "fingerprint" => record.settings.objects[0].fingerprint = value.into(),
            _ => record.program_version = value.into(),
        }
        record.save(&folder.path().join("study.json")).unwrap();
        let message = run(four_cells(), folder.path(), 0.5).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
        std::fs::write(folder.path().join("study.json"), &before).unwrap();
    }
    assert_eq!(run(four_cells(), folder.path(), 0.5).unwrap(), 0);
}

#[test]
fn files_that_are_no_study_are_refused_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    run(four_cells(), folder.path(), 0.25).unwrap();
    let path = folder.path().join("study.json");
    let whole = std::fs::read_to_string(&path).unwrap();
    for (text, part) in [
        (whole[..whole.len() / 2].to_owned(), "line "),
        ("{}".into(), "no format entry"),
        (whole.replace("lenslet-studio/study", "lenslet-studio/design"), "lenslet-studio/design"),
        (whole.replacen("\"format_version\": 1", "\"format_version\": 9", 1), "newer Lenslet Studio"),
        (whole.replacen("\"kind\": \"grid\"", "\"kind\": \"grill\"", 1), "grill"),
    ] {
        std::fs::write(&path, &text).unwrap();
        let message = run(four_cells(), folder.path(), 0.5).unwrap_err().to_string();
        assert!(message.contains(part) && message.contains("study.json"), "{part} in {message}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text, "what is not understood is not overwritten");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn two_runs_do_not_share_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let study = Study::open(four_cells(), folder.path()).unwrap();
    assert!(matches!(Study::open(four_cells(), folder.path()), Err(StudyError::File(FormatError::Busy { .. }))));
    drop(study);
    assert!(Study::open(four_cells(), folder.path()).is_ok());
}

#[test]
fn estimates_are_compared_with_published_ones() {
    let folder = tempfile::tempdir().unwrap();
    let mut study = Study::open(four_cells(), folder.path()).unwrap();
    // Published: 0.13, 0.3138 (density 0.008) and 0.267, 0.5801 (0.02). Above by 0.01, 0.003 and 0.3, below by 0.08.
    let bits = |design: &Design| match (design.objects.to_string().as_str(), design.encoder.describe().as_str()) {
        ("beads:0.008", "1 lenslet") => 0.14,
        ("beads:0.008", _) => 0.3168,
        (_, "1 lenslet") => 0.567,
        _ => 0.5,
    };
    study
        .run_with(&|design, _, _| Ok(of(design, estimated(bits(design), Some(0.4)))), &mut CancelToken::new())
        .unwrap();
    let summary = &study.record().summary;
    let within: Vec<usize> = summary.within_published.iter().map(|row| row.within).collect();
    assert_eq!((within, summary.within_published[0].compared), (vec![3, 2, 1], 4));
    assert_eq!(summary.within_published[1].share, 0.5);
    let ranks: Vec<f64> = summary.rank_correlations.iter().map(|row| row.spearman).collect();
    assert_eq!((ranks, summary.above_ceiling), (vec![1.0, -1.0], 2));
    let text = study.markdown();
    for part in [
        "| beads:0.008 | heuristic:1 | 32 x 32 px | 0.1400 (",
        "| - | - | 0.1400 | - | 0.4000 | 0.1300 (0.1185 to 0.1418) | +0.0100 | 2.0 |",
        "- 3 of 4 estimates (75 %) at most the published value + 0.02 bits per pixel, 3 by the density model alone",
        "- beads:0.02: rank correlation with the published order of 2 designs -1.00",
        "- 2 of 4 estimates above the entropy bound",
        "- computed on ",
        "Estimator causal, 60 s for each cell; shot noise",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let table = std::fs::read_to_string(folder.path().join("study.csv")).unwrap();
    let columns: Vec<&str> = table.lines().next().unwrap().split(',').collect();
    let row: Vec<&str> = table.lines().nth(1).unwrap().split(',').collect();
    let at = |name: &str| row[columns.iter().position(|&column| column == name).unwrap()];
    assert_eq!((at("objects"), at("density_beads_per_px"), at("lenslets")), ("beads:0.008", "0.008", "1"));
    assert_eq!((at("published_bits_per_px"), at("patch_rows_px"), at("failure")), ("0.13", "32", ""));
    assert!((at("bits_per_px").parse::<f64>().unwrap() - 0.14).abs() < 1e-9);
}

#[test]
fn designs_are_compared_with_the_first_on_the_same_patches() {
    let folder = tempfile::tempdir().unwrap();
    let mut wide = heuristic_layout(2);
    wide.cols = 40;
    let mut settings = four_cells();
    settings.objects.truncate(1);
    settings.designs.push(StudyDesign { name: "wide".into(), encoder: Encoder::Lenslets(wide) });
    // The differences between scenes are the same for all masks.
    let information = |design: &Design| {
        let more = if design.encoder.describe() == "1 lenslet" { 0.0 } else { -0.1 };
        (0..50).map(|patch| 0.3 + more + 0.01 * f64::from(patch) + 1e-4 * more * f64::from(patch % 2)).collect()
    };
    let compute = |design: &Design, _: &EstimateRequest, _: &mut (dyn Progress<EstimateProgress> + Send)| {
        let (estimate, _) = of(design, estimated(0.25, None));
        Ok((estimate, TestPatches { information: information(design), ..TestPatches::default() }))
    };
    let mut study = Study::open(settings.clone(), folder.path()).unwrap();
    let stopped = study.run_with(&compute, &mut |event: &StudyEvent<'_>| match event {
        StudyEvent::Done { .. } => ControlFlow::Break(()),
        StudyEvent::Step(_) => ControlFlow::Continue(()),
    });
    assert!(matches!(stopped, Err(StudyError::Cancelled)));
    drop(study);
    // A resumed study knows the patch information of the first design.
    let mut study = Study::open(settings, folder.path()).unwrap();
    study.run_with(&compute, &mut CancelToken::new()).unwrap();
    let [first, second, wide] = study.record().cells.as_slice() else { panic!("three cells") };
    assert_eq!(
        (first.patch_information.len(), first.difference_to_reference, second.patch_information.len()),
        (50, None, 0)
    );
    let PairedDifference { bits_per_pixel, interval_95: [low, high] } = second.difference_to_reference.unwrap();
    assert!((bits_per_pixel - 0.100_005).abs() < 1e-9 && low > 0.1 && high < 0.10001, "{low} to {high}");
    assert_eq!(wide.difference_to_reference, None, "its patches are others");
    assert!(study.markdown().contains("| +0.1000 (+0.1000 to +0.1000) |"), "{}", study.markdown());
    let table = std::fs::read_to_string(folder.path().join("study.csv")).unwrap();
    assert!(table.lines().nth(2).unwrap().contains(&format!(",{bits_per_pixel:?},{low:?},{high:?},")), "{table}");
    assert_eq!(&saved(folder.path()), study.record());
}
