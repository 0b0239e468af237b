//! The figure of a study: numbers and names of its plot, without any drawing.

use super::cell::{CellSettings, StudyMask};
use super::facet::Facet;
use super::folder::CellState;
use super::plan::Plan;
use crate::information::Protocol;
use crate::studies::published::{Published, published};

/// A figure: panels of lines that share their axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    /// Title.
    pub title: String,
    /// What all its numbers have in common.
    pub caption: String,
    /// Label of the x axis, with its unit.
    pub x_label: String,
    /// Labelled places of the x axis, in rising order.
    pub ticks: Vec<Tick>,
    /// Whether the x axis is logarithmic.
    pub logarithmic: bool,
    /// Whether optima are marked, and the sensor's Tamura coefficient is shown there.
    pub optima: bool,
    /// The panels.
    pub panels: Vec<Panel>,
}

/// A labelled place of the x axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The place.
    pub x: f64,
    /// Its label.
    pub label: String,
}

/// A panel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// Title; empty where there is one panel.
    pub title: String,
    /// The lines.
    pub series: Vec<Series>,
}

/// A line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Name.
    pub name: String,
    /// The points with a result, in rising x.
    pub points: Vec<Point>,
}

/// A point: one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Place of the cell in the plan.
    pub cell: usize,
    /// Place on the x axis.
    pub x: f64,
    /// The estimate, an upper bound, bits per pixel.
    pub bits: f64,
    /// Its 95 % interval.
    pub interval_95: [f64; 2],
    /// Lower bound, where one was computed, bits per pixel.
    pub lower: Option<f64>,
    /// The published value of the cell, bits per pixel.
    pub published: Option<f64>,
    /// Mean Tamura coefficient of noisy sensor patches.
    pub tamura: Option<f64>,
    /// Whether an optimizer made the mask.
    pub is_designed: bool,
}

impl Series {
    /// The point of the largest value that the line proves, and that value: the largest lower bound where all points have one, the
    /// largest estimate otherwise.
    pub fn optimum(&self) -> Option<(&Point, f64)> {
        let proves = self.points.iter().all(|point| point.lower.is_some());
        let worth = |point: &Point| point.lower.filter(|_| proves).unwrap_or(point.bits);
        let points = self.points.iter().map(|point| (point, worth(point)));
        points.max_by(|(_, one), (_, other)| one.total_cmp(other))
    }
}

/// The published value of a cell, where there is one for exactly these settings.
pub fn published_value(cell: &CellSettings) -> Option<Published> {
    let StudyMask::Given(source) = &cell.mask else { return None };
    let crate::forward::MaskSource::Heuristic(_) = source else { return None };
    let encoder = source.mask(cell.seed, &cell.objects).ok()?.encoder;
    published(&cell.design(encoder), cell.published_as, cell.patch.shape())
}

