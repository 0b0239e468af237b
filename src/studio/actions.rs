//! What menus and shortcuts do: one list for both.

use egui::{Key, KeyboardShortcut, Modifiers};

use super::dialogs::Purpose;
use super::image_view::{ImageView, name_widget};
use super::state::State;
use crate::optics::{DIFFUSER_APERTURES, Diffuser, Encoder, depth_layout, heuristic_layout, random_layout};
use crate::workbench::Command;

/// Something that a menu entry or a shortcut does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Starts from the default design.
    New,
    /// Opens a design file.
    Open,
    /// Saves to the design's file, or asks for one.
    Save,
    /// Asks for a file and saves.
    SaveAs,
    /// Opens objects.
    OpenObjects,
    /// Imports a PSF.
    ImportPsf,
    /// Exports PSF and design.
    ExportDesign,
    /// Exports objects and measurements.
    ExportMeasurements,
    /// Goes one step back.
    Undo,
    /// Goes one step forth again.
    Redo,
    /// Selects every lenslet.
    SelectAll,
    /// Deletes the selection.
    Delete,
    /// Closes the window.
    Quit,
}

impl Action {
    /// All actions that have a shortcut, longer ones first: a shorter one would swallow them.
    const WITH_SHORTCUT: [Self; 9] = [
        Self::SaveAs,
        Self::New,
        Self::Open,
        Self::Save,
        Self::OpenObjects,
        Self::ExportDesign,
        Self::Quit,
        Self::Redo,
        Self::Undo,
    ];

    /// Text of the menu entry.
    pub fn label(self) -> &'static str {
        match self {
            Self::New => "New design",
            Self::Open => "Open design...",
            Self::Save => "Save design",
            Self::SaveAs => "Save design as...",
            Self::OpenObjects => "Open objects...",
            Self::ImportPsf => "Import PSF...",
            Self::ExportDesign => "Export design...",
            Self::ExportMeasurements => "Export measurements...",
            Self::Undo => "Undo",
            Self::Redo => "Redo",
            Self::SelectAll => "Select all lenslets",
            Self::Delete => "Delete selected lenslets",
            Self::Quit => "Quit",
        }
    }

    /// Its shortcut.
    pub fn shortcut(self) -> Option<KeyboardShortcut> {
        let command = Modifiers::COMMAND;
        let (modifiers, key) = match self {
            Self::New => (command, Key::N),
            Self::Open => (command, Key::O),
            Self::Save => (command, Key::S),
            Self::SaveAs => (command | Modifiers::SHIFT, Key::S),
            Self::OpenObjects => (command, Key::L),
            Self::ExportDesign => (command, Key::E),
            // The canvas reads these keys itself, since text fields have uses of their own for them.
            Self::SelectAll => (command, Key::A),
            Self::Delete => (Modifiers::NONE, Key::Delete),
            Self::Undo => (command, Key::Z),
            Self::Redo => (command | Modifiers::SHIFT, Key::Z),
            Self::Quit => (command, Key::Q),
            Self::ImportPsf | Self::ExportMeasurements => return None,
        };
        Some(KeyboardShortcut::new(modifiers, key))
    }

    /// The action whose shortcut was pressed.
    pub fn pressed(ctx: &egui::Context) -> Option<Self> {
        // Text fields undo what was typed into them.
        let focused = ctx.memory(egui::Memory::focused);
        let typing = focused.is_some_and(|id| egui::TextEdit::load_state(ctx, id).is_some());
        Self::WITH_SHORTCUT.into_iter().filter(|action| !typing || !action.is_for_text()).find(|action| {
            let shortcut = action.shortcut();
            shortcut.is_some_and(|shortcut| ctx.input_mut(|input| input.consume_shortcut(&shortcut)))
        })
    }

    /// Whether a text field does this for its own text.
    fn is_for_text(self) -> bool {
        matches!(self, Self::Undo | Self::Redo)
    }

    /// Does it.
    pub fn run(self, ctx: &egui::Context, state: &mut State) {
        let beside = state.bench.path().map(ToOwned::to_owned);
        let mut ask = |purpose| state.dialogs.ask(purpose, beside.as_deref());
        match self {
            Self::New => state.guard(ctx, super::state::Leave::New),
            Self::Open => state.guard(ctx, super::state::Leave::Open),
            Self::Save => match &beside {
                Some(path) => state.bench.save_to(path.clone()),
                None => ask(Purpose::SaveAs),
            },
            Self::SaveAs => ask(Purpose::SaveAs),
            Self::OpenObjects => ask(Purpose::OpenObjects),
            Self::ImportPsf => ask(Purpose::ImportPsf),
            Self::ExportDesign => ask(Purpose::ExportDesign),
            Self::ExportMeasurements => ask(Purpose::ExportMeasurements),
            Self::Undo => state.bench.undo(),
            Self::Redo => state.bench.redo(),
            Self::SelectAll => state.selection = (0..state.lenslet_count()).collect(),
            Self::Delete => state.delete_selection(),
            Self::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
        }
    }
}

