//! The scatter plot of a study: image quality against information.

use super::cell::{CellRecord, CellSettings, StudyMask};
use super::facet::Facet;
use super::figure::{Panel, Point, Quantity, Series, line_of, psnr_of};
use super::folder::CellState;
use super::plan::Plan;
use crate::forward::MaskSource;
use crate::studies::published_psnr::published_psnr_db;

/// Name of the published decoder beside those of a plan.
pub(super) const PUBLISHED: &str = "published U-net";

/// Information that ranks masks, bits per pixel, with its 95 % interval: the lower bound where there is one, which is free of the
/// looseness of a density model; else the estimate.
pub(super) fn information_of(record: &CellRecord) -> Option<(f64, [f64; 2])> {
    let estimate = record.estimate.as_ref()?;
    let Some(lower) = estimate.lower() else { return Some((estimate.bits_per_pixel, estimate.interval_95)) };
    let interval = estimate.bracket.as_ref().and_then(|bracket| bracket.lower_interval_95);
    Some((lower, interval.unwrap_or([lower; 2])))
}

/// Published PSNR of the layout and objects of a cell, dB, in the light of the paper protocol.
pub(super) fn published_psnr(cell: &CellSettings) -> Option<f64> {
    let StudyMask::Given(MaskSource::Heuristic(lenslets)) = &cell.mask else { return None };
    let is_published = cell.field.is_usual() && cell.grid.is_usual();
    published_psnr_db(&cell.objects, cell.published_as, *lenslets).filter(|_| is_published)
}

/// Name of a cell's point: the number of its lenslets, or another value of the axis that names points.
pub(super) fn name_of(plan: &Plan, cell: &CellSettings) -> String {
    plan.plot.x.number(cell).map_or_else(|| plan.value(plan.plot.x, cell), |number| number.to_string())
}

/// Panels with a point for each cell that has a decoder; the published decoder is the last series of a panel.
pub(super) fn panels_of(plan: &Plan, cells: &[CellSettings], states: &[CellState], lines: &[Facet]) -> Vec<Panel> {
    let mut panels: Vec<Panel> = Vec::new();
    for (index, cell) in cells.iter().enumerate().filter(|(_, cell)| cell.reconstruction.is_some()) {
        let title = plan.plot.panels.map_or(String::new(), |panels| plan.value(panels, cell));
        let names: Vec<String> = lines.iter().map(|&facet| plan.value(facet, cell)).collect();
        let line = line_of(&mut panels, Quantity::Psnr, &title, &names.join(", "));
        line.points.extend(point_of(index, cell, &states[index]));
    }
    for panel in &mut panels {
        let mut known = Series { name: PUBLISHED.into(), points: Vec::new() };
        for point in panel.series.iter().flat_map(|series| &series.points) {
            let cell = &cells[point.cell];
            let is_new = known.points.iter().all(|other| cells[other.cell].estimate_id() != cell.estimate_id());
            if let Some(psnr_db) = published_psnr(cell).filter(|_| is_new) {
                let (value, interval_95, upper) = (psnr_db, [psnr_db; 2], psnr_db);
                known.points.push(Point { value, interval_95, upper, published: None, ..*point });
            }
        }
        if !known.points.is_empty() {
            panel.series.push(known);
        }
    }
    panels
}

fn point_of(index: usize, cell: &CellSettings, state: &CellState) -> Option<Point> {
    let (x, x_interval_95) = information_of(state.done()?)?;
    let point = psnr_of(index, x, cell, state)?;
    Some(Point { x_interval_95, published: None, ..point })
}
