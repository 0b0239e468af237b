//! The menus: entries for actions, and what only stands in menus.

use ndarray::Array2;

use super::actions::{Action, Preset};
use super::dialogs::Purpose;
use super::image_view::{ImageView, name_widget};
use super::links::{measurement_of, object_of};
use super::mtf_panel::MtfView;
use super::state::{Leave, State};
use crate::optics::DIFFUSER_APERTURES;

/// The File menu.
pub fn file_menu(ui: &mut egui::Ui, state: &mut State) {
    for action in [Action::New, Action::Open] {
        entry(ui, state, action);
    }
    ui.add_enabled_ui(!state.preferences.recent.is_empty(), |ui| {
        ui.menu_button("Open recent", |ui| recent_menu(ui, state));
    });
    for action in [Action::Save, Action::SaveAs] {
        entry(ui, state, action);
    }
    ui.separator();
    entry(ui, state, Action::OpenObjects);
    entry(ui, state, Action::ImportPsf);
    ui.separator();
    entry(ui, state, Action::ExportDesign);
    entry(ui, state, Action::ExportMeasurements);
    ui.menu_button("Export view", |ui| {
        export_view_menu(ui, state);
    });
    ui.separator();
    entry(ui, state, Action::Quit);
}

/// Designs that were opened or saved before, the newest first.
fn recent_menu(ui: &mut egui::Ui, state: &mut State) {
    let mut chosen = None;
    for path in &state.preferences.recent {
        let name = path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into());
        if ui.button(name).on_hover_text(path.display().to_string()).clicked() {
            chosen = Some(path.clone());
            ui.close();
        }
    }
    ui.separator();
    if ui.button("Forget these").clicked() {
        state.preferences.recent.clear();
        ui.close();
    }
    if let Some(path) = chosen {
        let ctx = ui.ctx().clone();
        state.guard(&ctx, Leave::OpenFile(path));
    }
}

/// The Help menu.
pub fn help_menu(ui: &mut egui::Ui, state: &mut State) {
    for action in [Action::Palette, Action::Shortcuts, Action::Tour, Action::Welcome, Action::About] {
        entry(ui, state, action);
    }
}

/// A picture that can be exported.
#[derive(Clone, Copy)]
enum View {
    Psf,
    Object,
    Measurement,
    Mtf,
}

/// One entry per picture that there is.
fn export_view_menu(ui: &mut egui::Ui, state: &mut State) {
    for view in [View::Psf, View::Object, View::Measurement, View::Mtf] {
        let is_there = match view {
            View::Psf => state.live.optics.is_some(),
            View::Object => state.live.scene.is_some(),
            View::Measurement => state.live.measurements.is_some(),
            View::Mtf => state.live.optics.is_some() && state.mtf_view == MtfView::Map,
        };
        if is_there && ui.button(format!("{}...", view.of(state).name())).clicked() {
            if let Some(image) = view.picture(state) {
                let shown = view.of(state);
                let (name, colormap, limits) = (shown.name(), shown.colormap, shown.limits_of(image.view()));
                let purpose = Purpose::ExportView { name, image, limits, colormap };
                state.dialogs.ask(purpose, state.bench.path());
            }
            ui.close();
        }
    }
}

impl View {
    fn of(self, state: &State) -> &ImageView {
        match self {
            Self::Psf => &state.views.psf,
            Self::Object => &state.views.object,
            Self::Measurement => &state.views.measurement,
            Self::Mtf => &state.views.mtf,
        }
    }

    /// What it shows, shape (rows, cols).
    fn picture(self, state: &State) -> Option<Array2<f32>> {
        let live = &state.live;
        Some(match self {
            Self::Psf => live.optics.as_ref()?.value.image.clone(),
            Self::Object => object_of(&live.scene.as_ref()?.value, state.sample).into_owned(),
            Self::Measurement => {
                measurement_of(&live.measurements.as_ref()?.value, state.sample, state.noisy).to_owned()
            }
            Self::Mtf => live.optics.as_ref()?.value.mtf.map.clone(),
        })
    }
}

/// The Edit menu.
pub fn edit_menu(ui: &mut egui::Ui, state: &mut State) {
    let undoes = state.bench.undoes().map(str::to_lowercase);
    let redoes = state.bench.redoes().map(str::to_lowercase);
    for (action, step) in [(Action::Undo, undoes), (Action::Redo, redoes)] {
        let text = format!("{} {}", action.label(), step.as_deref().unwrap_or_default());
        entry_called(ui, state, action, text.trim_end());
    }
    ui.separator();
    entry(ui, state, Action::SelectAll);
    entry(ui, state, Action::Delete);
    ui.separator();
    entry(ui, state, Action::Accept);
    entry(ui, state, Action::LookAway);
    entry(ui, state, Action::KeepDesign);
    entry(ui, state, Action::CopyNumbers);
    entry(ui, state, Action::CopyCommand);
    ui.separator();
    entry(ui, state, Action::Settings);
}

/// The Presets menu: masks to start from.
pub fn presets_menu(ui: &mut egui::Ui, state: &mut State) {
    let preset = |ui: &mut egui::Ui, state: &mut State, preset: Preset, hint: &str| {
        let response = ui.button(preset.label());
        let response = if hint.is_empty() { response } else { response.on_hover_text(hint) };
        if response.clicked() {
            preset.put(state);
            ui.close();
        }
    };
    ui.menu_button("Heuristic lenslets", |ui| {
        for count in 1..=9 {
            preset(ui, state, Preset::Heuristic(count), "");
        }
    });
    preset(ui, state, Preset::Random, "Drawn from the design's seed; again draws others");
    preset(ui, state, Preset::Depth, "Each focused on a plane of its own, for volumes");
    ui.menu_button("Diffuser", |ui| {
        for aperture in DIFFUSER_APERTURES {
            preset(ui, state, Preset::Diffuser(aperture), "");
        }
    });
    entry(ui, state, Action::ImportPsf);
}

/// A menu entry for an action.
pub fn entry(ui: &mut egui::Ui, state: &mut State, action: Action) {
    entry_called(ui, state, action, &action.label());
}

fn entry_called(ui: &mut egui::Ui, state: &mut State, action: Action, text: &str) {
    let mut button = egui::Button::new(text);
    if let Some(shortcut) = action.shortcut() {
        button = button.shortcut_text(ui.ctx().format_shortcut(&shortcut));
    }
    let response = ui.add_enabled(action.is_possible(state), button);
    name_widget(&response, text);
    if response.clicked() {
        ui.close();
        let ctx = ui.ctx().clone();
        action.run(&ctx, state);
    }
}
