//! What all drawings of studies share: their font and their colours.

use std::sync::Once;

use plotters::style::{FontStyle, RGBColor, register_font};

/// Family of all texts. Texts are measured by the program's own font; a viewer of the SVG takes its own sans-serif.
pub(super) const FONT: &str = "sans-serif";

/// Makes the font known to the drawing library. A drawing without it fails.
pub(super) fn use_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // The font is complete, as the program contains it; without it a drawing says that its font is missing.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
}

/// Colour number `index` of `count`, from dark to light, distinct for colour-blind readers as well (viridis without its palest end).
pub(super) fn ordered_colour(index: usize, count: usize) -> RGBColor {
    use colorgrad::Gradient;
    let share = if count > 1 { 0.88 * index as f32 / (count - 1) as f32 } else { 0.3 };
    let [red, green, blue, _] = colorgrad::preset::viridis().at(share).to_rgba8();
    RGBColor(red, green, blue)
}
