//! Runs that optimize the mask: what to start, how it goes, and every mask on the way.

use std::sync::Arc;

use egui::{Align, Color32, ComboBox, DragValue, Layout, ProgressBar, Slider, Ui, vec2};
use egui_plot::{FilledArea, Line, Plot, PlotPoints, Points, VLine};

use super::dialogs::Purpose;
use super::image_view::name_widget;
use super::information_panel::{DENSITY, LOWER, between, interval, rounded};
use super::lenslet_table::COUNTS;
use super::messages::Severity;
use super::state::{Leave, State};
use super::trails::TRAIL;
use crate::design::{Frame, Free, IdealEvent, IdealSettings, Objective, Preset};
use crate::objects::ObjectSource;
use crate::optics::{Encoder, random_layout};
use crate::workbench::{
    Design, DesignRun, RunStatus, Start, curve_of, estimate_command, patches_of, run_command, spoken,
};

/// Height of what stands above the curve of a run, its numbers and the slider, in points.
const ABOVE_PLOT: f32 = 84.0;
/// Width of the button beside that slider, in points.
const NEWEST_WIDTH: f32 = 68.0;
/// Random starts of one order.
const STARTS: u64 = 8;
/// Colour of the Tamura coefficient in plots.
const TAMURA: Color32 = Color32::from_rgb(120, 200, 120);
/// Colour of the number of lenslets in plots.
const LENSLETS: Color32 = Color32::from_rgb(200, 140, 220);

/// What a run starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum From {
    Design,
    Random,
    RandomStarts,
}

impl From {
    const ALL: [Self; 3] = [Self::Design, Self::Random, Self::RandomStarts];

    fn name(self) -> &'static str {
        match self {
            Self::Design => "This design",
            Self::Random => "Random lenslets",
            Self::RandomStarts => "8 random starts",
        }
    }
}

/// What the form asks for.
pub struct OptimizeForm {
    from: From,
    /// Lenslets of random starts.
    count: usize,
    settings: IdealSettings,
    /// What the mask climbs, where a person chose.
    objective: Option<Objective>,
    /// The frame that is looked at; the newest one where none was chosen.
    frame: Option<usize>,
    /// Whether the mask shows the ways of the lenslets.
    pub trails: bool,
}

impl Default for OptimizeForm {
    fn default() -> Self {
        let settings = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
        Self { from: From::Design, count: 25, settings, objective: None, frame: None, trails: true }
    }
}

impl OptimizeForm {
    /// Settings that suit the objects.
    fn turn_to(&mut self, preset: Preset, objects: &ObjectSource) {
        // What was chosen for beads says nothing of other objects.
        let chosen = self.objective.filter(|&objective| offered(objective, preset, objects));
        let objective = chosen.unwrap_or_else(|| Objective::usual(preset, objects));
        if (self.settings.preset, self.settings.objective) != (preset, objective) {
            self.settings = self.settings.clone().turned_to(preset, objective);
        }
    }
}

/// Shows the panel.
pub fn show(ui: &mut Ui, state: &mut State) {
    let form = &mut state.optimize_form;
    form.turn_to(form.settings.preset, &state.bench.design().objects);
    let run = state.run.clone();
    match &run {
        Some(run) if run.is_active() => progress(ui, state, run),
        _ => order(ui, state, run.as_ref()),
    }
    ui.separator();
    let Some(run) = run else {
        ui.weak(
            "Lenslets move, merge, fade and sharpen while the information of their measurements climbs. The mask of \
             the run is shown in place of your design, which stays as it is until you accept one.",
        );
        return;
    };
    if let RunStatus::Failed(sentence) = &run.status {
        ui.colored_label(ui.visuals().error_fg_color, sentence);
    }
    let room = ui.available_height();
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ranking(ui, state, &run);
        if run.frames.is_empty() {
            if run.is_active() {
                ui.weak("The first fit takes some seconds.");
            }
            return;
        }
        let last = run.frames.len() - 1;
        let shown = state.optimize_form.frame.unwrap_or(last).min(last);
        value(ui, state, &run, shown);
        rewind(ui, state, &run, shown);
        information_plot(ui, &run, shown, (room - ABOVE_PLOT).clamp(120.0, 320.0));
        notes(ui, state, &run);
        other_plots(ui, &run);
    });
}

