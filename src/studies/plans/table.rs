//! The table of a study, for people and for programs.

use std::collections::HashMap;

use super::axes::Axis;
use super::cell::{CellRecord, CellSettings};
use super::correlation::{Correlation, correlations, published_patch};
use super::facet::{Facet, distinct};
use super::figure::{caption, figure_of, published_value};
use super::folder::{CellState, StudyFolder};
use super::plan::Plan;
use super::scatter::published_psnr;
use crate::information::{self, Estimate, PairedDifference};
use crate::plural::counted;
use crate::reconstruction::DecoderQuality;
use crate::studies::markdown::{self, NOTHING, bits, header, lower, row, with_interval};
use crate::studies::rank::spearman;

/// A column: its name, and the text of a row.
struct Column<'a> {
    name: String,
    text: Box<dyn Fn(&Row<'_>) -> String + 'a>,
}

impl<'a> Column<'a> {
    fn new(name: impl Into<String>, text: impl Fn(&Row<'_>) -> String + 'a) -> Self {
        Self { name: name.into(), text: Box::new(text) }
    }
}

/// A published value of a cell, where there is one.
type Value = fn(&CellSettings) -> Option<f64>;

/// A row: one cell.
struct Row<'a> {
    cell: &'a CellSettings,
    state: &'a CellState,
    /// The first mask of the same other settings less this one.
    difference: Option<PairedDifference>,
    /// The published value, bits per pixel.
    published: Option<f64>,
}

impl<'a> Row<'a> {
    fn estimate(&self) -> Option<&'a Estimate> {
        self.state.done()?.estimate.as_ref()
    }

    /// Image quality of the plan's decoder.
    fn quality(&self) -> Option<&'a DecoderQuality> {
        self.state.done()?.reconstruction.as_ref()
    }

    /// Mean Tamura coefficient of noisy sensor patches.
    fn tamura(&self) -> Option<f64> {
        Some(self.state.done()?.sensor_tamura?.mean)
    }
}

/// Distance above the published value within which an estimate counts as its equal, bits per pixel.
const MARGIN: f64 = 0.02;

/// Fewest masks whose order is compared with the published one.
const FEWEST_RANKED: usize = 3;

/// Header of the table for programs. Times and machines are left out, so that equal studies have equal tables; they are in the files of
/// the cells.
pub const CSV_HEADER: [&str; 31] = [
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
    "field",
    "grid",
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
    "decoder",
    "psnr_db",
    "psnr_low_95",
    "psnr_high_95",
    "published_psnr_db",
    "failure",
];

/// The table of a study: what is computed so far, with the differences between masks.
pub struct StudyTable<'a> {
    folder: &'a StudyFolder,
    states: &'a [CellState],
    rows: Vec<Row<'a>>,
}

impl<'a> StudyTable<'a> {
    /// The table of a folder with these states of its cells.
    pub fn new(folder: &'a StudyFolder, states: &'a [CellState]) -> Self {
        let cells = folder.cells();
        let mut first: HashMap<String, usize> = HashMap::new();
        let row = |(index, cell): (usize, &'a CellSettings)| {
            // Cells that differ in their mask alone have one reference: the first of them.
            let alike = CellSettings { mask: cells[0].mask.clone(), ..cell.clone() }.id();
            let reference = *first.entry(alike).or_insert(index);
            let difference = (reference != index).then(|| difference(&states[reference], &states[index])).flatten();
            let published = published_value(cell).map(|known| known.bits_per_pixel);
            Row { cell, state: &states[index], difference, published }
        };
        Self { folder, states, rows: cells.iter().enumerate().map(row).collect() }
    }

    /// The rows of the table for programs, in the order of the plan; see [`CSV_HEADER`].
    pub fn csv_rows(&self) -> Vec<Vec<String>> {
        self.rows.iter().zip(self.folder.ids()).map(|(row, id)| csv_row(self.folder.plan(), row, id)).collect()
    }

    /// The study as Markdown: what all cells share, the table, and what follows from it.
    pub fn markdown(&self) -> String {
        let (plan, cells) = (self.folder.plan(), self.folder.cells());
        let columns = self.columns();
        let mut lines = vec![format!("# {}", plan.title), String::new(), shared(plan, cells), String::new()];
        lines.extend(header(columns.iter().map(|column| column.name.as_str())));
        lines.extend(self.rows.iter().map(|of_cell| row(columns.iter().map(|column| (column.text)(of_cell)))));
        lines.push(String::new());
        lines.extend(self.summary().into_iter().map(|sentence| format!("- {sentence}")));
        lines.extend(rank_table(&self.correlations()));
        lines.push(String::new());
        lines.join("\n")
    }

    /// Correlations of PSNR and information, of a study whose plot shows them.
    pub fn correlations(&self) -> Vec<Correlation> {
        let plan = self.folder.plan();
        if plan.plot.scatter { correlations(plan, self.folder.cells(), self.states) } else { Vec::new() }
    }

