//! Colours that all drawings of studies share.

use plotters::style::RGBColor;

/// Colour number `index` of `count`, from dark to light, distinct for colour-blind readers as well (viridis without its palest end).
pub(super) fn ordered_colour(index: usize, count: usize) -> RGBColor {
    use colorgrad::Gradient;
    let share = if count > 1 { 0.88 * index as f32 / (count - 1) as f32 } else { 0.3 };
    let [red, green, blue, _] = colorgrad::preset::viridis().at(share).to_rgba8();
    RGBColor(red, green, blue)
}
