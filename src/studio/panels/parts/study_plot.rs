//! The plot of a study, which grows as its cells are computed.

use std::ops::RangeInclusive;

use egui::{Align2, Color32, RichText, Ui, Vec2, vec2};
use egui_plot::{GridMark, Legend, Line, LineStyle, MarkerShape, Plot, PlotPoints, Points, Text};

use crate::studies::plans::{Figure, Panel, Point, Quantity, Series};
use crate::studio::state::request::{Request, StudyRequest};
use crate::studio::widgets::controls::{name_widget, rest_of_panel};
use crate::workbench::{Colormap, OpenStudy};

/// Least height of the plot, points.
const LEAST_HEIGHT: f32 = 170.0;
/// Margin around the points, as a share of their range: labels of the first and last tick have room.
const MARGIN: Vec2 = vec2(0.12, 0.05);
/// Distance within which the pointer finds a point, points of the screen.
const NEAR: f32 = 12.0;
/// Size of the names of points, points of the screen.
const LABEL: f32 = 10.0;

/// Draws a panel of the figure. A click on a point opens the design of its cell.
pub fn show(ui: &mut Ui, panel: usize, open: &OpenStudy, requests: &mut Vec<Request>) {
    let figure = &open.figure;
    let Some(shown) = figure.panels.get(panel) else { return };
    if shown.series.iter().all(|series| series.points.is_empty()) {
        ui.weak("No cell is done yet");
        return;
    }
    let place = |x: f64| if figure.logarithmic { x.log10() } else { x };
    let ticks: Vec<(f64, String)> = figure.ticks.iter().map(|tick| (place(tick.x), tick.label.clone())).collect();
    let marks = grid(&ticks);
    let label = move |mark: GridMark, _: &RangeInclusive<f64>| {
        ticks.iter().find(|(x, _)| (x - mark.value).abs() < 1e-9).map_or(String::new(), |(_, label)| label.clone())
    };
    let quantity = shown.quantity;
    let mut plot = Plot::new("Study plot").x_axis_label(figure.x_label.clone());
    if !figure.is_scatter() {
        plot = plot.x_grid_spacer(move |_| marks.clone()).x_axis_formatter(label);
    }
    if quantity == Quantity::Information {
        plot = plot.include_y(0.0);
    }
    let is_dark = ui.visuals().dark_mode;
    let response = plot
        .height(rest_of_panel(ui, LEAST_HEIGHT))
        .set_margin_fraction(MARGIN)
        .legend(Legend::default())
        .allow_scroll(false)
        .y_axis_label(quantity.unit())
        .show(ui, |plot| {
            let count = shown.series.len();
            for (index, series) in shown.series.iter().enumerate() {
                let colour = colour(index, count, is_dark);
                if figure.is_scatter() {
                    cloud(plot, series, figure, colour);
                } else {
                    line(plot, series, figure, colour, figure.marks_optima(shown));
                }
            }
            let pointer = plot.response().hover_pos()?;
            let at = |point: &Point| plot.screen_from_plot([place(point.x), point.value].into()).distance(pointer);
            nearest(shown, &at)
        });
    name_widget(&response.response, "Study plot");
    let Some((name, point)) = response.inner else { return };
    let text = if figure.is_scatter() { described_cell(figure, name, point) } else { described(name, point, quantity) };
    requests.push(Request::Describe(text.clone()));
    response.response.clone().on_hover_text_at_pointer(text);
    if response.response.clicked() {
        requests.push(Request::Study(StudyRequest::OpenCell(point.cell)));
    }
}

fn line(plot: &mut egui_plot::PlotUi<'_>, series: &Series, figure: &Figure, colour: Color32, marks_optimum: bool) {
    let name = series.name.as_str();
    let place = |x: f64| if figure.logarithmic { x.log10() } else { x };
    let of = |value: &dyn Fn(&Point) -> Option<f64>| -> Vec<[f64; 2]> {
        series.points.iter().filter_map(|point| Some([place(point.x), value(point)?])).collect()
    };
    let joined = of(&|point| Some(point.value).filter(|_| !point.is_designed));
    plot.line(Line::new(name, PlotPoints::from(joined.clone())).color(colour).width(2.0));
    plot.points(Points::new(name, PlotPoints::from(joined)).color(colour).radius(2.5));
    let designed = of(&|point| Some(point.value).filter(|_| point.is_designed));
    plot.points(Points::new(name, designed).color(colour).shape(MarkerShape::Diamond).radius(5.0));
    let lower = of(&|point| point.lower);
    plot.line(Line::new(name, lower).color(colour).width(1.0).style(LineStyle::dashed_loose()));
    let published = of(&|point| point.published);
    plot.points(Points::new(name, published).color(colour).filled(false).radius(4.0));
    if let Some((best, bits)) = series.optimum().filter(|_| marks_optimum) {
        let star = vec![[place(best.x), bits]];
        plot.points(Points::new(name, star).color(colour).shape(MarkerShape::Asterisk).radius(6.0));
    }
}

