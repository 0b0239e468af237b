//! Results of a run: its designs, every mask on the way with its numbers, and their curves.

use std::sync::Arc;

use egui::{Align, Color32, Layout, Slider, Ui, vec2};
use egui_plot::{FilledArea, Line, Plot, PlotPoints, Points, VLine};

use crate::design::{Checkpoint, IdealEvent, Objective, gain_summary};
use crate::information::{Bracket, Estimate, between, rounded, with_interval};
use crate::plural::counted;
use crate::studio::panels::parts::hints::COUNTS;
use crate::studio::state::optimize::OptimizeState;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::{Request, RunRequest};
use crate::studio::state::view::View;
use crate::studio::widgets::colours::{DENSITY, LOWER, TRAJECTORY};
use crate::studio::widgets::controls::name_widget;
use crate::workbench::{DesignRun, comparison_summary, curve_of, estimate_command, patches_of, run_command};

/// Height of the numbers and the slider above the curve of a run, points.
const ABOVE_PLOT: f32 = 84.0;
/// Width of the button beside that slider, points.
const NEWEST_WIDTH: f32 = 68.0;
/// Colour of the Tamura coefficient in plots.
const TAMURA: Color32 = Color32::from_rgb(120, 200, 120);
/// Colour of the number of lenslets in plots.
const LENSLETS: Color32 = Color32::from_rgb(200, 140, 220);

/// Shows the run, or the run of the chosen result. `room` points of height are visible without scrolling.
pub fn show(
    ui: &mut Ui,
    state: &mut OptimizeState,
    all: &DesignRun,
    room: f32,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    let chosen = state.chosen.clone();
    let run = chosen.as_deref().unwrap_or(all);
    ranking(ui, state, all, requests);
    comparison(ui, all, requests);
    if run.checkpoints.is_empty() {
        if run.is_active() {
            ui.weak("The first fit takes some seconds.");
        }
        return;
    }
    let last = run.checkpoints.len() - 1;
    let shown = state.checkpoint.unwrap_or(last).min(last);
    value(ui, run, shown, requests);
    rewind(ui, state, run, shown, view, requests);
    information_plot(ui, run, shown, (room - ABOVE_PLOT).clamp(120.0, 320.0));
    notes(ui, run, view);
    other_plots(ui, run);
}

/// Shows the score of a mask.
fn value(ui: &mut Ui, run: &DesignRun, shown: usize, requests: &mut Vec<Request>) {
    let checkpoint = &run.checkpoints[shown];
    ui.horizontal(|ui| {
        // The space beside the button in the corner.
        let room = vec2((ui.available_width() - 34.0).max(80.0), 20.0);
        ui.allocate_ui_with_layout(room, Layout::left_to_right(Align::Min).with_main_wrap(true), |ui| {
            ui.set_min_width(room.x);
            let (sign, hint) = match run.settings.objective {
                Objective::Density | Objective::PixelCnn => (
                    '\u{2264}',
                    "Upper bound on held-out objects, by the density model of the run. It is loose for sparse scenes; judge \
                     these by a lower bound.",
                ),
                Objective::Posterior => (
                    '\u{2265}',
                    "Lower bound on new scenes, by the decoder of the run. A bracket of the design adds annealed importance \
                     sampling and is narrower.",
                ),
            };
            ui.strong(format!("{sign} {}", with_interval(checkpoint.bits_per_pixel, checkpoint.interval_95)));
            let text = format!("bits per pixel at step {}", checkpoint.step);
            ui.label(text).on_hover_text(hint);
            // The newest lower bound up to this checkpoint.
            if let Some(lower) = run.checkpoints[..=shown].iter().rev().find_map(|checkpoint| checkpoint.lower) {
                let text = format!("\u{2265} {}", rounded(lower.bits_per_pixel));
                ui.colored_label(LOWER, text).on_hover_text(
                    "Lower bound on new scenes, by the pretrained decoder, at every fifth refit",
                );
            }
        });
        more(ui, run, requests);
    });
    let patch = patches_of(run.record.as_ref().map_or(run.settings.patch, |record| record.settings.patch));
    ui.weak(format!(
        "{patch}, {} ({:.1} effective), Tamura {:.3}",
        counted(checkpoint.distinct_lenslets, "lenslet"),
        checkpoint.effective_lenslets,
        checkpoint.tamura
    ))
    .on_hover_text(COUNTS);
}

