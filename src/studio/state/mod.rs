//! Data that the window shows and its forms hold.

pub mod action;
pub mod app_state;
pub mod availability;
pub mod bound_summary;
pub mod comparison;
pub mod copied_numbers;
pub mod edit_history;
pub mod estimate_form;
pub mod locks;
pub mod messages;
pub mod open_dialogs;
pub mod optimize_form;
pub mod pane;
pub mod panel_capture;
pub mod path_question;
pub mod preferences;
pub mod request;
pub mod run_start;
pub mod unfinished_work;
pub mod views;
