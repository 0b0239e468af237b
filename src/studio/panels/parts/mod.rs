//! Parts shared by several panels.

pub mod action_entry;
pub mod camera_calibration;
pub mod camera_captures;
pub mod camera_comparison;
pub mod camera_images;
pub mod camera_plots;
pub mod fit_length;
pub mod hints;
pub mod image_menu;
pub mod information_overlay;
pub mod job_progress;
pub mod lenslet_menu;
pub mod linked_cursor;
pub mod mask_drawing;
pub mod run_results;
pub mod severity_colour;
pub mod spectrum_plot;
pub mod study_cells;
pub mod study_plot;
pub mod tamura_gauge;
pub mod training;
pub mod training_curves;
pub mod trajectories;
