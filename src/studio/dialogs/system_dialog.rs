//! The file dialog of the system, on its own thread.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};

use crate::studio::state::path_dialog::{Answer, Picker};

/// Opens the dialog at a path; `None` if no thread can be started.
pub fn open(ctx: &egui::Context, picker: Picker, start: &Path) -> Option<Receiver<Answer>> {
    let (sender, receiver) = channel();
    let (start, ctx) = (start.to_owned(), ctx.clone());
    let thread = std::thread::Builder::new().name("lenslet-file-dialog".into()).spawn(move || {
        let answer = if can_answer() { ask(picker, &start) } else { Answer::Missing };
        // The question may be closed already; the answer is then dropped.
        let _ = sender.send(answer);
        ctx.request_repaint();
    });
    thread.ok().map(|_| receiver)
}

fn ask(picker: Picker, start: &Path) -> Answer {
    let mut dialog = rfd::FileDialog::new();
    if let Some(folder) = start.parent().and_then(|folder| folder.canonicalize().ok()) {
        dialog = dialog.set_directory(folder);
    }
    if let Some(name) = start.file_name() {
        dialog = dialog.set_file_name(name.to_string_lossy());
    }
    let path = match picker {
        Picker::Open => dialog.pick_file(),
        Picker::Save => dialog.save_file(),
        Picker::Folder => dialog.pick_folder(),
    };
    path.map_or(Answer::Cancelled, Answer::Chosen)
}

/// Whether the system has a file dialog. On Linux a desktop portal or zenity opens it; without either, `rfd` reports
/// "cancelled".
#[cfg(target_os = "linux")]
fn can_answer() -> bool {
    has_zenity() || has_portal()
}

/// Whether the system has a file dialog, which it always has.
#[cfg(not(target_os = "linux"))]
fn can_answer() -> bool {
    true
}

#[cfg(target_os = "linux")]
fn has_zenity() -> bool {
    use std::os::unix::fs::PermissionsExt;
    let is_program =
        |path: PathBuf| path.metadata().is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0);
    let folders = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&folders).any(|folder| is_program(folder.join("zenity")))
}

/// Whether a desktop portal offers file dialogs; the call starts it.
#[cfg(target_os = "linux")]
fn has_portal() -> bool {
    let version = || -> zbus::Result<u32> {
        let connection = zbus::blocking::Connection::session()?;
        let portal = zbus::blocking::Proxy::new(
            &connection,
            "org.freedesktop.portal.Desktop",
            "/org/freedesktop/portal/desktop",
            "org.freedesktop.portal.FileChooser",
        )?;
        portal.get_property("version")
    };
    version().is_ok()
}
