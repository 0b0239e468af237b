//! State of the dialogs in front of the window.

use crate::studio::state::capture::CaptureDialog;
use crate::studio::state::path_dialog::PathDialog;
use crate::studio::state::psf_import::PsfImportDialog;
use crate::studio::state::transition::PendingTransition;

/// The state of each dialog.
#[derive(Default)]
pub struct Dialogs {
    /// The question for a path.
    pub path: PathDialog,
    /// The import of a PSF.
    pub psf_import: PsfImportDialog,
    /// The open command palette.
    pub palette: Option<ActionPalette>,
    /// The open settings dialog.
    pub settings: Option<SettingsDialog>,
    /// Welcome dialog and tour.
    pub onboarding: Onboarding,
    /// The transition that waits for a confirmation.
    pub transition: Option<PendingTransition>,
    /// The window of a capture.
    pub capture: CaptureDialog,
    /// Whether the list of jobs is open.
    pub jobs_open: bool,
}

impl Dialogs {
    /// Whether a dialog has the keyboard.
    pub fn is_one_in_front(&self) -> bool {
        self.path.is_open()
            || self.psf_import.open.is_some()
            || self.transition.is_some()
            || self.palette.is_some()
            || self.settings.is_some()
            || self.onboarding.welcome
    }
}

/// State of welcome dialog and tour.
#[derive(Default)]
pub struct Onboarding {
    /// Whether the welcome dialog is open.
    pub welcome: bool,
    /// Index of the current step of the tour.
    pub tour: Option<usize>,
    /// Whether a design was exported.
    pub exported: bool,
}

/// One of the settings dialogs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingsDialog {
    /// Keys and gestures.
    Shortcuts,
    /// Settings.
    Settings,
    /// Versions and machine.
    About,
}

/// The open command palette.
#[derive(Default)]
pub struct ActionPalette {
    /// The typed words.
    pub query: String,
    /// Index of the marked action in the list.
    pub marked: usize,
}
