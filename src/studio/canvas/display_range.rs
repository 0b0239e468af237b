//! The display range of an image: the values of its first and last colour, set by a rule or on its histogram.

use std::ops::RangeInclusive;

use egui::{Color32, Rect, Sense, Stroke, Ui, pos2, vec2};
use ndarray::ArrayView2;

use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::format::format_significant;
use crate::studio::widgets::number_field::NumberField;

/// Share of the pixels that *Auto* clips at each end.
const CLIPPED: f64 = 0.0035;
/// Size of the histogram, points.
const WIDTH: f32 = 264.0;
const HEIGHT: f32 = 92.0;
/// Height of the colour strip below it, points.
const STRIP: f32 = 8.0;
/// Half width of a limit's handle, points.
const REACH: f32 = 5.0;

/// Rule for the display range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum DisplayRange {
    /// Minimum and maximum of each image.
    #[default]
    Full,
    /// Minimum and maximum of each image after clipping a few pixels at each end.
    Auto,
    /// Fixed values for all images.
    Fixed(f32, f32),
}

impl DisplayRange {
    /// Display range (low, high) of an image of shape (rows, cols). A range that is `common` to several images precedes a
    /// rule, and fixed values precede both.
    pub fn limits(self, image: ArrayView2<'_, f32>, common: Option<(f32, f32)>) -> (f32, f32) {
        match (self, common) {
            (Self::Fixed(low, high), _) => (low, high),
            (_, Some(common)) => common,
            (Self::Full, None) => full_range(image),
            (Self::Auto, None) => most_of(image).unwrap_or_else(|| full_range(image)),
        }
    }
}

fn full_range(image: ArrayView2<'_, f32>) -> (f32, f32) {
    let finite = image.iter().copied().filter(|value| value.is_finite());
    let (low, high) =
        finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    // A minimum close to 0 is displayed as 0.
    let low = if low > 0.0 && low < 1e-3 * high { 0.0 } else { low };
    if low < high { (low, high) } else { (low.min(0.0), low.max(0.0) + 1.0) }
}

/// Quantiles with a share [`CLIPPED`] of the pixels below and above; none if they are equal.
fn most_of(image: ArrayView2<'_, f32>) -> Option<(f32, f32)> {
    let mut values: Vec<f32> = image.iter().copied().filter(|value| value.is_finite()).collect();
    let left_out = (CLIPPED * values.len() as f64) as usize;
    let last = values.len().checked_sub(1 + left_out)?;
    let high = *values.select_nth_unstable_by(last, f32::total_cmp).1;
    let low = *values.select_nth_unstable_by(left_out, f32::total_cmp).1;
    (low < high).then_some((low, high))
}

/// Histogram of the values of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Lower edge of the first bin.
    start: f64,
    /// Width of a bin.
    width: f64,
    counts: Vec<u32>,
    /// Number, mean and standard deviation of the finite values.
    pixels: u32,
    mean: f64,
    sd: f64,
}

impl Histogram {
    const BINS: usize = 132;

    /// Histogram of an image, shape (rows, cols). Integers, such as photons, have bins of integer width, so that all bins
    /// hold equally many of them.
    pub fn of(image: ArrayView2<'_, f32>) -> Self {
        let finite = || image.iter().copied().filter(|value| value.is_finite()).map(f64::from);
        let (mut low, mut high, mut pixels, mut whole) = (f64::INFINITY, f64::NEG_INFINITY, 0_u32, true);
        let (mut sum, mut squares) = (0.0, 0.0);
        for value in finite() {
            low = low.min(value);
            high = high.max(value);
            whole &= value.fract() == 0.0;
            pixels += 1;
            sum += value;
        }
        if pixels == 0 {
            return Self { start: 0.0, width: 1.0, counts: vec![0], pixels, mean: 0.0, sd: 0.0 };
        }
        let mean = sum / f64::from(pixels);
        let (start, width, bins) = if whole {
            let width = ((high - low + 1.0) / Self::BINS as f64).ceil();
            (low - 0.5, width, ((high - low + 1.0) / width).ceil() as usize)
        } else if low < high {
            (low, (high - low) / Self::BINS as f64, Self::BINS)
        } else {
            (low - 0.5, 1.0, 1)
        };
        let mut counts = vec![0; bins.max(1)];
        let last = counts.len() - 1;
        for value in finite() {
            squares += (value - mean).powi(2);
            counts[(((value - start) / width) as usize).min(last)] += 1;
        }
        Self { start, width, counts, pixels, mean, sd: (squares / f64::from(pixels)).sqrt() }
    }

