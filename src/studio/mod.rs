//! The window: it shows the workbench and sends it commands; everything that computes lives below.
//!
//! Sub-folders from the lowest to the highest; an import only goes down.

pub(crate) mod app;
pub(crate) mod canvas;
pub(crate) mod dialogs;
pub(crate) mod panels;
pub(crate) mod state;
pub(crate) mod widgets;

pub use app::studio::Studio;
pub use app::window::{WindowError, open_window};
pub use state::preferences::RendererChoice;
