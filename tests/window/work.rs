//! Lists of long jobs, reproducible numbers, and layouts of the window.

use std::process::{Command, Stdio};
use std::sync::Arc;

use egui::{Color32, ColorImage, OutputCommand, ViewportCommand};
use egui_kittest::kittest::NodeT;
use lenslet_studio::evaluation::EstimateRequest;
use lenslet_studio::information::Estimator;
use lenslet_studio::workbench::{ActivityState, RunStatus};

use super::estimates::small_stripes;
use super::home::at_home;
use super::psf_import::{import_typed, type_psf_path, wait_for_image};
use super::runs::{TALL, shorten_run};
use super::waiting::{stop_run, wait_for, wait_for_stop};
use super::*;

/// Clicks and returns the text in the clipboard.
pub fn copied(window: &mut Window, name: &str) -> String {
    if window.query_by_label(name).is_none() {
        click(window, "More of the numbers");
    }
    window.get_by_label(name).click();
    for _ in 0..8 {
        window.step();
        let commands = &window.output().platform_output.commands;
        if let Some(OutputCommand::CopyText(text)) = commands.first() {
            let text = text.clone();
            // The menu closes.
            window.run_steps(4);
            return text;
        }
    }
    panic!("{name}: nothing was copied");
}

/// Output of a command line from the window, run by a shell in another folder.
#[cfg(unix)]
pub fn run_line(line: &str) -> serde_json::Value {
    let folder = tempfile::tempdir().unwrap();
    let line = line.replacen("lenslet-studio", env!("CARGO_BIN_EXE_lenslet-studio"), 1);
    let shell =
        Command::new("sh").args(["-c", &line]).current_dir(folder.path()).stdin(Stdio::null()).output().unwrap();
    assert!(shell.status.success(), "{line}\n{}", String::from_utf8_lossy(&shell.stderr));
    serde_json::from_slice(&shell.stdout).unwrap()
}

/// Chooses fits of so many steps to whole measurements.
fn ask_for_steps(window: &mut Window, steps: &str) {
    click(window, "Estimates");
    click(window, "Estimator");
    click(window, "Causal model");
    click(window, "Patch");
    click(window, "Whole sensor");
    click(window, "Length of the fit");
    click(window, "steps");
    type_number(window, "Steps of the fit", steps);
}

fn states(window: &Window) -> Vec<ActivityState> {
    studio(window).session().activities().iter().map(|activity| activity.state.clone()).collect()
}

#[test]
#[cfg(unix)]
fn copied_commands_reproduce_numbers_bit_for_bit() {
    // A mask that no flag names, so the command includes the whole design.
    let design =
        Design { encoder: Encoder::Lenslets(lenslet_studio::optics::random_layout(3, 5)), ..Design::default() };
    let mut window = open(design);
    let live = studio(&window).session().live();
    let (information, measurements) = (live.information.unwrap(), live.measurements.unwrap());
    let numbers: serde_json::Value = serde_json::from_str(&copied(&mut window, "Copy numbers as JSON")).unwrap();
    let shown = information.value.gaussian.bits_per_pixel;
    assert_eq!(numbers["gaussian_bound"].as_f64(), Some(shown));
    assert_eq!(numbers["design"]["seed"], 1);
    let line = copied(&mut window, "Copy command line");
    let looked = run_line(&line);
    assert_eq!(looked["information"]["gaussian_bound"].as_f64(), Some(shown), "{line}");
    assert_eq!(looked["information"]["ceiling"].as_f64(), information.value.ceiling_bits());
    assert_eq!(looked["sensor_tamura"].as_f64(), Some(measurements.value.tamura.mean));

    drop(window);
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(small_stripes(folder.path()));
    ask_for_steps(&mut window, "12");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "the estimate", |window| !studio(window).session().estimates().finished.is_empty());
    let finished = studio(&window).session().estimates().finished;
    let estimate = &finished[0].value.estimate;
    let line = copied(&mut window, "Copy command of estimate 1");
    assert!(line.contains("--estimator causal --patch sensor --steps 12"), "{line}");
    let repeated = run_line(&line);
    assert_eq!(repeated["bits_per_pixel"].as_f64(), Some(estimate.bits_per_pixel), "whatever the number of threads");
}

