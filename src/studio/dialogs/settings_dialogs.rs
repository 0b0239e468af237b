//! The dialogs *Keys and gestures*, *Settings* and *About*.

use std::path::Path;
use std::sync::LazyLock;

use egui::{KeyboardShortcut, RichText, Ui};

use crate::information::EngineChoice;
use crate::plural::counted;
use crate::studies::Machine;
use crate::studio::state::dialogs::SettingsDialog;
use crate::studio::state::keys::{Gesture, ON_OTHER_IMAGES, ON_THE_MASK, ZOOM_KEYS, actions_with_keys};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::preferences::{RendererChoice, THREADS, ZOOM};
use crate::studio::state::request::{Request, Setting};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::modal;
use crate::studio::widgets::number_field::NumberField;

/// Width at which keys and gestures stand side by side, points.
const TWO_COLUMNS: f32 = 860.0;
/// Width of the names of keys and gestures, points.
const KEYS: f32 = 170.0;

/// What the dialogs say about the program.
pub struct Environment<'a> {
    /// Name of the renderer; none in tests.
    pub renderer: Option<&'static str>,
    /// Folder of the application data, if any.
    pub folder: Option<&'a Path>,
}

/// Draws the open dialog.
pub fn show(
    ctx: &egui::Context,
    open: &mut Option<SettingsDialog>,
    environment: &Environment<'_>,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    let Some(dialog) = *open else { return };
    let mut leaves = false;
    let width = match dialog {
        SettingsDialog::Shortcuts => TWO_COLUMNS,
        SettingsDialog::Settings => 400.0,
        SettingsDialog::About => 420.0,
    };
    let response = modal::show(ctx, "sheet", width, |ui| {
        modal::body(ui, |ui| match dialog {
            SettingsDialog::Shortcuts => shortcuts(ui),
            SettingsDialog::Settings => leaves = settings(ui, environment.folder, view, requests),
            SettingsDialog::About => about(ui, environment.renderer, view.preferences.engine, requests),
        });
        ui.add_space(8.0);
        ui.button("Close").clicked()
    });
    if leaves || response.inner || response.should_close() {
        *open = None;
    }
}

fn shortcuts(ui: &mut Ui) {
    let room = ui.available_width();
    ui.heading("Keys and gestures");
    ui.add_space(4.0);
    if room < TWO_COLUMNS {
        // The descriptions wrap.
        keys(ui, room - KEYS);
        ui.add_space(12.0);
        gestures(ui, room - KEYS);
    } else {
        ui.horizontal_top(|ui| {
            keys(ui, f32::INFINITY);
            ui.add_space(24.0);
            gestures(ui, f32::INFINITY);
        });
    }
}

fn keys(ui: &mut Ui, most: f32) {
    let format = |ui: &Ui, shortcuts: &[KeyboardShortcut]| {
        shortcuts.iter().map(|keys| ui.ctx().format_shortcut(keys)).collect::<Vec<_>>().join(", ")
    };
    egui::Grid::new("keys").num_columns(2).max_col_width(most).spacing([16.0, 4.0]).show(ui, |ui| {
        for (action, shortcuts) in actions_with_keys() {
            entry(ui, format(ui, &shortcuts), action.label());
        }
        entry(ui, ZOOM_KEYS.gesture, ZOOM_KEYS.effect);
    });
}

fn gestures(ui: &mut Ui, most: f32) {
    egui::Grid::new("gestures").num_columns(2).max_col_width(most).spacing([16.0, 4.0]).show(ui, |ui| {
        for (place, gestures) in [("On the mask", &ON_THE_MASK[..]), ("On other images", &ON_OTHER_IMAGES)] {
            ui.weak(place);
            ui.end_row();
            for Gesture { gesture, effect } in gestures {
                entry(ui, *gesture, *effect);
            }
        }
    });
}

/// A row of a grid: keys or a gesture, and the effect.
fn entry(ui: &mut Ui, keys: impl Into<String>, effect: impl Into<egui::WidgetText>) {
    ui.label(RichText::new(keys).strong());
    ui.label(effect);
    ui.end_row();
}