    /// One sentence for each result, for people.
    fn summary(&self) -> Vec<String> {
        let (plan, cells, states) = (self.folder.plan(), self.folder.cells(), self.states);
        let counts: Vec<String> =
            StudyFolder::counts(states).iter().map(|(word, count)| format!("{count} {word}")).collect();
        let mut lines = vec![format!("{}: {}", counted(cells.len(), "cell"), counts.join(", "))];
        let above = self.estimates().filter(|estimate| estimate.above_ceiling()).count();
        if above > 0 {
            lines.push(format!(
                "{} above the entropy bound: loose there, so do not rank masks by them",
                counted(above, "estimate")
            ));
        }
        if plan.plot.optima {
            let figure = figure_of(plan, cells, states);
            for series in figure.information_panels().flat_map(|panel| &panel.series) {
                if let Some((best, _)) = series.optimum() {
                    let tamura = best.tamura.map_or(String::new(), |tamura| format!(", sensor Tamura {tamura:.3}"));
                    let ends = [series.points.first(), series.points.last()];
                    let is_end = ends.into_iter().flatten().any(|point| point.x == best.x);
                    let end = if is_end { ", the end of the sweep" } else { "" };
                    lines.push(format!("{}: optimum at {} {}{end}{tamura}", series.name, plan.plot.x, best.x));
                }
            }
        }
        lines.extend(beside_published(plan, &self.rows));
        lines.extend(plan.left_out().ok().flatten());
        let failures = cells.iter().zip(states).filter_map(|(cell, state)| Some((cell, state.failure()?)));
        lines.extend(failures.map(|(cell, failure)| format!("failed: {}: {failure}", plan.name_of(cell))));
        let records = || states.iter().filter_map(CellState::done);
        lines.extend(distinct(records().flat_map(|record| record.notices.clone())));
        let machines = distinct(records().map(|record| record.machine.describe()));
        lines.extend(machines.iter().map(|machine| format!("computed on {machine}")));
        lines
    }

    fn estimates(&self) -> impl Iterator<Item = &'a Estimate> {
        self.rows.iter().filter_map(Row::estimate)
    }

    fn columns(&self) -> Vec<Column<'a>> {
        let (plan, cells) = (self.folder.plan(), self.folder.cells());
        let mut columns: Vec<Column<'a>> = Vec::new();
        for axis in Axis::ALL.map(Facet::Axis) {
            let mut values = cells.iter().map(|cell| plan.value(axis, cell));
            let first = values.next();
            if values.any(|value| Some(value) != first) {
                columns.push(Column::new(axis.to_string(), move |row| plan.value(axis, row.cell)));
            }
        }
        if self.estimates().any(|estimate| estimate.lower().is_some()) {
            columns.push(Column::new("lower bound", |row| lower(row.estimate())));
        }
        columns.push(Column::new("estimate", estimate));
        if self.estimates().any(|estimate| estimate.ceiling.is_some()) {
            columns.push(Column::new("entropy bound", |row| bits(row.estimate().and_then(|of| of.ceiling))));
        }
        if self.rows.iter().any(|row| row.difference.is_some()) {
            columns.push(Column::new("first mask's - this", |row| markdown::difference(row.difference)));
        }
        if self.rows.iter().any(|row| row.published.is_some()) {
            columns.push(Column::new("published", |row| bits(row.published)));
        }
        if self.rows.iter().any(|row| row.quality().is_some()) {
            columns.push(Column::new("PSNR, dB", |row| {
                row.quality().map_or(NOTHING.into(), |quality| {
                    information::with_interval(quality.psnr_db, quality.psnr_db_interval_95)
                })
            }));
        }
        if plan.plot.scatter {
            let columns_of =
                [("published, 32 x 32 px", published_patch as Value), ("published PSNR, dB", published_psnr)];
            for (name, value) in
                columns_of.into_iter().filter(|(_, value)| cells.iter().any(|cell| value(cell).is_some()))
            {
                columns.push(Column::new(name, move |row| short(value(row.cell))));
            }
        }
        columns.push(Column::new("sensor Tamura", |row| {
            row.tamura().map_or(NOTHING.into(), |tamura| format!("{tamura:.3}"))
        }));
        columns
    }
}

/// The table of correlations for people; nothing without any.
fn rank_table(correlations: &[Correlation]) -> Vec<String> {
    if correlations.is_empty() {
        return Vec::new();
    }
    let names = ["objects", "decoder", "masks", "Spearman", "Pearson", "Spearman, published", "Pearson, published"];
    let mut lines = vec![
        String::new(),
        "Correlations of PSNR with information, and with the published information of patches of 32 x 32 px:".into(),
        String::new(),
    ];
    lines.extend(header(names.into_iter()));
    lines.extend(correlations.iter().map(|found| {
        let texts = [found.cells.clone(), found.decoder.clone(), found.masks.to_string()];
        row(texts.into_iter().chain(found.numbers().map(short)))
    }));
    lines
}

