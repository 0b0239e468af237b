//! The welcome dialog and the tour.

use egui::{RichText, Ui};

use crate::studio::state::action::Action;
use crate::studio::state::dialogs::Onboarding;
use crate::studio::state::pane::Pane;
use crate::studio::state::request::{Request, Setting};
use crate::studio::state::transition::Transition;
use crate::studio::state::view::View;
use crate::studio::widgets::modal;
use crate::workbench::SAMPLES;

/// A step of the tour.
struct Stop {
    title: &'static str,
    text: &'static str,
    /// The panel that is shown.
    panel: Pane,
    /// Whether the user has done it.
    done: fn(&View<'_>, &Onboarding) -> bool,
}

const STOPS: [Stop; 5] = [
    Stop {
        title: "Move a lenslet",
        text: "Drag one of the circles in Mask. PSF, measurement and all numbers follow while you drag. Double-click adds a lenslet, Delete removes the selected ones.",
        panel: Pane::Mask,
        done: |view, _| view.undoes.is_some(),
    },
    Stop {
        title: "Read the information",
        text: "The large number bounds the information in bits per pixel. The live estimate starts within a second of an edit and refines until it says converged. Arrows in Mask show its gradient for each lenslet.",
        panel: Pane::Information,
        done: |view, _| view.estimates.live.is_some(),
    },
    Stop {
        title: "Compare designs",
        text: "Ctrl+D takes a snapshot of the open design with its numbers. Take two, then flip between their images.",
        panel: Pane::Compare,
        done: |view, _| view.shared.snapshots > 0,
    },
    Stop {
        title: "Optimize the mask",
        text: "Start run moves, merges and dims lenslets to increase the information. Stop it at any time; the slider shows any earlier step. Accept this mask puts the shown mask into your design.",
        panel: Pane::Optimize,
        done: |view, _| view.run.is_some(),
    },
    Stop {
        title: "Export the design",
        text: "Ctrl+E writes the PSF as images and arrays and the design as JSON into a folder. Save writes the design file.",
        panel: Pane::Mask,
        done: |_, onboarding| onboarding.exported,
    },
];

/// Shows the welcome dialog, which offers samples to start from.
pub fn show_welcome(ctx: &egui::Context, onboarding: &mut Onboarding, requests: &mut Vec<Request>) {
    if !onboarding.welcome {
        return;
    }
    let mut leave = false;
    let response = modal::show(ctx, "welcome", 545.0, |ui| {
        modal::body(ui, |ui| {
            ui.heading("Welcome to Lenslet Studio");
            ui.label("Place lenslets in front of a sensor and see how much information its measurements carry.");
            ui.add_space(8.0);
            ui.strong("Start from");
            for sample in &SAMPLES {
                ui.horizontal(|ui| {
                    if ui.add_sized([120.0, 22.0], egui::Button::new(sample.name)).clicked()
                        && let Some(design) = sample.design()
                    {
                        requests.push(Request::Transition(Transition::Sample(Box::new(design))));
                        leave = true;
                    }
                    ui.weak(sample.about);
                });
            }
            ui.horizontal(|ui| {
                if ui.add_sized([120.0, 22.0], egui::Button::new("Open my data...")).clicked() {
                    requests.push(Request::Do(Action::OpenObjects));
                    leave = true;
                }
                ui.weak("Images, IDX, CIFAR-10, NPY, NPZ or TIFF");
            });
        });
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            if ui.button("Take the tour").clicked() {
                onboarding.tour = Some(0);
                leave = true;
            }
            leave |= ui.button("Close").clicked();
        });
    });
    if leave || response.should_close() {
        onboarding.welcome = false;
        requests.push(Request::Set(Setting::Welcomed));
    }
}

/// Shows the current step of the tour and whether it is done.
pub fn show_tour(ctx: &egui::Context, onboarding: &mut Onboarding, view: &View<'_>, requests: &mut Vec<Request>) {
    let Some(number) = onboarding.tour else { return };
    let Some(stop) = STOPS.get(number) else {
        onboarding.tour = None;
        return;
    };
    let mut next = Some(number);
    egui::Window::new("Tour")
        .collapsible(false)
        .resizable(false)
        .default_width(300.0)
        .anchor(egui::Align2::LEFT_BOTTOM, [16.0, -40.0])
        .show(ctx, |ui| {
            ui.set_width(300.0);
            ui.label(RichText::new(format!("{}. {}", number + 1, stop.title)).heading());
            ui.label(stop.text);
            ui.add_space(4.0);
            let done = (stop.done)(view, onboarding);
            let text = if done { "Done" } else { "Try it" };
            let colour = if done { ui.visuals().selection.stroke.color } else { ui.visuals().weak_text_color() };
            ui.colored_label(colour, text);
            ui.separator();
            ui.horizontal(|ui| buttons(ui, number, &mut next));
        });
    if next != onboarding.tour {
        onboarding.tour = next;
        if let Some(stop) = next.and_then(|next| STOPS.get(next)) {
            requests.push(Request::Do(Action::Show(stop.panel)));
        }
    }
}

fn buttons(ui: &mut Ui, number: usize, next: &mut Option<usize>) {
    if ui.add_enabled(number > 0, egui::Button::new("Back")).clicked() {
        *next = Some(number - 1);
    }
    let last = number + 1 == STOPS.len();
    if ui.button(if last { "Finish" } else { "Next" }).clicked() {
        *next = (!last).then_some(number + 1);
    }
    if !last && ui.button("End tour").clicked() {
        *next = None;
    }
    ui.weak(format!("{} of {}", number + 1, STOPS.len()));
}
