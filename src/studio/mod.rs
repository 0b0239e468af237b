//! The window: it shows the session and sends it commands; everything that computes lies below.
//!
//! | folder, lowest first | holds |
//! |---|---|
//! | `widgets` | number fields, modal dialogs, names of controls, clipboard; know nothing of designs |
//! | `canvas` | images on screen: colours, display range, zoom, overlays |
//! | `state` | plain data: the state of each panel and dialog, the view of everything else, the requests; no widgets |
//! | `panels` | one file per panel; `parts` are what several panels are made of |
//! | `dialogs` | dialogs in front of the window |
//! | `app` | the window itself: the whole state, menus, layout, dispatch of requests, files of the application |
//!
//! Imports only go down, and panels do not import each other. In each frame results are loaded into the state. A panel or
//! dialog gets its own part of the state to change, a `View` of the rest to read, and a list for its requests.
//! `app::dispatch` serves the requests of each panel before the next one is drawn.

pub(crate) mod app;
pub(crate) mod canvas;
pub(crate) mod dialogs;
pub(crate) mod panels;
pub(crate) mod state;
pub(crate) mod widgets;

pub use app::studio::Studio;
pub use app::window::{WindowError, open_window};
pub use state::preferences::RendererChoice;
