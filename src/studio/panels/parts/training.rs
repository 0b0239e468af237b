//! The trained network of the Reconstruction panel: which one is used, its training, and the curves of that.

use egui::{ComboBox, ProgressBar, RichText, Ui};
use egui_plot::{HLine, Line, Plot, PlotPoints, Points};

use crate::evaluation::format_duration;
use crate::reconstruction::{NetworkMask, TrainedNetwork, TrainingPoint};
use crate::studio::state::request::{Request, TrainingRequest};
use crate::studio::state::training_form::TrainingForm;
use crate::studio::state::view::View;
use crate::studio::widgets::colours::{DENSITY, ENTROPY_BOUND};
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{LossPoint, NetworkFit, Reconstruction, Training, TrainingScope, TrainingStatus};

/// Size of the texts, points.
const TEXT: f32 = 12.5;
/// Least width of both curves beside each other, points.
const BOTH_WIDTH: f32 = 480.0;
/// Least height of both curves one above the other, points.
const BOTH_HEIGHT: f32 = 300.0;
/// Colour of the network.
const NETWORK: egui::Color32 = DENSITY;
/// Colour of the linear estimate.
const LINEAR: egui::Color32 = ENTROPY_BOUND;

/// Shows which network is used, and the training or the form of one.
pub fn show(
    ui: &mut Ui,
    form: &mut TrainingForm,
    shown: Option<&Reconstruction>,
    is_current: bool,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    if let Some(fit) = shown.and_then(|shown| shown.network.as_ref()) {
        let (sentence, hint) = sentence(fit);
        let text = RichText::new(sentence).size(TEXT);
        let is_stale = matches!(fit, NetworkFit::OtherMask | NetworkFit::OtherScene);
        let label = match (is_current, is_stale) {
            (false, _) => ui.weak(text),
            (true, true) => ui.colored_label(ui.visuals().warn_fg_color, text),
            (true, false) => ui.label(text),
        };
        label.on_hover_text(hint);
    }
    let newest = view.trainings.newest.as_ref();
    if let Some(training) = newest.filter(|training| training.is_active()) {
        progress(ui, training, requests);
        return;
    }
    match newest.map(|training| (&training.status, &training.best)) {
        Some((TrainingStatus::Failed(sentence), _)) => {
            ui.colored_label(ui.visuals().error_fg_color, sentence);
        }
        Some((TrainingStatus::Stopped, None)) => {
            ui.weak(RichText::new("Stopped before a validation: no weights are kept").size(TEXT));
        }
        _ => {}
    }
    ui.horizontal_wrapped(|ui| fields(ui, form, view, requests));
}

/// Switch of the curves, which are shown in place of the image.
pub fn switch(ui: &mut Ui, form: &mut TrainingForm, shown: Option<&Reconstruction>, view: &View<'_>) {
    let newest = view.trainings.newest.as_ref();
    form.follow(newest.is_some_and(Training::is_active));
    let is_possible = newest.is_some_and(Training::is_active) || !Curves::of(shown, view).is_empty();
    form.curves &= is_possible;
    let checkbox = ui.add_enabled(is_possible, egui::Checkbox::new(&mut form.curves, "Curves"));
    let checkbox =
        checkbox.on_hover_text("Loss and PSNR of the training").on_disabled_hover_text("There is no training");
    name_widget(&checkbox, "Show training curves");
}

/// Draws the curves of the training.
pub fn curves(ui: &mut Ui, form: &mut TrainingForm, shown: Option<&Reconstruction>, view: &View<'_>) {
    Curves::of(shown, view).show(ui, form);
}

/// What is used, in a sentence of one line, and more about it.
fn sentence(fit: &NetworkFit) -> (String, String) {
    match fit {
        NetworkFit::Missing => (
            "Not trained yet: the linear estimate is shown".into(),
            "There is no network for this design. Train one, or open weights".into(),
        ),
        NetworkFit::OtherMask => (
            "Stale, of another mask: linear estimate shown".into(),
            "The network was trained for another mask. Undo, or train one for this mask".into(),
        ),
        NetworkFit::OtherScene => (
            "Stale, of another scene: linear estimate shown".into(),
            "The network was trained for other objects, another light or noise".into(),
        ),
        NetworkFit::Current(network) if network.is_linear() => {
            ("No weights were better: linear estimate shown".into(), network.summary())
        }
        NetworkFit::Current(network) => (format!("Network for {}", quality(network)), network.summary()),
    }
}