/// What to start.
fn order(ui: &mut Ui, state: &mut State, last: Option<&DesignRun>) {
    let form = &mut state.optimize_form;
    ui.horizontal_wrapped(|ui| {
        let response = ComboBox::from_id_salt("start from")
            .selected_text(form.from.name())
            .width(112.0)
            .show_ui(ui, |ui| {
                for from in From::ALL {
                    ui.selectable_value(&mut form.from, from, from.name());
                }
            })
            .response;
        name_widget(&response, "Start from");
        if form.from != From::Design {
            let count = ui.add(DragValue::new(&mut form.count).range(1..=64).suffix(" lenslets"));
            name_widget(&count, "Random lenslets");
        }
        let response = ComboBox::from_id_salt("preset")
            .selected_text(form.settings.preset.to_string())
            .width(72.0)
            .show_ui(ui, |ui| {
                for (preset, hint) in [
                    (Preset::Default, "Small warm refits of what the mask climbs, patches of 32 x 32 px"),
                    (
                        Preset::Paper,
                        "Steps, batches, rates (those for beads) and refits as published, patches of 16 x 16 px; takes hours",
                    ),
                ] {
                    let chosen = form.settings.preset == preset;
                    if ui.selectable_label(chosen, preset.to_string()).on_hover_text(hint).clicked() {
                        form.turn_to(preset, &state.bench.design().objects);
                    }
                }
            })
            .response;
        name_widget(&response, "Preset");
        let steps = DragValue::new(&mut form.settings.steps).range(1..=100_000).suffix(" steps");
        name_widget(&ui.add(steps), "Steps");
    });
    details(ui, state);
    ui.horizontal_wrapped(|ui| {
        let start = ui.add_enabled(can_start(state), egui::Button::new("Start run"));
        if start.on_disabled_hover_text("This design has no lenslets to move; start from random ones").clicked() {
            state.guard(&ui.ctx().clone(), Leave::Run);
        }
        let resumable = last.is_some_and(|run| !run.is_active());
        if resumable && ui.button("Go on").on_hover_text("Takes the run further, from where it was left").clicked() {
            let form = &state.optimize_form.settings;
            // Steps for another objective say nothing of this run.
            let of_run = last.map(|run| &run.settings).filter(|settings| settings.objective != form.objective);
            let steps = of_run.unwrap_or(form).steps;
            state.optimize_form.frame = None;
            if let Err(refusal) = state.bench.extend_run(steps) {
                state.messages.push(Severity::Failure, refusal);
            }
        }
    });
}

/// What may change, and how.
fn details(ui: &mut Ui, state: &mut State) {
    let locked = state.locks.indices().len();
    let form = &mut state.optimize_form;
    let objects = &state.bench.design().objects;
    ui.collapsing("Details", |ui| {
        let settings = &mut form.settings;
        ui.horizontal_wrapped(|ui| {
            ui.label("Move");
            let Free { positions, widths, weights } = &mut settings.free;
            ui.checkbox(positions, "positions");
            ui.checkbox(widths, "widths");
            ui.checkbox(weights, "weights");
            ui.checkbox(&mut settings.anisotropic, "ellipses").on_hover_text("Lets spots become elliptic");
        });
        ui.horizontal_wrapped(|ui| {
            ui.label("Climb");
            for (objective, hint) in OBJECTIVES {
                let chosen = settings.objective == objective;
                let offered = offered(objective, settings.preset, objects);
                let label = ui.add_enabled(offered, egui::Button::selectable(chosen, objective.to_string()));
                if label.on_hover_text(hint).on_disabled_hover_text(hint).clicked() {
                    form.objective = Some(objective);
                }
            }
        });
        ui.horizontal_wrapped(|ui| {
            ui.label("Patch");
            for (text, patch) in [("16 px", Some((16, 16))), ("32 px", Some((32, 32))), ("sensor", None)] {
                let chosen = ui.selectable_label(settings.patch == patch, text);
                if chosen.clicked() {
                    settings.patch = patch;
                }
            }
        });
        ui.horizontal_wrapped(|ui| {
            ui.label("Least distance");
            let apart = DragValue::new(&mut settings.min_separation_px).range(0.0..=8.0).speed(0.05).suffix(" px");
            name_widget(&ui.add(apart), "Least distance");
            let mut limited = settings.lenslets.is_some();
            if ui.checkbox(&mut limited, "Limit number").clicked() {
                settings.lenslets = limited.then_some(6);
            }
            if let Some(count) = &mut settings.lenslets {
                name_widget(&ui.add(DragValue::new(count).range(1..=64).suffix(" lenslets")), "Lenslets in the end");
            }
        });
        let text = match locked {
            0 => "No lenslet is locked".to_owned(),
            1 => "One locked lenslet stays as it is".to_owned(),
            _ => format!("{locked} locked lenslets stay as they are"),
        };
        ui.weak(text).on_hover_text("The Lenslets room locks them; it counts where the run starts from this design");
    });
}