    /// Upper edge of the last bin.
    fn end(&self) -> f64 {
        self.start + self.width * self.counts.len() as f64
    }

    /// Count, mean and standard deviation as text.
    fn summary(&self, unit: &str) -> String {
        format!("{} px, mean {}, sd {} {unit}", self.pixels, format_significant(self.mean), format_significant(self.sd))
    }
}

/// An image whose display range is edited.
pub struct EditedImage<'a> {
    /// Name of the image, with which the names of the controls begin.
    pub name: &'a str,
    /// Unit of its values.
    pub unit: &'a str,
    /// Its colours, lowest value first.
    pub colours: &'a [Color32],
    /// Its histogram.
    pub histogram: &'a Histogram,
    /// Its display range (low, high).
    pub limits: (f32, f32),
}

/// Shows the histogram with two draggable limits, number fields and rules.
pub fn editor(ui: &mut Ui, edited: &EditedImage<'_>, levels: &mut DisplayRange, logarithmic: &mut bool) {
    ui.set_width(WIDTH);
    let name = edited.name;
    ui.horizontal(|ui| {
        ui.strong(name);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let log = ui.checkbox(logarithmic, "Log").on_hover_text("Logarithmic counts");
            name_widget(&log, &format!("{name} logarithmic counts"));
        });
    });
    let mut limits = edited.limits;
    histogram(ui, edited, &mut limits, *logarithmic);
    ui.weak(edited.histogram.summary(edited.unit));
    ui.horizontal(|ui| {
        let (low, high) = limits;
        let speed = f64::from(high - low) * 0.005;
        let field = |ui: &mut Ui, value: &mut f32, range: RangeInclusive<f32>, what: &str, expected: String| {
            let name = format!("{name} {what} value");
            let range = f64::from(*range.start())..=f64::from(*range.end());
            let field = NumberField::new(&name, range).speed(speed).shown_as(format_significant).expecting(expected);
            let (response, edit) = field.show(ui, f64::from(*value));
            response.on_hover_text(format!("The {what} value of the display range"));
            if let Some(edit) = edit {
                *value = edit.value as f32;
            }
        };
        let shown = |value: f32| format_significant(f64::from(value));
        ui.weak("from");
        let expected = format!("below the highest value, {}", shown(high));
        field(ui, &mut limits.0, f32::MIN..=below(high), "lowest", expected);
        ui.weak("to");
        let expected = format!("above the lowest value, {}", shown(low));
        field(ui, &mut limits.1, above(low)..=f32::MAX, "highest", expected);
        if !edited.unit.is_empty() {
            ui.weak(edited.unit);
        }
    });
    if limits != edited.limits {
        *levels = DisplayRange::Fixed(limits.0, limits.1);
    }
    ui.horizontal(|ui| {
        for (rule, text, hint) in [
            (DisplayRange::Auto, "Auto", "Clips 0.35 % of the pixels at each end"),
            (DisplayRange::Full, "Reset", "Spans the smallest to the largest value of each image"),
        ] {
            let response = ui.selectable_label(*levels == rule, text).on_hover_text(hint);
            name_widget(&response, &format!("{text} {name} display range"));
            if response.clicked() {
                *levels = rule;
            }
        }
        ui.weak("The data stay unchanged.");
    });
}

/// Largest allowed low limit below a high limit.
fn below(value: f32) -> f32 {
    value - (value.abs() * 1e-4).max(1e-9)
}

