//! The figure of a study: numbers and names of its plot, without any drawing.

use std::collections::{HashMap, HashSet};

use super::axes::Axis;
use super::cell::{CellSettings, StudyMask};
use super::facet::Facet;
use super::folder::CellState;
use super::plan::{Plan, PlotSettings};
use super::scatter::{name_of, panels_of, published_psnr};
use crate::forward::MaskSource;
use crate::information::Protocol;
use crate::studies::published::{Published, published};

/// Place of whole measurements on an axis of patches: the side of the published ones, px. Those of other fields lie there as well.
const SENSOR_SIDE: f64 = 65.0;
const DECODER: Facet = Facet::Axis(Axis::Decoder);

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
    /// Names of the points of a scatter plot, PSNR against information, by their cells; empty for lines.
    pub point_names: Vec<String>,
    /// What distinguishes the lines.
    pub lines_label: String,
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

/// What a panel shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quantity {
    /// Information of measurements.
    #[default]
    Information,
    /// Image quality of reconstructions.
    Psnr,
}

impl Quantity {
    /// Label of the y axis.
    pub fn label(self) -> &'static str {
        match self {
            Self::Information => "information, bits per pixel",
            Self::Psnr => "PSNR, dB",
        }
    }

    /// Its unit.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Information => "bits per pixel",
            Self::Psnr => "dB",
        }
    }
}

/// A panel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// What it shows.
    pub quantity: Quantity,
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
    /// 95 % interval of an x that was estimated.
    pub x_interval_95: [f64; 2],
    /// The estimate, an upper bound, bits per pixel; or the PSNR, dB.
    pub value: f64,
    /// Its 95 % interval.
    pub interval_95: [f64; 2],
    /// The smallest upper bound, bits per pixel: the estimate, or the entropy bound where the estimate is loose; or the PSNR.
    pub upper: f64,
    /// Lower bound, where one was computed, bits per pixel.
    pub lower: Option<f64>,
    /// The published value of the cell, in the unit of the panel.
    pub published: Option<f64>,
    /// Mean Tamura coefficient of noisy sensor patches.
    pub tamura: Option<f64>,
    /// Whether an optimizer made the mask.
    pub is_designed: bool,
}

impl Figure {
    /// Whether it is a scatter plot of PSNR against information.
    pub fn is_scatter(&self) -> bool {
        !self.point_names.is_empty()
    }

    /// Whether the optima of a panel are marked.
    pub fn marks_optima(&self, panel: &Panel) -> bool {
        self.optima && panel.quantity == Quantity::Information
    }

    /// The panels of information.
    pub fn information_panels(&self) -> impl Iterator<Item = &Panel> {
        self.panels.iter().filter(|panel| panel.quantity == Quantity::Information)
    }
}

impl Series {
    /// The point of the largest value that the line proves, and that value: the largest lower bound where all points have one, the
    /// largest estimate otherwise.
    pub fn optimum(&self) -> Option<(&Point, f64)> {
        let proves = self.points.iter().all(|point| point.lower.is_some());
        let score = |point: &Point| point.lower.filter(|_| proves).unwrap_or(point.value);
        let points = self.points.iter().map(|point| (point, score(point)));
        points.max_by(|(_, one), (_, other)| one.total_cmp(other))
    }
}

/// The published value of a cell, where there is one for exactly these settings.
pub fn published_value(cell: &CellSettings) -> Option<Published> {
    let StudyMask::Given(MaskSource::Heuristic(_)) = &cell.mask else { return None };
    let encoder = cell.open_mask().ok()?.encoder;
    published(&cell.design(encoder), cell.published_as, cell.patch.shape())
}

/// The figure of the cells that are done.
pub fn figure_of(plan: &Plan, cells: &[CellSettings], states: &[CellState]) -> Figure {
    let lines: Vec<Facet> =
        std::iter::once(plan.plot.lines).chain(others(plan, cells).into_iter().map(Facet::Axis)).collect();
    let figure = Figure {
        title: plan.title.clone(),
        caption: caption(plan, cells),
        lines_label: lines.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
        ..Figure::default()
    };
    if plan.plot.scatter {
        let mut lines = lines;
        if !lines.contains(&DECODER) && plan.plot.panels != Some(DECODER) {
            lines.push(DECODER);
        }
        return Figure {
            x_label: Quantity::Information.label().into(),
            point_names: cells.iter().map(|cell| name_of(plan, cell)).collect(),
            panels: panels_of(plan, cells, states, &lines),
            ..figure
        };
    }
    with_lines(figure, plan, cells, states, &lines)
}

