//! The window itself: menus, layout, shortcuts, files of the application.

pub mod app_data;
pub mod capture;
pub mod dispatch;
pub mod layout;
pub mod menus;
pub mod repaint_throttle;
pub mod studio;
pub mod window;
#[cfg(target_os = "linux")]
pub mod window_system;
