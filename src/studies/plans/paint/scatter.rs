//! Drawing of a panel of a scatter plot.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::{AxisX, Drawn, MOST_LABELS, Painter};
use crate::studies::plans::figure::{Panel, Point, Tick};

/// Space beyond the points of a panel, as a share of their range.
const SPACE: f64 = 0.08;
/// Least range of an axis, so that one point has a place.
const LEAST_RANGE: f64 = 1e-3;

impl Painter<'_> {
    /// A panel with its own ranges: sets of objects differ more than masks do.
    pub(super) fn scatter<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>, panel: &Panel) -> Drawn
    where
        DB::ErrorType: 'static,
    {
        let points = || panel.series.iter().flat_map(|series| &series.points);
        let ends = range(points().flat_map(|point| point.x_interval_95));
        let axis = AxisX { ticks: round_ticks(&ends), ends, logarithmic: false };
        let values = range(points().flat_map(|point| point.interval_95));
        let mut chart = self.chart(area, panel.title.clone(), axis, values, panel.quantity.label())?;
        for series in &panel.series {
            let colour = self.colour(&series.name);
            let bar = |ends: [(f64, f64); 2]| PathElement::new(ends, colour.stroke_width(self.scale));
            let bars = |&Point { x, value, x_interval_95: [left, right], interval_95: [low, high], .. }: &Point| {
                [bar([(left, value), (right, value)]), bar([(x, low), (x, high)])]
            };
            chart.draw_series(series.points.iter().flat_map(bars))?;
            let size = self.px(4);
            let at = |point: &Point| (point.x, point.value);
            chart.draw_series(series.points.iter().map(|point| Circle::new(at(point), size, colour.filled())))?;
            let beside = (self.px(6), self.px(-14));
            let name = |point: &Point| self.figure.point_names.get(point.cell).cloned().unwrap_or_default();
            let label = |point: &Point| EmptyElement::at(at(point)) + Text::new(name(point), beside, self.font(10));
            chart.draw_series(series.points.iter().map(label))?;
        }
        Ok(())
    }
}

/// The range of some values with space around them.
fn range(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 0.0..1.0;
    }
    let space = SPACE * (high - low).max(LEAST_RANGE);
    low - space..high + space
}

/// Ticks at multiples of 1, 2 or 5 times a power of ten.
fn round_ticks(ends: &std::ops::Range<f64>) -> Vec<Tick> {
    let least = (ends.end - ends.start) / MOST_LABELS as f64;
    let power = 10_f64.powf(least.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power).into_iter().find(|step| *step >= least);
    let step = step.unwrap_or(10.0 * power);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let (first, last) = ((ends.start / step).ceil() as i64, (ends.end / step).floor() as i64);
    let tick = |number: i64| Tick { x: number as f64 * step, label: format!("{:.decimals$}", number as f64 * step) };
    (first..=last).map(tick).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers_within_the_range() {
        let labels = |ends| round_ticks(&ends).into_iter().map(|tick| tick.label).collect::<Vec<_>>();
        assert_eq!(
            labels(0.17..0.26),
            ["0.17", "0.18", "0.19", "0.20", "0.21", "0.22", "0.23", "0.24", "0.25", "0.26"]
        );
        assert_eq!(labels(-0.2..1.1), ["-0.2", "0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(range(std::iter::empty())).first().map(String::as_str), Some("0.0"));
        let one = range([3.0].into_iter());
        assert!(one.start < 3.0 && one.end > 3.0 && !round_ticks(&one).is_empty());
    }
}
