//! Overlays of an image: pixel values, scale bar, cross hair of the linked cursor.

use egui::{Align2, Color32, FontId, Painter, Rect, Stroke, pos2, vec2};
use ndarray::ArrayView2;

use crate::studio::canvas::viewport::{Placement, round_length};
use crate::studio::widgets::format::format_significant;

/// Smallest pixel that shows its value, points.
const READABLE: f32 = 36.0;
/// Maximal number of drawn values.
const MOST_VALUES: usize = 600;
/// Maximal length of a scale bar, points, and its maximal share of the image.
const LONGEST_BAR: f32 = 110.0;
const LONGEST_SHARE: f32 = 0.4;
/// Dark outline of white lines.
const SHADE: Color32 = Color32::from_black_alpha(150);
/// Shade over what lies outside a region.
const DIM: Color32 = Color32::from_black_alpha(120);
/// Dark background of a scale bar, which hides values below it.
const PLATE: Color32 = Color32::from_black_alpha(225);

/// Draws the values of visible pixels, if those are large enough; `colour` maps a value to its colour.
pub fn pixel_values(
    painter: &Painter,
    placement: Placement,
    seen: Rect,
    image: ArrayView2<'_, f32>,
    colour: impl Fn(f32) -> Color32,
) {
    if placement.scale < READABLE {
        return;
    }
    let (rows, cols) = placement.pixels_in(seen, image.dim());
    if rows.len() * cols.len() > MOST_VALUES {
        return;
    }
    for row in rows {
        for col in cols.clone() {
            let Some(&value) = image.get((row, col)) else { continue };
            let text = short(value);
            // A character is about 0.56 times as wide as high.
            let size = (0.88 * placement.scale / (0.56 * text.len() as f32)).min(13.0);
            let font = FontId::proportional(size.floor());
            let place = placement.to_screen(col as f64, row as f64);
            // A clipped number would be misread.
            let half = vec2(0.28 * text.len() as f32, 0.5) * font.size;
            if seen.contains_rect(Rect::from_center_size(place, 2.0 * half)) {
                painter.text(place, Align2::CENTER_CENTER, text, font, contrasting(colour(value)));
            }
        }
    }
}

/// A value in few characters; integers without decimals.
fn short(value: f32) -> String {
    if value.fract() == 0.0 && value.abs() < 1e6 { format!("{value:.0}") } else { format_significant(f64::from(value)) }
}

/// Black or white, by contrast to a colour.
fn contrasting(below: Color32) -> Color32 {
    // Black and white have the same contrast at a relative luminance of 0.179.
    let linear = egui::Rgba::from(below);
    let luminance = 0.2126 * linear.r() + 0.7152 * linear.g() + 0.0722 * linear.b();
    if luminance > 0.179 { Color32::BLACK } else { Color32::WHITE }
}

/// Size of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelSize {
    /// Width in `unit`.
    pub width: f64,
    /// The unit.
    pub unit: &'static str,
    /// Micrometres per `unit`, which a scale bar then shows, too.
    pub pitch_um: Option<f64>,
}

impl PixelSize {
    /// A pixel of a sensor of this pitch in micrometres, if it is known.
    pub fn of_sensor(pitch_um: Option<f64>) -> Self {
        Self { width: 1.0, unit: "px", pitch_um }
    }

    /// Label of an axis of spatial frequencies.
    pub fn frequency_label(pitch_um: Option<f64>) -> &'static str {
        if pitch_um.is_some() { "cycles per millimetre" } else { "cycles per pixel" }
    }

    /// A spatial frequency of `width` cycles per pixel of such a sensor: cycles per millimetre where the pitch is known.
    pub fn of_frequency(width: f64, pitch_um: Option<f64>) -> Self {
        match pitch_um {
            None => Self { width, unit: "cycles/px", pitch_um: None },
            Some(pitch) => Self { width: width * 1000.0 / pitch, unit: "cycles/mm", pitch_um: None },
        }
    }
}

/// A scale bar.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleBar {
    /// Length, points.
    pub length: f32,
    /// Length as text, with its unit.
    pub text: String,
}

/// Scale bar of an image `room` points wide, with `scale` points per pixel. Lengths in pixels are whole numbers; none if not
/// even one pixel fits.
pub fn scale_bar_length(room: f32, scale: f32, pixel: PixelSize) -> Option<ScaleBar> {
    let PixelSize { width: per_pixel, unit, pitch_um } = pixel;
    let units_in = |points: f32| f64::from(points) * per_pixel / f64::from(scale);
    let length = round_length(units_in(LONGEST_BAR.min(LONGEST_SHARE * room)))
        .filter(|length| unit != "px" || *length >= 1.0)
        // One pixel is the minimum.
        .or_else(|| (unit == "px" && scale <= 0.8 * room).then_some(1.0))?;
    let physical = pitch_um.map_or_else(String::new, |pitch| format!(", {} \u{b5}m", tidy(length * pitch)));
    Some(ScaleBar { length: (length / per_pixel) as f32 * scale, text: format!("{} {unit}{physical}", tidy(length)) })
}

