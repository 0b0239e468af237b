//! The trained network of the Reconstruction panel: which one is used, and its training.

use egui::{ComboBox, ProgressBar, RichText, Ui};

use crate::evaluation::format_duration;
use crate::reconstruction::{NetworkMask, TrainedNetwork};
use crate::studio::panels::parts::training_curves::Curves;
use crate::studio::state::request::{Request, TrainingRequest};
use crate::studio::state::training_form::TrainingForm;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{NetworkFit, Reconstruction, Training, TrainingScope, TrainingStatus};

/// Size of the texts, points.
const TEXT: f32 = 12.5;

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
        let (sentence, hint) = sentence(fit, form.curves);
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

/// What is used, in a sentence of one line, and more about it; with `curves` no image is shown.
fn sentence(fit: &NetworkFit, curves: bool) -> (String, String) {
    let state = |state: &str, shown: &str| if curves { state.to_owned() } else { format!("{state}: {shown}") };
    match fit {
        NetworkFit::Missing => (
            state("Not trained yet", "the linear estimate is shown"),
            "There is no network for this design. Train one, or open weights".into(),
        ),
        NetworkFit::OtherMask => (
            state("Stale, of another mask", "linear estimate shown"),
            "The network was trained for another mask. Undo, or train one for this mask".into(),
        ),
        NetworkFit::OtherScene => (
            state("Stale, of another scene", "linear estimate shown"),
            "The network was trained for other objects, another light or noise".into(),
        ),
        NetworkFit::Current(network) if network.is_linear() => {
            (state("No weights were better", "linear estimate shown"), network.summary())
        }
        NetworkFit::Current(network) => (
            quality(network),
            format!("{}\nPSNR of validation: of training images that were held out", network.summary()),
        ),
    }
}

/// Masks and quality of a network on the validation images.
fn quality(network: &TrainedNetwork) -> String {
    let mask = match network.training.mask {
        NetworkMask::One { .. } => "this mask",
        NetworkMask::Any { .. } => "any mask",
    };
    let (psnr_db, linear_psnr_db) = (network.training.psnr_db, network.linear_psnr_db);
    format!("Validation, {mask}: {psnr_db:.2} dB, linear {linear_psnr_db:.2} dB")
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