#[test]
fn stale_numbers_are_marked_and_not_exported() {
    let folder = tempfile::tempdir().unwrap();
    let objects = folder.path().join("objects.npy");
    let pixels = ndarray::Array3::from_shape_fn((60, 48, 48), |(n, row, col)| ((n + row * col) % 17) as f32);
    lenslet_studio::formats::write_array(&objects, pixels.view()).unwrap();
    let mut window = open(Design { objects: ObjectSource::Stack(objects), ..Design::default() });
    let can_export = |window: &Window| !window.get_by_label("Export measurements...").accesskit_node().is_disabled();
    let is_stale = |window: &Window| {
        let label = |node: egui_kittest::Node<'_>| node.accesskit_node().label().unwrap_or_default();
        let mut meters = window.query_all_by_label_contains("Sensor Tamura").map(label);
        meters.any(|meter| meter.ends_with(", of an earlier edit"))
    };
    // A PSF larger than the objects of a stack has no measurement.
    let file = folder.path().join("large.npy");
    lenslet_studio::formats::write_array(&file, ndarray::Array2::<f32>::ones((128, 128)).view()).unwrap();
    click(&mut window, "File");
    assert!(can_export(&window) && !is_stale(&window));
    click(&mut window, "Import PSF...");
    type_psf_path(&mut window, &file);
    import_typed(&mut window);
    wait_for_image(&mut window);
    let live = studio(&window).session().live();
    let (revision, failure) = live.failure.unwrap();
    assert_eq!(revision, studio(&window).session().revision(), "{failure}");
    assert!(live.measurements.unwrap().revision < revision && window.query_all_by_label(&failure).next().is_some());
    assert!(is_stale(&window));
    let numbers: serde_json::Value = serde_json::from_str(&copied(&mut window, "Copy numbers as JSON")).unwrap();
    assert_eq!((numbers["current"].as_bool(), numbers["sensor_tamura"].as_f64()), (Some(false), None));
    assert!(numbers["object_tamura"].is_f64(), "the objects are the same");
    click(&mut window, "File");
    assert!(!can_export(&window));
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    settle(&mut window);
    assert!(!is_stale(&window) && window.query_all_by_label(&failure).next().is_none());
    assert!(studio(&window).session().live().failure.is_none());
}

#[test]
fn lenslets_are_fitted_to_imported_psf() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    let before = lenslets(&window);
    let psf = studio(&window).session().design().psf(1).unwrap().index_axis_move(ndarray::Axis(0), 0);
    let file = folder.path().join("psf.npy");
    lenslet_studio::formats::write_array(&file, psf.mapv(|light| light as f32).view()).unwrap();
    click(&mut window, "Presets");
    assert!(window.get_by_label("Fit lenslets to this PSF").accesskit_node().is_disabled(), "it has lenslets");
    click(&mut window, "Import PSF...");
    type_psf_path(&mut window, &file);
    import_typed(&mut window);
    wait_for_image(&mut window);
    settle(&mut window);
    assert!(lenslets(&window).is_empty());
    menu(&mut window, &["Presets", "Fit lenslets to this PSF"]);
    wait_for(&mut window, "the lenslets", |window| !lenslets(window).is_empty());
    window.get_by_label_contains("9 lenslets stand for the PSF, 0.0 % of whose light is elsewhere");
    for lenslet in &before {
        let near = |found: &&Lenslet| (found.x - lenslet.x).hypot(found.y - lenslet.y) < 0.05;
        assert_eq!(lenslets(&window).iter().filter(near).count(), 1, "{lenslet:?}");
    }
    menu(&mut window, &["Edit", "Undo use fitted lenslets"]);
    assert!(lenslets(&window).is_empty(), "the image is there again");
}

