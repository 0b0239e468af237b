//! Opens the window.

use std::cell::Cell;
use std::path::PathBuf;
use std::rc::Rc;

use thiserror::Error;

use crate::forward::Design;
use crate::studio::app::app_data::AppData;
use crate::studio::app::studio::Studio;
#[cfg(target_os = "linux")]
use crate::studio::app::window_system::WindowSystem;
use crate::studio::state::preferences::RendererChoice;
use crate::studio::widgets::clipboard::Clipboard;

/// Reason why there is no window.
#[derive(Debug, Error)]
pub enum WindowError {
    /// No display answers.
    #[error(
        "no window could be opened: nothing answers at the display that DISPLAY or WAYLAND_DISPLAY names; start it or \
         correct the name"
    )]
    NoDisplay,
    /// The renderer or the display of the open window was lost.
    #[error("the window was lost ({reason}); unsaved changes are offered when the program is started again")]
    Lost {
        /// The error.
        reason: String,
    },
    /// Neither renderer starts.
    #[error(
        "no window could be opened ({first_name}: {first}; {second_name}: {second}); check that the display named by \
         DISPLAY or WAYLAND_DISPLAY is running"
    )]
    NoRenderer {
        /// Name of the renderer that was tried first.
        first_name: &'static str,
        /// Its error.
        first: String,
        /// Name of the other.
        second_name: &'static str,
        /// Its error.
        second: String,
    },
}

/// The icon of the program, as a PNG.
const ICON: &[u8] = include_bytes!("../../../packaging/icons/lenslet-studio-128.png");

/// The icon of the window. An icon that cannot be read leaves the choice to the window system.
fn icon() -> egui::IconData {
    eframe::icon_data::from_png_bytes(ICON).unwrap_or_default()
}

/// Opens the window with a design and returns when it is closed. `renderer` draws it, or else the renderer of the
/// preferences. If that one does not start, the other one is used, with a message. `reset` resets layout and preferences
/// first.
///
/// # Errors
/// [`WindowError`] if neither renderer starts or the open window is lost.
pub fn open_window(
    design: Design,
    path: Option<PathBuf>,
    renderer: Option<RendererChoice>,
    reset: bool,
) -> Result<(), WindowError> {
    let folder = eframe::storage_dir("lenslet-studio");
    let mut notices = Vec::new();
    if reset && let Some(Err(error)) = folder.as_deref().map(AppData::reset) {
        notices.push(error.to_string());
    }
    #[cfg(target_os = "linux")]
    let system = WindowSystem::of_environment();
    #[cfg(target_os = "linux")]
    notices.extend(system.notice());
    let renderer = renderer.or_else(|| folder.as_deref().and_then(AppData::renderer)).unwrap_or_default();
    let opened = Rc::new(Cell::new(false));
    let open = |renderer: RendererChoice, notices: Vec<String>| {
        let opening = Opening {
            design: design.clone(),
            path: path.clone(),
            folder: folder.clone(),
            notices,
            opened: Rc::clone(&opened),
            #[cfg(target_os = "linux")]
            system: system.clone(),
        };
        opening.run(renderer)
    };
    let lost = |error: &eframe::Error| WindowError::Lost { reason: error.to_string() };
    let first = match open(renderer, notices.clone()) {
        Ok(()) => return Ok(()),
        Err(error) if opened.get() => return Err(lost(&error)),
        Err(eframe::Error::WinitEventLoop(_)) => return Err(WindowError::NoDisplay),
        Err(error) => error,
    };
    let other = renderer.other();
    let notice =
        format!("{} did not start ({first}); the window is drawn by {} instead.", renderer.name(), other.name());
    notices.push(notice);
    open(other, notices).map_err(|second| {
        if opened.get() {
            return lost(&second);
        }
        WindowError::NoRenderer {
            first_name: renderer.name(),
            first: first.to_string(),
            second_name: other.name(),
            second: second.to_string(),
        }
    })
}

/// Parameters of a window to open.
struct Opening {
    design: Design,
    path: Option<PathBuf>,
    /// Folder of the application data.
    folder: Option<PathBuf>,
    /// Messages at the start.
    notices: Vec<String>,
    /// Set when the window is open.
    opened: Rc<Cell<bool>>,
    #[cfg(target_os = "linux")]
    system: WindowSystem,
}

impl Opening {
    fn run(self, renderer: RendererChoice) -> Result<(), eframe::Error> {
        #[cfg(target_os = "linux")]
        let system = self.system.clone();
        let options = eframe::NativeOptions {
            viewport: egui::ViewportBuilder::default()
                .with_title("Lenslet Studio")
                .with_app_id("lenslet-studio")
                .with_inner_size([1280.0, 800.0])
                .with_min_inner_size([400.0, 300.0])
                .with_drag_and_drop(true)
                .with_icon(icon()),
            renderer: renderer.renderer(),
            // A failed first renderer must return, so that the second can be tried.
            run_and_return: true,
            #[cfg(target_os = "linux")]
            event_loop_builder: Some(Box::new(move |builder| system.choose(builder))),
            ..eframe::NativeOptions::default()
        };
        eframe::run_native(
            "lenslet-studio",
            options,
            Box::new(move |creation| Ok(Box::new(self.studio(creation, renderer)?))),
        )
    }

    fn studio(self, creation: &eframe::CreationContext<'_>, renderer: RendererChoice) -> std::io::Result<Studio> {
        let clipboard = self.clipboard();
        let mut studio = Studio::new(&creation.egui_ctx, self.design, self.path)?;
        self.opened.set(true);
        studio.drawn_by(renderer);
        studio.copy_to(clipboard);
        for notice in self.notices {
            studio.notify(notice);
        }
        match self.folder {
            Some(folder) => studio.keep_data_in(&creation.egui_ctx, &folder),
            None => studio.keep_no_data("there is no home folder"),
        }
        Ok(studio)
    }

    fn clipboard(&self) -> Clipboard {
        #[cfg(target_os = "linux")]
        if self.system == WindowSystem::Wayland {
            return Clipboard::OfEgui;
        }
        Clipboard::of_system()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn icon_is_read_with_its_size() {
        let icon = icon();
        assert_eq!((icon.width, icon.height, icon.rgba.len()), (128, 128, 4 * 128 * 128));
    }
}
