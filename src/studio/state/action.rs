//! The actions of menus, shortcuts, palette and buttons.

use std::borrow::Cow;

use egui::{Event, Key, KeyboardShortcut, Modifiers};

use crate::optics::DIFFUSER_APERTURES;
use crate::plural::counted;
use crate::studio::state::pane::Pane;

/// Number of layouts that can be saved.
const LAYOUTS: usize = 2;

/// An action, with its label and its shortcut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Starts from the default design.
    New,
    /// Opens a design file.
    Open,
    /// Saves to the file of the design, or asks for one.
    Save,
    /// Asks for a file and saves.
    SaveAs,
    /// Opens objects.
    OpenObjects,
    /// Opens the window that reconstructs a capture of a camera.
    OpenCapture,
    /// Imports a PSF.
    ImportPsf,
    /// Fits lenslets to the PSF of a mask without lenslets.
    FitLenslets,
    /// Exports PSF and design.
    ExportDesign,
    /// Exports objects and measurements.
    ExportMeasurements,
    /// Undoes the last step.
    Undo,
    /// Redoes the last undone step.
    Redo,
    /// Selects every lenslet.
    SelectAll,
    /// Deletes the selection.
    Delete,
    /// Adds a lenslet in the middle.
    AddLenslet,
    /// Starts the run of the form in the Optimize panel.
    StartRun,
    /// Stops the run, which can be resumed.
    StopRun,
    /// Accepts the previewed mask: into the design, or as a new design.
    Accept,
    /// Opens the previewed mask as a new design.
    OpenMask,
    /// Shows the open design again.
    EndPreview,
    /// Takes a snapshot of the open design for comparison.
    KeepSnapshot,
    /// Replaces the mask by a preset.
    Preset(Preset),
    /// Brings a panel to the front.
    Show(Pane),
    /// Restores the default layout.
    ResetLayout,
    /// Saves the layout under a number.
    RememberLayout(usize),
    /// Loads a saved layout.
    RecallLayout(usize),
    /// Maximizes the panel under the pointer, or restores all panels.
    Maximise,
    /// Opens the command palette.
    Palette,
    /// Shows keys and gestures.
    Shortcuts,
    /// Opens the settings.
    Settings,
    /// Opens the welcome dialog.
    Welcome,
    /// Starts the tour.
    Tour,
    /// Shows versions and the machine.
    About,
    /// Copies the numbers of the shown design as JSON.
    CopyNumbers,
    /// Copies the command line that reproduces them.
    CopyCommand,
    /// Exports the record of the live estimate.
    ExportLive,
    /// Shows the jobs.
    Jobs,
    /// Shows all messages.
    Messages,
    /// Closes the window.
    Quit,
}

/// A preset mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// Heuristic layout of this many lenslets, 1 to 9.
    Heuristic(usize),
    /// 25 random lenslets, from the seed of the design; new ones at every use.
    Random,
    /// 5 lenslets, each focused on a plane of its own.
    Depth,
    /// Diffuser with an aperture of this many pixels.
    Diffuser(usize),
}

impl Preset {
    fn all() -> impl Iterator<Item = Self> {
        let diffusers = DIFFUSER_APERTURES.into_iter().map(Self::Diffuser);
        (1..=9).map(Self::Heuristic).chain([Self::Random, Self::Depth]).chain(diffusers)
    }

    /// Its name in its menu.
    pub fn label(self) -> String {
        match self {
            Self::Heuristic(count) => counted(count, "lenslet"),
            Self::Random => "25 random lenslets".into(),
            Self::Depth => "5 lenslets in depth".into(),
            Self::Diffuser(aperture_px) => format!("Aperture {aperture_px} px"),
        }
    }

    /// Its name outside the Presets menu.
    fn full_label(self) -> String {
        match self {
            Self::Heuristic(_) => format!("Mask: {}, heuristic", self.label()),
            Self::Random | Self::Depth => format!("Mask: {}", self.label()),
            Self::Diffuser(aperture_px) => format!("Mask: diffuser, aperture {aperture_px} px"),
        }
    }
}

impl Action {
    /// Actions with a shortcut; shortcuts with more modifiers come first, because a shorter one would match too.
    const WITH_SHORTCUT: [Self; 20] = [
        Self::SaveAs,
        Self::Palette,
        Self::CopyCommand,
        Self::Shortcuts,
        Self::KeepSnapshot,
        Self::Jobs,
        Self::Maximise,
        Self::RecallLayout(1),
        Self::RecallLayout(2),
        Self::Settings,
        Self::New,
        Self::Open,
        Self::Save,
        Self::OpenObjects,
        Self::ExportDesign,
        Self::Quit,
        Self::Redo,
        Self::Undo,
        Self::SelectAll,
        Self::Delete,
    ];

    /// All actions of the palette.
    pub fn all() -> impl Iterator<Item = Self> {
        let plain = [
            Self::New,
            Self::Open,
            Self::Save,
            Self::SaveAs,
            Self::OpenObjects,
            Self::OpenCapture,
            Self::ImportPsf,
            Self::FitLenslets,
            Self::ExportDesign,
            Self::ExportMeasurements,
            Self::Undo,
            Self::Redo,
            Self::SelectAll,
            Self::Delete,
            Self::AddLenslet,
            Self::StartRun,
            Self::StopRun,
            Self::Accept,
            Self::OpenMask,
            Self::EndPreview,
            Self::KeepSnapshot,
            Self::Maximise,
            Self::Shortcuts,
            Self::Settings,
            Self::Welcome,
            Self::Tour,
            Self::About,
            Self::CopyNumbers,
            Self::CopyCommand,
            Self::ExportLive,
            Self::Jobs,
            Self::Messages,
            Self::Quit,
        ];
        plain.into_iter().chain(Self::layouts()).chain(Preset::all().map(Self::Preset)).chain(Pane::ALL.map(Self::Show))
    }

