//! The window: it shows the session and sends it commands; everything that computes lies below.
//!
//! | folder, lowest first | holds |
//! |---|---|
//! | `widgets` | number fields, modal dialogs, names of controls, clipboard; know nothing of designs |
//! | `canvas` | images on screen: colours, display range, zoom, overlays |
//! | `state` | the data that panels and dialogs show, the actions, the requests of panels |
//! | `panels` | one file per panel; `parts` are what several panels are made of |
//! | `dialogs` | dialogs in front of the window |
//! | `app` | the window itself: menus, layout, dispatch of actions, files of the application |
//!
//! Imports only go down, and panels do not import each other. In each frame results are loaded into the state. Panels and
//! dialogs draw it and request actions, and `app::dispatch` runs the actions.

pub(crate) mod app;
pub(crate) mod canvas;
pub(crate) mod dialogs;
pub(crate) mod panels;
pub(crate) mod state;
pub(crate) mod widgets;

pub use app::studio::Studio;
pub use app::window::{WindowError, open_window};
pub use state::preferences::RendererChoice;