/// A value with two decimals, where there is one.
fn short(value: Option<f64>) -> String {
    value.map_or(NOTHING.into(), |value| format!("{value:.2}"))
}

/// First mask less another one, by the density model on the same test patches. A density model above the entropy bound is loose, and so
/// would be their difference.
fn difference(first: &CellState, other: &CellState) -> Option<PairedDifference> {
    let (first, other) = (first.done()?, other.done()?);
    let is_loose = |record: &CellRecord| {
        let patches = &record.test_patches.information;
        let mean = patches.iter().sum::<f64>() / patches.len().max(1) as f64;
        record.estimate.as_ref().and_then(|estimate| estimate.ceiling).is_some_and(|ceiling| mean > ceiling)
    };
    if is_loose(first) || is_loose(other) {
        return None;
    }
    PairedDifference::new(&first.test_patches.information, &other.test_patches, other.settings.seed).ok()?
}

fn csv_row(plan: &Plan, row: &Row<'_>, id: &str) -> Vec<String> {
    let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let (record, estimate) = (row.state.done(), row.estimate());
    let bracket = estimate.and_then(|estimate| estimate.bracket.as_ref());
    let lower_interval = bracket.and_then(|bracket| bracket.lower_interval_95);
    let value = |axis: Axis| plan.value(Facet::Axis(axis), row.cell);
    vec![
        id.to_owned(),
        value(Axis::Objects),
        value(Axis::Mask),
        record.and_then(|record| record.lenslets).map_or(String::new(), |count| count.to_string()),
        value(Axis::Patch),
        value(Axis::Noise),
        value(Axis::Photons),
        value(Axis::Background),
        value(Axis::Estimator),
        row.cell.estimates.protocol.to_string(),
        value(Axis::Seed),
        value(Axis::Field),
        value(Axis::Grid),
        number(estimate.map(|estimate| estimate.bits_per_pixel)),
        number(estimate.map(|estimate| estimate.interval_95[0])),
        number(estimate.map(|estimate| estimate.interval_95[1])),
        number(bracket.and_then(|bracket| bracket.lower)),
        number(lower_interval.map(|[low, _]| low)),
        number(lower_interval.map(|[_, high]| high)),
        number(estimate.and_then(|estimate| estimate.ceiling)),
        number(row.difference.map(|difference| difference.bits_per_pixel)),
        number(row.difference.map(|difference| difference.interval_95[0])),
        number(row.difference.map(|difference| difference.interval_95[1])),
        number(row.published),
        number(row.tamura()),
        row.quality().map_or(String::new(), |quality| quality.decoder.to_string()),
        number(row.quality().map(|quality| quality.psnr_db)),
        number(row.quality().map(|quality| quality.psnr_db_interval_95[0])),
        number(row.quality().map(|quality| quality.psnr_db_interval_95[1])),
        number(row.quality().and_then(|_| published_psnr(row.cell))),
        row.state.failure().unwrap_or_default().to_owned(),
    ]
}

/// How estimates compare with published ones: their number below, and the order of masks that differ in nothing else. Loose estimates
/// order nothing.
fn beside_published(plan: &Plan, rows: &[Row<'_>]) -> Vec<String> {
    let pair = |row: &Row<'_>| Some((row.estimate()?.bits_per_pixel, row.published?));
    let compared: Vec<(f64, f64)> = rows.iter().filter_map(pair).collect();
    if compared.is_empty() {
        return Vec::new();
    }
    let below = compared.iter().filter(|(ours, published)| *ours <= published + MARGIN).count();
    let estimates = counted(compared.len(), "estimate");
    let mut lines = vec![format!("{below} of {estimates} at most the published value + {MARGIN} bits per pixel")];
    let mut alike: Vec<(&CellSettings, Vec<&Row<'_>>)> = Vec::new();
    for row in rows {
        let same = |of: &CellSettings| CellSettings { mask: of.mask.clone(), ..row.cell.clone() } == *of;
        match alike.iter_mut().find(|(of, _)| same(of)) {
            Some((_, group)) => group.push(row),
            None => alike.push((row.cell, vec![row])),
        }
    }
    lines.extend(alike.iter().filter_map(|(cell, group)| {
        let is_ranked = |row: &&Row<'_>| row.estimate().is_some_and(|estimate| !estimate.above_ceiling());
        let known: Vec<&Row<'_>> = group.iter().filter(|row| row.published.is_some()).copied().collect();
        if known.len() < FEWEST_RANKED || !known.iter().all(is_ranked) {
            return None;
        }
        let pairs: Vec<(f64, f64)> = known.into_iter().filter_map(pair).collect();
        let masks = counted(pairs.len(), "mask");
        let objects = plan.value(Facet::Axis(Axis::Objects), cell);
        Some(format!("{objects}: rank correlation with the published order of {masks} {:.2}", spearman(&pairs)?))
    }));
    lines
}

/// What all cells have in common.
fn shared(plan: &Plan, cells: &[CellSettings]) -> String {
    let common = caption(plan, cells);
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
