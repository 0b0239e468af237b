//! Estimates in the window: the live estimate and requested ones.

use std::time::Duration;

use super::home::at_home;
use super::waiting::wait_for;
use super::*;
use lenslet_studio::evaluation::{Calibration, DensityModel, EstimateRequest, MeasuredOrder};
use lenslet_studio::information::{BoundMethod, EngineChoice, Estimator};

/// A design for few small objects of no known prior, whose measurements have 9 x 9 px. Estimates of them take a moment.
pub fn small_stripes(folder: &Path) -> Design {
    let path = folder.join("objects.npy");
    let stripes = ndarray::Array3::from_shape_fn((12, 40, 40), |(n, r, c)| ((r + 3 * n + c % 5) % 9) as f32);
    lenslet_studio::formats::write_array(&path, stripes.view()).unwrap();
    Design { objects: ObjectSource::Stack(path), ..Design::default() }
}

#[test]
fn live_estimate_follows_edits_and_can_be_switched_off() {
    let mut window = open(Design::default());
    studio(&window).session().set_live_speed(20.0);
    studio(&window).set_live(true);
    wait_for(&mut window, "the first live estimate", |window| studio(window).session().estimates().live.is_some());
    let first = studio(&window).session().estimates().live.unwrap();
    assert!(first.value.start.is_none() && first.value.remaining.is_some());
    assert!(window.query_by_label_contains("refining").is_some());
    assert!(first.value.bits_per_pixel > 0.1 && first.value.interval_95[0] < first.value.bits_per_pixel);
    let before = studio(&window).session().revision();
    menu(&mut window, &["Presets", "Heuristic lenslets", "2 lenslets"]);
    let after = studio(&window).session().revision();
    assert!(after > before);
    wait_for(&mut window, "the estimate of the edited design", |window| {
        studio(window).session().estimates().live.is_some_and(|live| live.revision == after)
    });
    assert!(
        studio(&window).session().estimates().live.unwrap().value.start.is_some(),
        "it starts from the model before"
    );
    click(&mut window, "Map");
    click(&mut window, "Information map of a patch");
    click(&mut window, "Next patch");
    assert!(window.query_by_label("2 of 8").is_some());
    wait_for(&mut window, "where the gradient pulls", |window| {
        studio(window).session().estimates().live.is_some_and(|live| live.value.pulls.is_some())
    });
    let live = studio(&window).session().estimates().live.unwrap();
    assert_eq!((live.revision, live.value.pulls.as_ref().unwrap().len()), (after, 2));
    // Both bounds arrive without a request.
    wait_for(&mut window, "the lower bound", |window| {
        studio(window).session().estimates().live.is_some_and(|live| live.value.lower.is_some())
    });
    let lower = studio(&window).session().estimates().live.unwrap().value.lower.clone().unwrap();
    let ceiling = studio(&window).session().live().information.unwrap().value.ceiling_bits().unwrap();
    assert!(lower.bits_per_pixel > 0.7 * ceiling && lower.bits_per_pixel < ceiling, "{lower:?} {ceiling}");
    window.get_by_label("Lower bound");
    // Two lenslets carry less information than nine; there is no earlier edit.
    assert!(first.value.edit.is_none());
    wait_for(&mut window, "what the edit has changed", |window| {
        studio(window).session().estimates().live.is_some_and(|live| live.value.edit.is_some())
    });
    let edit = studio(&window).session().estimates().live.unwrap().value.edit.unwrap();
    assert!(edit.is_clear() && edit.bits_per_pixel < -0.03, "{edit:?}");
    let change = format!("{:+.4} [", edit.bits_per_pixel);
    assert!(
        window.query_by_label("Last edit").is_some() && window.query_by_label_contains(&change).is_some(),
        "{change}"
    );
    click(&mut window, "Arrows");
    menu(&mut window, &["View", "Live estimate"]);
    assert!(!studio(&window).session().is_live());
}

fn bracket_within(time: Duration) -> DensityModel {
    DensityModel::new(Estimator::Bracket, Some(time), EngineChoice::default())
}

