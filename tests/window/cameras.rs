//! The room of cameras: calibration, captures of systems, and their comparison.

use std::path::{Path, PathBuf};

use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::camera::{CalibratedCamera, ColourChoice, FrameSeries, calibrate};
use lenslet_studio::formats::write_array;
use lenslet_studio::forward::Design;
use lenslet_studio::prelude::CancelToken;
use lenslet_studio::workbench::{CameraResults, WorkState, range_of};
use ndarray::Array3;

use super::home::at_home;
use super::waiting::wait_for;
use super::{Window, answer, click, menu, open, studio, type_number};

/// Frames of a sensor of 2 DN per electron, offset 100 DN and read noise of 3 electrons; `electrons` is the mean of each pixel.
fn frames(shape: (usize, usize, usize), seed: u64, electrons: impl Fn(usize, usize, usize) -> f64) -> Array3<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1_u64 << 24) as f64
    };
    let mut normal = move || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
    Array3::from_shape_fn(shape, |(n, row, col)| {
        let electrons = electrons(n, row, col);
        let value = 100.0 + 2.0 * (electrons + (electrons + 9.0).sqrt() * normal());
        value.round().clamp(0.0, 4095.0) as f32
    })
}

/// A folder of pairs of frames in the dark and of 12 exposures.
fn write_series(folder: &Path) -> PathBuf {
    let place = folder.join("frames");
    std::fs::create_dir(&place).unwrap();
    let write = |name: &str, electrons: f64, seed| {
        write_array(&place.join(name), frames((2, 40, 50), seed, |_, _, _| electrons).view()).unwrap();
    };
    write("dark.npy", 0.0, 1);
    for level in 1..=12 {
        write(&format!("light_{level:02}ms.npy"), 180.0 * f64::from(level), 1 + level as u64);
    }
    place
}

fn cameras(window: &Window) -> CameraResults {
    studio(window).session().cameras()
}

fn shows(window: &Window, text: &str) -> bool {
    window.query_all_by_label_contains(text).next().is_some()
}

/// Chooses frames and waits until their groups are read or refused.
fn choose_frames(window: &mut Window, button: &str, path: &Path) {
    click(window, button);
    answer(window, path, "Choose");
    wait_for_calibration(window);
}

fn wait_for_calibration(window: &mut Window) {
    wait_for(window, "the calibration", |window| !cameras(window).calibration_state.is_working());
    window.run_steps(2);
}

fn failure(window: &Window) -> String {
    let WorkState::Failed(sentence) = cameras(window).calibration_state else { panic!("expected a failure") };
    assert!(shows(window, &sentence), "{sentence}");
    sentence
}

