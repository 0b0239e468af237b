//! Data that panels and dialogs show and edit, their requests, and the view of everything else. No widgets are drawn here.

pub mod action;
pub mod bound_summary;
pub mod comparison;
pub mod copied_numbers;
pub mod dialogs;
pub mod edit_history;
pub mod estimate_form;
pub mod image_panels;
pub mod locks;
pub mod mask_panel;
pub mod messages;
pub mod optimize_form;
pub mod pane;
pub mod panels;
pub mod path_question;
pub mod preferences;
pub mod request;
pub mod samples;
pub mod selection;
pub mod transition;
pub mod view;
pub mod window_layout;