/// Whether a run with this preset can climb this before these objects.
fn offered(objective: Objective, preset: Preset, objects: &ObjectSource) -> bool {
    objective.suits(preset) && (objective != Objective::Posterior || objects.is_beads())
}

/// What a mask can climb, and what that is good for.
const OBJECTIVES: [(Objective, &str); 3] = [
    (
        Objective::Posterior,
        "What can be told of beads, by a decoder: some minutes. For beads and the default preset; other objects have no known \
         prior",
    ),
    (
        Objective::Density,
        "Information under a density model of the measurements, for any objects. Before sparse beads a mask can climb what \
         the model does not know",
    ),
    (Objective::PixelCnn, "The same under a PixelCNN, as published: for the paper preset. It takes hours"),
];

/// Whether a run can be started as the form asks.
pub fn can_start(state: &State) -> bool {
    let has_lenslets = state.bench.open_design().encoder.lenslets().is_some_and(|array| !array.lenslets.is_empty());
    let is_free = !state.run.as_ref().is_some_and(DesignRun::is_active);
    is_free && (has_lenslets || state.optimize_form.from != From::Design)
}

/// Starts what the form asks for.
pub fn start(state: &mut State) {
    let design = Arc::clone(state.bench.open_design());
    let form = &mut state.optimize_form;
    form.frame = None;
    form.turn_to(form.settings.preset, &design.objects);
    let mut settings = IdealSettings { seed: design.seed, ..form.settings.clone() };
    let random = |seed: u64| {
        let encoder = Encoder::Lenslets(random_layout(form.count, seed));
        let name = format!("{} random, seed {seed}", form.count);
        Start { name, design: Arc::new(Design { encoder, ..Design::clone(&design) }) }
    };
    let starts = match form.from {
        From::Design => {
            settings.locked = state.locks.indices().iter().copied().collect();
            vec![Start { name: design.encoder.describe(), design: Arc::clone(&design) }]
        }
        From::Random => vec![random(design.seed)],
        From::RandomStarts => (0..STARTS).map(|number| random(design.seed.wrapping_add(number))).collect(),
    };
    if let Err(refusal) = state.bench.start_run(starts, settings) {
        state.messages.push(Severity::Failure, refusal);
    }
}

/// The run that goes on.
fn progress(ui: &mut Ui, state: &mut State, run: &DesignRun) {
    let steps = run.settings.steps;
    ui.add(ProgressBar::new(run.step as f32 / steps.max(1) as f32).desired_height(8.0));
    let left = run.left.map_or(String::new(), |left| format!(", {} left", spoken(left)));
    let doing = match (&run.status, &run.doing) {
        (RunStatus::Paused, _) => "paused".to_owned(),
        (_, Some((doing, share))) if *share < 1.0 => format!("{doing}, {:.0} %", 100.0 * share),
        (_, Some((doing, _))) => doing.clone(),
        _ => "moving lenslets".to_owned(),
    };
    ui.horizontal_wrapped(|ui| {
        ui.label(format!("{}{left}", run.place()));
        ui.weak(doing);
    });
    ui.horizontal_wrapped(|ui| {
        if run.status == RunStatus::Paused {
            if ui.button("Resume run").clicked() {
                state.bench.pause_run(false);
            }
        } else if ui.button("Pause run").clicked() {
            state.bench.pause_run(true);
        }
        if ui.button("Stop run").clicked() {
            state.bench.stop_run();
        }
        let mut follow = state.bench.is_following();
        let hint = "Shows the masks of the run as they come, in place of your design";
        if ui.checkbox(&mut follow, "Follow").on_hover_text(hint).clicked() {
            state.optimize_form.frame = None;
            state.bench.follow_run(follow);
        }
        ui.checkbox(&mut state.optimize_form.trails, "Trails");
    });
}

