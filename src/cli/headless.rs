//! Fallback without a display: computes and exports the design.

use std::path::Path;

use super::bounds::DesignBounds;
use super::failure::Failure;
use super::output;
use crate::forward::Design;
use crate::workbench::export_design;

/// Export folder of a headless run.
const FOLDER: &str = "lenslet-studio-export";

/// The design of a file, or the default one.
pub fn design(path: Option<&Path>) -> anyhow::Result<Design> {
    Ok(match path {
        Some(path) => Design::open(path)?,
        None => Design::default(),
    })
}

/// Whether a display is available.
#[cfg(feature = "studio")]
pub fn has_display() -> bool {
    let named = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    // Other systems have a display, or report an error when the window opens.
    !cfg!(target_os = "linux") || named("DISPLAY") || named("WAYLAND_DISPLAY")
}

/// Computes the bounds of a design, prints them, and exports the design.
pub fn run(design: &Design) -> Result<(), Failure> {
    let mut lines = DesignBounds::with_lower_bound(design)?.lines();
    let exported = export_design(design, Path::new(FOLDER), None);
    if let Ok(files) = &exported {
        lines.push(format!("Exported to {FOLDER}:"));
        let names = files.iter().filter_map(|file| file.file_name());
        lines.extend(names.map(|name| format!("  {}", name.to_string_lossy())));
    }
    // The numbers are printed even if the export fails.
    let printed = output::print(&lines.join("\n"));
    exported?;
    printed
}
