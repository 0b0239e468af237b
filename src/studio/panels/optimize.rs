//! Runs that optimize the mask: form of a new run, progress, and every mask on the way.

use egui::{ComboBox, ProgressBar, Ui};

use crate::design::{Free, IdealSettings, Objective, Preset, Rates};
use crate::evaluation::format_duration;
use crate::studio::panels::parts::run_results;
use crate::studio::state::action::Action;
use crate::studio::state::optimize::{OptimizeState, StartMask, offered};
use crate::studio::state::request::{Request, RunRequest};
use crate::studio::state::transition::Transition;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{DesignRun, RunStatus};

/// Shows the panel.
pub fn show(ui: &mut Ui, state: &mut OptimizeState, view: &View<'_>, requests: &mut Vec<Request>) {
    state.turn_to(state.settings.preset, &view.design.objects);
    let active = view.run.filter(|run| run.is_active());
    if let Some(run) = active {
        progress(ui, state, run, view.preview.is_following, requests);
        ui.separator();
    }
    let room = ui.available_height();
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let top = ui.cursor().top();
        if active.is_none() {
            form(ui, state, view, requests);
            ui.separator();
        }
        let Some(run) = view.run else {
            ui.weak(
                "Lenslets move, merge, fade and sharpen while the information of their measurements increases. The mask of \
                 the run is shown in place of your design, which stays as it is until you accept one.",
            );
            return;
        };
        if let RunStatus::Failed(sentence) = &run.status {
            ui.colored_label(ui.visuals().error_fg_color, sentence);
        }
        let room = room - (ui.cursor().top() - top);
        run_results::show(ui, state, run, room, view, requests);
    });
}

/// Form of a new run.
fn form(ui: &mut Ui, form: &mut OptimizeState, view: &View<'_>, requests: &mut Vec<Request>) {
    ui.horizontal_wrapped(|ui| {
        let response = ComboBox::from_id_salt("start from")
            .selected_text(form.from.name())
            .width(112.0)
            .show_ui(ui, |ui| {
                for from in StartMask::ALL {
                    ui.selectable_value(&mut form.from, from, from.name());
                }
            })
            .response;
        name_widget(&response, "Start from");
        match form.from {
            StartMask::Design => {}
            StartMask::Heuristic => {
                let field = NumberField::whole("Heuristic lenslets", 1..=9).counting(" lenslet", " lenslets");
                field.edit_whole(ui, &mut form.heuristic);
            }
            StartMask::Random | StartMask::RandomStarts => {
                let field = NumberField::whole("Random lenslets", 1..=64).counting(" lenslet", " lenslets");
                field.edit_whole(ui, &mut form.count);
                let seed = form.seed.unwrap_or(view.open_design.seed);
                let (field, edit) = NumberField::seed("Seed of the start").prefix("seed ").show(ui, seed as f64);
                field.on_hover_text("Seed of the lenslets of the first start, and of the run");
                if let Some(edit) = edit {
                    form.seed = Some(edit.value as u64);
                }
            }
        }
        let response = ComboBox::from_id_salt("preset")
            .selected_text(form.settings.preset.to_string())
            .width(72.0)
            .show_ui(ui, |ui| {
                for (preset, hint) in [
                    (
                        Preset::Default,
                        "Short warm fits of the objective: whole measurements of beads, patches of 32 x 32 px for a density \
                         model",
                    ),
                    (
                        Preset::Paper,
                        "Steps, batches, rates and refits as published, patches of 16 x 16 px; takes hours",
                    ),
                ] {
                    let chosen = form.settings.preset == preset;
                    if ui.selectable_label(chosen, preset.to_string()).on_hover_text(hint).clicked() {
                        form.turn_to(preset, &view.design.objects);
                    }
                }
            })
            .response;
        name_widget(&response, "Preset");
        let field = NumberField::whole("Steps", 1..=100_000).counting(" step", " steps");
        field.edit_whole(ui, &mut form.settings.steps);
    });
    details(ui, form, view);
    ui.horizontal_wrapped(|ui| {
        let start = ui.add_enabled(form.can_start(view.open_design, view.run), egui::Button::new("Start run"));
        if start
            .on_disabled_hover_text(
                "This design has no lenslets to move; fit some to its PSF (Presets), or start from random ones",
            )
            .clicked()
        {
            requests.push(Request::Transition(Transition::Run));
        }
        let Some(last) = view.run.filter(|run| !run.is_active()) else { return };
        let is_extended = last.status == RunStatus::Finished;
        // Several finished starts have several results. A new run can start from each of them.
        if is_extended && last.start_number.1 > 1 {
            return;
        }
        let (text, hint) = if is_extended {
            ("Extend", "Extends the run by the steps of the form")
        } else {
            ("Resume", "Resumes the run where it was stopped")
        };
        if ui.button(text).on_hover_text(hint).clicked() {
            requests.push(Request::Run(RunRequest::Extend(form.further_steps(last))));
        }
    });
}