/// Menu that copies, exports or opens parts of the run.
fn more(ui: &mut Ui, run: &DesignRun, requests: &mut Vec<Request>) {
    let more = ui.menu_button("...", |ui| {
        if ui.button("Export curve of run...").on_hover_text("As a table, CSV").clicked() {
            let curve = curve_of(run.settings.objective, &run.checkpoints);
            requests.push(Request::AskPath(PathPurpose::ExportCurve { curve, name: "run.csv" }));
        }
        if let Some(record) = &run.record {
            let export = ui.button("Export record of run...");
            if export.on_hover_text("All that is needed to reproduce the run, as JSON").clicked() {
                requests.push(Request::AskPath(PathPurpose::ExportRecord(Arc::clone(record))));
            }
        }
        let copy = ui.button("Copy command of run");
        if copy.on_hover_text("The command line that reproduces the run").clicked() {
            requests.push(Request::CopyCommand(run_command(&run.start, &run.settings, &run.events)));
        }
    });
    let hint = "Export the curve or the record of the run, or copy the command line that reproduces it";
    name_widget(&more.response.on_hover_text(hint), "More of the run");
}

/// Slider over all masks, from the start to the newest.
fn rewind(
    ui: &mut Ui,
    state: &mut OptimizeState,
    run: &DesignRun,
    mut shown: usize,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    let last = run.checkpoints.len() - 1;
    ui.horizontal(|ui| {
        let back = ui.small_button("Start").on_hover_text("The mask that the run started from");
        name_widget(&back, "Back to start");
        if back.clicked()
            && let Some(array) = run.start.encoder.lenslets()
        {
            requests.push(Request::Run(state.show_checkpoint(0, array, run)));
        }
        ui.spacing_mut().slider_width = (ui.available_width() - NEWEST_WIDTH).max(60.0);
        let slider = ui.add(Slider::new(&mut shown, 0..=last.max(1)).show_value(false));
        name_widget(&slider, "Rewind");
        if slider.changed() && shown <= last {
            requests.push(Request::Run(state.show_checkpoint(shown, &run.checkpoints[shown].array, run)));
        }
        let newest = ui.small_button("Newest").on_hover_text("The newest mask of the run");
        name_widget(&newest, "Show newest");
        if newest.clicked() {
            state.show_newest();
            let run = view.run.unwrap_or(run);
            let (array, start) = ((*run.array).clone(), Arc::clone(&run.start));
            requests.push(Request::Run(RunRequest::Preview { array, start, follow: run.is_active() }));
        }
    });
}

/// A curve over the steps of a run.
fn points(run: &DesignRun, value: &dyn Fn(&Checkpoint) -> f64) -> PlotPoints<'static> {
    run.checkpoints.iter().map(|checkpoint| [checkpoint.step as f64, value(checkpoint)]).collect()
}