/// Shows the settings. Returns whether the dialog makes room for another.
fn settings(ui: &mut Ui, folder: Option<&Path>, view: &View<'_>, requests: &mut Vec<Request>) -> bool {
    let mut leaves = false;
    let preferences = view.preferences;
    ui.heading("Settings");
    ui.add_space(4.0);
    egui::Grid::new("settings").num_columns(2).spacing([16.0, 8.0]).show(ui, |ui| {
        ui.label("Theme");
        ui.horizontal(theme_choice);
        ui.end_row();
        ui.label("Interface zoom");
        // The zoom changes on release: the slider would move away from the pointer otherwise.
        let id = egui::Id::unique("zoom");
        let mut zoom = ui.data(|data| data.get_temp(id)).unwrap_or_else(|| ui.ctx().zoom_factor());
        ui.horizontal(|ui| {
            let response = ui.add(egui::Slider::new(&mut zoom, ZOOM).step_by(0.1).show_value(false));
            name_widget(&response, "Zoom");
            let percent = |bound: &f32| f64::from(100.0 * bound);
            let field = NumberField::new("Zoom in per cent", percent(ZOOM.start())..=percent(ZOOM.end()));
            let (typed, edit) = field.decimals(0).unit(" %").show(ui, f64::from(100.0 * zoom));
            if let Some(edit) = edit {
                zoom = edit.value as f32 / 100.0;
            }
            if response.dragged() || typed.dragged() {
                ui.data_mut(|data| data.insert_temp(id, zoom));
            } else if response.drag_stopped() || typed.drag_stopped() || response.changed() || edit.is_some() {
                ui.data_mut(|data| data.remove::<f32>(id));
                ui.ctx().set_zoom_factor(zoom);
            }
        });
        ui.end_row();
        ui.label("Live estimates");
        let mut live = view.is_live;
        if ui.checkbox(&mut live, "Estimate while the design is edited").clicked() {
            requests.push(Request::Set(Setting::Live(live)));
        }
        ui.end_row();
        ui.label("Compute threads");
        threads(ui, preferences.threads, requests);
        ui.end_row();
        ui.label("PixelCNN engine");
        ui.horizontal(|ui| {
            for engine in EngineChoice::built() {
                if ui.radio(preferences.engine == engine, engine.to_string()).clicked() {
                    requests.push(Request::Set(Setting::Engine(engine)));
                }
            }
        });
        ui.end_row();
        ui.label("Folder of unsaved changes");
        ui.horizontal(|ui| {
            if ui.button("Choose folder...").clicked() {
                requests.push(Request::AskPath(PathPurpose::KeepUnsaved));
                leaves = true;
            }
            let usual = ui.add_enabled(preferences.unsaved.is_some(), egui::Button::new("Default folder"));
            if usual.clicked() {
                requests.push(Request::Set(Setting::UnsavedFolder(None)));
            }
        });
        ui.end_row();
        ui.label("Renderer");
        ui.horizontal(|ui| {
            for choice in [RendererChoice::Glow, RendererChoice::Wgpu] {
                if ui.radio(preferences.renderer == choice, choice.name()).clicked() {
                    requests.push(Request::Set(Setting::Renderer(choice)));
                }
            }
        });
        ui.end_row();
        ui.label("");
        ui.weak("takes effect at the next start");
        ui.end_row();
    });
    if let Some(folder) = folder {
        ui.weak(format!("Settings, layout, snapshots and runs: {}", folder.display()));
        let unsaved = preferences.unsaved.clone().unwrap_or_else(|| folder.join("unsaved"));
        ui.weak(format!("Unsaved changes: {}", unsaved.display()));
    }
    leaves
}

/// The number of compute threads.
fn threads(ui: &mut Ui, before: Option<usize>, requests: &mut Vec<Request>) {
    ui.horizontal(|ui| {
        let mut chosen = before;
        let mut all = chosen.is_none();
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        if ui
            .checkbox(&mut all, "One per core")
            .on_hover_text("Compute threads have a lower priority than the window")
            .changed()
        {
            chosen = (!all).then_some(cores);
        }
        if let Some(count) = &mut chosen {
            NumberField::whole("Threads", THREADS).edit_whole(ui, count);
            if *count > cores {
                ui.weak(format!("this machine has {cores}"));
            }
        }
        if chosen != before {
            requests.push(Request::Set(Setting::Threads(chosen)));
        }
    });
}

/// System, light or dark.
pub fn theme_choice(ui: &mut Ui) -> bool {
    let current = ui.ctx().options(|options| options.theme_preference);
    let themes = [
        ("System", egui::ThemePreference::System),
        ("Light", egui::ThemePreference::Light),
        ("Dark", egui::ThemePreference::Dark),
    ];
    let mut chosen = false;
    for (text, theme) in themes {
        if ui.radio(current == theme, text).clicked() {
            ui.ctx().set_theme(theme);
            chosen = true;
        }
    }
    chosen
}

/// Name of the processor, read once: the system lists it in a long file.
static PROCESSOR: LazyLock<String> = LazyLock::new(|| Machine::here().processor);

fn about(ui: &mut Ui, renderer: Option<&str>, engine: EngineChoice, requests: &mut Vec<Request>) {
    ui.heading("Lenslet Studio");
    ui.label(env!("CARGO_PKG_DESCRIPTION"));
    ui.add_space(6.0);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let engines: Vec<String> = EngineChoice::built().into_iter().map(|engine| engine.to_string()).collect();
    let facts = [
        ("Version", env!("CARGO_PKG_VERSION").to_owned()),
        ("System", format!("{} on {}", std::env::consts::OS, std::env::consts::ARCH)),
        ("Processor", format!("{}, {}", PROCESSOR.as_str(), counted(cores, "thread"))),
        ("Estimate engine", engine.to_string()),
        ("Available engines", engines.join(", ")),
        ("Renderer", renderer.unwrap_or("-").to_owned()),
        ("Licence", env!("CARGO_PKG_LICENSE").to_owned()),
    ];
    egui::Grid::new("about").num_columns(2).spacing([16.0, 4.0]).show(ui, |ui| {
        for (name, value) in &facts {
            ui.label(RichText::new(*name).strong());
            ui.label(value);
            ui.end_row();
        }
    });
    ui.add_space(6.0);
    ui.label("The method is that of Kabuli et al. 2026; every bound names its source in the documentation.");
    ui.add_space(4.0);
    if ui.button("Copy").clicked() {
        let text: Vec<String> = facts.iter().map(|(name, value)| format!("{name}: {value}")).collect();
        requests.push(Request::Copy { text: text.join("\n"), what: "Versions" });
    }
}
