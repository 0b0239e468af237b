//! Runs in the window: started, previewed, paused, stopped, and undone. Undo of other commands.

use std::time::Duration;

use super::home::{at_home, at_home_sized};
use super::waiting::{stop_run, wait_for};
use super::*;
use egui::accesskit::Toggled;
use egui_kittest::kittest::NodeT;
use lenslet_studio::design::{IdealOptimizer, IdealSettings, Objective, Preset};
use lenslet_studio::evaluation::{DensityModel, EstimateRequest, WeightsFiles, estimate};
use lenslet_studio::information::Protocol;
use lenslet_studio::optics::{heuristic_layout, random_layout};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::studies::{Machine, Study, StudyCell};
use lenslet_studio::workbench::{
    DesignRun, RankedStart, RunQueue, RunStatus, RunStore, Start, run_ideal, score_settings,
};

/// Room for the whole form of a run.
pub const TALL: Vec2 = Vec2::new(1280.0, 1600.0);

/// The present or last run.
fn run(window: &Window) -> DesignRun {
    studio(window).session().run().expect("it was started")
}

/// Opens the form of a run in a tall window. The run has a density model, which searches for no better places, and fits of a few steps.
/// It has a checkpoint every second step.
pub fn shorten_run(window: &mut Window, patch: &str) {
    for name in ["Optimize", "Details", "density", patch, "Schedule and rates"] {
        click(window, name);
    }
    for (field, steps) in [("Refit every", "2"), ("First fit", "4"), ("Refit", "2"), ("Last fit", "2")] {
        type_number(window, field, steps);
    }
    // The results below the form have room again.
    click(window, "Details");
}

/// Starts a run in place of the last one, if there is one.
pub fn start_run(window: &mut Window) {
    click(window, "Start run");
    if window.query_by_label("Start new run").is_some() {
        click(window, "Start new run");
    }
}

#[test]
fn the_schedule_of_a_run_is_chosen_and_goes_back_to_that_of_the_preset() {
    let mut window = open_sized(Design::default(), TALL);
    let started = |window: &mut Window| {
        start_run(window);
        let settings = run(window).settings;
        stop_run(window);
        assert_eq!(run(window).status, RunStatus::Stopped);
        assert_eq!(settings.objective, Objective::Posterior, "the prior of beads is known");
        (settings.refit_every, settings.rates.position, settings.decay_fraction)
    };
    for name in ["Optimize", "Details", "16 px", "Schedule and rates"] {
        click(&mut window, name);
    }
    type_number(&mut window, "Refit every", "7");
    type_number(&mut window, "Position rate", "0.25");
    type_number(&mut window, "Decay over", "50");
    assert_eq!(started(&mut window), (7, 0.25, 0.5));
    click(&mut window, "Reset to preset");
    let preset = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
    assert_eq!(started(&mut window), (preset.refit_every, preset.rates.position, preset.decay_fraction));
}

#[test]
fn all_of_the_order_of_a_run_can_be_reached_in_a_small_window() {
    let mut window = open_sized(Design::default(), Vec2::new(900.0, 640.0));
    for name in ["Optimize", "Details", "Schedule and rates"] {
        click(&mut window, name);
    }
    let bottom = |window: &Window| window.get_by_label("Start run").rect().bottom();
    assert!(bottom(&window) > 640.0, "it is below what is seen: {}", bottom(&window));
    window.get_by_label("Start run").scroll_to_me();
    window.run_steps(40);
    assert!(bottom(&window) < 640.0, "{}", bottom(&window));
}

