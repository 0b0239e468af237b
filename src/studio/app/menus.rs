//! The menu bar.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use ndarray::{CowArray, Ix2};

use crate::optics::DIFFUSER_APERTURES;
use crate::studio::app::capture;
use crate::studio::canvas::image_view::ImageView;
use crate::studio::dialogs::settings_dialogs;
use crate::studio::panels::parts::{action_entry, image_menu};
use crate::studio::state::action::{Action, Preset};
use crate::studio::state::mtf_and_map::MtfMode;
use crate::studio::state::pane::Pane;
use crate::studio::state::panel_states::Panels;
use crate::studio::state::request::{Request, Setting};
use crate::studio::state::samples::{measurement_of, object_of};
use crate::studio::state::transition::Transition;
use crate::studio::state::view::View;
use crate::studio::state::window_layout::VisiblePanel;
use crate::workbench::Live;

/// The File menu.
pub fn file_menu(ui: &mut egui::Ui, panels: &Panels, view: &View<'_>, requests: &mut Vec<Request>) {
    for action in [Action::New, Action::Open] {
        action_entry::entry(ui, view, requests, action);
    }
    ui.add_enabled_ui(!view.preferences.recent.is_empty(), |ui| {
        ui.menu_button("Open recent", |ui| recent_menu(ui, view, requests));
    });
    for action in [Action::Save, Action::SaveAs] {
        action_entry::entry(ui, view, requests, action);
    }
    ui.separator();
    action_entry::entry(ui, view, requests, Action::OpenObjects);
    action_entry::entry(ui, view, requests, Action::ImportPsf);
    action_entry::entry(ui, view, requests, Action::OpenCapture);
    ui.separator();
    action_entry::entry(ui, view, requests, Action::ExportDesign);
    action_entry::entry(ui, view, requests, Action::ExportMeasurements);
    action_entry::entry(ui, view, requests, Action::ExportLive);
    ui.menu_button("Export view", |ui| export_view_menu(ui, panels, view, requests));
    ui.separator();
    action_entry::entry(ui, view, requests, Action::Quit);
}

/// An image that can be exported.
struct Exportable<'a> {
    shown: &'a ImageView,
    revision: u64,
    /// Shape (rows, cols).
    values: CowArray<'a, f32, Ix2>,
}

/// The images of all panels, as far as they are computed.
fn exportable_images<'a>(panels: &'a Panels, view: &'a View<'_>) -> impl Iterator<Item = Exportable<'a>> {
    let Live { optics, scene, measurements, .. } = view.live;
    let sample = panels.samples.shown;
    let psf = optics.as_ref().map(|optics| Exportable {
        shown: &panels.mask.psf,
        revision: optics.revision,
        values: (&optics.value.image).into(),
    });
    let object = scene.as_ref().map(|scene| Exportable {
        shown: &panels.samples.object,
        revision: scene.revision,
        values: object_of(&scene.value, sample.index),
    });
    let measurement = measurements.as_ref().map(|measurements| Exportable {
        shown: &panels.samples.measurement,
        revision: measurements.revision,
        values: measurement_of(&measurements.value, sample).into(),
    });
    let reconstruction = view.reconstructions.shown.as_ref().map(|shown| Exportable {
        shown: panels.samples.reconstruction.view(),
        revision: shown.key.revision,
        values: panels.samples.reconstruction.values_of(shown).into(),
    });
    let mtf = optics.as_ref().filter(|_| panels.mtf.mode == MtfMode::Map).map(|optics| Exportable {
        shown: &panels.mtf.image,
        revision: optics.revision,
        values: (&optics.value.mtf.map).into(),
    });
    let information = view.estimates.live.as_ref().map(|live| Exportable {
        shown: &panels.map.image,
        revision: live.revision,
        values: panels.map.map_of(&live.value).into(),
    });
    [psf, object, measurement, reconstruction, mtf, information].into_iter().flatten()
}

/// One entry per image that shows the current revision.
fn export_view_menu(ui: &mut egui::Ui, panels: &Panels, view: &View<'_>, requests: &mut Vec<Request>) {
    for Exportable { shown, values, .. } in
        exportable_images(panels, view).filter(|image| view.is_current(image.revision))
    {
        if ui.button(format!("{}...", shown.name())).clicked() {
            requests.push(image_menu::export(shown, values.view()));
            ui.close();
        }
    }
}

/// Recent design files, newest first.
fn recent_menu(ui: &mut egui::Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    for path in &view.preferences.recent {
        if ui.button(short_name(path, &view.preferences.recent)).on_hover_text(path.display().to_string()).clicked() {
            requests.push(Request::Transition(Transition::OpenFile(path.clone())));
            ui.close();
        }
    }
    ui.separator();
    if ui.button("Clear list").clicked() {
        requests.push(Request::Set(Setting::ClearRecent));
        ui.close();
    }
}