#[test]
fn estimate_is_started_cancelled_and_kept_with_its_design() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    click(&mut window, "Estimates");
    click(&mut window, "Length of the fit");
    click(&mut window, "min");
    type_number(&mut window, "Minutes of the fit", "0.1");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "a fit", |window| window.query_by_label_contains("Fitting").is_some());
    let running = studio(&window).session().estimates().running.unwrap();
    assert_eq!(running.model, bracket_within(Duration::from_secs(6)));
    click(&mut window, "Cancel estimate");
    wait_for(&mut window, "the end of it", |window| studio(window).session().estimates().running.is_none());
    assert!(studio(&window).session().estimates().finished.is_empty());
    assert!(window.query_by_label("Start estimate").is_some());
    // A shorter one than the form offers.
    let model = bracket_within(Duration::from_secs(1));
    let request = EstimateRequest { model, ..EstimateRequest::default() };
    studio(&window).session().order_estimate(request.with_patch(32, 32).with_patches(100, 60)).unwrap();
    wait_for(&mut window, "the estimate", |window| !studio(window).session().estimates().finished.is_empty());
    let finished = studio(&window).session().estimates().finished;
    let bracket = finished[0].value.estimate.bracket.clone().expect("a bracket");
    assert!(bracket.lower.unwrap() < bracket.upper);
    assert!([BoundMethod::EntropyBound, BoundMethod::Ais].contains(&bracket.upper_from), "{}", bracket.upper_from);
    assert!(!finished[0].value.curve.is_empty());
    // Information shows the bracket of this design first, until it is edited.
    assert!(window.query_by_label_contains("decoder, ").is_some() || window.query_by_label("AIS").is_some());
    click(&mut window, "Estimate 1");
    menu(&mut window, &["Presets", "Heuristic lenslets", "2 lenslets"]);
    assert!(window.query_by_label_contains("of another design").is_some());
    assert!(window.query_by_label_contains("decoder, ").is_none());
    drop(window);

    // In the next session the estimate is there with all its data, until it is deleted.
    let found = |window: &Window| studio(window).session().estimates().finished;
    let mut window = at_home(folder.path());
    click(&mut window, "Discard");
    click(&mut window, "Estimates");
    wait_for(&mut window, "the estimate of the other day", |window| !found(window).is_empty());
    let again = &found(&window)[0].value;
    assert_eq!((&again.estimate, &again.curve), (&finished[0].value.estimate, &finished[0].value.curve));
    assert_eq!(again.order.request, finished[0].value.order.request);
    assert!(window.query_by_label_contains("of another design").is_none(), "the same design is open");
    click(&mut window, "Delete estimate 1");
    assert!(found(&window).is_empty());
    click(&mut window, "Restore deleted estimate");
    assert_eq!(found(&window).len(), 1);
    drop(window);
    let mut window = at_home(folder.path());
    click(&mut window, "Estimates");
    wait_for(&mut window, "what was brought back", |window| !found(window).is_empty());
    click(&mut window, "Delete estimate 1");
    drop(window);
    let mut window = at_home(folder.path());
    window.run_steps(60);
    assert!(found(&window).is_empty(), "it is gone for good");
}

#[test]
#[ignore = "takes a minute or more; run with --ignored"]
fn running_estimate_resumes_in_next_window() {
    let folder = tempfile::tempdir().unwrap();
    let pending = folder.path().join("estimates/pending/order.json");
    let mut window = at_home(folder.path());
    click(&mut window, "Estimates");
    click(&mut window, "Estimator");
    click(&mut window, "Causal model");
    type_number(&mut window, "Steps of the fit", "60");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "a fit", |window| window.query_by_label_contains("Fitting").is_some());
    assert!(pending.exists());
    assert!(studio(&window).session().keeps_estimates());
    // A second estimate waits for the first.
    type_number(&mut window, "Steps of the fit", "50");
    click(&mut window, "Start estimate");
    let waiting = folder.path().join("estimates/waiting");
    wait_for(&mut window, "the note of it", |_| waiting.exists());
    drop(window);
    let crashes = |path: &std::path::Path| {
        let order: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        order["crashes"].as_u64().unwrap()
    };
    assert_eq!(crashes(&pending), 0, "the window was closed");

    let mut window = at_home(folder.path());
    wait_for(&mut window, "both estimates", |window| studio(window).session().estimates().finished.len() == 2);
    let models: Vec<DensityModel> =
        studio(&window).session().estimates().finished.iter().map(|found| found.value.order.request.model).collect();
    let full = |steps| DensityModel::new(Estimator::Causal, None, EngineChoice::default()).of_steps(steps);
    assert_eq!(models, [full(60), full(50)]);
    wait_for(&mut window, "the end", |_| !pending.exists() && !waiting.exists());

    // A cancelled estimate is not repeated.
    click(&mut window, "Estimates");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "a fit", |window| window.query_by_label_contains("Fitting").is_some());
    let order = std::fs::read_to_string(&pending).unwrap();
    click(&mut window, "Cancel estimate");
    wait_for(&mut window, "the end", |_| !pending.exists());
    drop(window);

    // An estimate that crashed several programs is dropped, with a message.
    std::fs::create_dir_all(pending.parent().unwrap()).unwrap();
    std::fs::write(&pending, order.replacen("\"crashes\": 0", "\"crashes\": 3", 1)).unwrap();
    assert_eq!(crashes(&pending), 3);
    let mut window = at_home(folder.path());
    wait_for(&mut window, "the word", |window| {
        let all = studio(window).session().activities();
        all.iter().any(|activity| format!("{:?}", activity.state).contains("ended in the midst of it 4 times"))
    });
    assert!(!pending.exists() && studio(&window).session().estimates().running.is_none());
    drop(window);

    // An estimate whose objects are on a missing disk waits for the disk.
    let objects = folder.path().join("objects.npy");
    let source = format!("\"stack:{}\"", objects.display());
    std::fs::create_dir_all(pending.parent().unwrap()).unwrap();
    std::fs::write(&pending, order.replacen("\"beads:0.02\"", &source, 1)).unwrap();
    let mut window = at_home(folder.path());
    wait_for(&mut window, "the word", |window| {
        let all = studio(window).session().activities();
        all.iter().any(|activity| format!("{:?}", activity.state).contains("goes on in the next window"))
    });
    assert!(pending.exists());
    drop(window);
    assert_eq!(crashes(&pending), 0, "nothing has crashed");
    let stripes = ndarray::Array3::from_shape_fn((12, 80, 80), |(n, r, c)| ((r + 3 * n + c % 5) % 9) as f32);
    lenslet_studio::formats::write_array(&objects, stripes.view()).unwrap();
    let mut window = at_home(folder.path());
    wait_for(&mut window, "the estimate", |window| {
        let found = &studio(window).session().estimates().finished;
        found.iter().any(|found| found.value.order.design.objects.is_read())
    });
    wait_for(&mut window, "the end", |_| !pending.exists());
}

