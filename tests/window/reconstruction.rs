//! The Reconstruction panel.

use std::sync::Arc;

use egui::{Role, Vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::{Design, ForwardModel};
use lenslet_studio::information::Protocol;
use lenslet_studio::progress::CancelToken;
use lenslet_studio::reconstruction::{DecoderKind, DecoderScene, ImageQuality};
use lenslet_studio::workbench::Reconstruction;
use ndarray::Axis;

use super::waiting::wait_for;
use super::{Window, click, menu, open, open_sized, settle, studio};

/// The complete reconstruction of the open design by a decoder, once it is shown.
fn reconstruction_by(window: &mut Window, decoder: DecoderKind) -> Arc<Reconstruction> {
    let newest = |window: &Window| {
        let shown = studio(window).session().reconstructions().shown?;
        let is_newest = (shown.key.revision, shown.key.decoder) == (studio(window).session().revision(), decoder);
        (is_newest && shown.iterations.is_none()).then_some(shown)
    };
    wait_for(window, "the reconstruction", |window| newest(window).is_some());
    newest(window).unwrap()
}

fn shows(window: &Window, text: &str) -> bool {
    window.query_all_by_label_contains(text).next().is_some()
}

fn psnr_text(shown: &Reconstruction) -> String {
    format!("This image: PSNR {:.2} dB", shown.quality.unwrap().psnr_db())
}

#[test]
fn reconstruction_and_its_quality_are_those_of_the_library() {
    let mut window = open(Design::default());
    let shown = reconstruction_by(&mut window, DecoderKind::Linear);
    window.get_by_role_and_label(Role::Image, "Reconstruction");

    let design = Design::default();
    let forward = ForwardModel::open(&design).unwrap();
    let scene = DecoderScene::new(&forward, Protocol::Default).unwrap();
    let model = scene.model(forward.psf(&design).unwrap().view()).unwrap();
    let prior = Arc::new(scene.prior(&CancelToken::new()).unwrap());
    let decoder = DecoderKind::Linear.decoder(Some(prior), None).unwrap().prepare(&model, &CancelToken::new()).unwrap();
    let measurements = studio(&window).session().live().measurements.unwrap();
    let measurement = measurements.value.noisy.index_axis(Axis(0), 0);
    let object = decoder.reconstruct_one(measurement, &mut CancelToken::new()).unwrap();
    assert_eq!(*shown.object, object);
    let peak = scene.set.peak();
    let [truth, estimate] = [&*shown.truth, &object].map(|image| image.mapv(|value| (f64::from(value) / peak) as f32));
    let quality = ImageQuality::of(truth.view(), estimate.view()).unwrap();
    assert_eq!(shown.quality, Some(quality));
    assert!(shows(&window, &psnr_text(&shown)));
    assert_eq!((shown.seen.corner, shown.seen.shape), (model.sensor_corner(), (65, 65)));
    let image = window.get_by_role_and_label(Role::Image, "Reconstruction").value().unwrap();
    assert!(image.ends_with("outlined rows 15 to 79, columns 15 to 79"), "{image}");
}

#[test]
fn methods_and_error_are_chosen_by_name() {
    let mut window = open(Design::default());
    let linear = reconstruction_by(&mut window, DecoderKind::Linear);
    click(&mut window, "Reconstruction method");
    click(&mut window, "Richardson-Lucy");
    let other = reconstruction_by(&mut window, DecoderKind::RichardsonLucy);
    assert_ne!(linear.object, other.object);
    assert!(shows(&window, &psnr_text(&other)) && !shows(&window, &psnr_text(&linear)));
    click(&mut window, "Show reconstruction error");
    window.get_by_role_and_label(Role::Image, "Reconstruction error");
    let uncertainty = window.get_by_label("Show reconstruction uncertainty");
    assert!(uncertainty.accesskit_node().is_disabled(), "this method has no posterior");
    click(&mut window, "Show reconstruction error");
    window.get_by_role_and_label(Role::Image, "Reconstruction");
    // Another sample, and the same one without noise.
    click(&mut window, "Next measurement");
    wait_for(&mut window, "the next sample", |window| {
        let shown = studio(window).session().reconstructions().shown.unwrap();
        shown.key.sample == 1 && shown.iterations.is_none()
    });
    window.get_by_role_and_label(Role::CheckBox, "Noise").click();
    window.run_steps(2);
    wait_for(&mut window, "the noiseless sample", |window| {
        let shown = studio(window).session().reconstructions().shown.unwrap();
        !shown.key.noisy && shown.iterations.is_none()
    });
}

#[test]
fn reconstruction_is_stale_after_an_edit_and_then_current() {
    let mut window = open(Design::default());
    let before = reconstruction_by(&mut window, DecoderKind::Linear);
    assert!(!shows(&window, "of an earlier edit"));
    window.get_by_label("Add lenslet").click();
    while studio(&window).session().revision() == before.key.revision {
        window.step();
    }
    assert!(shows(&window, "of an earlier edit"), "in the frame of the edit itself");
    let after = reconstruction_by(&mut window, DecoderKind::Linear);
    assert!(after.serial > before.serial && after.object != before.object);
    assert!(shows(&window, &psnr_text(&after)) && !shows(&window, "of an earlier edit"));
}

#[test]
fn objects_with_depth_give_one_sentence() {
    let mut window = open(Design::default());
    click(&mut window, "Volume");
    settle(&mut window);
    wait_for(&mut window, "the refusal", |window| studio(window).session().reconstructions().failure.is_some());
    assert!(shows(&window, "expected objects of one plane, found 5; choose objects without depth"));
    // Objects without depth have a reconstruction again.
    click(&mut window, "Beads");
    settle(&mut window);
    reconstruction_by(&mut window, DecoderKind::Linear);
    assert!(!shows(&window, "choose objects without depth"));
}

#[test]
fn panel_is_in_the_menu_and_its_image_can_be_exported() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    menu(&mut window, &["View", "Panel", "Show Reconstruction"]);
    reconstruction_by(&mut window, DecoderKind::Linear);
    menu(&mut window, &["File", "Export view", "Reconstruction..."]);
    let file = folder.path().join("object.png");
    super::answer(&mut window, &file, "Export");
    assert!(std::fs::read(&file).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn image_keeps_its_size_in_a_small_window() {
    let mut window = open_sized(Design::default(), Vec2::new(800.0, 600.0));
    for (method, decoder) in [("Posterior mean", DecoderKind::Posterior), ("Trained network", DecoderKind::Network)] {
        click(&mut window, "Reconstruction method");
        click(&mut window, method);
        reconstruction_by(&mut window, decoder);
        window.run_steps(4);
        let image = window.get_by_role_and_label(Role::Image, "Reconstruction").rect();
        assert!(image.height() >= 80.0, "{method}: {image}");
    }
}

#[test]
fn image_is_as_large_and_as_high_as_its_neighbours() {
    let mut window = open(Design::default());
    reconstruction_by(&mut window, DecoderKind::Linear);
    window.run_steps(4);
    let [object, found] =
        ["Object", "Reconstruction"].map(|name| window.get_by_role_and_label(Role::Image, name).rect());
    assert!((object.top() - found.top()).abs() <= 2.0, "{object} {found}");
    assert!((object.height() - found.height()).abs() <= 4.0, "{object} {found}");
}

#[test]
fn uncertainty_of_another_estimate_is_named() {
    let mut window = open(Design::default());
    click(&mut window, "Reconstruction method");
    click(&mut window, "Posterior mean");
    reconstruction_by(&mut window, DecoderKind::Posterior);
    click(&mut window, "Show reconstruction uncertainty");
    wait_for(&mut window, "the uncertainty", |window| {
        window.query_by_role_and_label(Role::Image, "Reconstruction uncertainty of Markov chains").is_some()
    });
    assert!(shows(&window, "Uncertainty of Markov chains"));
}