/// The figure of the cells that are done.
pub fn figure_of(plan: &Plan, cells: &[CellSettings], states: &[CellState]) -> Figure {
    let roles = &plan.plot;
    let numbers: Vec<Option<f64>> = cells.iter().map(|cell| place_of(roles.x, cell)).collect();
    let is_numeric = numbers.iter().all(Option::is_some);
    let names = distinct(cells.iter().map(|cell| plan.value(roles.x, cell)));
    let x_of = |index: usize| {
        let by_name = || names.iter().position(|name| *name == plan.value(roles.x, &cells[index])).unwrap_or(0) as f64;
        if is_numeric { numbers[index].unwrap_or_else(by_name) } else { by_name() }
    };
    let mut ticks: Vec<Tick> = Vec::new();
    for (index, cell) in cells.iter().enumerate() {
        let x = x_of(index);
        if !ticks.iter().any(|tick| tick.x == x) {
            ticks.push(Tick { x, label: plan.value(roles.x, cell) });
        }
    }
    ticks.sort_by(|one, other| one.x.total_cmp(&other.x));
    // Axes without a role and with several values tell lines apart, so that no line holds two points at one place.
    let others: Vec<Facet> = Facet::AXES
        .into_iter()
        .filter(|axis| {
            ![Some(roles.x), Some(roles.lines), roles.panels]
                .into_iter()
                .flatten()
                .any(|role| axis.holds(role) || role.holds(*axis))
        })
        .filter(|axis| distinct(cells.iter().map(|cell| plan.value(*axis, cell))).len() > 1)
        .collect();
    let panel_of = |cell: &CellSettings| roles.panels.map_or(String::new(), |panels| plan.value(panels, cell));
    let line_of = |cell: &CellSettings| {
        let rest = others.iter().map(|&axis| plan.value(axis, cell));
        std::iter::once(plan.value(roles.lines, cell)).chain(rest).collect::<Vec<_>>().join(", ")
    };
    let panels = distinct(cells.iter().map(panel_of)).into_iter().map(|title| {
        let of_panel = || cells.iter().enumerate().filter(|(_, cell)| panel_of(cell) == title);
        let series = distinct(of_panel().map(|(_, cell)| line_of(cell))).into_iter().map(|name| {
            let of_line = of_panel().filter(|(_, cell)| line_of(cell) == name);
            let mut points: Vec<Point> =
                of_line.filter_map(|(index, cell)| point_of(index, x_of(index), cell, &states[index])).collect();
            points.sort_by(|one, other| one.x.total_cmp(&other.x));
            Series { name, points }
        });
        let series: Vec<Series> = series.collect();
        let title = roles.panels.map_or(String::new(), |panels| format!("{panels} {title}"));
        Panel { title, series }
    });
    Figure {
        title: plan.title.clone(),
        caption: caption(plan, cells),
        x_label: roles.x.label(is_numeric).into(),
        logarithmic: roles.logarithmic && is_numeric && ticks.iter().all(|tick| tick.x > 0.0),
        optima: roles.optima,
        panels: panels.collect(),
        ticks,
    }
}

/// Place of a cell on a numeric x axis. A whole sensor lies where a patch of its size would.
fn place_of(x: Facet, cell: &CellSettings) -> Option<f64> {
    let whole = || {
        let model = cell.mask.source().mask(cell.seed, &cell.objects).ok()?.encoder.grid();
        // The published field; a set of another one is placed beyond all patches as well.
        Some(((96_usize.saturating_sub(model.0) + 1) * (96_usize.saturating_sub(model.1) + 1)) as f64)
    };
    match x {
        Facet::Patch if cell.patch.shape().is_none() => whole().map(f64::sqrt),
        _ => x.number(cell),
    }
}

fn point_of(index: usize, x: f64, cell: &CellSettings, state: &CellState) -> Option<Point> {
    let record = state.done()?;
    let estimate = record.estimate.as_ref()?;
    Some(Point {
        cell: index,
        x,
        bits: estimate.bits_per_pixel,
        interval_95: estimate.interval_95,
        lower: record.lower(),
        published: published_value(cell).map(|known| known.bits_per_pixel),
        tamura: record.sensor_tamura.map(|tamura| tamura.mean),
        is_designed: matches!(cell.mask, StudyMask::Ideal { .. }),
    })
}

/// What all cells have in common: one value of an axis without a role.
pub(super) fn caption(plan: &Plan, cells: &[CellSettings]) -> String {
    let only = |facet: Facet| {
        let values = distinct(cells.iter().map(|cell| plan.value(facet, cell)));
        if let [value] = values.as_slice() { Some(value.clone()) } else { None }
    };
    let mut parts = Vec::new();
    parts.extend(only(Facet::Objects));
    parts.extend(only(Facet::Mask));
    parts.extend(only(Facet::Patch).map(|patch| match patch.as_str() {
        "sensor" => "whole sensor".to_owned(),
        side => format!("patches of {side} px"),
    }));
    parts.extend(only(Facet::Noise).map(|noise| format!("{noise} noise")));
    parts.extend(only(Facet::Photons).map(|photons| format!("mean of {photons} photons")));
    parts.extend(only(Facet::Background).map(|photons| format!("background of {photons} photons")));
    parts.extend(only(Facet::Estimator).map(|estimator| format!("estimator {estimator}")));
    if plan.estimates.protocol == Protocol::Paper {
        parts.push("published protocol".into());
    }
    parts.join("; ")
}

/// The values in the order in which they first occur.
pub(super) fn distinct(values: impl Iterator<Item = String>) -> Vec<String> {
    let mut distinct: Vec<String> = Vec::new();
    for value in values {
        if !distinct.contains(&value) {
            distinct.push(value);
        }
    }
    distinct
}
