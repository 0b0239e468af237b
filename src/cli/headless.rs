//! What the program does where it cannot open a window: the same design, computed and exported.

use std::path::Path;

use super::look::Look;
use super::{Failure, output};
use crate::forward::Design;
use crate::workbench::export_design;

/// Folder that a run without a window exports to.
const FOLDER: &str = "lenslet-studio-export";

/// The design of a file, or the default one.
pub fn design(path: Option<&Path>) -> anyhow::Result<Design> {
    Ok(match path {
        Some(path) => Design::open(path)?,
        None => Design::default(),
    })
}

/// Whether there is something to open a window on.
#[cfg(feature = "studio")]
pub fn has_display() -> bool {
    let named = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    // Elsewhere the system always has one, or says so when the window is opened.
    !cfg!(target_os = "linux") || named("DISPLAY") || named("WAYLAND_DISPLAY")
}

/// Computes a design as the window would, prints its numbers, and exports it.
pub fn run(design: &Design) -> Result<(), Failure> {
    let mut lines = Look::bounded(design)?.lines();
    let exported = export_design(design, Path::new(FOLDER), None);
    if let Ok(files) = &exported {
        lines.push(format!("Exported to {FOLDER}:"));
        let names = files.iter().filter_map(|file| file.file_name());
        lines.extend(names.map(|name| format!("  {}", name.to_string_lossy())));
    }
    // Whatever becomes of the files, the numbers are told.
    let printed = output::print(&lines.join("\n"));
    exported?;
    printed
}