/// Form of the free parameters and the settings.
fn details(ui: &mut Ui, form: &mut OptimizeState, view: &View<'_>) {
    let locked = view.locks.indices().len();
    let objects = &view.design.objects;
    ui.collapsing("Details", |ui| {
        let settings = &mut form.settings;
        ui.horizontal_wrapped(|ui| {
            ui.label("Free");
            let Free { positions, widths, weights } = &mut settings.free;
            ui.checkbox(positions, "positions");
            ui.checkbox(widths, "widths");
            ui.checkbox(weights, "weights");
            ui.checkbox(&mut settings.anisotropic, "ellipses").on_hover_text("Lets spots become elliptic");
        });
        ui.horizontal_wrapped(|ui| {
            ui.label("Objective");
            for (objective, hint) in OBJECTIVES {
                let chosen = settings.objective == objective;
                let offered = offered(objective, settings.preset, objects);
                let label = ui.add_enabled(offered, egui::Button::selectable(chosen, objective.to_string()));
                if label.on_hover_text(hint).on_disabled_hover_text(hint).clicked() {
                    form.objective = Some(objective);
                }
            }
        });
        if settings.preset == Preset::Paper {
            ui.horizontal_wrapped(|ui| {
                ui.label("Rates for");
                for (name, rates) in PUBLISHED_RATES {
                    ui.selectable_value(&mut settings.rates, rates, name);
                }
            });
        }
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
            let field = NumberField::new("Least distance", 0.0..=8.0).speed(0.05).unit(" px");
            field.edit(ui, &mut settings.min_separation_px);
            let mut limited = settings.cardinality.is_some();
            if ui.checkbox(&mut limited, "Limit count").clicked() {
                settings.cardinality = limited.then_some(6);
            }
            if let Some(count) = &mut settings.cardinality {
                let field = NumberField::whole("Final lenslets", 1..=64).counting(" lenslet", " lenslets");
                field.edit_whole(ui, count);
            }
        });
        schedule(ui, settings);
        let text = match locked {
            0 => "No lenslet is locked".to_owned(),
            1 => "One locked lenslet stays as it is".to_owned(),
            _ => format!("{locked} locked lenslets stay as they are"),
        };
        ui.weak(text).on_hover_text("The Lenslets panel locks them. Locks apply where the run starts from this design");
    });
}

/// Steps of a warm fit.
const REFIT: &str = "Refit";

