//! The room of studies: a plan from a file, its cells, its plot, its files.

use std::path::{Path, PathBuf};

use egui::{Event, Modifiers, PointerButton, vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::Design;
use lenslet_studio::information::Estimator;
use lenslet_studio::reconstruction::DecoderKind;
use lenslet_studio::sensor::PatchSize;
use lenslet_studio::studies::plans::{
    Axes, Axis, EstimateSettings, Facet, Plan, PlotSettings, ReconstructionSettings, StudyDecoder, StudyMask,
};
use lenslet_studio::workbench::{StudyStatus, StudyView};

use super::home::at_home;
use super::waiting::wait_for;
use super::{Window, answer, click, close, lenslets, open, studio};

/// Distance of the places of a plot where the pointer looks for a point, less than twice the distance at which it finds one.
const STEP: f32 = 16.0;

/// Two masks imaging beads of two densities, in fractions of a second.
fn small_plan() -> Plan {
    let mask = vec![StudyMask::heuristic(2), StudyMask::heuristic(5)];
    let axes = Axes {
        patch: vec![PatchSize::Shape(6, 6)],
        estimator: vec![Estimator::GaussianStationary],
        ..Axes::new(mask, vec!["beads:0.008".into(), "beads:0.05".into()])
    };
    let plot = PlotSettings {
        x: Facet::Density,
        lines: Facet::Axis(Axis::Mask),
        panels: None,
        logarithmic: true,
        optima: true,
        scatter: false,
    };
    let estimates = EstimateSettings { patches_train: 200, patches_test: 40, ..EstimateSettings::default() };
    Plan { estimates, ..Plan::new("small", "Two layouts", axes, plot) }
}

fn write_plan(folder: &Path, plan: &Plan) -> PathBuf {
    let file = folder.join("small.toml");
    plan.save(&file).unwrap();
    file
}

fn study(window: &Window) -> StudyView {
    studio(window).session().study()
}

/// Waits until the study is read or computed.
fn wait_until_idle(window: &mut Window) {
    wait_for(window, "the study", |window| study(window).status == Some(StudyStatus::Idle));
    window.run_steps(2);
}

fn shows(window: &Window, text: &str) -> bool {
    window.query_all_by_label_contains(text).next().is_some()
}

/// Begins the plan in a folder.
fn begin(window: &mut Window, plan: &Path, folder: &Path) {
    click(window, "Studies");
    click(window, "Open plan");
    answer(window, plan, "Open");
    click(window, "Quick study");
    click(window, "New study");
    answer(window, folder, "Use");
    wait_until_idle(window);
}

#[test]
fn a_plan_fills_its_cells_and_its_plot() {
    let place = tempfile::tempdir().unwrap();
    let (plan, folder) = (write_plan(place.path(), &small_plan()), place.path().join("study"));
    let home = tempfile::tempdir().unwrap();
    let mut window = at_home(home.path());
    begin(&mut window, &plan, &folder);
    assert!(shows(&window, "0 of 4 cells done") && shows(&window, "No cell is done yet"));
    click(&mut window, "Start study");
    wait_until_idle(&mut window);
    assert!(shows(&window, "4 of 4 cells done"), "{:?}", study(&window));
    window.get_by_label("Study plot");
    assert!(window.get_by_label("Start study").accesskit_node().is_disabled());
    // A cell opens its design.
    click(&mut window, "Show study cells");
    click(&mut window, "Cell beads:0.05, heuristic:2, 6 x 6 px, gaussian-stationary");
    window.run_steps(4);
    let design = studio(&window).session().design();
    assert_eq!((lenslets(&window).len(), design.objects.to_string().as_str()), (2, "beads:0.05"));
    // Plot and table are written.
    for (entry, file, beginning) in [("Plot...", "plot.svg", "<svg"), ("Table...", "table.csv", "id,objects,mask")] {
        click(&mut window, "Export study");
        click(&mut window, entry);
        let file = place.path().join(file);
        answer(&mut window, &file, "Export");
        wait_for(&mut window, "the file", |_| file.exists());
        assert!(std::fs::read_to_string(&file).unwrap().starts_with(beginning));
    }
    // The study outlives the window.
    close(&mut window);
    drop(window);
    let mut window = at_home(home.path());
    wait_until_idle(&mut window);
    click(&mut window, "Studies");
    assert!(shows(&window, "4 of 4 cells done"));
}

#[test]
fn psnr_is_drawn_against_information_and_a_point_opens_its_design() {
    let place = tempfile::tempdir().unwrap();
    let mut plan = small_plan();
    plan.axes.decoder = vec![StudyDecoder::Kind(DecoderKind::Linear), StudyDecoder::Kind(DecoderKind::RichardsonLucy)];
    let of_four = ReconstructionSettings { test_objects: 4, ..ReconstructionSettings::of(DecoderKind::Linear) };
    plan.reconstruction = Some(of_four);
    plan.plot = PlotSettings {
        x: Facet::Axis(Axis::Mask),
        lines: Facet::Axis(Axis::Decoder),
        panels: Some(Facet::Axis(Axis::Objects)),
        logarithmic: false,
        optima: false,
        scatter: true,
    };
    let (plan, folder) = (write_plan(place.path(), &plan), place.path().join("study"));
    let mut window = open(Design::default());
    begin(&mut window, &plan, &folder);
    click(&mut window, "Start study");
    wait_until_idle(&mut window);
    assert!(shows(&window, "8 of 8 cells done"), "{:?}", study(&window));
    // The pointer finds a point of a panel.
    let plot = window.get_by_label("Study plot").rect();
    let (rows, cols) = ((plot.height() / STEP) as usize, (plot.width() / STEP) as usize);
    let places = (0..rows * cols).map(|index| ((index % cols) as f32 * STEP, (index / cols) as f32 * STEP));
    let found = places.into_iter().find(|&(x, y)| {
        window.hover_at(plot.min + vec2(x, y));
        window.run_steps(2);
        shows(&window, "bits per pixel") && shows(&window, "dB at")
    });
    let (x, y) = found.expect("a point of the plot");
    let place = plot.min + vec2(x, y);
    for pressed in [true, false] {
        let (button, modifiers) = (PointerButton::Primary, Modifiers::NONE);
        window.input_mut().events.push(Event::PointerButton { pos: place, button, pressed, modifiers });
        window.step();
    }
    window.run_steps(4);
    let design = studio(&window).session().design();
    assert!(design.objects.is_beads() && design.objects != Design::default().objects, "{:?}", design.objects);
}

#[test]
fn a_study_is_paused_and_stopped() {
    let place = tempfile::tempdir().unwrap();
    // No cell ends before the test does.
    let mut plan = small_plan();
    plan.axes.estimator = vec![Estimator::Causal];
    plan.estimates.seconds = Some(3600.0);
    let (plan, folder) = (write_plan(place.path(), &plan), place.path().join("study"));
    let mut window = open(Design::default());
    begin(&mut window, &plan, &folder);
    for _ in 0..2 {
        click(&mut window, "Start study");
        wait_for(&mut window, "a cell", |window| study(window).running.is_some());
        click(&mut window, "Pause study");
        assert_eq!(study(&window).status, Some(StudyStatus::Paused));
        click(&mut window, "Resume study");
        assert_eq!(study(&window).status, Some(StudyStatus::Running));
        click(&mut window, "Stop study");
        let view = study(&window);
        assert!(view.status == Some(StudyStatus::Idle) && view.running.is_none());
        // What is left is computed later.
        assert_eq!(view.open.unwrap().done(), 0);
    }
}

#[test]
fn folders_and_plans_that_cannot_be_used_are_told() {
    let place = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    click(&mut window, "Studies");
    click(&mut window, "Open study");
    answer(&mut window, place.path(), "Open");
    wait_for(&mut window, "the refusal", |window| matches!(study(window).status, Some(StudyStatus::Failed(_))));
    window.run_steps(2);
    assert!(shows(&window, "no plan.toml"));
    let broken = place.path().join("broken.toml");
    std::fs::write(&broken, "mask = 3").unwrap();
    click(&mut window, "Open plan");
    answer(&mut window, &broken, "Open");
    assert!(shows(&window, "broken.toml: expected a plan"));
    // A published plan of image sets asks for their files.
    click(&mut window, "Plan");
    click(&mut window, "s1");
    window.get_by_label("File of mnist");
    click(&mut window, "New study");
    window.run_steps(2);
    assert!(shows(&window, "objects cifar10: expected its file"));
}
