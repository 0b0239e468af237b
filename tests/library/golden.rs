//! Files written by earlier versions of the program: each of them opens.
//!
//! `tests/data/golden` holds one file of every kind and version. Its name ends with the format version; version 0 is that
//! of kinds without one at first. A file of this folder is never changed: a new version gets a new file.

use std::fs::File;
use std::io::Read;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use lenslet_studio::design::{IdealProgress, Objective};
use lenslet_studio::evaluation::EvaluationError;
use lenslet_studio::forward::Design;
use lenslet_studio::information::{Estimate, PixelCnn};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::studies::StudyRecord;
use lenslet_studio::workbench::{Record, RunStore, Session, Snapshots, StoredRun, run_ideal};

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden").join(name)
}

fn unpacked(name: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(File::open(golden(name)).unwrap()).read_to_end(&mut bytes).unwrap();
    bytes
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let (entry, kind) = entry.map(|entry| (entry.path(), entry.file_type().unwrap())).unwrap();
        let copy = to.join(entry.file_name().unwrap());
        if kind.is_dir() { copy_folder(&entry, &copy) } else { std::fs::copy(&entry, &copy).map(drop).unwrap() }
    }
}

/// A copy of a golden folder that the program may write to.
fn copied(name: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    copy_folder(&golden(name), folder.path());
    folder
}

#[test]
fn designs_open() {
    for name in [
        "design-v1",
        "design-v1-diffuser",
        "design-v1-picture",
        "design-v1-volume",
        "design-v2-throughput",
        "design-v2-diffuser",
        "design-v3-field",
        "design-v3-diffuser",
    ] {
        Design::open(&golden("..").join(name).with_extension("json")).unwrap();
    }
}

#[test]
fn estimates_open() {
    let mut opened = 0;
    for entry in std::fs::read_dir(golden("")).unwrap() {
        let path = entry.unwrap().path();
        if path.file_name().unwrap().to_string_lossy().starts_with("estimate-v") {
            let estimate = Estimate::from_json(&std::fs::read_to_string(&path).unwrap()).unwrap();
            assert!(estimate.bits_per_pixel.is_finite() && estimate.trials >= 1, "{}", path.display());
            opened += 1;
        }
    }
    assert!(opened >= 7);
}

#[test]
fn records_of_runs_and_live_estimates_open() {
    for (name, objective) in [
        ("v1-density", Objective::Density),
        ("v1-posterior", Objective::Posterior),
        ("v2-throughput", Objective::Density),
    ] {
        let Record::Run(run) = Record::open(&golden(&format!("run-{name}.json"))).unwrap() else {
            panic!("another record");
        };
        assert!(run.finished && run.settings.objective == objective && run.parts().is_ok());
        assert_eq!(run.result.throughput() < 1.0, name == "v2-throughput");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.json");
    std::fs::write(&path, unpacked("live-estimate-v1.json.gz")).unwrap();
    let Record::Live(live) = Record::open(&path).unwrap() else { panic!("another record") };
    assert!(live.steps() == 15 && live.numbers.lower.is_some());
}

#[test]
fn studies_open() {
    let study = StudyRecord::open(&golden("study-v1.json")).unwrap();
    assert!(study.cells.iter().all(|cell| cell.lower().is_some() && cell.bits_per_pixel().is_some()));
    assert!(study.cells.iter().any(|cell| !cell.patch_information.is_empty()));
    assert!(study.cells.iter().any(|cell| cell.difference_to_reference.is_some()));
}

#[test]
fn weights_open() {
    PixelCnn::from_bytes(&unpacked("pixelcnn-v1.safetensors.gz")).unwrap();
}

/// A run is resumed from its own state. A state of another run would be refused.
#[test]
fn runs_are_resumed() {
    for (name, at) in [("window-v0/run", 0), ("starts-v0", 1), ("window-v1/run", 0), ("starts-v1", 1)] {
        let folder = copied(name);
        let run = RunStore::in_folder(folder.path()).unwrap();
        let StoredRun { queue: order, states } = run.last().unwrap();
        assert_eq!(order.at, at);
        let state = match states[at].clone() {
            Some(state) => state,
            // The command line gives each start a separate folder.
            None => std::fs::read(folder.path().join("start-2/run.safetensors")).unwrap(),
        };
        assert_eq!(order.ranked.len(), at);
        let mut resumed = false;
        let mut on_progress = |_: &IdealProgress<'_>| {
            resumed = true;
            ControlFlow::Break(())
        };
        let from = Some(&state[..]);
        let design = &order.starts[at].design;
        let ended =
            run_ideal(design, &order.settings, from, &mut CancelToken::new(), &mut |_| Ok(()), &mut on_progress);
        assert!(ended.as_ref().is_err_and(EvaluationError::is_cancelled) && resumed, "{name}: {ended:?}");
    }
}

#[test]
fn unsaved_designs_and_snapshots_open() {
    for (name, throughput) in [("window-v0", 1.0), ("window-v1", 1.0), ("window-v2", 0.5)] {
        let folder = copied(name);
        let unsaved = Session::left_unsaved_in(&folder.path().join("unsaved"));
        assert_eq!(unsaved.len(), 1, "{name}");
        assert_eq!(unsaved[0].design.encoder.lenslets().unwrap().lenslets.len(), 1);
        let found = Snapshots::read(&folder.path().join("kept")).unwrap();
        assert_eq!((found.snapshots.entries.len(), found.unreadable, found.unlisted), (2, 0, 0), "{name}");
        assert!(found.snapshots.entries.iter().all(|snapshot| snapshot.numbers.ceiling.is_some()));
        let snapshots = found.snapshots.entries.iter().map(|snapshot| &snapshot.design.encoder);
        for encoder in snapshots.chain([&unsaved[0].design.encoder]) {
            assert_eq!(encoder.throughput(), throughput, "{name}");
        }
    }
}
