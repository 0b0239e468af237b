//! The open design: commands that change it, undo, autosave, the file of its network, samples and previews of files.

pub mod autosave;
pub mod command;
pub mod file_preview;
pub mod history;
pub mod network_file;
pub mod psf_preview;
pub mod samples;
