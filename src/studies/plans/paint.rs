//! Drawing of a figure as SVG or PNG.

mod scatter;

use std::path::Path;

use ndarray::Array3;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::prelude::*;

use super::figure::{Figure, Panel, Point, Quantity, Series, Tick};
use crate::formats::{DRAWING_FONT, use_drawing_font, write_png_rgb, write_safely};
use crate::studies::drawing::ordered_colour;
use crate::studies::error::StudyError;

/// Size of a panel with its labels, pixels of the drawing.
const PANEL: (u32, u32) = (520, 360);
/// Height of the panel with the Tamura coefficients, px.
const TAMURA: u32 = 230;
/// Height of title and caption, px.
const HEAD: u32 = 56;
/// Width of the legend, px.
const LEGEND: u32 = 210;
/// Distance of the entries of the legend, px.
const ENTRY: i32 = 20;
/// Pixels of a PNG for one of the drawing.
const PNG_SCALE: u32 = 2;
/// Most labelled ticks of an axis.
const MOST_LABELS: usize = 9;
/// Radii of the star of an optimum, px.
const STAR: (f64, f64) = (8.0, 3.4);
const GRID: RGBColor = RGBColor(0xdd, 0xdd, 0xdd);
const TEXT: RGBColor = RGBColor(0x22, 0x22, 0x22);

type Drawn = Result<(), Box<dyn std::error::Error>>;

/// The figure as SVG.
///
/// # Errors
/// [`StudyError::Plot`] where it cannot be drawn.
pub fn svg(figure: &Figure) -> Result<String, StudyError> {
    use_drawing_font();
    let mut text = String::new();
    let root = SVGBackend::with_string(&mut text, size_of(figure)).into_drawing_area();
    draw(&root, figure, 1).map_err(|error| StudyError::Plot { reason: error.to_string() })?;
    drop(root);
    Ok(text)
}

/// The figure as an image of shape (rows, cols, 3), for a PNG of 200 dots per inch at the size of the SVG.
///
/// # Errors
/// [`StudyError::Plot`] where it cannot be drawn.
pub fn png(figure: &Figure) -> Result<Array3<u8>, StudyError> {
    use_drawing_font();
    let (width, height) = size_of(figure);
    let (width, height) = (width * PNG_SCALE, height * PNG_SCALE);
    let mut pixels = vec![0_u8; 3 * (width * height) as usize];
    let failed = |reason: String| StudyError::Plot { reason };
    let root = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
    draw(&root, figure, PNG_SCALE).map_err(|error| failed(error.to_string()))?;
    drop(root);
    Array3::from_shape_vec((height as usize, width as usize, 3), pixels).map_err(|error| failed(error.to_string()))
}

/// Writes the figure as SVG or PNG, by the ending of the file.
///
/// # Errors
/// [`StudyError`] where the file has another ending, or cannot be drawn or written.
pub fn write_figure(figure: &Figure, file: &Path) -> Result<(), StudyError> {
    let ending = file.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "svg" => {
            let text = svg(figure)?;
            Ok(write_safely(file, |writer| writer.write_all(text.as_bytes()))?)
        }
        "png" => Ok(write_png_rgb(file, png(figure)?.view())?),
        _ => Err(StudyError::Ending { path: file.into() }),
    }
}

fn columns(figure: &Figure) -> usize {
    if figure.panels.len() > 1 { 2 } else { 1 }
}

fn size_of(figure: &Figure) -> (u32, u32) {
    let rows = figure.panels.len().div_ceil(columns(figure)).max(1) as u32;
    let tamura = if figure.optima { TAMURA } else { 0 };
    (PANEL.0 * columns(figure) as u32 + LEGEND, HEAD + PANEL.1 * rows + tamura)
}

/// A drawing of one scale.
struct Painter<'a> {
    figure: &'a Figure,
    scale: u32,
    /// Names of all lines, in the order of their colours.
    names: Vec<&'a str>,
}

