//! Dialogs in front of the window.

pub mod capture;
pub mod confirm_discard;
pub mod dropped_files;
pub mod palette;
pub mod path_dialog;
pub mod psf_images;
pub mod psf_import;
pub mod recovery;
pub mod settings_dialogs;
pub mod system_dialog;
pub mod welcome;