#[test]
fn camera_is_calibrated_saved_and_opened() {
    let place = tempfile::tempdir().unwrap();
    let folder = write_series(place.path());
    let mut window = open(Design::default());
    click(&mut window, "Camera");
    choose_frames(&mut window, "Choose folder of frames", &folder);
    for text in ["Groups by file names", "light_03ms", "40 x 50 px", "dark"] {
        assert!(shows(&window, text), "{text}");
    }
    let known = cameras(&window).calibration;
    assert_eq!((known.groups.len(), known.groups[0].frames, known.camera.is_none()), (13, 2, true));
    assert!(shows(&window, &format!("{:.1}", known.groups[5].mean_dn)));
    assert!(window.query_by_label("Save camera").is_none(), "nothing is calibrated");
    click(&mut window, "Calibrate");
    wait_for_calibration(&mut window);
    // The numbers are those of the library.
    let series = FrameSeries::open(&folder).unwrap();
    let expected = calibrate(&series, ColourChoice::default(), &mut CancelToken::new()).unwrap().calibration;
    assert_eq!(cameras(&window).calibration.camera.unwrap().calibration, expected);
    for quantity in expected.quantities() {
        assert!(shows(&window, &quantity.value_text()), "{quantity:?}");
    }
    for (part, plot) in [
        ("Calibration: photon transfer", "Photon transfer curve"),
        ("Calibration: linearity", "Linearity deviation"),
        ("Calibration: snr", "SNR curve"),
    ] {
        click(&mut window, part);
        window.get_by_label(plot);
    }
    click(&mut window, "Save camera");
    let file = place.path().join("camera.json");
    answer(&mut window, &file, "Save");
    assert_eq!(CalibratedCamera::open(&file).unwrap().calibration, expected);
    assert!(place.path().join("camera.svg").is_file());
    // Another camera does not replace maps or camera file without a question that names them.
    let mask = std::fs::read(place.path().join("camera-mask.npy")).unwrap();
    std::fs::write(place.path().join("other-mask.npy"), &mask).unwrap();
    let written = |name: &&str| place.path().join(name).is_file();
    let maps = ["camera-dark.npy", "camera-response.npy", "camera-mask.npy"].into_iter().filter(written);
    let all = format!("camera.json, {} and camera.svg already exist.", maps.collect::<Vec<_>>().join(", "));
    for (name, question) in [("other.json", "other-mask.npy already exists. Replace it?"), ("camera.json", &all)] {
        click(&mut window, "Save camera");
        answer(&mut window, &place.path().join(name), "Save");
        assert!(shows(&window, question), "{question}");
        click(&mut window, "Cancel");
    }
    assert!(!place.path().join("other.json").exists());
    click(&mut window, "Use camera for captures");
    window.get_by_label("Leave out camera file");
    // The file is opened in another window.
    drop(window);
    let mut window = open(Design::default());
    click(&mut window, "Camera");
    click(&mut window, "Open camera file");
    answer(&mut window, &file, "Open");
    wait_for_calibration(&mut window);
    assert!(shows(&window, &expected.quantities()[0].interval_text()));
    assert!(window.get_by_label("Calibration: groups").accesskit_node().is_disabled(), "a camera file has no frames");
    click(&mut window, "Calibration: photon transfer");
    window.get_by_label("Photon transfer curve");
}

#[test]
fn frames_that_cannot_be_used_are_told_and_nothing_is_written() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, shape| {
        let path = place.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_array(&path, frames(shape, 7, |_, _, _| 50.0).view()).unwrap();
    };
    write("alone/dark_1.npy", (1, 8, 9));
    write("alone/light_1.npy", (1, 8, 9));
    for name in ["sizes/dark_1.npy", "sizes/dark_2.npy", "sizes/light_1.npy"] {
        write(name, (1, 8, 9));
    }
    write("sizes/light_2.npy", (1, 8, 10));
    write("lines/dark.npy", (2, 8, 9));
    std::fs::write(place.path().join("camera.txt"), "v 4.0\nn 12 9 8\nd 1\ni lines\\dark.npy\nb 1 0\ni none.npy\n")
        .unwrap();
    let mut window = open(Design::default());
    click(&mut window, "Camera");
    choose_frames(&mut window, "Choose folder of frames", &place.path().join("nowhere"));
    assert!(failure(&window).contains("nowhere"));
    choose_frames(&mut window, "Choose descriptor of frames", &place.path().join("camera.txt"));
    assert!(failure(&window).contains("none.npy"));
    // Groups are shown first; the calibration refuses them.
    for (folder, group, sentence) in [
        ("alone", "light", "expected 2 or more frames of dark, found 1"),
        ("sizes", "several sizes", "expected 8 x 9 px"),
    ] {
        choose_frames(&mut window, "Choose folder of frames", &place.path().join(folder));
        assert!(shows(&window, group), "{folder}");
        click(&mut window, "Calibrate");
        wait_for_calibration(&mut window);
        assert!(failure(&window).contains(sentence), "{}", failure(&window));
        assert!(cameras(&window).calibration.camera.is_none() && window.query_by_label("Save camera").is_none());
    }
    let json = std::fs::read_dir(place.path())
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().path().extension().is_some_and(|ending| ending == "json"));
    assert_eq!(json.count(), 0);
}