/// What a mask is worth.
fn value(ui: &mut Ui, state: &mut State, run: &DesignRun, shown: usize) {
    let frame = &run.frames[shown];
    ui.horizontal(|ui| {
        // What is left beside the button in the corner.
        let room = vec2((ui.available_width() - 34.0).max(80.0), 20.0);
        ui.allocate_ui_with_layout(room, Layout::left_to_right(Align::Min).with_main_wrap(true), |ui| {
            ui.set_min_width(room.x);
            let (sign, hint) = match run.settings.objective {
                Objective::Density | Objective::PixelCnn => (
                    '\u{2264}',
                    "Of held-out objects, under the density model of the run: an upper bound. Where scenes are sparse it can \
                     climb because it is loose; the lower bound tells.",
                ),
                Objective::Posterior => (
                    '\u{2265}',
                    "What the decoder of the run tells of fresh scenes: the information is at least this. A bracket of the \
                     design follows the posterior and tells more.",
                ),
            };
            ui.strong(format!("{sign} {}", rounded(frame.bits_per_pixel)));
            let text = format!("{} bits per pixel at step {}", interval(frame.interval_95), frame.step);
            ui.label(text).on_hover_text(hint);
            // The last that was taken up to this frame.
            if let Some(lower) = run.frames[..=shown].iter().rev().find_map(|frame| frame.lower) {
                let text = format!("\u{2265} {}", rounded(lower.bits_per_pixel));
                ui.colored_label(LOWER, text).on_hover_text(
                    "What the decoder of the program tells of fresh scenes, taken at every fifth refit: the information is at \
                     least this.",
                );
            }
        });
        more(ui, state, run);
    });
    let patch = patches_of(run.record.as_ref().map_or(run.settings.patch, |record| record.settings.patch));
    ui.weak(format!(
        "{patch}, {} lenslets ({:.1} effective), Tamura {:.3}",
        frame.distinct_lenslets, frame.effective_lenslets, frame.tamura
    ))
    .on_hover_text(COUNTS);
}

/// What can be taken from the run.
fn more(ui: &mut Ui, state: &mut State, run: &DesignRun) {
    let more = ui.menu_button("...", |ui| {
        if ui.button("Export curve of run...").on_hover_text("As a table, CSV").clicked() {
            let curve = curve_of(run.settings.objective, &run.frames);
            state.dialogs.ask(Purpose::ExportCurve { curve, name: "run.csv" }, state.bench.path());
        }
        if let Some(record) = &run.record {
            let export = ui.button("Export record of run...");
            if export.on_hover_text("Everything that is needed to repeat the run, as JSON").clicked() {
                state.dialogs.ask(Purpose::ExportRecord(Arc::clone(record)), state.bench.path());
            }
        }
        let copy = ui.button("Copy command of run");
        if copy.on_hover_text("The command line that makes the same run again").clicked() {
            state.copy_command(ui.ctx(), run_command(&run.start, &run.settings, &run.events));
        }
    });
    let hint = "Export the curve or the record of the run, or copy the command line that makes it again";
    name_widget(&more.response.on_hover_text(hint), "More of the run");
}

/// A slider over all masks so far, from that of the start to the newest.
fn rewind(ui: &mut Ui, state: &mut State, run: &DesignRun, mut shown: usize) {
    let last = run.frames.len() - 1;
    ui.horizontal(|ui| {
        let back = ui.small_button("Start").on_hover_text("The mask that the run started from");
        name_widget(&back, "Back to start");
        if back.clicked()
            && let Some(array) = run.start.encoder.lenslets()
        {
            state.optimize_form.frame = Some(0);
            state.bench.follow_run(false);
            state.bench.look_at(array, &run.start);
        }
        ui.spacing_mut().slider_width = (ui.available_width() - NEWEST_WIDTH).max(60.0);
        let slider = ui.add(Slider::new(&mut shown, 0..=last.max(1)).show_value(false));
        name_widget(&slider, "Rewind");
        if slider.changed() && shown <= last {
            state.optimize_form.frame = Some(shown);
            state.bench.follow_run(false);
            state.bench.look_at(&run.frames[shown].array, &run.start);
        }
        let newest = ui.small_button("Newest").on_hover_text("The mask that the run has come to");
        name_widget(&newest, "Show newest");
        if newest.clicked() {
            state.optimize_form.frame = None;
            state.bench.look_at(&run.array, &run.start);
            state.bench.follow_run(run.is_active());
        }
    });
}