/// The File menu.
pub fn file_menu(ui: &mut egui::Ui, state: &mut State) {
    for action in [Action::New, Action::Open, Action::Save, Action::SaveAs] {
        entry(ui, state, action, true);
    }
    ui.separator();
    entry(ui, state, Action::OpenObjects, true);
    entry(ui, state, Action::ImportPsf, true);
    ui.separator();
    entry(ui, state, Action::ExportDesign, true);
    let measured = state.live.measurements.is_some();
    entry(ui, state, Action::ExportMeasurements, measured);
    ui.menu_button("Export view", |ui| {
        export_view_menu(ui, state);
    });
    ui.separator();
    entry(ui, state, Action::Quit, true);
}

/// One entry per picture that there is.
fn export_view_menu(ui: &mut egui::Ui, state: &mut State) {
    let mut pictures = Vec::new();
    let mut picture = |view: &ImageView, image| {
        pictures.push(Purpose::ExportView { name: view.name(), image, limits: view.limits(), colormap: view.colormap });
    };
    if let Some(optics) = &state.live.optics {
        picture(&state.views.psf, optics.value.image.clone());
    }
    if let Some(scene) = &state.live.scene {
        let shown = state.sample.min(scene.value.objects.len_of(ndarray::Axis(0)) - 1);
        let object = scene.value.objects.index_axis(ndarray::Axis(0), shown);
        picture(&state.views.object, object.sum_axis(ndarray::Axis(0)));
    }
    if let Some(measurements) = &state.live.measurements {
        let stack = if state.noisy { &measurements.value.noisy } else { &measurements.value.noiseless };
        let shown = state.sample.min(stack.len_of(ndarray::Axis(0)) - 1);
        picture(&state.views.measurement, stack.index_axis(ndarray::Axis(0), shown).to_owned());
    }
    if let Some(optics) = state.live.optics.as_ref().filter(|_| state.mtf_as_map) {
        picture(&state.views.mtf, optics.value.mtf.map.clone());
    }
    for purpose in pictures {
        let Purpose::ExportView { name, .. } = purpose else { continue };
        if ui.button(format!("{name}...")).clicked() {
            let beside = state.bench.path().map(ToOwned::to_owned);
            state.dialogs.ask(purpose, beside.as_deref());
            ui.close();
        }
    }
}

/// The Edit menu.
pub fn edit_menu(ui: &mut egui::Ui, state: &mut State) {
    let undoes = state.bench.undoes().map(str::to_lowercase);
    let redoes = state.bench.redoes().map(str::to_lowercase);
    for (action, step) in [(Action::Undo, undoes), (Action::Redo, redoes)] {
        let text = format!("{} {}", action.label(), step.as_deref().unwrap_or_default());
        entry_called(ui, state, action, step.is_some(), text.trim_end());
    }
    ui.separator();
    let editable = state.lenslet_count() > 0;
    entry(ui, state, Action::SelectAll, editable);
    let deletable = !state.selection.is_empty();
    entry(ui, state, Action::Delete, deletable);
}

/// The Presets menu: masks to start from.
pub fn presets_menu(ui: &mut egui::Ui, state: &mut State) {
    let mut chosen = None;
    ui.menu_button("Heuristic lenslets", |ui| {
        for count in 1..=9 {
            let name = if count == 1 { "1 lenslet".to_owned() } else { format!("{count} lenslets") };
            if ui.button(&name).clicked() {
                chosen = Some((format!("{count} heuristic lenslets"), Encoder::Lenslets(heuristic_layout(count))));
                ui.close();
            }
        }
    });
    let seed = state.bench.design().seed;
    if ui.button("25 random lenslets").on_hover_text("Drawn from the design's seed; again draws others").clicked() {
        let draw = state.next_random_start(seed);
        chosen = Some((format!("25 random lenslets, seed {draw}"), Encoder::Lenslets(random_layout(25, draw))));
        ui.close();
    }
    if ui.button("5 lenslets in depth").on_hover_text("Each focused on a plane of its own, for volumes").clicked() {
        chosen = Some(("5 lenslets in depth".into(), Encoder::Lenslets(depth_layout(5))));
        ui.close();
    }
    ui.menu_button("Diffuser", |ui| {
        for aperture_px in DIFFUSER_APERTURES {
            if ui.button(format!("Aperture {aperture_px} px")).clicked() {
                let diffuser = Diffuser { aperture_px, seed };
                chosen = Some((format!("diffuser, aperture {aperture_px} px"), Encoder::Diffuser(diffuser)));
                ui.close();
            }
        }
    });
    entry(ui, state, Action::ImportPsf, true);
    if let Some((name, encoder)) = chosen {
        state.send(&Command::ReplaceEncoder { name, encoder });
    }
}

fn entry(ui: &mut egui::Ui, state: &mut State, action: Action, enabled: bool) {
    entry_called(ui, state, action, enabled, action.label());
}

fn entry_called(ui: &mut egui::Ui, state: &mut State, action: Action, enabled: bool, text: &str) {
    let mut button = egui::Button::new(text);
    if let Some(shortcut) = action.shortcut() {
        button = button.shortcut_text(ui.ctx().format_shortcut(&shortcut));
    }
    let response = ui.add_enabled(enabled, button);
    name_widget(&response, action.label());
    if response.clicked() {
        ui.close();
        let ctx = ui.ctx().clone();
        action.run(&ctx, state);
    }
}