/// Twelve images of stripes of two systems, of which the second is dimmer and blurred.
fn write_systems(folder: &Path) -> [PathBuf; 2] {
    [("sharp", 400.0, 0.9), ("blurred", 200.0, 0.2)].map(|(name, mean, contrast)| {
        let stripes = |n: usize, row: usize, col: usize| {
            let phase = (row + (n % 5) * col) as f64 * (0.6 + 0.1 * n as f64);
            mean * (1.0 + contrast * phase.sin())
        };
        let path = folder.join(name).with_extension("npy");
        write_array(&path, frames((12, 16, 16), name.len() as u64, stripes).view()).unwrap();
        path
    })
}

#[test]
#[cfg(unix)]
fn systems_are_compared_as_by_the_command_line() {
    let place = tempfile::tempdir().unwrap();
    let systems = write_systems(place.path());
    let home = place.path().join("home");
    std::fs::create_dir(&home).unwrap();
    let mut window = at_home(&home);
    click(&mut window, "Camera");
    click(&mut window, "Show captures");
    for system in &systems {
        click(&mut window, "Add file of captures");
        answer(&mut window, system, "Choose");
    }
    type_number(&mut window, "Captures: gain", "2");
    type_number(&mut window, "Captures: offset", "100");
    let known = |window: &Window| cameras(window).previews.systems;
    wait_for(&mut window, "the previews", |window| {
        known(window).iter().filter(|preview| preview.as_ref().is_ok_and(|known| known.mean < 450.0)).count() == 2
    });
    let previews = known(&window);
    let [sharp, blurred] = [0, 1].map(|index| previews[index].as_ref().unwrap());
    assert!((sharp.mean - 400.0).abs() < 20.0 && (blurred.mean - 200.0).abs() < 10.0);
    assert!(shows(&window, &sharp.understood) && sharp.understood.contains("12 images of 16 x 16 px"));
    window.get_by_label("First image");
    click(&mut window, "Show comparison");
    click(&mut window, "Patch of systems");
    click(&mut window, "Whole image");
    click(&mut window, "Estimate systems");
    wait_for(&mut window, "the comparison", |window| !cameras(window).comparison_state.is_working());
    let found = cameras(&window).comparison.unwrap();
    let equal = found.equal.as_ref().unwrap();
    assert_eq!((found.own.systems.len(), equal.systems.len(), found.own.differences.len()), (2, 2, 1));
    assert!(found.own.differences[0].bits_per_pixel > 0.0, "{:?}", found.own.differences);
    assert!(shows(&window, "sharp.npy less blurred.npy") && shows(&window, "note: cross-validation"));
    for (light, compared) in [("own", &found.own), ("equal", equal)] {
        click(&mut window, &format!("Details at {light} light"));
        let line = super::work::copied(&mut window, "Copy command line of the comparison");
        let mut printed = super::work::run_line(&line);
        let mut copied: serde_json::Value =
            serde_json::from_str(&super::work::copied(&mut window, "Copy comparison as JSON")).unwrap();
        for json in [&mut printed, &mut copied] {
            for system in json["systems"].as_array_mut().unwrap() {
                system["seconds"] = 0.into();
            }
        }
        assert_eq!(printed, copied, "{line}");
        assert_eq!(copied["systems"][0]["bits_per_pixel"].as_f64(), Some(compared.systems[0].bits_per_pixel));
    }
    // Other options make the numbers those of earlier captures.
    click(&mut window, "Show captures");
    click(&mut window, "Captures: mirror");
    click(&mut window, "Show comparison");
    assert!(shows(&window, "earlier captures or options"));
    // The next window shows the same numbers, and their captures again.
    drop(window);
    let mut window = at_home(&home);
    click(&mut window, "Camera");
    click(&mut window, "Show comparison");
    assert_eq!(cameras(&window).comparison.as_deref(), Some(&*found));
    assert!(shows(&window, "sharp.npy less blurred.npy") && shows(&window, "earlier captures or options"));
    click(&mut window, "Choose the captures of the comparison");
    assert!(!shows(&window, "earlier captures or options"));
    click(&mut window, "Show captures");
    wait_for(&mut window, "the previews", |window| known(window).len() == 2);
    assert_eq!(known(&window)[0].as_ref().unwrap().mean, sharp.mean);
}

/// A value from 1 to 9,999 as the window writes it.
fn three_digits(value: f32) -> String {
    let decimals = (2 - value.log10().floor() as i32).max(0) as usize;
    format!("{value:.decimals$}")
}