#[test]
fn run_is_started_paused_stopped_accepted_and_undone() {
    let mut window = open_sized(Design::default(), TALL);
    shorten_run(&mut window, "16 px");
    let before = lenslets(&window);
    click(&mut window, "Start run");
    wait_for(&mut window, "the third refit", |window| run(window).checkpoints.len() >= 3);
    // The window shows the mask of the run and its results. The design is unchanged.
    assert_ne!(lenslets(&window), before);
    assert!(studio(&window).session().is_following() && studio(&window).session().is_previewing());
    assert_eq!(open_lenslets(&window), before);
    assert!(!studio(&window).session().is_dirty());
    let now = run(&window);
    assert!(now.checkpoints[0].bits_per_pixel > 0.1 && now.checkpoints[2].step == 4);
    assert_eq!(now.position_gradients.len(), before.len(), "arrows show where what it climbs pulls them");
    assert!(window.query_by_label("Rewind").is_some());

    // A paused run takes no step: the tests of its thread show that. The step under way may still end.
    click(&mut window, "Pause run");
    assert_eq!(run(&window).status, RunStatus::Paused);
    let paused = run(&window).step;
    click(&mut window, "Resume run");
    assert_eq!(run(&window).status, RunStatus::Running);
    wait_for(&mut window, "more steps", |window| run(window).step > paused + 1);

    stop_run(&mut window);
    assert_eq!(run(&window).status, RunStatus::Stopped);
    let stopped_at = run(&window).step;
    let stopped = lenslets(&window);
    assert_ne!(stopped, before);
    click(&mut window, "Back to start");
    assert_eq!(lenslets(&window), before);
    click(&mut window, "Show newest");
    assert_eq!(lenslets(&window), stopped);

    // A preview changes nothing, and accepting it is one step.
    menu(&mut window, &["Edit", "Undo look at the run"]);
    assert_eq!(lenslets(&window), before);
    click(&mut window, "Show newest");
    assert!(!studio(&window).session().is_dirty());
    click(&mut window, "Accept this mask");
    assert_eq!(open_lenslets(&window), stopped);
    assert!(studio(&window).session().is_dirty() && !studio(&window).session().is_previewing());
    assert!(!studio(&window).session().has_unsaved_result());
    menu(&mut window, &["Edit", "Undo optimize the mask"]);
    assert_eq!(lenslets(&window), before);
    assert!(!studio(&window).session().is_dirty(), "what was saved is there again");
    assert!(studio(&window).session().has_unsaved_result(), "what was accepted is gone");
    menu(&mut window, &["Edit", "Redo optimize the mask"]);
    assert_eq!(lenslets(&window), stopped);

    // It resumes from where it stopped. Another run does not replace it without a question.
    click(&mut window, "Start run");
    window.get_by_label("Discard the last run?");
    click(&mut window, "Cancel");
    assert_eq!(lenslets(&window), stopped);
    // Its later results can replace the accepted mask.
    click(&mut window, "Resume");
    wait_for(&mut window, "the next steps", |window| run(window).step > stopped_at);
    stop_run(&mut window);
    click(&mut window, "Start run");
    click(&mut window, "Start new run");
    assert!(run(&window).step < stopped_at && run(&window).checkpoints.len() < 3, "it is another run");
    wait_for(&mut window, "the first step", |window| run(window).step > 0);
    stop_run(&mut window);

    // A mask may also become a new design.
    click(&mut window, "Show newest");
    let newest = lenslets(&window);
    click(&mut window, "Open as new design");
    click(&mut window, "Discard");
    let session = studio(&window).session();
    assert_eq!((open_lenslets(&window), session.undoes(), session.is_previewing()), (newest, None, false));
}

#[test]
fn masks_of_a_run_push_no_edits_out_of_the_history() {
    let mut window = open_sized(Design::default(), TALL);
    shorten_run(&mut window, "16 px");
    click(&mut window, "Start run");
    wait_for(&mut window, "some masks", |window| run(window).step >= 8);
    stop_run(&mut window);
    click(&mut window, "End preview");
    settle(&mut window);
    menu(&mut window, &["View", "Panel", "Show History"]);
    // At the start, at the start of the run, and when it was shown again.
    let is_listed = |count: usize| window.query_by_label(&format!("{count} designs")).is_some();
    assert!((2..=5).any(is_listed), "there are more");
}

