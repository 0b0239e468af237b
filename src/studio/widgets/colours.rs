//! Colours of quantities, the same in every plot and table, and of texts.

use egui::{Color32, Visuals};

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

/// Gives texts and secondary texts a contrast of at least 4.5 to panels, which the defaults have not.
pub fn make_texts_readable(visuals: &mut Visuals) {
    let (text, secondary) = if visuals.dark_mode { (180, 140) } else { (60, 100) };
    visuals.widgets.noninteractive.fg_stroke.color = Color32::from_gray(text);
    visuals.weak_text_color = Some(Color32::from_gray(secondary));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Contrast ratio of two colours after WCAG 2.
    fn contrast(one: Color32, other: Color32) -> f32 {
        let luminance = |colour: Color32| {
            let linear = egui::Rgba::from(colour);
            0.2126 * linear.r() + 0.7152 * linear.g() + 0.0722 * linear.b() + 0.05
        };
        let (one, other) = (luminance(one), luminance(other));
        one.max(other) / one.min(other)
    }

    #[test]
    fn texts_have_contrast_in_both_themes() {
        for mut visuals in [Visuals::dark(), Visuals::light()] {
            make_texts_readable(&mut visuals);
            for fill in [visuals.panel_fill, visuals.window_fill, visuals.extreme_bg_color, visuals.faint_bg_color] {
                let fill = visuals.panel_fill.blend(fill);
                let [text, secondary] =
                    [visuals.text_color(), visuals.weak_text_color()].map(|text| contrast(text, fill));
                assert!(secondary >= 4.5 && text > 1.3 * secondary, "{fill:?}: {text} {secondary}");
            }
        }
    }
}