/// Information with its interval. A line marks the shown mask.
fn information_plot(ui: &mut Ui, run: &DesignRun, shown: usize, height: f32) {
    let link = ui.scope_id().with("run");
    let (name, colour) = match run.settings.objective {
        Objective::Density | Objective::PixelCnn => ("upper bound", DENSITY),
        Objective::Posterior => ("lower bound", LOWER),
    };
    Plot::new("Information of the run")
        .height(height)
        .link_axis(link, [true, false])
        .include_x(0.0)
        .allow_scroll(false)
        .y_axis_label("bits per pixel")
        .show(ui, |plot| {
            let column =
                |value: &dyn Fn(&Checkpoint) -> f64| -> Vec<f64> { run.checkpoints.iter().map(value).collect() };
            let (low, high) =
                (column(&|checkpoint| checkpoint.interval_95[0]), column(&|checkpoint| checkpoint.interval_95[1]));
            let band = FilledArea::new("95 % interval", &column(&|checkpoint| checkpoint.step as f64), &low, &high);
            plot.add(band.fill_color(colour.gamma_multiply(0.35)));
            let values = || points(run, &|checkpoint| checkpoint.bits_per_pixel);
            plot.line(Line::new(name, values()).color(colour).width(2.0));
            plot.points(Points::new("refits", values()).color(colour).radius(2.0));
            if shown + 1 < run.checkpoints.len() {
                plot.vline(VLine::new("shown", run.checkpoints[shown].step as f64).color(TRAJECTORY).width(1.0));
            }
            let lower = run
                .checkpoints
                .iter()
                .filter_map(|checkpoint| Some([checkpoint.step as f64, checkpoint.lower?.bits_per_pixel]));
            let lower: Vec<[f64; 2]> = lower.collect();
            if !lower.is_empty() {
                plot.line(Line::new("lower bound", PlotPoints::from(lower.clone())).color(LOWER).width(2.0));
                plot.points(Points::new("lower bound", PlotPoints::from(lower)).color(LOWER).radius(2.5));
            }
        });
}

/// Curves of Tamura coefficient and number of lenslets.
fn other_plots(ui: &mut Ui, run: &DesignRun) {
    let link = ui.scope_id().with("run");
    for (name, axis, colour, value) in [
        (
            "effective lenslets",
            "lenslets",
            LENSLETS,
            &(|checkpoint: &Checkpoint| checkpoint.effective_lenslets) as &dyn Fn(&Checkpoint) -> f64,
        ),
        ("sensor Tamura", "sensor Tamura", TAMURA, &|checkpoint: &Checkpoint| checkpoint.tamura),
    ] {
        Plot::new(name)
            .height(90.0)
            .link_axis(link, [true, false])
            .include_x(0.0)
            .allow_scroll(false)
            .y_axis_label(axis)
            .show(ui, |plot| plot.line(Line::new(name, points(run, value)).color(colour).width(2.0)));
    }
}

/// Notes on the events of the run, such as reverts and relocations.
fn notes(ui: &mut Ui, run: &DesignRun, view: &View<'_>) {
    for line in IdealEvent::event_summary(&run.events) {
        ui.weak(line);
    }
    if let Some(sentence) = gain_summary(&run.checkpoints, run.settings.objective).filter(|_| !run.is_active()) {
        ui.weak(sentence);
    }
    // The object-entropy bound of this mask, for patches like those of the run.
    let is_shown = view.design.encoder.lenslets() == Some(&*run.array);
    let information = view.live.information.as_ref().filter(|information| {
        is_shown && view.is_current(information.revision) && run.settings.patch == Some(information.value.patch)
    });
    let ceiling = information.and_then(|information| information.value.ceiling_bits());
    if let (Some(ceiling), Some(last)) = (ceiling, run.checkpoints.last())
        && last.interval_95[0] > ceiling
    {
        let warning = "The estimate of the run exceeds the entropy bound. Judge the design by a bracket.";
        ui.colored_label(ui.visuals().warn_fg_color, warning);
    }
}