#[test]
fn an_edit_takes_over_from_a_run_up_a_density_model() {
    let mut window = open_sized(Design::default(), TALL);
    shorten_run(&mut window, "16 px");
    click(&mut window, "Start run");
    wait_for(&mut window, "the first steps", |window| run(window).step >= 2);
    let settings = run(&window).settings;
    assert_eq!((settings.objective, settings.patch, settings.first_fit), (Objective::Density, Some((16, 16)), 4));
    let usual = density_for(&Design::default());
    let IdealSettings { patch, refit_every, first_fit, refit, last_fit, .. } = usual;
    assert_eq!(IdealSettings { patch, refit_every, first_fit, refit, last_fit, ..settings }, usual);
    click(&mut window, "Add lenslet");
    assert!(!studio(&window).session().is_following() && !studio(&window).session().is_previewing());
    let edited = lenslets(&window);
    assert_eq!(edited.len(), 10);
    let step = run(&window).step;
    wait_for(&mut window, "the run to go on", |window| run(window).step > step + 1);
    assert_eq!(lenslets(&window), edited);
    stop_run(&mut window);

    // The design is no longer the start of the run. A mask of the run can be opened as a new design.
    click(&mut window, "Show newest");
    let newest = lenslets(&window);
    click(&mut window, "Add lenslet");
    assert_eq!(lenslets(&window), newest, "an edit of it would be lost with the design, or the design with it");
    click(&mut window, "End preview");
    assert_eq!(lenslets(&window), edited);
    click(&mut window, "Show newest");
    click(&mut window, "Accept this mask");
    window.get_by_label("Save your changes?");
    click(&mut window, "Cancel");
    assert_eq!(open_lenslets(&window), edited);
    click(&mut window, "Accept this mask");
    click(&mut window, "Discard");
    let session = studio(&window).session();
    assert_eq!((open_lenslets(&window), session.undoes(), session.is_dirty()), (newest, None, true));
}

#[test]
fn what_is_done_beside_a_run_leaves_both_alone_and_its_masks_outlive_the_window() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home_sized(folder.path(), TALL);
    let before = lenslets(&window);
    click(&mut window, "Lock lenslet 2");
    // The bounds of the run are those of the patches that other bounds have.
    shorten_run(&mut window, "32 px");
    click(&mut window, "Start from");
    click(&mut window, "Random lenslets");
    type_number(&mut window, "Random lenslets", "4");
    click(&mut window, "Start run");
    wait_for(&mut window, "the second refit", |window| run(window).checkpoints.len() >= 2);
    assert_eq!((lenslets(&window).len(), open_lenslets(&window)), (4, before.clone()));
    // The bounds of the run for its mask are among the numbers.
    wait_for(&mut window, "the bounds of the run", |window| {
        window.query_all_by_label_contains("run, step").next().is_some()
    });
    // The scene is that of the design.
    click(&mut window, "Scene");
    click(&mut window, "Read noise");
    assert!(!studio(&window).session().is_previewing());
    assert_eq!(lenslets(&window), before);
    assert_eq!(studio(&window).session().undoes(), Some("Set noise to read:5"));
    window.get_by_label("Lock lenslet 2").accesskit_node().toggled().filter(|on| *on == Toggled::True).unwrap();
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    settle(&mut window);
    click(&mut window, "Optimize");
    stop_run(&mut window);
    click(&mut window, "Show newest");
    let newest = lenslets(&window);
    drop(window);

    // The result is there in the next session. The window asks about it until it is accepted.
    let mut window = at_home(folder.path());
    window.get_by_label_contains("A run was interrupted");
    click(&mut window, "Optimize");
    click(&mut window, "Show newest");
    assert_eq!(lenslets(&window).len(), newest.len());
    click(&mut window, "Start run");
    window.get_by_label("Discard the last run?");
    click(&mut window, "Cancel");
    click(&mut window, "Accept this mask");
    assert!(studio(&window).session().is_dirty() && studio(&window).session().undoes().is_none());
    assert_eq!(open_lenslets(&window).len(), newest.len());
}

#[test]
fn run_starts_from_a_layout_or_a_seed_and_ends_after_its_steps() {
    let mut window = open_sized(Design::default(), TALL);
    shorten_run(&mut window, "16 px");
    click(&mut window, "Start from");
    click(&mut window, "Heuristic layout");
    type_number(&mut window, "Heuristic lenslets", "2");
    click(&mut window, "Start run");
    assert_eq!(run(&window).start.encoder, Encoder::Lenslets(heuristic_layout(2)));
    stop_run(&mut window);
    click(&mut window, "Start from");
    click(&mut window, "Random lenslets");
    type_number(&mut window, "Random lenslets", "3");
    type_number(&mut window, "Seed of the start", "7");
    type_number(&mut window, "Steps", "2");
    start_run(&mut window);
    assert_eq!((&run(&window).start.encoder, run(&window).settings.seed), (&Encoder::Lenslets(random_layout(3, 7)), 7));
    // The result of its last step is scored.
    wait_for(&mut window, "the score", |window| run(window).is_scoring);
    assert_eq!((run(&window).step, run(&window).checkpoints.len()), (2, 2));
    window.get_by_label("Stop scoring");
}

