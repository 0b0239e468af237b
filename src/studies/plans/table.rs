//! The table of a study, for people and for programs.

use super::cell::CellSettings;
use super::facet::Facet;
use super::figure::{distinct, published_value};
use super::folder::{CellState, StudyFolder};
use super::plan::Plan;
use crate::information::PairedDifference;
use crate::plural::counted;
use crate::studies::rank::spearman;

/// A column: its name, and the text of a row.
struct Column<'a> {
    name: &'static str,
    text: Box<dyn Fn(&Row<'_>) -> String + 'a>,
}

/// A row: one cell.
struct Row<'a> {
    cell: &'a CellSettings,
    state: &'a CellState,
    difference: Option<PairedDifference>,
}

/// Distance above the published value within which an estimate counts as its equal, bits per pixel.
const MARGIN: f64 = 0.02;

/// Header of the table for programs. Times and machines are left out, so that equal studies have equal tables; they are in the files of
/// the cells.
pub const CSV_HEADER: [&str; 24] = [
    "id",
    "objects",
    "mask",
    "lenslets",
    "patch",
    "noise",
    "photons",
    "background",
    "estimator",
    "protocol",
    "seed",
    "bits_per_pixel",
    "low_95",
    "high_95",
    "lower_bound",
    "lower_low_95",
    "lower_high_95",
    "entropy_bound",
    "first_mask_less_this",
    "difference_low_95",
    "difference_high_95",
    "published",
    "sensor_tamura",
    "failure",
];

/// The rows of the table for programs, in the order of the plan; see [`CSV_HEADER`].
pub fn csv_rows(folder: &StudyFolder, states: &[CellState]) -> Vec<Vec<String>> {
    let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let rows = rows(folder.cells(), states);
    let row = |(row, id): (&Row<'_>, &String)| {
        let record = row.state.done();
        let estimate = record.and_then(|record| record.estimate.as_ref());
        let bracket = estimate.and_then(|estimate| estimate.bracket.as_ref());
        let value = |facet: Facet| folder.plan().value(facet, row.cell);
        vec![
            id.clone(),
            value(Facet::Objects),
            value(Facet::Mask),
            record.and_then(|record| record.lenslets).map_or(String::new(), |count| count.to_string()),
            value(Facet::Patch),
            value(Facet::Noise),
            value(Facet::Photons),
            value(Facet::Background),
            value(Facet::Estimator),
            row.cell.estimates.protocol.to_string(),
            value(Facet::Seed),
            number(estimate.map(|estimate| estimate.bits_per_pixel)),
            number(estimate.map(|estimate| estimate.interval_95[0])),
            number(estimate.map(|estimate| estimate.interval_95[1])),
            number(bracket.and_then(|bracket| bracket.lower)),
            number(bracket.and_then(|bracket| bracket.lower_interval_95).map(|[low, _]| low)),
            number(bracket.and_then(|bracket| bracket.lower_interval_95).map(|[_, high]| high)),
            number(estimate.and_then(|estimate| estimate.ceiling)),
            number(row.difference.map(|difference| difference.bits_per_pixel)),
            number(row.difference.map(|difference| difference.interval_95[0])),
            number(row.difference.map(|difference| difference.interval_95[1])),
            number(published_value(row.cell).map(|known| known.bits_per_pixel)),
            number(record.and_then(|record| record.sensor_tamura).map(|tamura| tamura.mean)),
            row.state.failure().unwrap_or_default().to_owned(),
        ]
    };
    rows.iter().zip(folder.ids()).map(row).collect()
}

/// Rows with their differences to the first mask of the same other settings, by the density model on the same test patches.
fn rows<'a>(cells: &'a [CellSettings], states: &'a [CellState]) -> Vec<Row<'a>> {
    let reference = |cell: &CellSettings| {
        cells.iter().position(|other| CellSettings { mask: cell.mask.clone(), ..other.clone() } == *cell)
    };
    let difference = |index: usize| {
        let first = reference(&cells[index]).filter(|&first| first != index)?;
        let (of, than) = (states[first].done()?, states[index].done()?);
        PairedDifference::new(&of.test_patches.information, &than.test_patches, cells[index].seed).ok()?
    };
    let row = |(index, cell)| Row { cell, state: &states[index], difference: difference(index) };
    cells.iter().enumerate().map(row).collect()
}

