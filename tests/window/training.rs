//! Training of a network in the Reconstruction panel, its files, and edits while it is used. Budgets are steps.

use std::path::Path;
use std::sync::Arc;

use egui::{Key, Modifiers, Role};
use egui_kittest::kittest::Queryable;
use lenslet_studio::formats::write_array;
use lenslet_studio::forward::{Design, ForwardModel};
use lenslet_studio::information::Protocol;
use lenslet_studio::objects::ObjectSource;
use lenslet_studio::optics::{Encoder, Lenslet, LensletArray};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::reconstruction::{DecoderKind, DecoderScene, NetworkTraining, TrainingBudget, TrainingMasks};
use lenslet_studio::workbench::{NetworkFit, Reconstruction, Training, TrainingStatus, weights_beside};
use ndarray::Array3;

use super::home::{after_a_power_cut, keep_data_of};
use super::waiting::wait_for;
use super::work::copied;
use super::{Window, answer, click, close, menu, open, settle, studio, type_number};

/// Small whole images of one bright bar each, which a linear estimate cannot know, before a small mask.
fn small_design(folder: &Path) -> Design {
    let path = folder.join("bars.npy");
    let bars = Array3::from_shape_fn((40, 24, 24), |(image, row, col)| {
        let place = if image % 2 == 0 { row } else { col };
        if (place + image / 2) % 12 < 2 { 200.0_f32 } else { 0.0 }
    });
    write_array(&path, bars.view().into_dyn()).unwrap();
    let lenslets = vec![Lenslet::round(2.0, 3.0, 0.8, 0.6), Lenslet::round(6.0, 5.0, 0.8, 0.4)];
    let encoder = Encoder::Lenslets(LensletArray::new(9, 9, lenslets));
    Design { objects: ObjectSource::Stack(path), encoder, ..Design::default() }
}

/// Chooses the method, and a budget of steps.
fn choose_steps(window: &mut Window, steps: usize) {
    click(window, "Reconstruction method");
    click(window, "Trained network");
    // The report above may change while the reconstruction is computed, and with it the place of these fields.
    for name in ["Unit of the training budget", "steps"] {
        window.get_by_label(name).click_accesskit();
        window.run_steps(8);
    }
    type_number(window, "Training budget", &steps.to_string());
}

/// The newest reconstruction of the open design, once it is shown.
fn shown(window: &mut Window) -> Arc<Reconstruction> {
    let newest = |window: &Window| {
        let session = studio(window).session();
        let shown = session.reconstructions().shown?;
        let networks = session.trainings().networks.serial();
        let key = (shown.key.revision, shown.key.decoder, shown.key.networks);
        (key == (session.revision(), DecoderKind::Network, networks)).then_some(shown)
    };
    wait_for(window, "the reconstruction", |window| newest(window).is_some());
    newest(window).unwrap()
}

fn training(window: &Window) -> Training {
    studio(window).session().trainings().newest.expect("one was started")
}

/// Starts a training and waits for its end.
fn train(window: &mut Window) {
    click(window, "Train");
    wait_for(window, "the end of the training", |window| !training(window).is_active());
    assert_eq!(training(window).status, TrainingStatus::Done);
}

fn is_stale(shown: &Reconstruction) -> bool {
    matches!(shown.network, Some(NetworkFit::OtherMask)) && shown.decoder() == DecoderKind::Linear
}

fn is_current(shown: &Reconstruction) -> bool {
    matches!(shown.network, Some(NetworkFit::Current(_))) && shown.decoder() == DecoderKind::Network
}

fn shows(window: &Window, text: &str) -> bool {
    window.query_all_by_label_contains(text).next().is_some()
}

fn edit(window: &mut Window) {
    let before = studio(window).session().revision();
    click(window, "Add lenslet");
    assert_ne!(studio(window).session().revision(), before);
}

fn undo(window: &mut Window) {
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    window.run_steps(4);
}

