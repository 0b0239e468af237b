//! The menu bar.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::optics::DIFFUSER_APERTURES;
use crate::studio::panels::parts::{action_entry, image_menu};
use crate::studio::state::action::{Action, Preset};
use crate::studio::state::app_state::{State, Transition};

/// The File menu.
pub fn file_menu(ui: &mut egui::Ui, state: &mut State) {
    for action in [Action::New, Action::Open] {
        action_entry::entry(ui, state, action);
    }
    ui.add_enabled_ui(!state.preferences.recent.is_empty(), |ui| {
        ui.menu_button("Open recent", |ui| recent_menu(ui, state));
    });
    for action in [Action::Save, Action::SaveAs] {
        action_entry::entry(ui, state, action);
    }
    ui.separator();
    action_entry::entry(ui, state, Action::OpenObjects);
    action_entry::entry(ui, state, Action::ImportPsf);
    ui.separator();
    action_entry::entry(ui, state, Action::ExportDesign);
    action_entry::entry(ui, state, Action::ExportMeasurements);
    action_entry::entry(ui, state, Action::ExportLive);
    ui.menu_button("Export view", |ui| {
        image_menu::export_menu(ui, state);
    });
    ui.separator();
    action_entry::entry(ui, state, Action::Quit);
}

/// Recent design files, newest first.
fn recent_menu(ui: &mut egui::Ui, state: &mut State) {
    let mut chosen = None;
    for path in &state.preferences.recent {
        if ui.button(short_name(path, &state.preferences.recent)).on_hover_text(path.display().to_string()).clicked() {
            chosen = Some(path.clone());
            ui.close();
        }
    }
    ui.separator();
    if ui.button("Clear list").clicked() {
        state.preferences.recent.clear();
        ui.close();
    }
    if let Some(path) = chosen {
        let ctx = ui.ctx().clone();
        state.request_transition(&ctx, Transition::OpenFile(path));
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

/// The Help menu.
pub fn help_menu(ui: &mut egui::Ui, state: &mut State) {
    for action in [Action::Palette, Action::Shortcuts, Action::Tour, Action::Welcome, Action::About] {
        action_entry::entry(ui, state, action);
    }
}

/// The Edit menu.
pub fn edit_menu(ui: &mut egui::Ui, state: &mut State) {
    let undoes = state.session.undoes().map(str::to_lowercase);
    let redoes = state.session.redoes().map(str::to_lowercase);
    for (action, step) in [(Action::Undo, undoes), (Action::Redo, redoes)] {
        let text = format!("{} {}", action.label(), step.as_deref().unwrap_or_default());
        action_entry::entry_called(ui, state, action, text.trim_end());
    }
    ui.separator();
    action_entry::entry(ui, state, Action::SelectAll);
    action_entry::entry(ui, state, Action::Delete);
    ui.separator();
    action_entry::entry(ui, state, Action::Accept);
    action_entry::entry(ui, state, Action::OpenMask);
    action_entry::entry(ui, state, Action::EndPreview);
    action_entry::entry(ui, state, Action::KeepSnapshot);
    action_entry::entry(ui, state, Action::CopyNumbers);
    action_entry::entry(ui, state, Action::CopyCommand);
    ui.separator();
    action_entry::entry(ui, state, Action::Settings);
}

/// The Presets menu: masks to start from.
pub fn presets_menu(ui: &mut egui::Ui, state: &mut State) {
    let preset = |ui: &mut egui::Ui, state: &mut State, preset: Preset, hint: &str| {
        let response = ui.button(preset.label());
        let response = if hint.is_empty() { response } else { response.on_hover_text(hint) };
        if response.clicked() {
            state.act(Action::Preset(preset));
            ui.close();
        }
    };
    ui.menu_button("Heuristic lenslets", |ui| {
        for count in 1..=9 {
            preset(ui, state, Preset::Heuristic(count), "");
        }
    });
    preset(ui, state, Preset::Random, "Drawn from the seed of the design; every use draws new ones");
    preset(ui, state, Preset::Depth, "Each focused on a plane of its own, for volumes");
    ui.menu_button("Diffuser", |ui| {
        for aperture in DIFFUSER_APERTURES {
            preset(ui, state, Preset::Diffuser(aperture), "");
        }
    });
    action_entry::entry(ui, state, Action::ImportPsf);
    action_entry::entry(ui, state, Action::FitLenslets);
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
