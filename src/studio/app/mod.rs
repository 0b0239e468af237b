//! The window itself: menus, layout, shortcuts, the whole state, files of the application.

pub mod app_data;
pub mod capture;
pub mod dispatch;
pub mod edits;
pub mod layout;
pub mod menus;
pub mod outcomes;
pub mod path_answers;
pub mod repaint_throttle;
pub mod state;
pub mod studio;
pub mod transitions;
pub mod window;
#[cfg(target_os = "linux")]
pub mod window_system;