/// Stores two starts in a folder, as if they had finished in an earlier session. Returns their results.
fn two_results_in(folder: &Path) -> Vec<RankedStart> {
    let settings = IdealSettings {
        patch: Some((6, 6)),
        steps: 4,
        refit_every: 2,
        first_fit: 20,
        last_fit: 20,
        ..density_for(&Design::default())
    };
    let starts: Vec<Start> = [1, 2].map(|seed| Start::random(&Design::default(), 3, seed)).into();
    let request = EstimateRequest {
        model: DensityModel::Stationary,
        protocol: Protocol::Default,
        patch: Some((6, 6)),
        patches_train: 80,
        patches_test: 20,
        fresh: false,
        trials: 1,
        keep: None,
        weights: WeightsFiles::default(),
    };
    let never = CancelToken::new();
    let kept = RunStore::in_folder(&folder.join("run")).unwrap();
    let found = |(at, start): (usize, &Start)| {
        let keep = &mut |ideal: &IdealOptimizer<'_>| kept.store(at, &ideal.to_bytes()?);
        let (reading, progress) = (&mut never.clone(), &mut never.clone());
        let record = run_ideal(&start.design, &settings, None, reading, keep, progress).unwrap();
        let design = std::sync::Arc::new(record.design());
        let estimate = estimate(&design, &request, &mut never.clone()).unwrap();
        let (name, record) = (start.name.clone(), Some(std::sync::Arc::new(record)));
        RankedStart {
            name,
            design,
            sensor: Some(estimate.clone()),
            estimate,
            is_scored: true,
            sensor_failure: None,
            record,
        }
    };
    let ranked: Vec<RankedStart> = starts.iter().enumerate().map(found).collect();
    let (starts, settings, found) = (starts, settings.clone(), ranked.clone());
    let order = RunQueue { at: 1, ranked: found, ..RunQueue::new(starts, settings) };
    kept.note(&order).unwrap();
    ranked
}

/// Stores a comparison of a result that was interrupted after its first mask.
fn comparison_in(folder: &Path, result: &RankedStart) {
    let record = result.record.as_ref().unwrap();
    let layouts: Vec<usize> = (1..=9).collect();
    let settings = score_settings(record, &layouts, Duration::from_secs(20)).unwrap();
    let cell = StudyCell {
        objects: record.start.objects.to_string(),
        design: settings.designs[0].name.clone(),
        patch: settings.patches[0],
        published: None,
        estimate: Some(result.estimate.clone()),
        failure: None,
        machine: Machine::here(),
        patch_information: Vec::new(),
        difference_to_reference: None,
    };
    let mut study = Study::begin(settings).unwrap().record().clone();
    study.cells.push(cell);
    std::fs::create_dir(folder.join("run/score")).unwrap();
    std::fs::write(folder.join("run/score/study.json"), serde_json::to_vec(&study).unwrap()).unwrap();
}

/// Number of masks that are compared so far.
fn compared(window: &Window) -> usize {
    run(window).comparison.as_ref().map_or(0, |study| study.cells.len())
}

#[test]
#[ignore = "takes half a minute; run with --ignored"]
fn comparison_estimates_one_mask_after_the_other() {
    let folder = tempfile::tempdir().unwrap();
    two_results_in(folder.path());
    let mut window = at_home(folder.path());
    click(&mut window, "Optimize");
    click(&mut window, "Compare with heuristic layouts");
    wait_for(&mut window, "the first numbers", |window| compared(window) >= 1);
    studio(&window).session().stop_run();
    wait_for(&mut window, "the end", |window| !run(window).is_active());
    let before = compared(&window);
    drop(window);
    let window = at_home(folder.path());
    assert_eq!(compared(&window), before);
}