/// The points of a series of a scatter plot, each with its intervals and its name.
fn cloud(plot: &mut egui_plot::PlotUi<'_>, series: &Series, figure: &Figure, colour: Color32) {
    let name = series.name.as_str();
    for point in &series.points {
        let ([left, right], [low, high]) = (point.x_interval_95, point.interval_95);
        for ends in [[[left, point.value], [right, point.value]], [[point.x, low], [point.x, high]]] {
            plot.line(Line::new(name, PlotPoints::from(ends.to_vec())).color(colour).width(1.0));
        }
        let label = figure.point_names.get(point.cell).map_or("", String::as_str);
        let text = RichText::new(label).size(LABEL);
        plot.text(Text::new(name, [point.x, point.value].into(), text).color(colour).anchor(Align2::LEFT_BOTTOM));
    }
    let points: Vec<[f64; 2]> = series.points.iter().map(|point| [point.x, point.value]).collect();
    plot.points(Points::new(name, points).color(colour).radius(3.0));
}

/// The point under the pointer, and its line.
fn nearest<'a>(panel: &'a Panel, distance: &dyn Fn(&Point) -> f32) -> Option<(&'a str, Point)> {
    let points = panel.series.iter().flat_map(|series| series.points.iter().map(move |point| (series, point)));
    let (series, point) = points.min_by(|(_, one), (_, other)| distance(one).total_cmp(&distance(other)))?;
    (distance(point) <= NEAR).then_some((series.name.as_str(), *point))
}

/// The numbers of a point, for people.
fn described(name: &str, point: Point, quantity: Quantity) -> String {
    let unit = quantity.unit();
    let [low, high] = point.interval_95;
    let lower = point.lower.map_or(String::new(), |bits| format!(", at least {bits:.4}"));
    let published = point.published.map_or(String::new(), |bits| format!(", published {bits:.4}"));
    let tamura = point.tamura.map_or(String::new(), |tamura| format!(", sensor Tamura {tamura:.3}"));
    format!("{name} at {}: {:.4} ({low:.4} to {high:.4}) {unit}{lower}{published}{tamura}", point.x, point.value)
}

/// The numbers of a point of a scatter plot, for people.
fn described_cell(figure: &Figure, name: &str, point: Point) -> String {
    let mask = figure.point_names.get(point.cell).map_or("", String::as_str);
    let ([left, right], [low, high]) = (point.x_interval_95, point.interval_95);
    format!(
        "{name}, {mask}: {:.2} ({low:.2} to {high:.2}) dB at {:.4} ({left:.4} to {right:.4}) bits per pixel",
        point.value, point.x
    )
}

/// Marks at the values of the x axis, as many as have room.
fn grid(ticks: &[(f64, String)]) -> Vec<GridMark> {
    let every = ticks.len().div_ceil(10).max(1);
    let ends = (ticks.first().map_or(0.0, |(x, _)| *x), ticks.last().map_or(1.0, |(x, _)| *x));
    let step = ((ends.1 - ends.0) / 4.0).max(1e-6);
    ticks.iter().step_by(every).map(|(x, _)| GridMark { value: *x, step_size: step }).collect()
}

/// Colour number `index` of `count`, from dark to light, without those that vanish on the background.
fn colour(index: usize, count: usize, is_dark: bool) -> Color32 {
    let (first, last) = if is_dark { (0.25, 1.0) } else { (0.0, 0.75) };
    let share = if count > 1 { first + (last - first) * index as f32 / (count - 1) as f32 } else { 0.5 };
    let [red, green, blue] = Colormap::Viridis.palette()[Colormap::index(share, (0.0, 1.0))];
    Color32::from_rgb(red, green, blue)
}