/// The figure with lines along the x axis of the plan: information, and a panel for the PSNR of each decoder.
fn with_lines(figure: Figure, plan: &Plan, cells: &[CellSettings], states: &[CellState], lines: &[Facet]) -> Figure {
    let roles = &plan.plot;
    let numbers: Option<Vec<f64>> = cells.iter().map(|cell| place_of(roles.x, cell)).collect();
    let is_numeric = numbers.is_some();
    let places = numbers.unwrap_or_else(|| numbered(cells.iter().map(|cell| plan.value(roles.x, cell))));
    let mut ticks: Vec<Tick> = Vec::new();
    let mut panels: Vec<Panel> = Vec::new();
    let mut estimates: HashSet<(String, u64)> = HashSet::new();
    let compares_decoders = [Some(roles.x), Some(roles.lines), roles.panels].contains(&Some(DECODER));
    for ((index, cell), &x) in cells.iter().enumerate().zip(&places) {
        if !ticks.iter().any(|tick| tick.x == x) {
            ticks.push(Tick { x, label: plan.value(roles.x, cell) });
        }
        let title = roles.panels.map_or(String::new(), |panels| format!("{panels} {}", plan.value(panels, cell)));
        // Cells of one estimate have one point, which is of no decoder.
        let name_by = |is_shown: &dyn Fn(&Facet) -> bool| -> String {
            let names = lines.iter().filter(|facet| is_shown(facet)).map(|&facet| plan.value(facet, cell));
            names.collect::<Vec<_>>().join(", ")
        };
        let name = Some(name_by(&|facet| *facet != DECODER)).filter(|name| !name.is_empty());
        let name = name.unwrap_or_else(|| "all decoders".into());
        let line = line_of(&mut panels, Quantity::Information, &title, &name);
        if let Some(point) = point_of(index, x, cell, &states[index])
            && estimates.insert((format!("{title} {}", cell.estimate_id()), x.to_bits()))
        {
            line.points.push(point);
        }
        if let Some(settings) = cell.reconstruction {
            let by = if compares_decoders { String::new() } else { format!(" by {}", settings.decoder) };
            let panel = [title, format!("PSNR{by}")];
            let panel = panel.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ");
            let line = line_of(&mut panels, Quantity::Psnr, &panel, &name_by(&|_| true));
            line.points.extend(psnr_of(index, x, cell, &states[index]));
        }
    }
    panels.sort_by_key(|panel| panel.quantity == Quantity::Psnr);
    ticks.sort_by(|one, other| one.x.total_cmp(&other.x));
    for line in panels.iter_mut().flat_map(|panel| &mut panel.series) {
        line.points.sort_by(|one, other| one.x.total_cmp(&other.x));
    }
    Figure {
        x_label: roles.x.label(is_numeric).into(),
        logarithmic: roles.logarithmic && is_numeric && ticks.iter().all(|tick| tick.x > 0.0),
        optima: roles.optima,
        panels,
        ticks,
        ..figure
    }
}

/// Axes that no role determines. They distinguish lines as well, so that no line holds two points at one place. Decoders without a role
/// have panels of their own.
fn others(plan: &Plan, cells: &[CellSettings]) -> Vec<Axis> {
    let PlotSettings { x, lines, panels, .. } = &plan.plot;
    let roles: Vec<Facet> = [*x, *lines].into_iter().chain(*panels).collect();
    let is_open = |axis: &Axis| {
        let mut values: HashMap<Vec<String>, String> = HashMap::new();
        cells.iter().any(|cell| {
            let role = roles.iter().map(|&role| plan.value(role, cell)).collect();
            let value = plan.value(Facet::Axis(*axis), cell);
            values.entry(role).or_insert_with(|| value.clone()) != &value
        })
    };
    let is_free = |axis: &Axis| *axis != Axis::Decoder && !roles.contains(&Facet::Axis(*axis));
    Axis::ALL.into_iter().filter(is_free).filter(is_open).collect()
}

