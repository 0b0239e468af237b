//! The window that reconstructs a capture of a camera.

use std::path::{Path, PathBuf};

use egui::Role;
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::Design;
use lenslet_studio::workbench::{CaptureReconstruction, CaptureState};

use super::waiting::wait_for;
use super::{Window, answer, click, menu, open, studio};

/// Three spots through a mask of two pinholes, and its PSF, as colour images.
fn write_capture(folder: &Path) -> [PathBuf; 2] {
    let pinholes = [(2, 3, 0.6), (6, 5, 0.4)];
    let measured = image::RgbImage::from_fn(40, 36, |x, y| {
        let light: f64 = pinholes
            .iter()
            .map(|&(row, col, share)| {
                let is_lit = [(12, 14), (22, 30), (30, 18)].iter().any(|&(spot_row, spot_col)| {
                    (spot_row..spot_row + 3).contains(&(y + row)) && (spot_col..spot_col + 3).contains(&(x + col))
                });
                if is_lit { 180.0 * share } else { 0.0 }
            })
            .sum();
        let light = light as u8;
        image::Rgb([light + 3, light / 2 + 2, light / 3 + (x % 2) as u8 + 1])
    });
    let psf = image::RgbImage::from_fn(9, 9, |x, y| {
        let found = pinholes.iter().find(|&&(row, col, _)| (row, col) == (y, x));
        let light = found.map_or(0, |(_, _, share)| (200.0 * share) as u8);
        image::Rgb([light, light / 2, light / 3])
    });
    let paths = ["capture.png", "psf.png"].map(|name| folder.join(name));
    measured.save(&paths[0]).unwrap();
    psf.save(&paths[1]).unwrap();
    paths
}

fn fill(window: &mut Window, field: &str, text: &str) {
    window.get_by_role_and_label(Role::TextInput, field).focus();
    window.run_steps(2);
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::A);
    window.get_by_role_and_label(Role::TextInput, field).type_text(text);
    window.run_steps(2);
}

/// The capture once it is no longer computed.
fn ended(window: &mut Window) -> CaptureReconstruction {
    let newest = |window: &Window| studio(window).session().capture().filter(|capture| !capture.state.is_open());
    wait_for(window, "the end of the reconstruction", |window| newest(window).is_some());
    newest(window).unwrap()
}

#[test]
fn colour_capture_is_reconstructed_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let [capture, psf] = write_capture(folder.path());
    let mut window = open(Design::default());
    menu(&mut window, &["File", "Open capture..."]);
    let start = window.get_by_label("Reconstruct the capture");
    assert!(start.accesskit_node().is_disabled(), "no file is chosen");
    click(&mut window, "Browse for Capture");
    answer(&mut window, &capture, "Choose");
    fill(&mut window, "PSF file", &psf.display().to_string());
    click(&mut window, "Method of the capture");
    click(&mut window, "Richardson-Lucy");
    click(&mut window, "Reconstruct the capture");
    let found = ended(&mut window);
    assert!(matches!(found.state, CaptureState::Done { .. }), "{:?}", found.state);
    let object = found.object.unwrap();
    assert_eq!((object.dim(), found.seen.shape), ((44, 48, 3), (36, 40)));
    window.get_by_role_and_label(Role::Image, "Capture in colour");
    click(&mut window, "Green of the capture");
    let image = window.get_by_role_and_label(Role::Image, "Capture image").value().unwrap();
    assert!(image.ends_with("outlined rows 4 to 39, columns 4 to 43"), "{image}");
    click(&mut window, "Export the reconstruction");
    let out = folder.path().join("out");
    answer(&mut window, &out, "Export");
    let written = lenslet_studio::formats::read_array(&out.join("reconstructions.npy")).unwrap();
    assert_eq!(written.shape(), [1, 44, 48, 3]);
    assert_eq!(image::image_dimensions(out.join("reconstruction-1.png")).unwrap(), (48, 44));
    assert_eq!(image::image_dimensions(out.join("measurement-1.png")).unwrap(), (40, 36));
}

#[test]
fn broken_capture_is_refused_in_one_sentence_and_can_be_corrected() {
    let folder = tempfile::tempdir().unwrap();
    let [capture, psf] = write_capture(folder.path());
    let mut window = open(Design::default());
    menu(&mut window, &["File", "Open capture..."]);
    // The photograph is larger than the capture.
    fill(&mut window, "Capture file", &psf.display().to_string());
    fill(&mut window, "PSF file", &capture.display().to_string());
    click(&mut window, "Reconstruct the capture");
    let found = ended(&mut window);
    let CaptureState::Failed(sentence) = &found.state else { panic!("{:?}", found.state) };
    assert!(sentence.contains("psf.png"), "{sentence}");
    assert!(window.query_all_by_label_contains(sentence.as_str()).next().is_some());
    assert!(window.query_by_label("Export the reconstruction").is_none(), "there is nothing to export");
    fill(&mut window, "Capture file", &capture.display().to_string());
    fill(&mut window, "PSF file", &psf.display().to_string());
    click(&mut window, "Reconstruct the capture");
    let found = ended(&mut window);
    assert!(matches!(found.state, CaptureState::Done { .. }), "{:?}", found.state);
}

#[test]
fn failed_order_keeps_the_complete_reconstruction() {
    let folder = tempfile::tempdir().unwrap();
    let [capture, psf] = write_capture(folder.path());
    let mut window = open(Design::default());
    menu(&mut window, &["File", "Open capture..."]);
    fill(&mut window, "Capture file", &capture.display().to_string());
    fill(&mut window, "PSF file", &psf.display().to_string());
    click(&mut window, "Method of the capture");
    click(&mut window, "Richardson-Lucy");
    click(&mut window, "Reconstruct the capture");
    let object = ended(&mut window).object;
    assert!(object.is_some());
    fill(&mut window, "Dark level of the capture", "abc");
    click(&mut window, "Reconstruct the capture");
    let failed = ended(&mut window);
    assert!(matches!(failed.state, CaptureState::Failed(_)), "{:?}", failed.state);
    assert_eq!(failed.object, object);
    assert!(!window.get_by_label("Export the reconstruction").accesskit_node().is_disabled());
    assert!(window.query_by_label("Dismiss").is_none(), "the dialog itself shows the failure");
}
