//! Estimates that take minutes: their form, the progress of the fit, and the results.

use std::sync::Arc;

use egui::{ComboBox, ProgressBar, Ui};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoints};

use crate::evaluation::{Calibration, FitPoint, FittedModel};
use crate::information::{Estimate, Estimator, Protocol, between, rounded, with_interval};
use crate::plural::counted;
use crate::studio::panels::parts::fit_length;
use crate::studio::state::estimates::EstimatesState;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::{EstimatesRequest, Request};
use crate::studio::state::view::View;
use crate::studio::widgets::colours::{DENSITY, LOWER};
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{Curve, FinishedEstimate, Revisioned, estimate_command, images_command};

/// Tooltip of the button that copies a command.
const COPY_HINT: &str = "Copies the command line that reproduces this number";

/// Protocols of a PixelCNN, with tooltips.
const PROTOCOLS: [(Protocol, &str); 2] = [
    (Protocol::Default, "New noise, disjoint training and test objects, exact noise entropy: an upper bound"),
    (
        Protocol::Paper,
        "As published: training and test patches of the same objects, approximate noise entropy; no bound",
    ),
];

/// Shows the panel.
pub fn show(ui: &mut Ui, state: &mut EstimatesState, view: &View<'_>, requests: &mut Vec<Request>) {
    form(ui, state, view, requests);
    // Scrolls: a low window has little space during a fit.
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        results(ui, state, view, requests);
    });
}

/// The running and the finished estimates.
fn results(ui: &mut Ui, state: &mut EstimatesState, view: &View<'_>, requests: &mut Vec<Request>) {
    let (running, finished) = (&view.estimates.running, &view.estimates.finished);
    if let Some(running) = running {
        let progress = &running.progress;
        let share = progress.done as f32 / progress.total.max(1) as f32;
        ui.label(format!("{}: {}", running.model.estimator(), progress.step));
        ui.add(ProgressBar::new(share).desired_height(8.0));
        ui.push_id("running", |ui| fit_plot(ui, &running.curve, 150.0));
    }
    if view.estimates.gone.is_some() {
        let back = ui.small_button("Restore deleted estimate");
        if back.on_hover_text("Possible until the window closes").clicked() {
            requests.push(Request::Estimates(EstimatesRequest::Restore));
            state.chosen = None;
        }
    }
    if finished.is_empty() && running.is_none() {
        ui.weak("Estimates run in the background; a result keeps its design.");
        return;
    }
    for (index, result) in finished.iter().enumerate().rev() {
        entry(ui, state, &Entry { index, result }, view, requests);
    }
    // A running estimate has a curve of its own.
    let newest = finished.last().filter(|_| running.is_none());
    let shown = state.chosen.and_then(|index| finished.get(index)).or(newest);
    if let Some(shown) = shown.filter(|shown| !shown.value.curve.is_empty()) {
        fit_plot(ui, &shown.value.curve, 170.0);
    }
}

/// Form of a new estimate.
fn form(ui: &mut Ui, form: &mut EstimatesState, view: &View<'_>, requests: &mut Vec<Request>) {
    let running = view.estimates.running.is_some();
    ui.horizontal_wrapped(|ui| {
        let known = EstimatesState::KINDS.iter().find(|(kind, ..)| *kind == form.kind);
        let response = ComboBox::from_id_salt("estimator")
            .selected_text(known.map_or("", |(_, name, ..)| name))
            .width(84.0)
            .show_ui(ui, |ui| {
                for (kind, name, hint) in EstimatesState::KINDS {
                    if ui.selectable_value(&mut form.kind, kind, name).on_hover_text(hint).clicked() {
                        form.length.turn_to(kind);
                    }
                }
            })
            .response;
        name_widget(&response, "Estimator");
        let response = ComboBox::from_id_salt("patch")
            .selected_text(if form.whole_sensor { "Whole sensor" } else { "32 x 32 px" })
            .width(96.0)
            .show_ui(ui, |ui| {
                ui.selectable_value(&mut form.whole_sensor, false, "32 x 32 px");
                ui.selectable_value(&mut form.whole_sensor, true, "Whole sensor")
                    .on_hover_text("Estimates whole measurements, in which copies of one object point count once");
            })
            .response;
        name_widget(&response, "Patch");
        if form.kind == Estimator::PixelCnn {
            let response = ComboBox::from_id_salt("protocol")
                .selected_text(format!("{} protocol", form.protocol))
                .width(104.0)
                .show_ui(ui, |ui| {
                    for (protocol, hint) in PROTOCOLS {
                        ui.selectable_value(&mut form.protocol, protocol, format!("{protocol} protocol"))
                            .on_hover_text(hint);
                    }
                })
                .response;
            name_widget(&response, "Protocol");
        }
        if form.kind != Estimator::Bracket {
            let field = NumberField::whole("Trials", 1..=100).counting(" trial", " trials");
            let trials = field.edit_whole(ui, &mut form.trials);
            trials.on_hover_text(
                "Number of fits with different seeds; the smallest value counts and the spread is reported",
            );
        }
        fit_length::show(ui, &mut form.length, form.kind, "of the fit");
        let start = ui.button("Start estimate");
        if start.on_hover_text("Starts the estimate, or queues it behind a running one").clicked() {
            let request = form.request(view.preferences.engine);
            requests.push(Request::Estimates(EstimatesRequest::Start(request)));
        }
        if running && ui.button("Cancel estimate").clicked() {
            requests.push(Request::Estimates(EstimatesRequest::Cancel));
        }
    });
}

