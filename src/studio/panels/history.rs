//! The information after each edit.

use egui::Ui;
use egui_plot::{Corner, Legend, Line, Plot, PlotPoints, Points};

use crate::plural::counted;
use crate::studio::state::edit_history::{EditHistory, EditPoint};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::Request;
use crate::studio::widgets::colours::{DENSITY, ENTROPY_BOUND, GAUSSIAN};
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};

/// Shows the bounds after each edit.
pub fn show(ui: &mut Ui, history: &EditHistory, requests: &mut Vec<Request>) {
    toolbar(ui, |ui| {
        ui.weak(counted(history.points.len(), "design"));
        let export = ui.small_button("Export CSV...");
        name_widget(&export, "Export history as CSV");
        if export.clicked() {
            let curve = history.curve();
            requests.push(Request::AskPath(PathPurpose::ExportCurve { curve, name: "information.csv" }));
        }
    });
    if history.points.is_empty() {
        placeholder(ui, "The bounds of each edit appear here.");
        return;
    }
    Plot::new("Information of past edits")
        .legend(Legend::default().position(Corner::LeftBottom))
        .include_y(0.0)
        .allow_scroll(false)
        .x_axis_label("edit")
        .y_axis_label("bits per pixel")
        .show(ui, |plot| {
            let mut first = 0;
            // A gap where the scene or the sensor changed: numbers on its two sides are not comparable.
            for segment in history.comparable_segments() {
                let line = |value: &dyn Fn(&EditPoint) -> Option<f64>| -> PlotPoints<'static> {
                    let points = segment.iter().enumerate();
                    points.filter_map(|(step, point)| Some([(first + step) as f64, value(point)?])).collect()
                };
                let is_bound = segment.iter().all(|point| point.gaussian_is_bound);
                let gaussian = if is_bound { "Gaussian bound" } else { "Gaussian approximation" };
                for (name, colour, value) in [
                    (gaussian, GAUSSIAN, &(|point: &EditPoint| Some(point.gaussian)) as &dyn Fn(&_) -> _),
                    ("entropy bound", ENTROPY_BOUND, &|point: &EditPoint| point.entropy_bound),
                    ("density model", DENSITY, &|point: &EditPoint| point.live),
                ] {
                    plot.line(Line::new(name, line(value)).color(colour).width(2.0));
                    plot.points(Points::new(name, line(value)).color(colour).radius(2.5));
                }
                first += segment.len();
            }
        });
}