#[test]
#[cfg(unix)]
fn live_estimate_is_reproduced_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    studio(&window).session().set_live_speed(20.0);
    studio(&window).session().set_live(true);
    let bounded =
        |window: &Window| studio(window).session().estimates().live.is_some_and(|live| live.value.lower.is_some());
    wait_for(&mut window, "an estimate with a bound from below", bounded);
    menu(&mut window, &["Presets", "Heuristic lenslets", "2 lenslets"]);
    let revision = studio(&window).session().revision();
    wait_for(&mut window, "that of two lenslets", |window| {
        bounded(window) && studio(window).session().estimates().live.unwrap().revision == revision
    });
    // An order is computed after the live estimate has ended.
    studio(&window).session().set_live(false);
    let gaussian = EstimateRequest::new(Estimator::GaussianStationary).with_patch(8, 8).with_patches(80, 20);
    studio(&window).session().order_estimate(gaussian).unwrap();
    wait_for(&mut window, "its end", |window| !studio(window).session().estimates().finished.is_empty());
    let shown = studio(&window).session().estimates().live.unwrap().value;
    let line = copied(&mut window, "Copy command line");
    assert!(shown.start.is_some() && line.starts_with("lenslet-studio reproduce "), "{line}");
    settle(&mut window);
    let repeated = run_line(&format!("{line} --json"));
    assert_eq!(repeated["numbers"]["bits_per_pixel"].as_f64(), Some(shown.bits_per_pixel), "{repeated:#}");
    assert_eq!(repeated["numbers"]["lower"]["bits_per_pixel"].as_f64(), shown.lower.as_ref().map(|b| b.bits_per_pixel));
    let bound = studio(&window).session().live().information.unwrap().value.gaussian.bits_per_pixel;
    assert_eq!(repeated["bounds"]["information"]["gaussian_bound"].as_f64(), Some(bound));
    assert_eq!(repeated["same"], true);
    // The same record, at a chosen path.
    menu(&mut window, &["More of the numbers", "Export record of the live estimate..."]);
    let file = folder.path().join("mine.json");
    answer(&mut window, &file, "Export");
    let kept = line.trim_start_matches("lenslet-studio reproduce ").trim_matches('\'');
    assert_eq!(std::fs::read(file).unwrap(), std::fs::read(kept).unwrap());
}

#[test]
fn jobs_queue_stop_and_keep_their_log() {
    let objects = tempfile::tempdir().unwrap();
    let mut window = open(small_stripes(objects.path()));
    // The first job has read the objects.
    let states = |window: &Window| states(window).split_off(1);
    ask_for_steps(&mut window, "100000");
    click(&mut window, "Start estimate");
    type_number(&mut window, "Steps of the fit", "8");
    click(&mut window, "Start estimate");
    window.key_press_modifiers(Modifiers::COMMAND, Key::J);
    window.run_steps(3);
    wait_for(&mut window, "the first", |window| {
        let states = states(window);
        states == [ActivityState::Running, ActivityState::Waiting]
    });
    window.get_by_label("waiting for other jobs");
    click(&mut window, "Stop job 2");
    wait_for(&mut window, "the second", |window| matches!(states(window).last(), Some(ActivityState::Done(_))));
    assert_eq!(states(&window)[0], ActivityState::Stopped);
    assert!(window.query_by_label("Stop job 2").is_none() && window.query_by_label("Stop job 3").is_none());
    // The result is listed, and the log names the steps.
    assert!(window.query_all_by_label_contains("bits per pixel").count() >= 2);
    click(&mut window, "Log of job 3");
    let log = copied(&mut window, "Copy log of job 3");
    assert!(log.contains("Estimate (causal) of 9 lenslets") && log.contains("Scoring test patches"), "{log}");
    // A failure is one sentence, in the list and as a message.
    let folder = tempfile::tempdir().unwrap();
    menu(&mut window, &["File", "Open design..."]);
    answer(&mut window, &folder.path().join("nothing.json"), "Open");
    let Some(ActivityState::Failed(sentence)) = states(&window).pop() else { panic!("{:?}", states(&window)) };
    assert!(sentence.contains("nothing.json"), "{sentence}");
    assert!(window.query_all_by_label(&sentence).count() >= 2);
}

#[test]
fn closing_asks_while_jobs_run() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    ask_for_steps(&mut window, "100000");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "its turn", |window| window.query_by_label("Cancel estimate").is_some());
    close(&mut window);
    window.get_by_label_contains("An estimate is running");
    click(&mut window, "Cancel");
    click(&mut window, "Cancel estimate");
    wait_for(&mut window, "its end", |window| states(window) == [ActivityState::Stopped]);
    // Closing also asks about a run, which continues meanwhile.
    click(&mut window, "Optimize");
    click(&mut window, "Start run");
    close(&mut window);
    window.get_by_label("Close the window?");
    window.get_by_label("A run is active. It is saved and can be resumed in the next window.");
    click(&mut window, "Cancel");
    let status = studio(&window).session().run().map(|run| run.status);
    assert_eq!(status, Some(RunStatus::Running));
    stop_run(&mut window);
    assert!(!states(&window).contains(&ActivityState::Running));
    close(&mut window);
    assert!(window.query_by_label("Close the window?").is_none());
}

