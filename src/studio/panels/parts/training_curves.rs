//! Curves of the training of a network: loss and PSNR on validation objects, over steps.

use std::ops::RangeInclusive;

use egui::{RichText, Sense, Ui, vec2};
use egui_plot::{GridInput, GridMark, HLine, Line, Plot, PlotPoints, Points};

use crate::reconstruction::TrainingPoint;
use crate::studio::state::training_form::{TrainingCurve, TrainingForm};
use crate::studio::state::view::View;
use crate::studio::widgets::colours::{DENSITY, ENTROPY_BOUND};
use crate::studio::widgets::controls::name_widget;
use crate::workbench::{LossPoint, Reconstruction};

/// Size of the texts, points.
const TEXT: f32 = 12.5;
/// Least width of both curves beside each other, points.
const BOTH_WIDTH: f32 = 480.0;
/// Least height of both curves one above the other, points.
const BOTH_HEIGHT: f32 = 300.0;
/// Spaces between the marks of an axis, about.
const SPACES: f64 = 4.0;
/// Least distance of the ends of the PSNR axis from the linear estimate, dB.
const LEAST_DB: f64 = 0.2;
/// Colour of the network.
const NETWORK: egui::Color32 = DENSITY;
/// Colour of the linear estimate.
const LINEAR: egui::Color32 = ENTROPY_BOUND;

/// Curves of a training.
pub struct Curves<'a> {
    losses: &'a [LossPoint],
    validations: &'a [TrainingPoint],
    linear_psnr_db: Option<f64>,
}

impl<'a> Curves<'a> {
    /// Those of the last training of this session, or else those of the used network.
    pub fn of(shown: Option<&'a Reconstruction>, view: &View<'a>) -> Self {
        match (&view.trainings.newest, shown.and_then(Reconstruction::trained_network)) {
            (Some(training), _) => Self {
                losses: &training.losses,
                validations: &training.validations,
                linear_psnr_db: training.linear_psnr_db,
            },
            (None, Some(network)) => {
                Self { losses: &[], validations: &network.training.curve, linear_psnr_db: Some(network.linear_psnr_db) }
            }
            (None, None) => Self { losses: &[], validations: &[], linear_psnr_db: None },
        }
    }

    /// Whether there is no point yet.
    pub fn is_empty(&self) -> bool {
        self.losses.is_empty() && self.validations.is_empty()
    }

    /// Draws both where there is room, beside each other or one above the other, and otherwise the chosen one.
    pub fn show(&self, ui: &mut Ui, form: &mut TrainingForm) {
        let room = ui.available_size();
        let has_both = room.x >= BOTH_WIDTH || room.y >= BOTH_HEIGHT;
        ui.horizontal(|ui| {
            if !has_both {
                ui.selectable_value(&mut form.curve, TrainingCurve::Loss, "Loss");
                ui.selectable_value(&mut form.curve, TrainingCurve::Psnr, "PSNR");
            }
            for (colour, name) in [(NETWORK, "network"), (LINEAR, "linear")] {
                let (rect, _) = ui.allocate_exact_size(vec2(8.0, 8.0), Sense::hover());
                ui.painter().rect_filled(rect, 2.0, colour);
                ui.label(RichText::new(name).size(TEXT));
            }
        });
        let room = ui.available_size();
        if room.x >= BOTH_WIDTH {
            ui.columns(2, |columns| {
                self.loss(&mut columns[0], room.y);
                self.psnr(&mut columns[1], room.y);
            });
        } else if has_both {
            let height = 0.5 * (room.y - ui.spacing().item_spacing.y);
            self.loss(ui, height);
            self.psnr(ui, height);
        } else if form.curve == TrainingCurve::Psnr {
            self.psnr(ui, room.y);
        } else {
            self.loss(ui, room.y);
        }
    }