/// Masks and quality of a network.
fn quality(network: &TrainedNetwork) -> String {
    let mask = match network.training.mask {
        NetworkMask::One { .. } => "this mask",
        NetworkMask::Any { .. } => "any mask",
    };
    let (psnr_db, linear_psnr_db) = (network.training.psnr_db, network.linear_psnr_db);
    format!("{mask}: {psnr_db:.2} dB, linear {linear_psnr_db:.2} dB")
}

/// The form of a new training.
fn fields(ui: &mut Ui, form: &mut TrainingForm, view: &View<'_>, requests: &mut Vec<Request>) {
    let has_lenslets = view.design.encoder.lenslets().is_some();
    if !has_lenslets {
        form.scope = TrainingScope::ThisMask;
    }
    let start = ui.button("Train").on_hover_text("Trains a network on top of the linear estimate, in the background");
    if start.clicked() {
        requests.push(Request::Training(TrainingRequest::Start(form.scope, form.budget())));
    }
    ui.label("for");
    let response = ComboBox::from_id_salt("training masks")
        .selected_text(name_of(form.scope))
        .width(82.0)
        .show_ui(ui, |ui| {
            let hint = "Better for this mask; stale after an edit of the mask";
            ui.selectable_value(&mut form.scope, TrainingScope::ThisMask, name_of(TrainingScope::ThisMask))
                .on_hover_text(hint);
            ui.add_enabled_ui(has_lenslets, |ui| {
                ui.selectable_value(&mut form.scope, TrainingScope::AnyMask, name_of(TrainingScope::AnyMask))
                    .on_hover_text("Any lenslets on this grid, for the same objects, light and noise")
                    .on_disabled_hover_text("This mask has no lenslets");
            });
        })
        .response;
    name_widget(&response, "Masks of the network");
    if form.by_steps {
        NumberField::whole("Training budget", 1..=10_000_000).speed(20.0).edit_whole(ui, &mut form.steps);
    } else {
        NumberField::new("Training budget", 1.0..=86_400.0).speed(1.0).decimals(0).edit(ui, &mut form.seconds);
    }
    let response = ComboBox::from_id_salt("training budget")
        .selected_text(if form.by_steps { "steps" } else { "s" })
        .width(52.0)
        .show_ui(ui, |ui| {
            ui.selectable_value(&mut form.by_steps, false, "s").on_hover_text("Seconds of work");
            ui.selectable_value(&mut form.by_steps, true, "steps").on_hover_text("Steps give equal weights every time");
        })
        .response;
    name_widget(&response, "Unit of the training budget");
}

fn name_of(scope: TrainingScope) -> &'static str {
    match scope {
        TrainingScope::ThisMask => "this mask",
        TrainingScope::AnyMask => "any mask",
    }
}

/// Progress of the active training, with its buttons.
fn progress(ui: &mut Ui, training: &Training, requests: &mut Vec<Request>) {
    ui.add(ProgressBar::new(training.done as f32).desired_height(8.0));
    ui.horizontal_wrapped(|ui| {
        let left = training.left.map_or(String::new(), |left| format!(", {} left", format_duration(left)));
        let text = match training.status {
            TrainingStatus::Preparing => "Preparing".to_owned(),
            TrainingStatus::Paused => format!("Paused at step {}{left}", training.steps),
            _ => format!("Step {}{left}", training.steps),
        };
        ui.label(RichText::new(text).size(TEXT));
        let is_paused = training.status == TrainingStatus::Paused;
        let pause = ui.small_button(if is_paused { "Resume" } else { "Pause" });
        name_widget(&pause, if is_paused { "Resume training" } else { "Pause training" });
        if pause.clicked() {
            requests.push(Request::Training(TrainingRequest::Pause(!is_paused)));
        }
        let stop = ui.small_button("Stop").on_hover_text("Ends the training; the best weights so far are kept");
        name_widget(&stop, "Stop training");
        if stop.clicked() {
            requests.push(Request::Training(TrainingRequest::Stop));
        }
    });
}