#[test]
fn trained_network_is_used_at_once_stale_after_an_edit_and_current_after_its_undo() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(small_design(folder.path()));
    choose_steps(&mut window, 60);
    let linear = shown(&mut window);
    assert!(linear.decoder() == DecoderKind::Linear && shows(&window, "Not trained yet: the linear estimate is shown"));
    click(&mut window, "Train");
    window.get_by_label("Stop training");
    window.get_by_label("Training loss");
    wait_for(&mut window, "the end of the training", |window| !training(window).is_active());
    let end = training(&window);
    assert_eq!((&end.status, end.steps, end.validations.len()), (&TrainingStatus::Done, 60, 1));
    assert_eq!(end.losses.iter().map(|point| point.steps).collect::<Vec<_>>(), (1..=60).collect::<Vec<_>>());
    let network = shown(&mut window);
    assert!(is_current(&network) && network.object != linear.object);
    assert!(network.quality.unwrap().psnr_db() > linear.quality.unwrap().psnr_db() + 1.0);
    assert!(shows(&window, "Validation, this mask: "));
    click(&mut window, "Show training curves");
    window.get_by_label("Training loss");
    click(&mut window, "PSNR");
    window.get_by_label("Validation PSNR");
    click(&mut window, "Show training curves");
    window.get_by_role_and_label(Role::Image, "Reconstruction");
    edit(&mut window);
    assert!(is_stale(&shown(&mut window)) && shows(&window, "Stale, of another mask: linear estimate shown"));
    undo(&mut window);
    assert_eq!(shown(&mut window).object, network.object);
    close(&mut window);
    window.get_by_label("A trained network is in no file. Save the design or export the weights.");
    click(&mut window, "Cancel");
    assert!(shows(&window, "Validation, this mask: "));
}

#[test]
fn trained_network_in_no_file_is_offered_after_a_power_cut() {
    let (folder, home) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut window = keep_data_of(open(small_design(folder.path())), home.path());
    choose_steps(&mut window, 60);
    train(&mut window);
    let object = shown(&mut window).object.clone();
    let is_network = |file: std::io::Result<std::fs::DirEntry>| {
        file.unwrap().file_name().to_string_lossy().ends_with(".network.safetensors")
    };
    wait_for(&mut window, "the autosave", |_| std::fs::read_dir(home.path().join("unsaved")).unwrap().any(is_network));
    let later = after_a_power_cut(home.path());
    let mut window = keep_data_of(open(Design::default()), later.path());
    assert!(shows(&window, "60 steps"), "the dialog names the network");
    click(&mut window, "Recover");
    settle(&mut window);
    click(&mut window, "Reconstruction method");
    click(&mut window, "Trained network");
    let recovered = shown(&mut window);
    assert!(is_current(&recovered) && recovered.object == object);
    assert!(studio(&window).session().has_unsaved_network());
}

#[test]
fn network_for_any_mask_stays_current_after_an_edit_and_is_stale_for_another_light() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(small_design(folder.path()));
    choose_steps(&mut window, 2);
    click(&mut window, "Masks of the network");
    click(&mut window, "any mask");
    train(&mut window);
    edit(&mut window);
    assert!(is_current(&shown(&mut window)));
    type_number(&mut window, "Background photons", "3");
    let other = shown(&mut window);
    assert!(matches!(other.network, Some(NetworkFit::OtherScene)) && other.decoder() == DecoderKind::Linear);
    assert!(shows(&window, "Stale, of another scene: linear estimate shown"));
}

#[test]
fn training_is_paused_edited_meanwhile_and_stopped_with_its_best_weights() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(small_design(folder.path()));
    choose_steps(&mut window, 1_000_000);
    click(&mut window, "Train");
    wait_for(&mut window, "a validation", |window| training(window).best.is_some());
    click(&mut window, "Pause training");
    assert_eq!(training(&window).status, TrainingStatus::Paused);
    assert!(shows(&window, "Paused at step"));
    close(&mut window);
    window.get_by_label("A network is training. Stop it to keep its weights.");
    click(&mut window, "Cancel");
    edit(&mut window);
    assert_ne!(training(&window).order.design, *studio(&window).session().design(), "it has a copy");
    undo(&mut window);
    click(&mut window, "Resume training");
    assert_eq!(training(&window).status, TrainingStatus::Running);
    let activity =
        studio(&window).session().activities().into_iter().find(|activity| activity.name.starts_with("Train"));
    menu(&mut window, &["View", "Jobs"]);
    click(&mut window, &format!("Stop job {}", activity.unwrap().number));
    assert_eq!(training(&window).status, TrainingStatus::Stopped, "at once");
    let best = training(&window).best.unwrap();
    let shown = shown(&mut window);
    assert!(matches!(&shown.network, Some(NetworkFit::Current(network)) if Arc::ptr_eq(network, &best)));
}

