//! The window: it shows the workbench and sends it commands; everything that computes lives below.

mod actions;
mod app;
mod capture;
mod compare_panel;
mod dialogs;
mod estimates_panel;
mod hand;
mod history_panel;
mod home;
mod image_view;
mod information_map_panel;
mod information_panel;
mod jobs_window;
mod layout;
mod leaving;
mod lenslet_table;
mod levels;
mod links;
mod mask_canvas;
mod menus;
mod messages;
mod mtf_panel;
mod optimize_panel;
mod overlays;
mod palette;
mod recovery;
mod sample_panels;
mod scene_panel;
mod sheets;
mod spectrum_plot;
mod state;
mod viewport;
mod welcome;
mod window;

pub use app::Studio;
pub use window::{RendererChoice, WindowError, open_window};