#[test]
fn pixelcnn_follows_its_protocol_and_trials() {
    let folder = tempfile::tempdir().unwrap();
    let pending = folder.path().join("estimates/pending/order.json");
    let mut window = at_home(folder.path());
    // Requested trials and protocol of an estimate that is then cancelled.
    let ordered = |window: &mut Window| {
        click(window, "Start estimate");
        wait_for(window, "the order", |_| pending.exists());
        let order: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&pending).unwrap()).unwrap();
        click(window, "Cancel estimate");
        wait_for(window, "the end", |_| !pending.exists());
        ["trials", "protocol"].map(|name| order["order"]["request"][name].to_string())
    };
    click(&mut window, "Estimates");
    assert!(window.query_by_label("Trials").is_none() && window.query_by_label("Protocol").is_none());
    for name in ["Estimator", "PixelCNN", "Protocol", "paper protocol"] {
        click(&mut window, name);
    }
    type_number(&mut window, "Trials", "3");
    assert_eq!(ordered(&mut window), ["3", "\"paper\""]);
    // These settings do not apply to a bracket.
    click(&mut window, "Estimator");
    click(&mut window, "Bracket");
    assert_eq!(ordered(&mut window), ["1", "\"default\""]);
}

#[test]
fn upper_bound_of_whole_sensor_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(small_stripes(folder.path()));
    click(&mut window, "Estimates");
    for name in ["Estimator", "Causal model", "Patch", "Whole sensor"] {
        click(&mut window, name);
    }
    type_number(&mut window, "Steps of the fit", "20");
    click(&mut window, "Start estimate");
    wait_for(&mut window, "the estimate", |window| !studio(window).session().estimates().finished.is_empty());
    let estimate = studio(&window).session().estimates().finished[0].value.estimate.clone();
    assert!(estimate.bracket.is_none() && estimate.patch == [9, 9]);
    let [low, high] = estimate.interval_95;
    window.get_by_label(&format!("{:.3} [{low:.3}, {high:.3}] causal estimate", estimate.bits_per_pixel));
}

#[test]
fn estimate_of_camera_images_shows_its_settings_and_notes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seen.npy");
    // Stripes that move from image to image, in grey levels of half a photon.
    let grey = ndarray::Array3::from_shape_fn((12, 40, 40), |(n, r, c)| {
        let photons = if (r + 3 * n) % 9 < 3 { 60 } else { 20 };
        2.0 * (photons + (r * 31 + c * 17 + n * 7) % 9) as f32
    });
    lenslet_studio::formats::write_array(&path, grey.view()).unwrap();
    let mut window = open(Design::default());
    let calibration = Calibration { gain: 2.0, ..Calibration::default() };
    let order = MeasuredOrder { source: path.into(), calibration };
    let request = EstimateRequest::new(Estimator::GaussianStationary);
    studio(&window).session().order_estimate_of_images(order, request).unwrap();
    click(&mut window, "Estimates");
    wait_for(&mut window, "the estimate", |window| !studio(window).session().estimates().finished.is_empty());
    let finished = &studio(&window).session().estimates().finished[0].value;
    let notes = finished.estimate.notes.join("; ");
    assert!(
        notes.contains("photons are (grey level - 0) / 2") && notes.contains("in place of clean images"),
        "{notes}"
    );
    assert!(
        !finished.is_of(studio(&window).session().design(), &lenslet_studio::workbench::Live::default()),
        "it is not a number of the design"
    );
    window.get_by_label_contains("the scenes of");
    // The settings and notes of the command line are beside the number.
    window.get_by_label("gain 2, offset 0, bin 1");
    window.get_by_label_contains("note: photons are (grey level - 0) / 2");
    for note in &finished.estimate.notes {
        window.get_by_label(&format!("note: {note}"));
    }
    click(&mut window, "Copy command of estimate 1");
}