/// Name of a file, with its folder if others have the same name.
fn short_name(path: &Path, all: &[PathBuf]) -> String {
    let text = |part: Option<&OsStr>| part.map_or_else(String::new, |part| part.to_string_lossy().into_owned());
    let folder = || path.parent().map_or_else(String::new, |folder| folder.display().to_string());
    match all.iter().filter(|other| other.file_name() == path.file_name()).count() {
        0 | 1 => text(path.file_name()),
        _ => format!("{} in {}", text(path.file_name()), folder()),
    }
}

/// The View menu. `visible` are the visible panels.
pub fn view_menu(
    ui: &mut egui::Ui,
    visible: &[VisiblePanel],
    shows_frame_times: &mut bool,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    ui.menu_button("Theme", |ui| {
        if settings_dialogs::theme_choice(ui) {
            ui.close();
        }
    });
    ui.menu_button("Panel", |ui| {
        for pane in Pane::ALL {
            action_entry::entry(ui, view, requests, Action::Show(pane));
        }
    });
    ui.menu_button("Layout", |ui| {
        for action in Action::layouts() {
            action_entry::entry(ui, view, requests, action);
        }
    });
    action_entry::entry(ui, view, requests, Action::Maximise);
    ui.menu_button("Export image of panel", |ui| capture::menu(ui, visible, requests));
    let mut live = view.is_live;
    if ui
        .checkbox(&mut live, "Live estimate")
        .on_hover_text("Fits a density model after every edit, with the processor time that the window leaves")
        .clicked()
    {
        requests.push(Request::Set(Setting::Live(live)));
        ui.close();
    }
    if ui.checkbox(shows_frame_times, "Frame times").clicked() {
        ui.close();
    }
    action_entry::entry(ui, view, requests, Action::Jobs);
    action_entry::entry(ui, view, requests, Action::Messages);
}

/// The Help menu.
pub fn help_menu(ui: &mut egui::Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    for action in [Action::Palette, Action::Shortcuts, Action::Tour, Action::Welcome, Action::About] {
        action_entry::entry(ui, view, requests, action);
    }
}

/// The Edit menu.
pub fn edit_menu(ui: &mut egui::Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    let undoes = view.undoes.map(str::to_lowercase);
    let redoes = view.redoes.map(str::to_lowercase);
    for (action, step) in [(Action::Undo, undoes), (Action::Redo, redoes)] {
        let text = format!("{} {}", action.label(), step.as_deref().unwrap_or_default());
        action_entry::entry_called(ui, view, requests, action, text.trim_end());
    }
    ui.separator();
    action_entry::entry(ui, view, requests, Action::SelectAll);
    action_entry::entry(ui, view, requests, Action::Delete);
    ui.separator();
    action_entry::entry(ui, view, requests, Action::Accept);
    action_entry::entry(ui, view, requests, Action::OpenMask);
    action_entry::entry(ui, view, requests, Action::EndPreview);
    action_entry::entry(ui, view, requests, Action::KeepSnapshot);
    action_entry::entry(ui, view, requests, Action::CopyNumbers);
    action_entry::entry(ui, view, requests, Action::CopyCommand);
    ui.separator();
    action_entry::entry(ui, view, requests, Action::Settings);
}

/// The Presets menu: masks to start from.
pub fn presets_menu(ui: &mut egui::Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    let preset = |ui: &mut egui::Ui, requests: &mut Vec<Request>, preset: Preset, hint: &str| {
        let response = ui.button(preset.label());
        let response = if hint.is_empty() { response } else { response.on_hover_text(hint) };
        if response.clicked() {
            requests.push(Request::Do(Action::Preset(preset)));
            ui.close();
        }
    };
    ui.menu_button("Heuristic lenslets", |ui| {
        for count in 1..=9 {
            preset(ui, requests, Preset::Heuristic(count), "");
        }
    });
    preset(ui, requests, Preset::Random, "Drawn from the seed of the design; every use draws new ones");
    preset(ui, requests, Preset::Depth, "Each focused on a plane of its own, for volumes");
    ui.menu_button("Diffuser", |ui| {
        for aperture in DIFFUSER_APERTURES {
            preset(ui, requests, Preset::Diffuser(aperture), "");
        }
    });
    action_entry::entry(ui, view, requests, Action::ImportPsf);
    action_entry::entry(ui, view, requests, Action::FitLenslets);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_file_names_show_their_folders() {
        let all: Vec<PathBuf> = ["/a/one.json", "/b/one.json", "/b/two.json"].map(PathBuf::from).to_vec();
        let names: Vec<String> = all.iter().map(|path| short_name(path, &all)).collect();
        assert_eq!(names, ["one.json in /a", "one.json in /b", "two.json"]);
    }
}