fn draw<DB: DrawingBackend>(root: &DrawingArea<DB, Shift>, figure: &Figure, scale: u32) -> Drawn
where
    DB::ErrorType: 'static,
{
    let mut names: Vec<&str> = Vec::new();
    for series in figure.panels.iter().flat_map(|panel| &panel.series) {
        if !names.contains(&series.name.as_str()) {
            names.push(&series.name);
        }
    }
    let painter = Painter { figure, scale, names };
    root.fill(&WHITE)?;
    let (head, body) = root.split_vertically(HEAD * scale);
    painter.head(&head)?;
    let width = PANEL.0 * columns(figure) as u32 * scale;
    let (plots, legend) = body.split_horizontally(width);
    painter.legend(&legend)?;
    let rows = figure.panels.len().div_ceil(columns(figure)).max(1);
    let (panels, below) = plots.split_vertically(PANEL.1 * rows as u32 * scale);
    for (area, panel) in panels.split_evenly((rows, columns(figure))).iter().zip(&figure.panels) {
        if figure.is_scatter() {
            painter.scatter(area, panel)?;
        } else {
            painter.panel(area, panel)?;
        }
    }
    if figure.optima {
        painter.tamura(&below)?;
    }
    root.present()?;
    Ok(())
}

impl Painter<'_> {
    fn px(&self, pixels: i32) -> i32 {
        pixels * self.scale as i32
    }

    fn font(&self, size: u32) -> TextStyle<'static> {
        (DRAWING_FONT, size * self.scale).into_font().color(&TEXT)
    }

    fn colour(&self, name: &str) -> RGBColor {
        ordered_colour(self.names.iter().position(|known| *known == name).unwrap_or(0), self.names.len())
    }

    fn head<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>) -> Drawn
    where
        DB::ErrorType: 'static,
    {
        area.draw(&Text::new(self.figure.title.clone(), (self.px(14), self.px(10)), self.font(18)))?;
        area.draw(&Text::new(self.figure.caption.clone(), (self.px(14), self.px(34)), self.font(12)))?;
        Ok(())
    }

    fn legend<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>) -> Drawn
    where
        DB::ErrorType: 'static,
    {
        let (left, text) = (self.px(8), self.px(42));
        let mut top = self.px(8);
        area.draw(&Text::new(self.figure.lines_label.clone(), (left, top), self.font(12)))?;
        top += self.px(ENTRY);
        let middle = |top: i32| top + self.px(6);
        for name in &self.names {
            let colour = self.colour(name);
            if self.figure.is_scatter() {
                area.draw(&Circle::new((left + self.px(13), middle(top)), self.px(4), colour.filled()))?;
            } else {
                let line = [(left, middle(top)), (left + self.px(26), middle(top))];
                area.draw(&PathElement::new(line, colour.stroke_width(2 * self.scale)))?;
            }
            area.draw(&Text::new((*name).to_owned(), (text, top), self.font(12)))?;
            top += self.px(ENTRY);
        }
        top += self.px(10);
        let points = || self.figure.panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.points);
        let middle_of = |top: i32| (left + self.px(13), middle(top));
        if points().next().is_some() {
            let (x, middle) = middle_of(top);
            let bar = [(x, middle - self.px(6)), (x, middle + self.px(6))];
            area.draw(&PathElement::new(bar, TEXT.stroke_width(self.scale)))?;
            area.draw(&Text::new("95 % interval", (text, top), self.font(12)))?;
            top += self.px(ENTRY);
        }
        if points().any(|point| point.lower.is_some()) {
            let band = [(left, top), (left + self.px(26), top + self.px(12))];
            area.draw(&Rectangle::new(band, TEXT.mix(0.2).filled()))?;
            area.draw(&Text::new("lower to upper bound", (text, top), self.font(12)))?;
            top += self.px(ENTRY);
        }
        if points().any(|point| point.published.is_some()) {
            area.draw(&Circle::new(middle_of(top), self.px(4), TEXT.stroke_width(self.scale)))?;
            area.draw(&Text::new("published", (text, top), self.font(12)))?;
            top += self.px(ENTRY);
        }
        if points().any(|point| point.is_designed) {
            area.draw(&diamond(middle_of(top), f64::from(self.px(5)), TEXT))?;
            area.draw(&Text::new("designed mask", (text, top), self.font(12)))?;
            top += self.px(ENTRY);
        }
        if self.figure.optima {
            area.draw(&star(middle_of(top), f64::from(self.scale), TEXT))?;
            area.draw(&Text::new("optimum of a line", (text, top), self.font(12)))?;
        }
        Ok(())
    }

    /// Ends of the x axis, with some space beyond the points.
    fn ends(&self) -> std::ops::Range<f64> {
        let (first, last) = match (self.figure.ticks.first(), self.figure.ticks.last()) {
            (Some(first), Some(last)) => (first.x, last.x),
            _ => (0.0, 1.0),
        };
        if self.figure.logarithmic {
            return first / 1.1..last * 1.1;
        }
        let space = if last > first { 0.04 * (last - first) } else { 1.0 };
        first - space..last + space
    }

    /// Range of the y axis of all panels of a quantity: from 0 for information, around the values for a PSNR.
    fn range(&self, quantity: Quantity) -> std::ops::Range<f64> {
        let panels = self.figure.panels.iter().filter(|panel| panel.quantity == quantity);
        let points = panels.flat_map(|panel| &panel.series).flat_map(|series| &series.points);
        let values = points
            .flat_map(|point| [point.interval_95[0], point.interval_95[1], point.published.unwrap_or(point.value)]);
        let values: Vec<f64> = values.collect();
        let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        match quantity {
            Quantity::Information => 0.0..1.06 * most.max(0.05),
            Quantity::Psnr if values.is_empty() => 0.0..1.0,
            Quantity::Psnr => values.iter().copied().fold(f64::INFINITY, f64::min).floor() - 1.0..most.ceil() + 1.0,
        }
    }

    fn panel<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>, panel: &Panel) -> Drawn
    where
        DB::ErrorType: 'static,
    {
        let axis = AxisX { ends: self.ends(), ticks: self.figure.ticks.clone(), logarithmic: self.figure.logarithmic };
        let mut chart =
            self.chart(area, panel.title.clone(), axis, self.range(panel.quantity), panel.quantity.label())?;
        for series in &panel.series {
            let colour = self.colour(&series.name);
            for run in bounded(&series.points) {
                if let [point] = run {
                    let bar = [(point.x, point.lower.unwrap_or(point.upper)), (point.x, point.upper)];
                    chart.draw_series([PathElement::new(bar, colour.mix(0.3).stroke_width(6 * self.scale))])?;
                    continue;
                }
                let upper = run.iter().map(|point| (point.x, point.upper));
                let lower = run.iter().rev().map(|point| (point.x, point.lower.unwrap_or(point.upper)));
                chart.draw_series([Polygon::new(upper.chain(lower).collect::<Vec<_>>(), colour.mix(0.18).filled())])?;
            }
            let joined: Vec<(f64, f64)> =
                series.points.iter().filter(|point| !point.is_designed).map(|point| (point.x, point.value)).collect();
            chart.draw_series(LineSeries::new(joined, colour.stroke_width(2 * self.scale)))?;
            let known: Vec<(f64, f64)> =
                series.points.iter().filter_map(|point| Some((point.x, point.published?))).collect();
            let size = self.px(4);
            chart.draw_series(known.iter().map(|&at| Circle::new(at, size, colour.stroke_width(self.scale))))?;
            for point in &series.points {
                let [low, high] = point.interval_95;
                let style = colour.stroke_width(self.scale);
                chart.draw_series([PathElement::new([(point.x, low), (point.x, high)], style)])?;
                let at = (point.x, point.value);
                if point.is_designed {
                    let size = f64::from(self.px(5));
                    chart.draw_series([EmptyElement::at(at) + diamond((0, 0), size, colour)])?;
                } else {
                    chart.draw_series([Circle::new(at, self.px(2), colour.filled())])?;
                }
            }
            if let Some((best, bits)) = series.optimum().filter(|_| self.figure.marks_optima(panel)) {
                let scale = f64::from(self.scale);
                chart.draw_series([EmptyElement::at((best.x, bits)) + star((0, 0), scale, colour)])?;
            }
        }
        Ok(())
    }

    /// The sensor's Tamura coefficient at the optimum of each line.
    fn tamura<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>) -> Drawn
    where
        DB::ErrorType: 'static,
    {
        let best: Vec<(&Series, &Point)> = self
            .figure
            .information_panels()
            .flat_map(|panel| &panel.series)
            .filter_map(|series| Some((series, series.optimum()?.0)))
            .collect();
        let values: Vec<f64> = best.iter().filter_map(|(_, point)| point.tamura).collect();
        let most = values.iter().copied().fold(1.0, f64::max) * 1.1;
        let ticks = best.iter().enumerate();
        let ticks = ticks.map(|(place, (series, _))| Tick { x: place as f64, label: series.name.clone() }).collect();
        let axis = AxisX { ends: -0.5..best.len().max(1) as f64 - 0.5, ticks, logarithmic: false };
        let title = "Tamura coefficient of the sensor at each optimum".to_owned();
        let mut chart = self.chart(area, title, axis, 0.0..most, "Tamura coefficient")?;
        for (place, (series, point)) in best.iter().enumerate() {
            let Some(tamura) = point.tamura else { continue };
            let scale = f64::from(self.scale);
            let at = EmptyElement::at((place as f64, tamura));
            chart.draw_series([at + star((0, 0), scale, self.colour(&series.name))])?;
        }
        if !values.is_empty() {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let line = [(-0.5, mean), (best.len() as f64 - 0.5, mean)];
            chart.draw_series(LineSeries::new(line, TEXT.mix(0.5).stroke_width(self.scale)))?;
        }
        Ok(())
    }

    fn chart<'b, DB: DrawingBackend>(
        &self,
        area: &'b DrawingArea<DB, Shift>,
        title: String,
        x: AxisX,
        y: std::ops::Range<f64>,
        y_label: &str,
    ) -> Result<
        ChartContext<'b, DB, Cartesian2d<AxisX, plotters::coord::types::RangedCoordf64>>,
        Box<dyn std::error::Error>,
    >
    where
        DB::ErrorType: 'static,
    {
        let mut builder = ChartBuilder::on(area);
        builder
            .margin(self.px(8))
            .margin_right(self.px(16))
            .x_label_area_size(self.px(44))
            .y_label_area_size(self.px(54));
        if !title.is_empty() {
            builder.caption(title, self.font(13));
        }
        let is_tamura = y_label.starts_with("Tamura");
        let labels = x.ticks.clone();
        let mut chart = builder.build_cartesian_2d(x, y)?;
        let name = |at: &f64| {
            labels
                .iter()
                .find(|tick| (tick.x - at).abs() <= 1e-9 * tick.x.abs().max(1e-6))
                .map_or(String::new(), |tick| tick.label.clone())
        };
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(GRID.stroke_width(1))
            .x_labels(MOST_LABELS)
            .y_labels(7)
            .x_label_formatter(&name)
            .y_label_formatter(&|value| format!("{value:.2}"))
            .label_style(self.font(11))
            .axis_desc_style(self.font(12))
            .x_desc(if is_tamura { "" } else { self.figure.x_label.as_str() })
            .y_desc(y_label)
            .draw()?;
        Ok(chart)
    }
}

