//! What is drawn over a picture: values inside its pixels, a scale bar, the cross hair of a linked picture.

use egui::{Align2, Color32, FontId, Painter, Rect, Stroke, pos2, vec2};
use ndarray::ArrayView2;

use crate::studio::canvas::viewport::{Placement, round_length};
use crate::studio::widgets::format::format_significant;

/// Pixels that are at least this large show their values, points.
const READABLE: f32 = 36.0;
/// No more values than this are drawn.
const MOST_VALUES: usize = 600;
/// A scale bar is at most this long, points, and takes at most this share of the picture.
const LONGEST_BAR: f32 = 110.0;
const LONGEST_SHARE: f32 = 0.4;
/// Dark around what is drawn in white.
const SHADE: Color32 = Color32::from_black_alpha(150);
/// Dark behind a scale bar; values below would be mistaken for its own.
const PLATE: Color32 = Color32::from_black_alpha(225);

/// Writes the values of the pixels in sight into them, where they are large enough; `colour` tells what is below.
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
            // As large as fits: a character is about 0.56 as wide as it is high.
            let size = (0.88 * placement.scale / (0.56 * text.len() as f32)).min(13.0);
            let font = FontId::proportional(size.floor());
            let place = placement.to_screen(col as f64, row as f64);
            // A number that is cut in two is read as another.
            let half = vec2(0.28 * text.len() as f32, 0.5) * font.size;
            if seen.contains_rect(Rect::from_center_size(place, 2.0 * half)) {
                painter.text(place, Align2::CENTER_CENTER, text, font, contrasting(colour(value)));
            }
        }
    }
}

/// A value in few characters; counts of photons as the whole numbers they are.
fn short(value: f32) -> String {
    if value.fract() == 0.0 && value.abs() < 1e6 { format!("{value:.0}") } else { format_significant(f64::from(value)) }
}

/// Black or white, whichever is read more easily on a colour.
fn contrasting(below: Color32) -> Color32 {
    // Relative luminance; at 0.179 black and white have the same contrast.
    let linear = egui::Rgba::from(below);
    let luminance = 0.2126 * linear.r() + 0.7152 * linear.g() + 0.0722 * linear.b();
    if luminance > 0.179 { Color32::BLACK } else { Color32::WHITE }
}

/// Length of the scale bar of a picture `room` points wide, with `scale` points per pixel of `per_pixel` units, and what is
/// written on it. Lengths in pixels are whole; none where not one fits.
pub fn scale_bar_length(room: f32, scale: f32, (per_pixel, unit): (f64, &str)) -> Option<(f32, String)> {
    let units_in = |points: f32| f64::from(points) * per_pixel / f64::from(scale);
    let length = round_length(units_in(LONGEST_BAR.min(LONGEST_SHARE * room)))
        .filter(|length| unit != "px" || *length >= 1.0)
        // One pixel is as short as it gets.
        .or_else(|| (unit == "px" && scale <= 0.8 * room).then_some(1.0))?;
    Some(((length / per_pixel) as f32 * scale, format!("{} {unit}", tidy(length))))
}

/// A round number without zeros at its end.
fn tidy(length: f64) -> String {
    let text = format!("{length:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Draws the scale bar into the lower left corner.
pub fn scale_bar(painter: &Painter, seen: Rect, length: f32, text: &str) {
    if seen.height() < 48.0 {
        return;
    }
    let galley = painter.layout_no_wrap(text.to_owned(), FontId::proportional(11.0), Color32::WHITE);
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

/// Draws a cross hair at pixel coordinates (x, y); the pixel itself stays free.
pub fn cross_hair(painter: &Painter, placement: Placement, seen: Rect, (x, y): (f64, f64)) {
    let centre = placement.to_screen(x, y);
    let gap = (0.5 * placement.scale).clamp(5.0, 24.0);
    let painter = painter.with_clip_rect(painter.clip_rect().intersect(seen));
    // White on dark is seen on every colour.
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
        let (length, text) = scale_bar_length(290.0, 3.0, (1.0, "px")).unwrap();
        assert_eq!((length, text.as_str()), (60.0, "20 px"));
        assert_eq!(scale_bar_length(290.0, 12.0, (1.0, "px")).unwrap().1, "5 px");
        // A pixel larger than the longest bar is still the shortest length, as long as it fits.
        assert_eq!(scale_bar_length(290.0, 150.0, (1.0, "px")).unwrap(), (150.0, "1 px".into()));
        assert_eq!(scale_bar_length(100.0, 150.0, (1.0, "px")), None);
        // 32 frequencies of 1/32 cycle per pixel.
        let (length, text) = scale_bar_length(320.0, 10.0, (1.0 / 32.0, "cycles/px")).unwrap();
        assert_eq!(text, "0.2 cycles/px");
        assert!((length - 64.0).abs() < 1e-3);
    }

    #[test]
    fn values_are_short_and_stand_out() {
        for (value, text) in [(0.0, "0"), (134.0, "134"), (45.0, "45"), (45.25, "45.2"), (0.01234, "0.0123")] {
            assert_eq!(short(value), text);
        }
        assert_eq!(contrasting(Color32::from_gray(40)), Color32::WHITE);
        assert_eq!(contrasting(Color32::from_gray(150)), Color32::BLACK);
        assert_eq!(contrasting(Color32::YELLOW), Color32::BLACK);
        assert_eq!(contrasting(Color32::BLUE), Color32::WHITE);
    }
}
