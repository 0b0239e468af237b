//! Controls that do not depend on designs: number fields, modal dialogs, the clipboard.

pub mod clipboard;
pub mod colours;
pub mod controls;
pub mod file_preview;
pub mod format;
pub mod missing_glyphs;
pub mod modal;
pub mod number;
pub mod number_field;
