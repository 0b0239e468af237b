//! Cameras: their calibration, captures of systems, and the comparison of systems.

use egui::{ComboBox, ScrollArea, Ui};

use crate::camera::{BayerPattern, ColourChannel, ColourChoice};
use crate::studio::panels::parts::{camera_calibration, camera_captures, camera_comparison};
use crate::studio::state::camera::{CameraState, CameraTab};
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{name_widget, toolbar};

/// Shows the panel.
pub fn show(ui: &mut Ui, state: &mut CameraState, view: &View<'_>, requests: &mut Vec<Request>) {
    toolbar(ui, |ui| {
        for (tab, text, hint) in [
            (CameraTab::Calibration, "Calibration", "Photon transfer after EMVA 1288"),
            (CameraTab::Captures, "Captures", "Images of one camera or several, and how they are read"),
            (CameraTab::Comparison, "Comparison", "Information of the images of each camera"),
        ] {
            let response = ui.selectable_value(&mut state.tab, tab, text).on_hover_text(hint);
            name_widget(&response, &format!("Show {}", text.to_lowercase()));
        }
        let choice = match state.tab {
            CameraTab::Calibration => &mut state.colour,
            CameraTab::Captures => &mut state.captures.colour,
            CameraTab::Comparison => return,
        };
        colour(ui, choice);
    });
    let tab = state.tab;
    ScrollArea::vertical().id_salt(("camera", text_of(tab))).auto_shrink(false).show(ui, |ui| match tab {
        CameraTab::Calibration => camera_calibration::show(ui, state, view, requests),
        CameraTab::Captures => camera_captures::show(ui, state, view, requests),
        CameraTab::Comparison => camera_comparison::show(ui, state, view, requests),
    });
}

fn text_of(tab: CameraTab) -> &'static str {
    match tab {
        CameraTab::Calibration => "calibration",
        CameraTab::Captures => "captures",
        CameraTab::Comparison => "comparison",
    }
}

/// The colour that is taken from frames or captures.
fn colour(ui: &mut Ui, choice: &mut ColourChoice) {
    let named = ColourChannel::NAMES.iter().map(|(channel, name)| (Some(*channel), *name));
    let channels: Vec<_> = std::iter::once((None, "any channel")).chain(named).collect();
    choose(ui, ["Channel", "Camera channel"], &mut choice.channel, &channels);
    let named = BayerPattern::NAMES.iter().map(|(pattern, name)| (Some(*pattern), *name));
    let patterns: Vec<_> = std::iter::once((None, "no mosaic")).chain(named).collect();
    choose(ui, ["Mosaic", "Camera Bayer pattern"], &mut choice.bayer, &patterns);
}

/// A choice with a short text while nothing is chosen.
fn choose<T: Copy + PartialEq>(
    ui: &mut Ui,
    [short, name]: [&str; 2],
    value: &mut Option<T>,
    choices: &[(Option<T>, &'static str)],
) {
    let known = choices.iter().find(|(choice, _)| choice.is_some() && choice == value);
    let response = ComboBox::from_id_salt(name)
        .selected_text(known.map_or(short, |(_, text)| text))
        .width(40.0)
        .show_ui(ui, |ui| {
            for (choice, text) in choices {
                ui.selectable_value(value, *choice, *text);
            }
        })
        .response;
    name_widget(&response, name);
}
