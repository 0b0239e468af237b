//! Which of the small dialogs are open, and what they hold.

/// What newcomers are shown.
#[derive(Default)]
pub struct Onboarding {
    /// Whether it is asked what to start from.
    pub welcome: bool,
    /// The stop of the tour, if it is taken.
    pub tour: Option<usize>,
    /// Whether something was exported.
    pub exported: bool,
}

/// A sheet to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingsDialog {
    /// Keys and gestures.
    Shortcuts,
    /// What a person can choose.
    Settings,
    /// Versions and machine.
    About,
}

/// The open palette.
#[derive(Default)]
pub struct ActionPalette {
    pub query: String,
    /// Place of the marked action in the list.
    pub marked: usize,
}