/// Schedule of the fits, and rates of the lenslets.
fn schedule(ui: &mut Ui, settings: &mut IdealSettings) {
    let is_refitted = settings.warm;
    ui.collapsing("Schedule and rates", |ui| {
        egui::Grid::new("schedule").num_columns(2).show(ui, |ui| {
            let counts = [
                ("Refit every", &mut settings.refit_every, "Steps of the mask between two fits of the model"),
                ("First fit", &mut settings.first_fit, "Fit steps for the first mask"),
                (REFIT, &mut settings.refit, "Fit steps of every other round"),
                ("Last fit", &mut settings.last_fit, "Fit steps for the last mask"),
            ];
            for (name, count, hint) in counts {
                let label = ui.label(name).on_hover_text(hint);
                let field = NumberField::whole(name, 1..=IdealSettings::MOST).counting(" step", " steps");
                let is_used = name != REFIT || is_refitted;
                let value = ui.add_enabled_ui(is_used, |ui| field.edit_whole(ui, count)).inner.labelled_by(label.id);
                value.on_disabled_hover_text("Cold fits have the steps of the first and the last fit");
                ui.end_row();
            }
            let Rates { position, variance, weight, relative_weight } = &mut settings.rates;
            let rates = [
                ("Position rate", position, " px", "Step of a centre, about"),
                ("Variance rate", variance, " px\u{b2}", "Step of a squared width, about"),
                ("Weight rate", weight, "", "Step of a weight, about; all weights sum to 1"),
                ("Relative weight rate", relative_weight, "", "Least step of a weight, as a share of it"),
            ];
            for (name, rate, unit, hint) in rates {
                let label = ui.label(name).on_hover_text(hint);
                let speed = (0.02 * *rate).max(1e-5);
                NumberField::new(name, 0.0..=10.0).speed(speed).unit(unit).edit(ui, rate).labelled_by(label.id);
                ui.end_row();
            }
            let label =
                ui.label("Decay over").on_hover_text("Share of the steps, at the end, over which the rates decay");
            let field = NumberField::new("Decay over", 0.0..=100.0).unit(" %");
            let (value, edit) = field.show(ui, 100.0 * settings.decay_fraction);
            value.labelled_by(label.id);
            if let Some(edit) = edit {
                settings.decay_fraction = edit.value / 100.0;
            }
            ui.end_row();
        });
        ui.checkbox(&mut settings.warm, "warm").on_hover_text("Every fit starts from the one before");
        let preset = settings.clone().with_preset(settings.preset, settings.objective);
        if ui.add_enabled(*settings != preset, egui::Button::new("Reset to preset")).clicked() {
            *settings = preset;
        }
    });
}

/// Objectives, with tooltips.
const OBJECTIVES: [(Objective, &str); 3] = [
    (Objective::Posterior, "Lower bound by a decoder, for beads and the default preset. It takes minutes"),
    (
        Objective::Density,
        "Upper bound by a causal density model, for any objects. With sparse beads a mask can exploit errors of the model",
    ),
    (Objective::PixelCnn, "Upper bound by the published PixelCNN, for the paper preset. It takes hours"),
];

/// Learning rates of lenslets for the published objects.
const PUBLISHED_RATES: [(&str, Rates); 3] =
    [("beads, Fashion-MNIST", Rates::PAPER), ("MNIST", Rates::PAPER_MNIST), ("CIFAR-10", Rates::PAPER_CIFAR)];

/// Progress of the active run.
fn progress(ui: &mut Ui, state: &mut OptimizeState, run: &DesignRun, is_following: bool, requests: &mut Vec<Request>) {
    let steps = run.settings.steps;
    ui.add(ProgressBar::new(run.step as f32 / steps.max(1) as f32).desired_height(8.0));
    let of_what = if run.start_number.1 > 1 { " of this start" } else { "" };
    let left = run.left.map_or(String::new(), |left| format!(", {} left{of_what}", format_duration(left)));
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
                requests.push(Request::Run(RunRequest::Pause(false)));
            }
        } else if ui.button("Pause run").clicked() {
            requests.push(Request::Run(RunRequest::Pause(true)));
        }
        if ui.button(stop_label(run)).clicked() {
            requests.push(Request::Do(Action::StopRun));
        }
        let mut follow = is_following;
        let hint = "Shows the masks of the run as they come, in place of your design";
        if ui.checkbox(&mut follow, "Follow").on_hover_text(hint).clicked() {
            state.show_newest();
            requests.push(Request::Run(RunRequest::Follow(follow)));
        }
        ui.checkbox(&mut state.trajectories, "Trails");
    });
}

/// Label of the button that stops a run or its score.
fn stop_label(run: &DesignRun) -> &'static str {
    if run.is_scoring { "Stop scoring" } else { "Stop run" }
}