/// The study as Markdown: what all cells share, the table, and what follows from it.
pub fn markdown(folder: &StudyFolder, states: &[CellState]) -> String {
    let (plan, cells) = (folder.plan(), folder.cells());
    let columns = columns(plan, cells, states);
    let mut lines = vec![format!("# {}", plan.title), String::new(), shared(plan, cells), String::new()];
    lines.push(line(columns.iter().map(|column| column.name.to_owned())));
    lines.push(line(columns.iter().map(|_| "---".to_owned())));
    let rows = rows(cells, states);
    lines.extend(rows.iter().map(|row| line(columns.iter().map(|column| (column.text)(row)))));
    lines.push(String::new());
    lines.extend(summary(folder, states).into_iter().map(|sentence| format!("- {sentence}")));
    lines.push(String::new());
    lines.join("\n")
}

/// One sentence for each result, for people.
pub fn summary(folder: &StudyFolder, states: &[CellState]) -> Vec<String> {
    let (plan, cells) = (folder.plan(), folder.cells());
    let counts: Vec<String> =
        StudyFolder::counts(states).iter().map(|(word, count)| format!("{count} {word}")).collect();
    let mut lines = vec![format!("{}: {}", counted(cells.len(), "cell"), counts.join(", "))];
    let above = states
        .iter()
        .filter_map(CellState::done)
        .filter(|record| record.estimate.as_ref().is_some_and(crate::information::Estimate::above_ceiling))
        .count();
    if above > 0 {
        lines.push(format!(
            "{} above the entropy bound: loose there, so do not rank masks by them",
            counted(above, "estimate")
        ));
    }
    if plan.plot.optima {
        let figure = super::figure::figure_of(plan, cells, states);
        for series in figure.panels.iter().flat_map(|panel| &panel.series) {
            if let Some((best, _)) = series.optimum() {
                let tamura = best.tamura.map_or(String::new(), |tamura| format!(", sensor Tamura {tamura:.3}"));
                lines.push(format!("{}: optimum at {} {}{tamura}", series.name, plan.plot.x, best.x));
            }
        }
    }
    lines.extend(beside_published(plan, cells, states));
    for (cell, state) in cells.iter().zip(states) {
        if let Some(failure) = state.failure() {
            lines.push(format!("failed: {}: {failure}", cell.name()));
        }
    }
    lines.extend(distinct(states.iter().filter_map(CellState::done).flat_map(|record| record.notices.clone())));
    let machines = distinct(states.iter().filter_map(CellState::done).map(|record| record.machine.describe()));
    lines.extend(machines.iter().map(|machine| format!("computed on {machine}")));
    lines
}

/// How estimates compare with published ones: their number below, and the order of masks for each set of objects.
fn beside_published(plan: &Plan, cells: &[CellSettings], states: &[CellState]) -> Vec<String> {
    let compared: Vec<(String, f64, f64)> = cells
        .iter()
        .zip(states)
        .filter_map(|(cell, state)| {
            let objects = plan.value(Facet::Objects, cell);
            Some((objects, state.done()?.bits_per_pixel()?, published_value(cell)?.bits_per_pixel))
        })
        .collect();
    if compared.is_empty() {
        return Vec::new();
    }
    let below = compared.iter().filter(|(_, ours, published)| *ours <= published + MARGIN).count();
    let mut lines = vec![format!(
        "{below} of {} at most the published value + {MARGIN} bits per pixel",
        counted(compared.len(), "estimate")
    )];
    for objects in distinct(compared.iter().map(|(objects, ..)| objects.clone())) {
        let pairs: Vec<(f64, f64)> =
            compared.iter().filter(|(of, ..)| *of == objects).map(|&(_, ours, published)| (ours, published)).collect();
        if let Some(spearman) = spearman(&pairs) {
            let masks = counted(pairs.len(), "mask");
            lines.push(format!("{objects}: rank correlation with the published order of {masks} {spearman:.2}"));
        }
    }
    lines
}