/// Curves of a training.
struct Curves<'a> {
    losses: &'a [LossPoint],
    validations: &'a [TrainingPoint],
    linear_psnr_db: Option<f64>,
}

impl<'a> Curves<'a> {
    /// Those of the last training of this session, or else those of the used network.
    fn of(shown: Option<&'a Reconstruction>, view: &View<'a>) -> Self {
        match (&view.trainings.newest, shown.and_then(|shown| shown.network.as_ref())) {
            (Some(training), _) => Self {
                losses: &training.losses,
                validations: &training.validations,
                linear_psnr_db: training.linear_psnr_db,
            },
            (None, Some(NetworkFit::Current(network))) => {
                Self { losses: &[], validations: &network.training.curve, linear_psnr_db: Some(network.linear_psnr_db) }
            }
            _ => Self { losses: &[], validations: &[], linear_psnr_db: None },
        }
    }

    fn is_empty(&self) -> bool {
        self.losses.is_empty() && self.validations.is_empty()
    }

    /// Draws both where there is room, beside each other or one above the other, and otherwise the chosen one.
    fn show(&self, ui: &mut Ui, form: &mut TrainingForm) {
        let room = ui.available_size();
        let has_both = room.x >= BOTH_WIDTH || room.y >= BOTH_HEIGHT;
        ui.horizontal(|ui| {
            if !has_both {
                ui.selectable_value(&mut form.loss, false, "PSNR");
                ui.selectable_value(&mut form.loss, true, "Loss");
            }
            for (colour, name) in [(NETWORK, "network"), (LINEAR, "linear")] {
                ui.colored_label(colour, RichText::new(format!("\u{25cf} {name}")).size(TEXT));
            }
        });
        let room = ui.available_size();
        if room.x >= BOTH_WIDTH {
            ui.columns(2, |columns| {
                self.psnr(&mut columns[0], room.y);
                self.loss(&mut columns[1], room.y);
            });
        } else if has_both {
            let height = 0.5 * (room.y - ui.spacing().item_spacing.y);
            self.psnr(ui, height);
            self.loss(ui, height);
        } else if form.loss {
            self.loss(ui, room.y);
        } else {
            self.psnr(ui, room.y);
        }
    }

    fn loss(&self, ui: &mut Ui, height: f32) {
        let points = |value: fn(&LossPoint) -> f64| -> PlotPoints<'static> {
            self.losses.iter().map(|point| [point.steps as f64, value(point)]).collect()
        };
        let shown = plot("Training loss", "loss, peak\u{b2}", height).show(ui, |plot| {
            plot.line(Line::new("linear", points(|point| point.linear)).color(LINEAR).width(1.5));
            plot.line(Line::new("network", points(|point| point.network)).color(NETWORK).width(2.0));
        });
        name_widget(&shown.response, "Training loss");
    }

    fn psnr(&self, ui: &mut Ui, height: f32) {
        let points: Vec<[f64; 2]> = self.validations.iter().map(|point| [point.steps as f64, point.psnr_db]).collect();
        let shown = plot("Validation PSNR", "validation PSNR, dB", height).show(ui, |plot| {
            if let Some(linear) = self.linear_psnr_db {
                plot.hline(HLine::new("linear", linear).color(LINEAR).width(1.5));
            }
            plot.line(Line::new("network", points.clone()).color(NETWORK).width(2.0));
            plot.points(Points::new("network", points).color(NETWORK).radius(2.5));
        });
        name_widget(&shown.response, "Validation PSNR");
    }
}

/// A plot over steps.
fn plot<'a>(name: &'a str, axis: &'a str, height: f32) -> Plot<'a> {
    Plot::new(name)
        .height(height)
        .include_x(0.0)
        .include_x(10.0)
        .allow_scroll(false)
        .x_axis_label("steps")
        .y_axis_label(axis)
}
