//! How past edits fared.

use egui::Ui;
use egui_plot::{Corner, Legend, Line, Plot, PlotPoints};

use super::dialogs::Purpose;
use super::image_view::{name_widget, toolbar};
use super::information_panel::{CEILING, GAUSSIAN};
use super::state::State;

/// Shows the bounds after each edit.
pub fn show(ui: &mut Ui, state: &mut State) {
    toolbar(ui, |ui| {
        ui.weak(format!("{} designs", state.trail.points.len()));
        let export = ui.small_button("Export CSV...");
        name_widget(&export, "Export history as CSV");
        if export.clicked() {
            let curve = state.trail.curve();
            state.dialogs.ask(Purpose::ExportCurve { curve, name: "information.csv" }, state.bench.path());
        }
    });
    let points = |value: &dyn Fn(&(u64, f64, Option<f64>)) -> Option<f64>| -> PlotPoints<'static> {
        let points = state.trail.points.iter().enumerate();
        points.filter_map(|(edit, point)| Some([edit as f64, value(point)?])).collect::<Vec<_>>().into()
    };
    let bound = points(&|point| Some(point.1));
    let ceiling = points(&|point| point.2);
    Plot::new("Information of past edits")
        .legend(Legend::default().position(Corner::LeftBottom))
        .include_y(0.0)
        .allow_scroll(false)
        .x_axis_label("edit")
        .y_axis_label("bits per pixel")
        .show(ui, |plot| {
            plot.line(Line::new("Gaussian bound", bound).color(GAUSSIAN).width(2.0));
            plot.line(Line::new("ceiling", ceiling).color(CEILING).width(2.0));
        });
}