/// A curve over the steps of a run.
fn points(run: &DesignRun, value: &dyn Fn(&Frame) -> f64) -> PlotPoints<'static> {
    run.frames.iter().map(|frame| [frame.step as f64, value(frame)]).collect()
}

/// Information with its interval; a line marks the mask that is shown.
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
            let column = |value: &dyn Fn(&Frame) -> f64| -> Vec<f64> { run.frames.iter().map(value).collect() };
            let (low, high) = (column(&|frame| frame.interval_95[0]), column(&|frame| frame.interval_95[1]));
            let band = FilledArea::new("95 % interval", &column(&|frame| frame.step as f64), &low, &high);
            plot.add(band.fill_color(colour.gamma_multiply(0.35)));
            let values = || points(run, &|frame| frame.bits_per_pixel);
            plot.line(Line::new(name, values()).color(colour).width(2.0));
            plot.points(Points::new("refits", values()).color(colour).radius(2.0));
            if shown + 1 < run.frames.len() {
                plot.vline(VLine::new("shown", run.frames[shown].step as f64).color(TRAIL).width(1.0));
            }
            let lower = run.frames.iter().filter_map(|frame| Some([frame.step as f64, frame.lower?.bits_per_pixel]));
            let lower: Vec<[f64; 2]> = lower.collect();
            if !lower.is_empty() {
                plot.line(Line::new("lower bound", PlotPoints::from(lower.clone())).color(LOWER).width(2.0));
                plot.points(Points::new("lower bound", PlotPoints::from(lower)).color(LOWER).radius(2.5));
            }
        });
}

/// What becomes of the mask.
fn other_plots(ui: &mut Ui, run: &DesignRun) {
    let link = ui.scope_id().with("run");
    for (name, axis, colour, value) in [
        (
            "effective lenslets",
            "lenslets",
            LENSLETS,
            &(|frame: &Frame| frame.effective_lenslets) as &dyn Fn(&Frame) -> f64,
        ),
        ("sensor Tamura", "sensor Tamura", TAMURA, &|frame: &Frame| frame.tamura),
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

/// What the run had to do besides climbing.
fn notes(ui: &mut Ui, state: &State, run: &DesignRun) {
    for line in IdealEvent::detours(&run.events) {
        ui.weak(line);
    }
    // The ceiling of this mask, in patches like those of the run.
    let is_shown = state.bench.design().encoder.lenslets() == Some(&*run.array);
    let information = state.live.information.as_ref().filter(|information| {
        is_shown && state.is_current(information.revision) && run.settings.patch == Some(information.value.patch)
    });
    let ceiling = information.and_then(|information| information.value.ceiling_bits());
    if let (Some(ceiling), Some(last)) = (ceiling, run.frames.last())
        && last.interval_95[0] > ceiling
    {
        let warning = "The run's estimate lies above what the objects hold at all: judge the design by a bracket.";
        ui.colored_label(ui.visuals().warn_fg_color, warning);
    }
}

/// Results of finished starts, the best first.
fn ranking(ui: &mut Ui, state: &mut State, run: &DesignRun) {
    for (place, result) in run.ranked.iter().enumerate() {
        let estimate = &result.estimate;
        ui.horizontal_wrapped(|ui| {
            let bits = match estimate.lower() {
                Some(lower) => between(lower, estimate.bits_per_pixel),
                None => format!("\u{2264} {} {}", rounded(estimate.bits_per_pixel), interval(estimate.interval_95)),
            };
            let text = format!("{}. {}: {bits}", place + 1, result.name);
            let open = ui.button(text).on_hover_text(
                "Shows this design. Its numbers, bits per pixel on held-out objects, come from models of their own: \
                 a bracket, ranked by its lower bound, or the live estimate where no lower bound is known.",
            );
            name_widget(&open, &format!("Result {}", place + 1));
            if open.clicked()
                && let Some(array) = result.design.encoder.lenslets()
            {
                state.bench.follow_run(false);
                state.bench.look_at(array, &result.design);
            }
            let copy =
                ui.small_button("Copy command").on_hover_text("The command line that computes these numbers again");
            name_widget(&copy, &format!("Copy command of result {}", place + 1));
            if copy.clicked() {
                state.copy_command(ui.ctx(), estimate_command(&result.design, &result.request()));
            }
        });
    }
}
