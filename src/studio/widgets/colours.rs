//! Colours of quantities, the same in every plot and table.

use egui::Color32;

/// Colour of the Gaussian bound.
pub const GAUSSIAN: Color32 = Color32::from_rgb(74, 158, 255);
/// Colour of the entropy bound.
pub const ENTROPY_BOUND: Color32 = Color32::from_rgb(240, 138, 36);
/// Colour of density models.
pub const DENSITY: Color32 = Color32::from_rgb(196, 122, 232);
/// Colour of finished estimates by one density model.
pub const FITTED: Color32 = Color32::from_rgb(214, 190, 86);
/// Colour of upper bounds by posterior sampling.
pub const SAMPLED: Color32 = Color32::from_rgb(226, 92, 118);
/// Colour of lower bounds.
pub const LOWER: Color32 = Color32::from_rgb(64, 176, 112);

/// Colour of the trajectories of lenslets.
pub const TRAJECTORY: Color32 = Color32::from_rgb(120, 230, 255);
