//! Application data of earlier versions open in the window; those of the present version are written on request.

use std::path::{Path, PathBuf};

use egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;

use super::home::at_home;
use super::waiting::wait_for;
use super::{click, lenslets, menu, settle, studio, type_number};

/// Copies files, but no locks.
fn copy_files(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let (name, copy) = (path.file_name().unwrap().to_string_lossy(), to.join(path.file_name().unwrap()));
        match path.is_dir() {
            true => copy_files(&path, &copy),
            false if name.ends_with("lock") => {}
            false => std::fs::copy(&path, &copy).map(drop).unwrap(),
        }
    }
}

#[test]
fn application_data_of_earlier_versions_open() {
    for version in ["window-v0", "window-v1"] {
        let folder = tempfile::tempdir().unwrap();
        copy_files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden").join(version), folder.path());
        let mut window = at_home(folder.path());
        // Unsaved changes, a run, snapshots, and all estimates: finished, in progress, and waiting.
        click(&mut window, "Recover");
        assert_eq!(lenslets(&window).len(), 1, "{version}");
        let run = studio(&window).session().run().expect("the interrupted run");
        assert!(run.checkpoints.len() >= 2, "{version}");
        menu(&mut window, &["View", "Panel", "Show Compare"]);
        assert!(window.query_by_label("More of snapshot 2").is_some(), "{version}");
        wait_for(&mut window, "the estimates", |window| {
            let estimates = studio(window).session().estimates();
            estimates.finished.len() == 1 && estimates.running.is_some()
        });
        assert!(folder.path().join("estimates/waiting").exists(), "{version}");
        // The layout was stored with a place for every panel.
        let layout = std::fs::read_to_string(folder.path().join("layout.json")).unwrap();
        assert!(layout.contains("Compare"), "{version}");
    }
}

#[test]
fn a_comparison_of_an_earlier_version_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden/comparison-v1.json");
    std::fs::copy(golden, folder.path().join("comparison.json")).unwrap();
    let mut window = at_home(folder.path());
    click(&mut window, "Camera");
    click(&mut window, "Show comparison");
    let found = studio(&window).session().cameras().comparison.expect("the comparison");
    assert!(found.own.systems.len() == 2 && found.equal.is_some());
    assert!(window.query_all_by_label_contains("lens.npy less diffuser.npy").next().is_some());
}

/// Run it once for each new version of a file, with `LENSLET_GOLDEN` set to a new folder of `tests/data/golden`.
#[test]
#[ignore = "writes golden files of the present version to the folder LENSLET_GOLDEN, if that is set"]
fn golden_files_of_the_present_version_are_written() {
    let Some(target) = std::env::var_os("LENSLET_GOLDEN").map(PathBuf::from) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    menu(&mut window, &["Presets", "Heuristic lenslets", "1 lenslet"]);
    menu(&mut window, &["View", "Panel", "Show Compare"]);
    for _ in 0..2 {
        click(&mut window, "Take snapshot");
        settle(&mut window);
    }
    window.key_press_modifiers(Modifiers::COMMAND | Modifiers::SHIFT, Key::Num1);
    window.run_steps(4);

    // A run that waits.
    for name in ["Optimize", "Details", "16 px", "Start run"] {
        click(&mut window, name);
    }
    wait_for(&mut window, "a refit", |window| {
        studio(window).session().run().is_some_and(|run| run.checkpoints.len() >= 2)
    });
    click(&mut window, "Pause run");
    wait_for(&mut window, "its state", |_| folder.path().join("run/run.safetensors").exists());

    // A finished estimate; a bracket in progress; an estimate that waits for it.
    click(&mut window, "Estimates");
    click(&mut window, "Estimator");
    click(&mut window, "Causal model");
    type_number(&mut window, "Steps of the fit", "20");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "the estimate", |window| !studio(window).session().estimates().finished.is_empty());
    click(&mut window, "Estimator");
    click(&mut window, "Bracket");
    click(&mut window, "Length of the fit");
    click(&mut window, "min");
    type_number(&mut window, "Minutes of the fit", "0.1");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "a fit", |window| window.query_by_label_contains("Fitting").is_some());
    click(&mut window, "Start estimate");
    wait_for(&mut window, "the order", |_| folder.path().join("estimates/waiting").exists());
    wait_for(&mut window, "trial and decoder", |window| {
        window.query_by_label_contains("Annealed importance sampling").is_some()
    });
    // A power cut, but for the layout, which is written when the window closes.
    copy_files(folder.path(), &target);
    drop(window);
    std::fs::copy(folder.path().join("layout.json"), target.join("layout.json")).unwrap();
}