#[test]
fn weights_are_exported_opened_and_refused_for_another_mask() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(small_design(folder.path()));
    choose_steps(&mut window, 2);
    train(&mut window);
    let network = shown(&mut window);
    click(&mut window, "More of the reconstruction");
    click(&mut window, "Export weights...");
    let weights = folder.path().join("net.safetensors");
    answer(&mut window, &weights, "Export");
    assert!(weights.is_file());
    click(&mut window, "More of the reconstruction");
    let line = copied(&mut window, "Copy command line");
    assert!(line.contains(&format!(" --decoder network --weights {} --test ", weights.display())), "{line}");
    // Steps give the weights of the library.
    let design = small_design(folder.path());
    let forward = ForwardModel::open(&design).unwrap();
    let scene = DecoderScene::new(&forward, Protocol::Default).unwrap();
    let masks = TrainingMasks::One(scene.model(forward.psf(&design).unwrap().view()).unwrap());
    let (order, cancel) = (NetworkTraining { budget: TrainingBudget::Steps(2), seed: design.seed }, CancelToken::new());
    let expected = order.train(&scene, &masks, None, None, &cancel, &mut cancel.clone()).unwrap();
    let NetworkFit::Current(network_of_window) = network.network.as_ref().unwrap() else { panic!("it is current") };
    assert_eq!(network_of_window.training.psnr_db, expected.training.psnr_db);
    assert_eq!(network_of_window.training.curve[0].psnr_db, expected.training.curve[0].psnr_db);

    let mut window = open(small_design(folder.path()));
    click(&mut window, "Reconstruction method");
    click(&mut window, "Trained network");
    let open_weights = |window: &mut Window, path: &Path| {
        click(window, "More of the reconstruction");
        click(window, "Open weights...");
        answer(window, path, "Open");
    };
    open_weights(&mut window, &weights);
    let opened = shown(&mut window);
    assert!(is_current(&opened) && opened.object == network.object);
    edit(&mut window);
    settle(&mut window);
    open_weights(&mut window, &weights);
    assert!(shows(&window, "net.safetensors: network: expected the mask that it was trained for, found another"));
    std::fs::write(&weights, b"no weights").unwrap();
    open_weights(&mut window, &weights);
    assert!(shows(&window, "net.safetensors: these are not weights"), "one sentence with the file");
    assert!(is_stale(&shown(&mut window)), "the first ones are still there");
}

#[test]
fn weights_are_saved_beside_the_design_and_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mask.lenslet.json");
    let mut window = open(small_design(folder.path()));
    choose_steps(&mut window, 2);
    train(&mut window);
    let network = shown(&mut window);
    menu(&mut window, &["File", "Save design as..."]);
    answer(&mut window, &path, "Save");
    let weights = weights_beside(&path);
    assert_eq!(weights, folder.path().join("mask.lenslet.network.safetensors"));
    assert!(weights.is_file() && shows(&window, "mask.lenslet.network.safetensors"));

    let mut window = open(Design::default());
    menu(&mut window, &["File", "Open design..."]);
    answer(&mut window, &path, "Open");
    settle(&mut window);
    click(&mut window, "Reconstruction method");
    click(&mut window, "Trained network");
    let found = shown(&mut window);
    assert!(is_current(&found) && found.object == network.object);

    // A broken file beside the design says so, and the design opens.
    std::fs::write(&weights, b"no weights").unwrap();
    menu(&mut window, &["File", "Open design..."]);
    answer(&mut window, &path, "Open");
    settle(&mut window);
    assert!(shows(&window, "mask.lenslet.network.safetensors: these are not weights"));
    assert_eq!(studio(&window).session().path(), Some(&*path));
}