/// What all cells have in common.
fn shared(plan: &Plan, cells: &[CellSettings]) -> String {
    let common = super::figure::caption(plan, cells);
    let estimates = cells.first().map_or(plan.estimates, |cell| cell.estimates);
    let length = match (estimates.seconds, estimates.steps) {
        (Some(seconds), _) => format!("fits of {seconds} s; "),
        (_, Some(steps)) => format!("fits of {}; ", counted(steps, "step")),
        _ => String::new(),
    };
    format!(
        "{common}; {length}{}. Information in bits per pixel, 95 % intervals. Lenslet Studio {}.",
        counted(estimates.patches_test, "test patch"),
        crate::information::NUMBERS_VERSION
    )
}

fn columns<'a>(plan: &'a Plan, cells: &'a [CellSettings], states: &[CellState]) -> Vec<Column<'a>> {
    let mut columns: Vec<Column<'a>> = Vec::new();
    for (axis, name) in Facet::AXES.into_iter().zip(AXIS_NAMES) {
        if distinct(cells.iter().map(|cell| plan.value(axis, cell))).len() > 1 {
            columns.push(Column { name, text: Box::new(move |row| plan.value(axis, row.cell)) });
        }
    }
    let any = |has: &dyn Fn(&super::cell::CellRecord) -> bool| states.iter().filter_map(CellState::done).any(has);
    if any(&|record| record.lower().is_some()) {
        columns.push(Column { name: "lower bound", text: Box::new(lower) });
    }
    columns.push(Column { name: "estimate", text: Box::new(estimate) });
    if any(&|record| record.estimate.as_ref().is_some_and(|estimate| estimate.ceiling.is_some())) {
        let ceiling = |row: &Row<'_>| number(row.state.done().and_then(|of| of.estimate.as_ref()?.ceiling));
        columns.push(Column { name: "entropy bound", text: Box::new(ceiling) });
    }
    if rows(cells, states).iter().any(|row| row.difference.is_some()) {
        columns.push(Column { name: "first mask's - this", text: Box::new(difference) });
    }
    if cells.iter().any(|cell| published_value(cell).is_some()) {
        let known = |row: &Row<'_>| number(published_value(row.cell).map(|known| known.bits_per_pixel));
        columns.push(Column { name: "published", text: Box::new(known) });
    }
    let tamura = |row: &Row<'_>| {
        row.state.done().and_then(|of| of.sensor_tamura).map_or(NOTHING.into(), |tamura| format!("{:.3}", tamura.mean))
    };
    columns.push(Column { name: "sensor Tamura", text: Box::new(tamura) });
    columns
}

const AXIS_NAMES: [&str; 8] = ["objects", "mask", "photons", "background", "noise", "patch", "estimator", "seed"];
/// Text of an empty place.
const NOTHING: &str = "-";

fn estimate(row: &Row<'_>) -> String {
    match row.state {
        CellState::Waiting => NOTHING.into(),
        CellState::Failed(_) | CellState::Unusable(_) => "failed".into(),
        CellState::Done(record) => record
            .estimate
            .as_ref()
            .map_or(NOTHING.into(), |estimate| with_interval(estimate.bits_per_pixel, Some(estimate.interval_95))),
    }
}

fn lower(row: &Row<'_>) -> String {
    let bracket = row.state.done().and_then(|record| record.estimate.as_ref()?.bracket.as_ref());
    match bracket.and_then(|bracket| Some((bracket.lower?, bracket.lower_interval_95))) {
        Some((bits, interval)) => with_interval(bits, interval),
        None => NOTHING.into(),
    }
}

fn difference(row: &Row<'_>) -> String {
    row.difference.map_or(NOTHING.into(), |PairedDifference { bits_per_pixel, interval_95: [low, high] }| {
        format!("{bits_per_pixel:+.4} ({low:+.4} to {high:+.4})")
    })
}

fn with_interval(bits: f64, interval: Option<[f64; 2]>) -> String {
    match interval {
        // A bound without samples has no interval.
        Some([low, high]) if low < high => format!("{bits:.4} ({low:.4} to {high:.4})"),
        _ => format!("{bits:.4}"),
    }
}

fn number(value: Option<f64>) -> String {
    value.map_or(NOTHING.into(), |value| format!("{value:.4}"))
}

/// A row of a Markdown table; a bar in a text would end its column.
fn line(columns: impl Iterator<Item = String>) -> String {
    let columns: Vec<String> = columns.map(|text| text.replace('|', "\\|").replace('\n', " ")).collect();
    format!("| {} |", columns.join(" | "))
}