    fn loss(&self, ui: &mut Ui, height: f32) {
        if self.losses.is_empty() {
            let text = if self.validations.is_empty() { "No step yet" } else { "Weights of a file have no losses" };
            empty(ui, "Training loss", text, height);
            return;
        }
        let points = |value: fn(&LossPoint) -> f64| -> PlotPoints<'static> {
            self.losses.iter().map(|point| [point.steps as f64, value(point)]).collect()
        };
        let shown = self.plot("Training loss", "loss, peak\u{b2}", height).show(ui, |plot| {
            plot.line(Line::new("linear", points(|point| point.linear)).color(LINEAR).width(1.5));
            plot.line(Line::new("network", points(|point| point.network)).color(NETWORK).width(2.0));
        });
        name_widget(&shown.response, "Training loss");
    }

    fn psnr(&self, ui: &mut Ui, height: f32) {
        if self.validations.is_empty() {
            empty(ui, "Validation PSNR", "No validation yet: one comes every 100 steps", height);
            return;
        }
        let points: Vec<[f64; 2]> = self.validations.iter().map(|point| [point.steps as f64, point.psnr_db]).collect();
        let mut plot = self.plot("Validation PSNR", "validation PSNR, dB", height);
        if let Some(linear) = self.linear_psnr_db {
            plot = plot.include_y(linear - LEAST_DB).include_y(linear + LEAST_DB);
        }
        let shown = plot.show(ui, |plot| {
            if let Some(linear) = self.linear_psnr_db {
                plot.hline(HLine::new("linear", linear).color(LINEAR).width(1.5));
            }
            plot.line(Line::new("network", points.clone()).color(NETWORK).width(2.0));
            plot.points(Points::new("network", points).color(NETWORK).radius(2.5));
        });
        name_widget(&shown.response, "Validation PSNR");
    }

    /// A plot over the steps so far.
    fn plot<'b>(&self, name: &'b str, axis: &'b str, height: f32) -> Plot<'b> {
        let steps = |last: Option<usize>| last.unwrap_or(0) as f64;
        let last = steps(self.losses.last().map(|point| point.steps));
        Plot::new(name)
            .height(height)
            .include_x(0.0)
            .include_x(last.max(steps(self.validations.last().map(|point| point.steps))).max(10.0))
            .allow_scroll(false)
            .x_grid_spacer(marks)
            .y_grid_spacer(marks)
            .x_axis_formatter(label)
            .y_axis_formatter(label)
            .x_axis_label("steps")
            .y_axis_label(axis)
    }
}

/// Sentence in place of a plot without points.
fn empty(ui: &mut Ui, name: &str, text: &str, height: f32) {
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), height), Sense::hover());
    let (font, colour) = (egui::FontId::proportional(TEXT), ui.visuals().weak_text_color());
    let galley = ui.painter().layout(text.to_owned(), font, colour, rect.width());
    let corner = rect.center() - 0.5 * galley.size();
    ui.painter().galley(corner, galley, colour);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name));
    response.ctx.accesskit_node_builder(response.id, |node| node.set_value(text));
}

/// Distance of the marks between two bounds: 1, 2 or 5 times a power of ten.
fn mark_distance((low, high): (f64, f64)) -> f64 {
    let least = ((high - low) / SPACES).max(f64::MIN_POSITIVE);
    let power = 10.0_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|factor| factor * power).find(|step| *step >= least).unwrap_or(10.0 * power)
}

/// A few marks that all have labels.
fn marks(input: GridInput) -> Vec<GridMark> {
    let (low, high) = input.bounds;
    let step = mark_distance(input.bounds);
    if !(step.is_normal() && low.is_finite() && high.is_finite()) {
        return Vec::new();
    }
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(|index| GridMark { value: index as f64 * step, step_size: 2.5 * step }).collect()
}

/// Label of a mark, with the digits in which it differs from its neighbours.
fn label(mark: GridMark, range: &RangeInclusive<f64>) -> String {
    let decimals = -mark_distance((*range.start(), *range.end())).log10().floor();
    format!("{:.*}", decimals.clamp(0.0, 12.0) as usize, mark.value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_have_a_few_marks_with_different_labels() {
        for (low, high) in [(0.0021, 0.00224), (26.5, 27.3), (-3.0, 61.0), (0.0, 100_000.0)] {
            let marks = marks(GridInput { bounds: (low, high), base_step_size: 0.1 });
            assert!((2..=5).contains(&marks.len()), "{low} {high}: {}", marks.len());
            let mut labels: Vec<String> = marks.iter().map(|mark| label(*mark, &(low..=high))).collect();
            labels.dedup();
            assert_eq!(labels.len(), marks.len(), "{labels:?}");
        }
        assert!(marks(GridInput { bounds: (f64::NAN, 1.0), base_step_size: 0.1 }).is_empty());
        assert_eq!(label(GridMark { value: 0.0022, step_size: 1.0 }, &(0.0021..=0.00224)), "0.00220");
    }
}