#[test]
fn run_is_listed_among_jobs_and_reproducible() {
    let mut window = open_sized(Design::default(), TALL);
    shorten_run(&mut window, "16 px");
    type_number(&mut window, "Steps", "10");
    click(&mut window, "Start run");
    wait_for(&mut window, "the second refit", |window| {
        studio(window).session().run().is_some_and(|run| run.checkpoints.len() >= 2)
    });
    click(&mut window, "More of the run");
    let line = copied(&mut window, "Copy command of run");
    assert!(line.starts_with("lenslet-studio optimize --start heuristic:9") && line.contains("--steps 10"), "{line}");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.json");
    click(&mut window, "More of the run");
    click(&mut window, "Export record of run...");
    answer(&mut window, &file, "Export");
    let record: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    assert_eq!(record["settings"]["steps"], 10);
    assert!(!record["checkpoints"].as_array().unwrap().is_empty() && record["objects_fingerprint"].is_string());
    window.key_press_modifiers(Modifiers::COMMAND, Key::J);
    window.run_steps(3);
    click(&mut window, "Stop job 1");
    wait_for_stop(&mut window);
    assert_eq!(states(&window)[0], ActivityState::Stopped);
}

#[test]
fn layouts_are_saved_and_panels_maximize() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    menu(&mut window, &["View", "Panel", "Show Compare"]);
    menu(&mut window, &["View", "Layout", "Save as layout 1"]);
    menu(&mut window, &["View", "Layout", "Reset layout"]);
    assert!(window.query_by_label("Take snapshot").is_none());
    window.key_press_modifiers(Modifiers::COMMAND, Key::Num1);
    window.run_steps(4);
    window.get_by_label("Take snapshot");
    // The panel under the pointer is maximized until Escape.
    let at = window.get_by_role_and_label(Role::Image, "Measurement").rect().center();
    let before = window.get_by_role_and_label(Role::Image, "Measurement").rect().width();
    window.hover_at(at);
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::M);
    window.run_steps(4);
    assert!(window.get_by_role_and_label(Role::Image, "Measurement").rect().width() > 1.5 * before);
    assert!(window.query_by_label("Lenslet 1").is_none());
    // The dialog in front closes first.
    window.key_press(Key::F1);
    window.run_steps(4);
    window.get_by_label("Select in a box; with Shift, add to the selection");
    window.key_press(Key::Escape);
    window.run_steps(4);
    assert!(window.query_by_label("Select in a box; with Shift, add to the selection").is_none());
    window.get_by_label("Show all panels");
    window.key_press(Key::Escape);
    window.run_steps(4);
    window.get_by_label("Lenslet 1");
    // In the next session the layout is still there.
    drop(window);
    let mut window = at_home(folder.path());
    menu(&mut window, &["View", "Layout", "Reset layout"]);
    menu(&mut window, &["View", "Layout", "Use layout 1"]);
    window.get_by_label("Take snapshot");
}

#[test]
fn shortcuts_of_one_frame_run_in_order() {
    let mut window = open(Design::default());
    let press = |window: &mut Window, keys: &[Key]| {
        for &key in keys {
            let modifiers = Modifiers::COMMAND;
            let event = egui::Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers };
            window.input_mut().events.push(event);
        }
        window.run_steps(4);
    };
    for _ in 0..3 {
        click(&mut window, "Add lenslet");
    }
    assert_eq!(lenslets(&window).len(), 12);
    press(&mut window, &[Key::Z, Key::Z]);
    assert_eq!(lenslets(&window).len(), 10);
    // Keys typed into the palette do not reach the window.
    press(&mut window, &[Key::D, Key::K, Key::Z]);
    window.get_by_label("Snapshot taken: Design 1");
    window.get_by_label("Find an action");
    assert_eq!(lenslets(&window).len(), 10);
}

