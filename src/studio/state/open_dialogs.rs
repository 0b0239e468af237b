//! State of welcome dialog, tour, settings dialogs and command palette.

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
    pub query: String,
    /// Index of the marked action in the list.
    pub marked: usize,
}