/// A number without trailing zeros.
fn tidy(length: f64) -> String {
    let text = format!("{length:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Draws the scale bar into the lower left corner.
pub fn scale_bar(painter: &Painter, seen: Rect, bar: &ScaleBar) {
    let ScaleBar { length, text } = bar;
    if seen.height() < 48.0 {
        return;
    }
    let galley = painter.layout_no_wrap(text.clone(), FontId::proportional(11.0), Color32::WHITE);
    let inside = vec2(length.max(galley.size().x), galley.size().y + 5.0);
    let plate =
        Rect::from_min_size(seen.left_bottom() - vec2(0.0, inside.y + 12.0) + vec2(5.0, 0.0), inside + vec2(10.0, 7.0));
    if plate.width() > seen.width() - 8.0 {
        return;
    }
    painter.rect_filled(plate, 3.0, PLATE);
    painter.galley(pos2(plate.center().x - galley.size().x / 2.0, plate.top() + 2.0), galley, Color32::WHITE);
    let (left, y) = (plate.center().x - length / 2.0, plate.bottom() - 5.0);
    painter.hline(left..=left + length, y, Stroke::new(2.0, Color32::WHITE));
    for end in [left, left + length] {
        painter.vline(end, y - 3.0..=y + 3.0, Stroke::new(1.0, Color32::WHITE));
    }
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelRegion {
    /// First row and column.
    pub corner: (usize, usize),
    /// Rows and columns.
    pub shape: (usize, usize),
}

impl PixelRegion {
    /// The region as the end of a sentence.
    pub fn describe(self) -> String {
        let Self { corner: (top, left), shape: (rows, cols) } = self;
        let (bottom, right) = ((top + rows).saturating_sub(1), (left + cols).saturating_sub(1));
        format!(", outlined rows {top} to {bottom}, columns {left} to {right}")
    }
}

/// Outlines a region of pixels and dims what is visible around it.
pub fn region(painter: &Painter, placement: Placement, seen: Rect, region: PixelRegion) {
    let PixelRegion { corner: (top, left), shape: (rows, cols) } = region;
    let edge = |row: usize, col: usize| placement.to_screen(col as f64 - 0.5, row as f64 - 0.5);
    let region = Rect::from_min_max(edge(top, left), edge(top + rows, left + cols));
    let inside = region.intersect(seen);
    let inside = if inside.is_positive() { inside } else { Rect::from_min_size(seen.min, egui::Vec2::ZERO) };
    for (from, to) in [
        (seen.left_top(), pos2(seen.right(), inside.top())),
        (pos2(seen.left(), inside.bottom()), seen.right_bottom()),
        (pos2(seen.left(), inside.top()), inside.left_bottom()),
        (inside.right_top(), pos2(seen.right(), inside.bottom())),
    ] {
        painter.rect_filled(Rect::from_min_max(from, to), 0.0, DIM);
    }
    // White on dark is visible on every colour.
    for stroke in [Stroke::new(3.0, SHADE), Stroke::new(1.0, Color32::WHITE)] {
        painter.rect_stroke(region, 0.0, stroke, egui::StrokeKind::Middle);
    }
}

/// Draws a cross hair at pixel coordinates (x, y); the pixel itself stays free.
pub fn cross_hair(painter: &Painter, placement: Placement, seen: Rect, (x, y): (f64, f64)) {
    let centre = placement.to_screen(x, y);
    let gap = (0.5 * placement.scale).clamp(5.0, 24.0);
    let painter = painter.with_clip_rect(painter.clip_rect().intersect(seen));
    // White on dark is visible on every colour.
    for stroke in [Stroke::new(3.0, SHADE), Stroke::new(1.0, Color32::WHITE)] {
        painter.hline(seen.left()..=centre.x - gap, centre.y, stroke);
        painter.hline(centre.x + gap..=seen.right(), centre.y, stroke);
        painter.vline(centre.x, seen.top()..=centre.y - gap, stroke);
        painter.vline(centre.x, centre.y + gap..=seen.bottom(), stroke);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_bars_are_round_and_fit() {
        let px = PixelSize::of_sensor(None);
        let bar = |length: f32, text: &str| Some(ScaleBar { length, text: text.into() });
        assert_eq!(scale_bar_length(290.0, 3.0, px), bar(60.0, "20 px"));
        assert_eq!(scale_bar_length(290.0, 12.0, px), bar(60.0, "5 px"));
        // A pixel larger than the longest bar is still the shortest length, as long as it fits.
        assert_eq!(scale_bar_length(290.0, 150.0, px), bar(150.0, "1 px"));
        assert_eq!(scale_bar_length(100.0, 150.0, px), None);
        // 32 frequencies of 1/32 cycle per pixel.
        let frequency = PixelSize::of_frequency(1.0 / 32.0, None);
        let ScaleBar { length, text } = scale_bar_length(320.0, 10.0, frequency).unwrap();
        assert_eq!(text, "0.2 cycles/px");
        assert!((length - 64.0).abs() < 1e-3);
        let text = |pixel| scale_bar_length(290.0, 3.0, pixel).unwrap().text;
        assert_eq!(text(PixelSize::of_sensor(Some(3.45))), "20 px, 69 \u{b5}m");
        assert_eq!(PixelSize::of_frequency(0.5, Some(4.0)).width, 125.0);
    }

    #[test]
    fn pixel_values_are_short_and_have_contrast() {
        for (value, text) in [(0.0, "0"), (134.0, "134"), (45.0, "45"), (45.25, "45.2"), (0.01234, "0.0123")] {
            assert_eq!(short(value), text);
        }
        assert_eq!(contrasting(Color32::from_gray(40)), Color32::WHITE);
        assert_eq!(contrasting(Color32::from_gray(150)), Color32::BLACK);
        assert_eq!(contrasting(Color32::YELLOW), Color32::BLACK);
        assert_eq!(contrasting(Color32::BLUE), Color32::WHITE);
    }
}