/// Smallest allowed high limit above a low limit.
fn above(value: f32) -> f32 {
    value + (value.abs() * 1e-4).max(1e-9)
}

/// Draws histogram, colour strip and the two draggable limits.
fn histogram(ui: &mut Ui, edited: &EditedImage<'_>, limits: &mut (f32, f32), logarithmic: bool) {
    let (all, _) = ui.allocate_exact_size(vec2(WIDTH, HEIGHT + STRIP + 8.0), Sense::hover());
    // The handles stay inside.
    let bars = Rect::from_min_size(all.min + vec2(REACH, 0.0), vec2(WIDTH - 2.0 * REACH, HEIGHT));
    let counted = edited.histogram;
    let first = counted.start.min(f64::from(limits.0));
    let last = counted.end().max(f64::from(limits.1));
    let x_of = |value: f64| egui::remap(value, first..=last, f64::from(bars.left())..=f64::from(bars.right())) as f32;
    let painter = ui.painter_at(all);
    painter.rect_filled(bars, 2.0, ui.visuals().extreme_bg_color);
    let tallest = counted.counts.iter().copied().max().unwrap_or(0).max(1);
    let colour = ui.visuals().text_color().gamma_multiply(0.75);
    for (index, &count) in counted.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let share = if logarithmic {
            f64::from(count).ln_1p() / f64::from(tallest).ln_1p()
        } else {
            f64::from(count) / f64::from(tallest)
        };
        let left = counted.start + index as f64 * counted.width;
        let (left, right) = (x_of(left), x_of(left + counted.width));
        // Every occupied bin is visible.
        let top = bars.bottom() - ((HEIGHT - 4.0) * share as f32).max(1.0);
        let right = right.max(left + 1.0);
        painter.rect_filled(Rect::from_min_max(pos2(left, top), pos2(right, bars.bottom())), 0.0, colour);
    }
    strip(&painter, bars, edited.colours, [x_of(f64::from(limits.0)), x_of(f64::from(limits.1))]);
    let value_at = |x: f32| {
        let value = egui::remap(f64::from(x), f64::from(bars.left())..=f64::from(bars.right()), first..=last);
        value.clamp(first, last) as f32
    };
    for (is_high, what) in [(false, "low limit"), (true, "high limit")] {
        let value = if is_high { limits.1 } else { limits.0 };
        let x = x_of(f64::from(value));
        let grip = Rect::from_x_y_ranges(x - REACH..=x + REACH, all.y_range());
        let response = ui.interact(grip, ui.scope_id().with(what), Sense::drag());
        let name = format!("{} {what}", edited.name);
        response.widget_info(|| egui::WidgetInfo::slider(true, f64::from(value), &name));
        let response = response.on_hover_and_drag_cursor(egui::CursorIcon::ResizeHorizontal);
        if response.dragged()
            && let Some(position) = response.interact_pointer_pos()
        {
            let value = value_at(position.x);
            if is_high {
                limits.1 = value.max(above(limits.0));
            } else {
                limits.0 = value.min(below(limits.1));
            }
        }
        let accent = if response.hovered() || response.dragged() {
            ui.visuals().strong_text_color()
        } else {
            ui.visuals().selection.stroke.color
        };
        painter.vline(x, bars.y_range(), Stroke::new(1.5, accent));
        let foot = bars.bottom() + STRIP;
        let tip = vec![pos2(x, foot), pos2(x + REACH, foot + 7.0), pos2(x - REACH, foot + 7.0)];
        painter.add(egui::Shape::convex_polygon(tip, accent, Stroke::NONE));
    }
}