#[test]
fn snapshots_are_restored_in_next_session() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    window.key_press_modifiers(Modifiers::COMMAND, Key::D);
    settle(&mut window);
    menu(&mut window, &["Presets", "Heuristic lenslets", "2 lenslets"]);
    window.key_press_modifiers(Modifiers::COMMAND, Key::D);
    settle(&mut window);
    let bound = studio(&window).session().live().information.unwrap().value.ceiling_bits().unwrap();
    let written = |folder: &Path| std::fs::read_dir(folder.join("kept")).map_or(0, Iterator::count);
    wait_for(&mut window, "both files", |_| written(folder.path()) == 2);
    std::fs::write(folder.path().join("kept/broken.json"), "{").unwrap();
    close(&mut window);
    click(&mut window, "Discard");
    drop(window);
    let mut window = at_home(folder.path());
    window.get_by_label("1 snapshot could not be read; it is left unchanged");
    menu(&mut window, &["View", "Panel", "Show Compare"]);
    window.get_by_label("PSF of Design 1");
    window.get_by_label(&format!("\u{2264} {bound:.3}"));
    // Measurements are not stored. They are simulated again for compared snapshots.
    for name in ["A is snapshot 1", "B is snapshot 2", "Compare Measurement", "Show difference"] {
        click(&mut window, name);
    }
    wait_for(&mut window, "both measurements", |window| window.query_by_label("Difference").is_some());
    menu(&mut window, &["More of snapshot 2", "Open"]);
    assert_eq!(lenslets(&window).len(), 2);
    menu(&mut window, &["More of snapshot 1", "Delete"]);
    wait_for(&mut window, "the file to go", |_| written(folder.path()) == 2);
    click(&mut window, "Restore snapshot");
    wait_for(&mut window, "the file to come back", |_| written(folder.path()) == 3);
}

#[test]
fn panel_is_exported_as_image() {
    let mut window = open(Design::default());
    window.key_press_modifiers(Modifiers::COMMAND, Key::D);
    settle(&mut window);
    window.get_by_label("Export comparison as PNG").click();
    let mut taken = false;
    for _ in 0..40 {
        window.step();
        let output = &window.output().viewport_output[&egui::ViewportId::ROOT];
        let command = output.commands.iter().find_map(|command| match command {
            ViewportCommand::Screenshot(callback) => Some(callback.clone()),
            _ => None,
        });
        if let Some(callback) = command {
            // The answer of a real window.
            callback.complete(Arc::new(ColorImage::filled([1280, 800], Color32::from_rgb(10, 20, 30))));
            taken = true;
            break;
        }
    }
    assert!(taken, "no path was asked for");
    window.run_steps(4);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("compare.png");
    answer(&mut window, &file, "Export");
    let image = lenslet_studio::formats::read_grey(&file).unwrap();
    let (rows, cols) = image.dim();
    assert!((200..800).contains(&rows) && (200..800).contains(&cols), "{rows} x {cols}: a panel, not the window");
}

#[test]
fn threads_engine_and_folder_are_stored() {
    let folder = tempfile::tempdir().unwrap();
    let elsewhere = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    window.key_press_modifiers(Modifiers::COMMAND, Key::Comma);
    window.run_steps(3);
    click(&mut window, "One per core");
    type_number(&mut window, "Threads", "2");
    click(&mut window, "burn:ndarray");
    click(&mut window, "Choose folder...");
    answer(&mut window, elsewhere.path(), "Use");
    menu(&mut window, &["Presets", "Heuristic lenslets", "3 lenslets"]);
    let designs = |folder: &Path| {
        let files = std::fs::read_dir(folder).unwrap().filter_map(|file| Some(file.ok()?.path()));
        files.filter(|file| file.extension().is_some_and(|ending| ending == "json")).count()
    };
    wait_for(&mut window, "the unsaved design", |_| designs(elsewhere.path()) == 1);
    assert_eq!(designs(&folder.path().join("unsaved")), 0);
    drop(window);
    let known = std::fs::read_to_string(folder.path().join("preferences.json")).unwrap();
    let known: serde_json::Value = serde_json::from_str(&known).unwrap();
    assert_eq!((known["threads"].as_u64(), known["engine"].as_str()), (Some(2), Some("burn:ndarray")));
    assert_eq!(known["unsaved"].as_str(), elsewhere.path().to_str());
}
