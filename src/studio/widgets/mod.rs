//! Controls that know nothing of designs: number fields, modal dialogs, the clipboard.

pub mod clipboard;
pub mod glyphs;
pub mod modal;
pub mod number;
pub mod number_field;
