//! Data that panels and dialogs show and edit, their requests, and the view of everything else. No widgets are drawn here.

pub mod action;
pub mod bound_summary;
pub mod capture;
pub mod compare;
pub mod copied_numbers;
pub mod dialogs;
pub mod edit_history;
pub mod estimates;
pub mod keys;
pub mod locks;
pub mod mask;
pub mod messages;
pub mod mtf_and_map;
pub mod optimize;
pub mod pane;
pub mod panel_states;
pub mod path_dialog;
pub mod preferences;
pub mod reconstruction;
pub mod request;
pub mod samples;
pub mod selection;
pub mod training_form;
pub mod transition;
pub mod view;
pub mod window_layout;