/// One finished estimate and its index.
struct Entry<'a> {
    index: usize,
    result: &'a Revisioned<FinishedEstimate>,
}

fn entry(ui: &mut Ui, state: &mut EstimatesState, entry: &Entry<'_>, view: &View<'_>, requests: &mut Vec<Request>) {
    let Entry { index, result } = *entry;
    let current = result.value.is_of(view.design, view.live);
    let estimate = &result.value.estimate;
    ui.group(|ui| {
        ui.set_width(ui.available_width());
        ui.horizontal_wrapped(|ui| {
            let text = egui::RichText::new(summary(estimate)).strong();
            let response = ui.selectable_label(state.chosen == Some(index), text);
            name_widget(&response, &format!("Estimate {}", index + 1));
            if response.on_hover_text("Shows the curve of this fit").clicked() {
                state.chosen = Some(index);
            }
        });
        let [rows, cols] = estimate.patch;
        let measured = result.value.order.measured.as_ref();
        let age = match (result.value.is_of_this_version(), current || measured.is_some()) {
            (false, _) => ", by another version of the program",
            (true, false) => ", of another design",
            (true, true) => "",
        };
        let minutes = estimate.seconds / 60.0;
        let of = if measured.is_some() { &estimate.objects } else { &estimate.encoder };
        let trials = match estimate.trials {
            1 => String::new(),
            trials => format!(", smallest of {}, spread {}", counted(trials, "trial"), rounded(estimate.trial_spread)),
        };
        let noise = estimate.noise;
        ui.weak(format!("{of}, {noise} noise, patch {rows} x {cols} px, {minutes:.1} min{trials}{age}"));
        if let Some(Calibration { gain, offset, bin }) = measured.map(|measured| measured.calibration) {
            ui.weak(format!("gain {gain}, offset {offset}, bin {bin}"));
        }
        if estimate.above_ceiling() {
            ui.colored_label(ui.visuals().warn_fg_color, "This value exceeds the entropy bound. It cannot rank masks.");
        }
        ui.horizontal_wrapped(|ui| {
            let copy = ui.small_button("Copy JSON");
            name_widget(&copy, &format!("Copy estimate {}", index + 1));
            if copy.clicked()
                && let Ok(json) = serde_json::to_string_pretty(estimate)
            {
                requests.push(Request::Copy { text: json, what: "Estimate" });
            }
            let command = ui.small_button("Copy command");
            name_widget(&command, &format!("Copy command of estimate {}", index + 1));
            if command.on_hover_text(COPY_HINT).clicked() {
                let order = &result.value.order;
                let command = match &order.measured {
                    Some(measured) => Ok(images_command(measured, &order.request, &order.design)),
                    None => estimate_command(&order.design, &order.request),
                };
                requests.push(Request::CopyCommand(command));
            }
            let export = ui.small_button("Curve CSV...");
            name_widget(&export, &format!("Export curve of estimate {}", index + 1));
            if export.clicked() {
                let curve = columns(&result.value.curve);
                requests.push(Request::AskPath(PathPurpose::ExportCurve { curve, name: "fit.csv" }));
            }
            let delete = ui.small_button("Delete").on_hover_text("Deletes this estimate when the window closes");
            name_widget(&delete, &format!("Delete estimate {}", index + 1));
            if delete.clicked() {
                requests.push(Request::Estimates(EstimatesRequest::Delete(Arc::clone(&result.value))));
                state.chosen = None;
            }
        });
        // Below the buttons, so that many notes do not move them.
        for note in &estimate.notes {
            ui.weak(format!("note: {note}"));
        }
    });
}

/// Value of an estimate in one line.
fn summary(estimate: &Estimate) -> String {
    let (bits, from) = (estimate.bits_per_pixel, estimate.upper_from());
    match (estimate.lower(), estimate.protocol) {
        (Some(lower), _) => format!("{} bits per pixel ({from})", between(lower, bits)),
        (None, protocol) => {
            let sign = if protocol == Protocol::Paper { "\u{2248}" } else { "\u{2264}" };
            format!("{sign} {} bits per pixel ({from})", with_interval(bits, estimate.interval_95))
        }
    }
}

/// Curves of a fit: cross-entropy of a density model, information gain of a decoder.
fn fit_plot(ui: &mut Ui, curve: &[FitPoint], height: f32) {
    for (model, name, colour) in [
        (FittedModel::Density, "cross-entropy", DENSITY),
        (FittedModel::Decoder, "information gain of the decoder", LOWER),
    ] {
        let points: Vec<[f64; 2]> =
            curve.iter().filter(|point| point.model == model).map(|point| [point.seconds, point.bits]).collect();
        if points.len() < 2 {
            continue;
        }
        // The first tenth is off the scale.
        let late = &points[points.len() / 10..];
        Plot::new(("fit", name))
            .height(height)
            .legend(Legend::default().position(Corner::RightTop))
            .include_x(0.0)
            .allow_scroll(false)
            .x_axis_label("seconds")
            .y_axis_label("bits per pixel")
            .show(ui, |plot| {
                plot.line(Line::new(name, PlotPoints::from(late.to_vec())).color(colour).width(2.0));
            });
    }
}

fn columns(curve: &[FitPoint]) -> Curve {
    let row = |point: &FitPoint| {
        let decoder = point.model == FittedModel::Decoder;
        vec![f64::from(u8::from(decoder)), point.seconds, point.bits]
    };
    Curve {
        names: Vec::new(),
        header: ["decoder", "seconds", "bits_per_pixel"].map(String::from).to_vec(),
        rows: curve.iter().map(row).collect(),
    }
}