#[test]
fn a_capture_is_shown_beside_the_simulated_measurement_of_the_design() {
    let place = tempfile::tempdir().unwrap();
    let capture = place.path().join("raw.npy");
    let stripes = |_, row: usize, col: usize| 200.0 + 100.0 * ((row + 2 * col) as f64 * 0.4).sin();
    write_array(&capture, frames((1, 24, 36), 5, stripes).view()).unwrap();
    let mut window = open(Design::default());
    click(&mut window, "Camera");
    click(&mut window, "Show captures");
    click(&mut window, "Add file of captures");
    answer(&mut window, &capture, "Choose");
    let is_known = |window: &Window| matches!(cameras(window).previews.systems.as_slice(), [Ok(_)]);
    wait_for(&mut window, "the preview", is_known);
    let known = cameras(&window).previews.systems[0].clone().unwrap();
    let captured = |unit: &str, (low, high): (f32, f32)| {
        format!("First image: 24 x 36 px, {} to {} {unit}", three_digits(low), three_digits(high))
    };
    assert!(shows(&window, &captured("grey values", known.range)));
    assert!(shows(&window, "An estimate needs 2 or more"), "a single image is no system");
    type_number(&mut window, "Captures: gain", "2");
    wait_for(&mut window, "photons", |window| {
        cameras(window).previews.systems.len() == 1 && shows(window, " photons; mean")
    });
    // The other image follows each edit of the design.
    let simulated = |window: &Window| {
        let measurements = studio(window).session().live().measurements.unwrap();
        assert_eq!(measurements.revision, studio(window).session().revision());
        let image = measurements.value.noisy.index_axis(ndarray::Axis(0), 0);
        let (low, high) = range_of(image);
        let (rows, cols) = image.dim();
        format!("Simulated measurement: {rows} x {cols} px, {} to {} photons", three_digits(low), three_digits(high))
    };
    let before = simulated(&window);
    assert!(shows(&window, &before), "{before}");
    for name in ["First image", "Simulated measurement"] {
        window.get_by_role_and_label(egui::Role::Image, name);
    }
    menu(&mut window, &["Presets", "25 random lenslets"]);
    let after = simulated(&window);
    assert!(before != after && shows(&window, &after), "{after}");
    assert!(!shows(&window, &before));
}

#[test]
fn captures_that_cannot_be_read_are_told_and_taken_out() {
    let place = tempfile::tempdir().unwrap();
    let [sharp, _] = write_systems(place.path());
    let broken = place.path().join("broken.npy");
    std::fs::write(&broken, b"no array").unwrap();
    let mut window = open(Design::default());
    click(&mut window, "Camera");
    click(&mut window, "Show captures");
    for system in [&sharp, &broken] {
        click(&mut window, "Add file of captures");
        answer(&mut window, system, "Choose");
    }
    let states =
        |window: &Window| -> Vec<bool> { cameras(window).previews.systems.iter().map(Result::is_ok).collect() };
    wait_for(&mut window, "the previews", |window| states(window) == [true, false]);
    let sentence = cameras(&window).previews.systems[1].clone().unwrap_err();
    assert!(shows(&window, &sentence) && sentence.contains("broken.npy"), "{sentence}");
    click(&mut window, "Remove system 2");
    wait_for(&mut window, "the previews", |window| states(window) == [true]);
    // A crop that leaves the images.
    let field = window.get_by_label("Captures: crop");
    field.focus();
    window.run_steps(2);
    window.get_by_label("Captures: crop").type_text("20x20+0+0");
    window.run_steps(2);
    window.key_press(egui::Key::Enter);
    window.run_steps(2);
    wait_for(&mut window, "the refusal", |window| states(window) == [false]);
    assert!(shows(&window, "20x20+0+0"));
    click(&mut window, "Show comparison");
    assert!(!window.get_by_label("Estimate systems").accesskit_node().is_disabled());
    click(&mut window, "Estimate systems");
    wait_for(&mut window, "the refusal", |window| matches!(cameras(window).comparison_state, WorkState::Failed(_)));
}