/// Runs of points that have a lower bound.
fn bounded(points: &[Point]) -> Vec<&[Point]> {
    points
        .chunk_by(|one, other| one.lower.is_some() == other.lower.is_some())
        .filter(|run| run[0].lower.is_some())
        .collect()
}

/// The x axis: linear or logarithmic, with labels at the values of the cells.
#[derive(Clone)]
struct AxisX {
    ends: std::ops::Range<f64>,
    ticks: Vec<Tick>,
    logarithmic: bool,
}

impl AxisX {
    fn place(&self, x: f64) -> f64 {
        if self.logarithmic { x.max(f64::MIN_POSITIVE).ln() } else { x }
    }
}

impl Ranged for AxisX {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let (first, last) = (self.place(self.ends.start), self.place(self.ends.end));
        let share = (self.place(*value) - first) / (last - first);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        let most = hint.max_num_points().clamp(1, MOST_LABELS);
        let (first, last) = (self.place(self.ends.start), self.place(self.ends.end));
        // Labels that crowd are left out, from the left.
        let least = (last - first) / (1.6 * most as f64);
        let mut points: Vec<f64> = Vec::new();
        for tick in &self.ticks {
            let is_apart = points.last().is_none_or(|before| self.place(tick.x) - self.place(*before) >= least);
            if is_apart {
                points.push(tick.x);
            }
        }
        points
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.ends.clone()
    }
}

fn star(at: (i32, i32), scale: f64, colour: RGBColor) -> Polygon<(i32, i32)> {
    let corner = |corner: i32| {
        let radius = scale * if corner % 2 == 0 { STAR.0 } else { STAR.1 };
        let angle = std::f64::consts::PI * (f64::from(corner) / 5.0 - 0.5);
        (at.0 + (radius * angle.cos()).round() as i32, at.1 + (radius * angle.sin()).round() as i32)
    };
    Polygon::new((0..10).map(corner).collect::<Vec<_>>(), colour.filled())
}

fn diamond(at: (i32, i32), size: f64, colour: RGBColor) -> Polygon<(i32, i32)> {
    let size = size.round() as i32;
    let corners = [(0, -size), (size, 0), (0, size), (-size, 0)];
    Polygon::new(corners.map(|(x, y)| (at.0 + x, at.1 + y)).to_vec(), colour.filled())
}