    /// Actions on layouts.
    pub fn layouts() -> impl Iterator<Item = Self> {
        let numbers = 1..=LAYOUTS;
        let remember = numbers.clone().map(Self::RememberLayout);
        numbers.map(Self::RecallLayout).chain(remember).chain([Self::ResetLayout])
    }

    /// Text of the menu entry.
    pub fn label(self) -> Cow<'static, str> {
        Cow::Borrowed(match self {
            Self::New => "New design",
            Self::Open => "Open design...",
            Self::Save => "Save design",
            Self::SaveAs => "Save design as...",
            Self::OpenObjects => "Open objects...",
            Self::OpenCapture => "Open capture...",
            Self::ImportPsf => "Import PSF...",
            Self::FitLenslets => "Fit lenslets to this PSF",
            Self::ExportDesign => "Export design...",
            Self::ExportMeasurements => "Export measurements...",
            Self::Undo => "Undo",
            Self::Redo => "Redo",
            Self::SelectAll => "Select all lenslets",
            Self::Delete => "Delete selected lenslets",
            Self::Preset(preset) => return preset.full_label().into(),
            Self::Show(pane) => return format!("Show {}", pane.title()).into(),
            Self::AddLenslet => "Add a lenslet",
            Self::StartRun => "Start an optimization run",
            Self::StopRun => "Stop the run",
            Self::Accept => "Accept this mask",
            Self::OpenMask => "Open as new design",
            Self::EndPreview => "End preview",
            Self::KeepSnapshot => "Take snapshot of design",
            Self::ResetLayout => "Reset layout",
            Self::RememberLayout(number) => return format!("Save as layout {number}").into(),
            Self::RecallLayout(number) => return format!("Use layout {number}").into(),
            Self::Maximise => "Maximize or restore panel",
            Self::Palette => "Find an action...",
            Self::Shortcuts => "Keys and gestures",
            Self::Settings => "Settings...",
            Self::Welcome => "Welcome and samples...",
            Self::Tour => "Take the tour",
            Self::About => "About Lenslet Studio",
            Self::CopyNumbers => "Copy numbers as JSON",
            Self::CopyCommand => "Copy command line",
            Self::ExportLive => "Export record of the live estimate...",
            Self::Jobs => "Jobs",
            Self::Messages => "Messages",
            Self::Quit => "Quit",
        })
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
            Self::SelectAll => (command, Key::A),
            Self::Delete => (Modifiers::NONE, Key::Delete),
            Self::Undo => (command, Key::Z),
            Self::Redo => (command | Modifiers::SHIFT, Key::Z),
            Self::Quit => (command, Key::Q),
            Self::Palette => (command | Modifiers::SHIFT, Key::P),
            Self::KeepSnapshot => (command, Key::D),
            Self::CopyCommand => (command | Modifiers::SHIFT, Key::C),
            Self::Jobs => (command, Key::J),
            Self::Maximise => (command, Key::M),
            Self::RecallLayout(1) => (command, Key::Num1),
            Self::RecallLayout(2) => (command, Key::Num2),
            Self::Settings => (command, Key::Comma),
            Self::Shortcuts => (Modifiers::NONE, Key::F1),
            _ => return None,
        };
        Some(KeyboardShortcut::new(modifiers, key))
    }

    /// Its shortcuts, the usual one first.
    pub fn shortcuts(self) -> impl Iterator<Item = KeyboardShortcut> {
        let second = match self {
            // Common in other programs.
            Self::Palette => Some(KeyboardShortcut::new(Modifiers::COMMAND, Key::K)),
            // For keyboards without a Delete key.
            Self::Delete => Some(KeyboardShortcut::new(Modifiers::NONE, Key::Backspace)),
            _ => None,
        };
        self.shortcut().into_iter().chain(second)
    }

    /// Actions whose shortcuts were pressed since the last frame, in order.
    pub fn pressed(ctx: &egui::Context) -> Vec<Self> {
        let focused = ctx.memory(egui::Memory::focused);
        let typing = focused.is_some_and(|id| egui::TextEdit::load_state(ctx, id).is_some());
        let mut pressed = Vec::new();
        ctx.input_mut(|input| {
            input.events.retain(|event| {
                let Event::Key { key, modifiers, pressed: true, .. } = event else { return true };
                let action = Self::of_key(*modifiers, *key, typing);
                pressed.extend(action);
                action.is_none()
            });
        });
        pressed
    }

    /// Action of a key, if any. `typing` is true if a text field has the keyboard.
    fn of_key(modifiers: Modifiers, key: Key, typing: bool) -> Option<Self> {
        let is = |other: Modifiers, wanted: Key| key == wanted && modifiers.matches_logically(other);
        let mut by_shortcut = Self::WITH_SHORTCUT.into_iter().filter(|action| !typing || !action.is_for_text());
        by_shortcut.find(|action| action.shortcuts().any(|shortcut| is(shortcut.modifiers, shortcut.logical_key)))
    }

    /// Whether a text field handles this action for its own text.
    fn is_for_text(self) -> bool {
        matches!(self, Self::Undo | Self::Redo | Self::SelectAll | Self::Delete)
    }
}