/// Results of finished starts, the best first.
fn ranking(ui: &mut Ui, state: &mut OptimizeState, run: &DesignRun, requests: &mut Vec<Request>) {
    for sentence in run.all_failures() {
        ui.colored_label(ui.visuals().error_fg_color, sentence);
    }
    for (place, result) in run.ranked.iter().enumerate() {
        let estimate = &result.estimate;
        ui.horizontal_wrapped(|ui| {
            let bits = match estimate.lower() {
                Some(lower) => between(lower, estimate.bits_per_pixel),
                None => format!("\u{2264} {}", with_interval(estimate.bits_per_pixel, estimate.interval_95)),
            };
            let text = format!("{}. {}: {bits}", place + 1, result.name);
            let open = ui.button(text).on_hover_text(format!(
                "Previews this result and shows its run. The numbers are bits per pixel on held-out objects, by models fitted for \
                 the score: a bracket, or the live estimate where no lower bound is known. The lower bound ranks the results, \
                 for the whole sensor where all have one. In patches: {}",
                with_intervals(estimate)
            ));
            name_widget(&open, &format!("Result {}", place + 1));
            if open.clicked() {
                requests.extend(state.show_result(run, place).map(Request::Run));
            }
            let copy = ui.small_button("Copy").on_hover_text("The command lines that reproduce these numbers");
            name_widget(&copy, &format!("Copy command of result {}", place + 1));
            if copy.clicked() {
                let commands = result.requests().into_iter().map(|request| estimate_command(&result.design, &request));
                let commands = commands.collect::<Result<Vec<_>, _>>().map(|lines| lines.join("\n"));
                requests.push(Request::CopyCommand(commands));
            }
            if let Some(sensor) = &result.sensor {
                let hint = format!("The same for whole measurements: {}", with_intervals(sensor));
                ui.weak(format!("sensor {}", short(sensor))).on_hover_text(hint);
            }
        });
    }
}

/// The best result beside its start and the heuristic layouts.
fn comparison(ui: &mut Ui, run: &DesignRun, requests: &mut Vec<Request>) {
    let has_result = run.ranked.first().is_some_and(|best| best.record.is_some());
    if has_result && !run.is_active() {
        let compare = ui.button("Compare with heuristic layouts");
        let hint = "Estimates the best result, its start and the nine published layouts in the same way, in patches and for \
                    the whole sensor: 22 fits of 20 s and their scores. It can be stopped and resumed";
        if compare.on_hover_text(hint).clicked() {
            requests.push(Request::Run(RunRequest::Compare));
        }
    }
    if let Some(sentence) = &run.comparison_failure {
        ui.colored_label(ui.visuals().error_fg_color, sentence);
    }
    let Some(study) = run.comparison.as_ref().filter(|study| !study.cells.is_empty()) else { return };
    egui::CollapsingHeader::new("Comparison").default_open(true).show(ui, |ui| {
        egui::Grid::new("comparison").num_columns(1 + study.settings.patches.len()).striped(true).show(ui, |ui| {
            ui.weak("bits per pixel");
            for &patch in &study.settings.patches {
                ui.weak(patches_of(patch));
            }
            ui.end_row();
            for design in &study.settings.designs {
                ui.label(&design.name);
                for &patch in &study.settings.patches {
                    let cell = study.cells.iter().find(|cell| cell.design == design.name && cell.patch == patch);
                    let estimate = cell.and_then(|cell| cell.estimate.as_ref());
                    let failure = cell.and_then(|cell| cell.failure.clone());
                    match (estimate, failure) {
                        (Some(estimate), _) => ui.label(short(estimate)).on_hover_text(with_intervals(estimate)),
                        (None, Some(sentence)) => ui.weak("failed").on_hover_text(sentence),
                        (None, None) => ui.weak("\u{2026}"),
                    };
                }
                ui.end_row();
            }
        });
        for sentence in comparison_summary(study) {
            ui.label(sentence);
        }
    });
}

/// An estimate with the intervals of its bounds, 95 %.
fn with_intervals(estimate: &Estimate) -> String {
    let upper = |bits, of| format!("upper bound {}", with_interval(bits, of));
    match &estimate.bracket {
        Some(Bracket {
            lower: Some(lower), lower_interval_95: Some(of_lower), upper: bits, upper_interval_95, ..
        }) => {
            format!("lower bound {}, {}", with_interval(*lower, *of_lower), upper(*bits, *upper_interval_95))
        }
        _ => upper(estimate.bits_per_pixel, estimate.interval_95),
    }
}

/// An estimate as a short text.
fn short(estimate: &Estimate) -> String {
    match estimate.lower() {
        Some(lower) => between(lower, estimate.bits_per_pixel),
        None => format!("\u{2264} {}", rounded(estimate.bits_per_pixel)),
    }
}