#[test]
fn results_keep_the_runs_that_led_to_them_and_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let ranked = two_results_in(folder.path());
    comparison_in(folder.path(), &ranked[0]);
    let mut window = at_home_sized(folder.path(), TALL);
    click(&mut window, "Optimize");
    // The run of each result is there, from its start to its end.
    for (place, result) in ranked.iter().enumerate() {
        click(&mut window, &format!("Result {}", place + 1));
        assert_eq!(lenslets(&window), result.design.encoder.lenslets().unwrap().lenslets);
        click(&mut window, "Back to start");
        let record = result.record.as_ref().unwrap();
        assert_eq!(lenslets(&window), record.start.encoder.lenslets().unwrap().lenslets);
        window.get_by_label_contains("bits per pixel at step 0");
    }

    assert_eq!(compared(&window), 1);
    click(&mut window, "Compare with heuristic layouts");
    assert_eq!(run(&window).status, RunStatus::Running);
    wait_for(&mut window, "the next mask", |window| {
        run(window).doing.is_some_and(|(doing, _)| doing.starts_with("Comparing masks: "))
    });
    click(&mut window, "Stop scoring");
    wait_for(&mut window, "the end", |window| !run(window).is_active());
    assert_eq!((run(&window).status, run(&window).ranked.len()), (RunStatus::Finished, 2), "as it was");
    assert_eq!(compared(&window), 1, "it goes on from where it was");
    window.get_by_label("heuristic:9");
    window.get_by_label("32 x 32 px patches");
    drop(window);

    // It is there in the next session.
    let mut window = at_home(folder.path());
    assert_eq!(compared(&window), 1);

    // A result is accepted and saved. The other is still there, and either can be extended.
    click(&mut window, "Optimize");
    click(&mut window, "Result 1");
    click(&mut window, "Accept this mask");
    let path = folder.path().join("accepted.json");
    menu(&mut window, &["File", "Save design as..."]);
    answer(&mut window, &path, "Save");
    wait_for(&mut window, "the file", |window| !studio(window).session().is_dirty());
    drop(window);
    let mut window = at_home(folder.path());
    assert!(!studio(&window).session().has_unsaved_result(), "it is in a file");
    click(&mut window, "Optimize");
    click(&mut window, "Start run");
    window.get_by_label_contains("It has 2 results.");
    click(&mut window, "Cancel");
    // Each result can be opened as a design, from which a new run starts.
    assert!(window.query_by_label("Extend").is_none() && window.query_by_label("Resume").is_none());
}

/// Lenslets of the open design, even during a preview.
fn open_lenslets(window: &Window) -> Vec<Lenslet> {
    let design = studio(window).session().open_design();
    design.encoder.lenslets().map(|array| array.lenslets.clone()).unwrap_or_default()
}

fn density_for(design: &Design) -> IdealSettings {
    IdealSettings::new(Preset::Default, Objective::Density, design.seed)
}

#[test]
fn what_a_run_climbs_suits_the_objects() {
    let mut window = open(Design::default());
    click(&mut window, "Optimize");
    click(&mut window, "Details");
    let offered = |window: &Window| !window.get_by_label("posterior").accesskit_node().is_disabled();
    assert!(offered(&window));
    // The published procedure optimizes the bound of a PixelCNN.
    click(&mut window, "Preset");
    click(&mut window, "paper");
    assert!(!offered(&window));
    click(&mut window, "Start run");
    assert_eq!(run(&window).settings.objective, Objective::PixelCnn);
    stop_run(&mut window);
    click(&mut window, "Preset");
    click(&mut window, "default");
    assert!(offered(&window));
    // Images have no known prior.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("objects.npy");
    let objects = ndarray::Array3::from_shape_fn((20, 96, 96), |(n, r, c)| ((n + r * c) % 7) as f32);
    lenslet_studio::formats::write_array(&path, objects.view()).unwrap();
    click(&mut window, "Scene");
    click(&mut window, "Open objects...");
    answer(&mut window, &path, "Open");
    click(&mut window, "Optimize");
    assert!(!offered(&window));
}

#[test]
fn gestures_are_undone_one_by_one() {
    let mut window = open(Design::default());
    let before = lenslets(&window);
    let from = window.get_by_label("Lenslet 1").rect().center();
    drag(&mut window, from, Vec2::new(40.0, 15.0), egui::PointerButton::Primary);
    settle(&mut window);
    let dragged = lenslets(&window);
    assert_ne!(dragged, before);
    click(&mut window, "Add lenslet");
    assert_eq!(lenslets(&window).len(), 10);
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    window.run_steps(4);
    assert_eq!(lenslets(&window), dragged);
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    window.run_steps(4);
    assert_eq!(lenslets(&window), before, "a drag is one step");
    window.key_press_modifiers(Modifiers::COMMAND | Modifiers::SHIFT, Key::Z);
    window.run_steps(4);
    assert_eq!(lenslets(&window), dragged);
}