/// Draws the colour strip.
fn strip(painter: &egui::Painter, bars: Rect, colours: &[Color32], [low, high]: [f32; 2]) {
    let (Some(&darkest), Some(&brightest)) = (colours.first(), colours.last()) else { return };
    let part = |left: f32, right: f32| {
        Rect::from_min_max(pos2(left, bars.bottom()), pos2(right.max(left), bars.bottom() + STRIP))
    };
    painter.rect_filled(part(bars.left(), low), 0.0, darkest);
    painter.rect_filled(part(high, bars.right()), 0.0, brightest);
    let mut mesh = egui::Mesh::default();
    let steps = 32;
    for step in 0..=steps {
        let share = step as f32 / steps as f32;
        let colour = colours[(share * (colours.len() - 1) as f32) as usize];
        let x = egui::lerp(low..=high, share);
        let next = mesh.vertices.len() as u32;
        mesh.colored_vertex(pos2(x, bars.bottom()), colour);
        mesh.colored_vertex(pos2(x, bars.bottom() + STRIP), colour);
        if next >= 2 {
            mesh.add_triangle(next - 2, next - 1, next);
            mesh.add_triangle(next - 1, next, next + 1);
        }
    }
    painter.add(mesh);
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, arr2};

    #[test]
    fn integers_have_bins_of_integer_width() {
        let image = arr2(&[[0.0, 1.0, 1.0], [3.0, 3.0, f32::NAN]]);
        let counted = Histogram::of(image.view());
        assert_eq!((counted.start, counted.width), (-0.5, 1.0));
        assert_eq!(counted.counts, [1, 2, 0, 2]);
        assert_eq!((counted.pixels, counted.end()), (5, 3.5));
        assert!((counted.mean - 1.6).abs() < 1e-12 && (counted.sd - 1.44_f64.sqrt()).abs() < 1e-12);
        // 400 values share bins of four each.
        let wide = Histogram::of(Array2::from_shape_fn((20, 20), |(row, col)| (20 * row + col) as f32).view());
        assert_eq!(wide.width, 4.0);
        assert!(wide.counts.iter().all(|&count| count == 4), "{:?}", wide.counts);
    }

    #[test]
    fn histogram_counts_every_pixel_once() {
        let image = Array2::from_shape_fn((30, 40), |(row, col)| ((row * 37 + col * 11) % 97) as f32 * 0.173 - 3.0);
        let counted = Histogram::of(image.view());
        assert_eq!(counted.counts.len(), Histogram::BINS);
        assert_eq!(counted.counts.iter().sum::<u32>(), 1200);
        let first = image.iter().filter(|value| f64::from(**value) < counted.start + counted.width).count();
        assert_eq!(counted.counts[0] as usize, first);
        let same = Histogram::of(Array2::from_elem((4, 4), 0.3).view());
        assert_eq!((same.counts, same.sd), (vec![16], 0.0));
        assert_eq!(Histogram::of(Array2::from_elem((2, 2), f32::NAN).view()).pixels, 0);
    }

    #[test]
    fn rules_follow_the_image_and_fixed_ranges_do_not() {
        let mut image = Array2::from_shape_fn((50, 40), |(row, col)| (row * 40 + col) as f32);
        assert_eq!(DisplayRange::Full.limits(image.view(), None), (0.0, 1999.0));
        // At either end 0.35 % of 2000 pixels are clipped.
        assert_eq!(DisplayRange::Auto.limits(image.view(), None), (7.0, 1992.0));
        image[(0, 0)] = 1e6;
        assert_eq!(DisplayRange::Full.limits(image.view(), None), (0.0, 1e6), "1 is as good as 0 there");
        assert!(DisplayRange::Auto.limits(image.view(), None).1 < 2000.0);
        assert_eq!(DisplayRange::Fixed(3.0, 4.0).limits(image.view(), None), (3.0, 4.0));
        assert_eq!(DisplayRange::Fixed(3.0, 4.0).limits(image.view(), Some((0.0, 9.0))), (3.0, 4.0));
        assert_eq!(DisplayRange::Auto.limits(image.view(), Some((0.0, 9.0))), (0.0, 9.0), "common to several images");
        // If nearly all pixels are equal, the range covers the few others.
        let mut dark = Array2::zeros((50, 40));
        dark[(4, 4)] = 8.0;
        assert_eq!(DisplayRange::Auto.limits(dark.view(), None), (0.0, 8.0));
        assert_eq!(DisplayRange::Full.limits(Array2::zeros((3, 3)).view(), None), (0.0, 1.0));
    }
}