/// The line of a name in the panel of a quantity and a title; both are added where they are missing.
pub(super) fn line_of<'a>(panels: &'a mut Vec<Panel>, quantity: Quantity, title: &str, name: &str) -> &'a mut Series {
    let place =
        panels.iter().position(|panel| panel.quantity == quantity && panel.title == title).unwrap_or_else(|| {
            panels.push(Panel { quantity, title: title.to_owned(), series: Vec::new() });
            panels.len() - 1
        });
    let series = &mut panels[place].series;
    let place = series.iter().position(|line| line.name == name).unwrap_or_else(|| {
        series.push(Series { name: name.to_owned(), points: Vec::new() });
        series.len() - 1
    });
    &mut series[place]
}

/// Number of each value in the order in which they first occur.
fn numbered(values: impl Iterator<Item = String>) -> Vec<f64> {
    let mut numbers: HashMap<String, f64> = HashMap::new();
    values
        .map(|value| {
            let next = numbers.len() as f64;
            *numbers.entry(value).or_insert(next)
        })
        .collect()
}

/// Place of a cell on a numeric x axis.
fn place_of(x: Facet, cell: &CellSettings) -> Option<f64> {
    match x {
        Facet::Axis(Axis::Patch) if cell.patch.shape().is_none() => Some(SENSOR_SIDE),
        _ => x.number(cell),
    }
}

fn point_of(index: usize, x: f64, cell: &CellSettings, state: &CellState) -> Option<Point> {
    let record = state.done()?;
    let estimate = record.estimate.as_ref()?;
    Some(Point {
        cell: index,
        x,
        x_interval_95: [x; 2],
        value: estimate.bits_per_pixel,
        interval_95: estimate.interval_95,
        upper: estimate.ceiling.map_or(estimate.bits_per_pixel, |ceiling| ceiling.min(estimate.bits_per_pixel)),
        lower: record.lower(),
        published: published_value(cell).map(|known| known.bits_per_pixel),
        tamura: record.sensor_tamura.map(|tamura| tamura.mean),
        is_designed: matches!(cell.mask, StudyMask::Ideal { .. }),
    })
}

/// The PSNR of a cell. Published values have the light of the paper protocol.
pub(super) fn psnr_of(index: usize, x: f64, cell: &CellSettings, state: &CellState) -> Option<Point> {
    let record = state.done()?;
    let quality = record.reconstruction.as_ref()?;
    let known = published_psnr(cell).filter(|_| cell.estimates.protocol == Protocol::Paper);
    Some(Point {
        cell: index,
        x,
        x_interval_95: [x; 2],
        value: quality.psnr_db,
        interval_95: quality.psnr_db_interval_95,
        upper: quality.psnr_db,
        lower: None,
        published: known,
        tamura: None,
        is_designed: matches!(cell.mask, StudyMask::Ideal { .. }),
    })
}

/// What all cells have in common: the axes with one value.
pub(super) fn caption(plan: &Plan, cells: &[CellSettings]) -> String {
    let only = |axis: Axis| {
        let mut values = cells.iter().map(|cell| plan.value(Facet::Axis(axis), cell));
        let first = values.next()?;
        values.all(|value| value == first).then_some(first)
    };
    let mut parts = Vec::new();
    parts.extend(only(Axis::Objects));
    let size = |axis: Axis| only(axis).filter(|size| size != "usual");
    parts.extend(size(Axis::Field).map(|side| format!("field of {side} px")));
    parts.extend(size(Axis::Grid).map(|side| format!("PSF grid of {side} px")));
    parts.extend(only(Axis::Mask));
    parts.extend(only(Axis::Patch).map(|patch| match patch.as_str() {
        "sensor" => "whole sensor".to_owned(),
        side => format!("patches of {side} px"),
    }));
    parts.extend(only(Axis::Noise).map(|noise| format!("{noise} noise")));
    let has_mean = cells.iter().any(|cell| cell.objects.has_mean());
    parts.extend(only(Axis::Photons).filter(|_| has_mean).map(|photons| format!("mean of {photons} photons")));
    parts.extend(only(Axis::Background).map(|photons| format!("background of {photons} photons")));
    parts.extend(only(Axis::Estimator).map(|estimator| format!("estimator {estimator}")));
    if plan.estimates.protocol == Protocol::Paper {
        parts.push("published protocol".into());
    }
    parts.join("; ")
}
