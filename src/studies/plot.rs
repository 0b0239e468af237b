//! The plot of a bracket study as SVG: for each mask a panel with the bounds, in bits per pixel, against bead density.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::information::BoundMethod;
use crate::studies::error::StudyError;
use crate::studies::record::{StudyCell, StudyRecord};
use crate::studies::settings::{StudyDesign, patch_name};
use crate::studies::tables::density_of;

use crate::plural::counted;

/// Size of a panel with its labels, pixels of the drawing.
const PANEL: (u32, u32) = (340, 260);
/// Height of the legend above the panels, px.
const LEGEND: u32 = 64;
/// Distance of the entries of the legend, px.
const ENTRY: i32 = 240;
const COLUMNS: usize = 3;
/// Most labels of the density axis.
const MOST_LABELS: usize = 7;

const BAND: RGBColor = RGBColor(0x9e, 0xca, 0xe1);
const DENSITY: RGBColor = RGBColor(0x08, 0x51, 0x9c);
const PUBLISHED: RGBColor = RGBColor(0xd9, 0x5f, 0x02);
const GRID: RGBColor = RGBColor(0xdd, 0xdd, 0xdd);
/// Lengths of the strokes of the published line and of their gaps, px.
const DASH: (u32, u32) = (5, 3);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// A point of a panel: bead density and bits per pixel, none where a cell is missing.
type Point = (f64, Option<f64>);

/// Returns the plot of all computed cells.
///
/// # Errors
/// [`StudyError::Plot`] where it cannot be drawn.
pub(super) fn bracket_plot(record: &StudyRecord) -> Result<String, StudyError> {
    let mut svg = String::new();
    draw(&mut svg, record).map_err(|error| StudyError::Plot { reason: error.to_string() })?;
    Ok(svg)
}

fn draw(svg: &mut String, record: &StudyRecord) -> Drawn {
    let designs = &record.settings.designs;
    let (rows, columns) = (designs.len().div_ceil(COLUMNS).max(1), designs.len().clamp(1, COLUMNS));
    let size = (PANEL.0 * columns as u32, LEGEND + PANEL.1 * rows as u32);
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    root.fill(&WHITE)?;
    let (legend_area, panels) = root.split_vertically(LEGEND);
    legend(&legend_area, record)?;
    let axes = Axes::of(record);
    for (area, design) in panels.split_evenly((rows, columns)).iter().zip(designs) {
        panel(area, record, design, &axes)?;
    }
    root.present()?;
    Ok(())
}

fn legend(area: &Area<'_>, record: &StudyRecord) -> Drawn {
    let text = ("sans-serif", 12).into_font();
    let entry = |index: i32, name: &'static str| {
        let left = 16 + index * ENTRY;
        (left, Text::new(name, (left + 34, 14), text.clone()))
    };
    let (left, name) = entry(0, "between lower and upper bound");
    area.draw(&Rectangle::new([(left, 14), (left + 26, 24)], BAND.filled()))?;
    area.draw(&name)?;
    let (left, name) = entry(1, "density model (an upper bound)");
    area.draw(&PathElement::new([(left, 19), (left + 26, 19)], DENSITY.stroke_width(2)))?;
    area.draw(&name)?;
    if record.cells.iter().any(|cell| cell.published.is_some()) {
        let (left, name) = entry(2, "published");
        area.draw(&PathElement::new([(left, 19), (left + 26, 19)], PUBLISHED.stroke_width(2)))?;
        area.draw(&Circle::new((left + 13, 19), 3, PUBLISHED.filled()))?;
        area.draw(&name)?;
    }
    // Bits per pixel of different patches do not compare, so the patch is named.
    let settings = &record.settings;
    let patches: Vec<String> = settings.patches.iter().map(|&patch| patch_name(patch)).collect();
    let scene = format!("patch: {}; {} noise", patches.join(", "), settings.noise);
    area.draw(&Text::new(scene, (16, 38), text))?;
    Ok(())
}

/// Axes that panels share, so that they compare: the densities, and the largest value.
struct Axes {
    /// Bead densities in rising order, beads per object pixel.
    densities: Vec<f64>,
    /// The largest value of the information axis, bits per pixel.
    most_bits: f64,
}

impl Axes {
    fn of(record: &StudyRecord) -> Self {
        let mut densities: Vec<f64> = record.cells.iter().filter_map(density_of).collect();
        densities.sort_by(f64::total_cmp);
        densities.dedup();
        let published = |cell: &StudyCell| cell.published.map(|published| published.bits_per_pixel);
        let values = record.cells.iter().flat_map(|cell| {
            [cell.bits_per_pixel(), cell.upper_from(BoundMethod::Density), published(cell)].into_iter().flatten()
        });
        Self { densities, most_bits: 1.05 * values.fold(0.1, f64::max) }
    }

    /// The densities at both ends of the axis, with some space beyond the points.
    fn ends(&self) -> std::ops::Range<f64> {
        let first = self.densities.first().copied().unwrap_or(0.01);
        let last = self.densities.last().copied().unwrap_or(first);
        first / 1.15..last * 1.15
    }

    /// The densities that get a label.
    fn labelled(&self) -> Vec<f64> {
        let every = self.densities.len().div_ceil(MOST_LABELS).max(1);
        self.densities.iter().copied().step_by(every).collect()
    }
}

fn panel(area: &Area<'_>, record: &StudyRecord, design: &StudyDesign, axes: &Axes) -> Drawn {
    let title = design.lenslets().map_or_else(|| design.name.clone(), |count| counted(count, "lenslet"));
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 14))
        .margin(8)
        .x_label_area_size(38)
        .y_label_area_size(50)
        .build_cartesian_2d(axes.ends().log_scale().with_key_points(axes.labelled()), 0.0..axes.most_bits)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .x_labels(MOST_LABELS)
        .x_label_formatter(&|density| density.to_string())
        .y_labels(6)
        .y_label_formatter(&|bits| ((bits * 1e4).round() / 1e4).to_string())
        .x_desc("bead density (beads per object pixel)")
        .y_desc("information (bits per pixel)")
        .label_style(("sans-serif", 11))
        .draw()?;
    let points = |value: &dyn Fn(&StudyCell) -> Option<f64>| -> Vec<Point> {
        let at = |&density: &f64| {
            let found =
                record.cells.iter().find(|cell| cell.design == design.name && density_of(cell) == Some(density));
            (density, found.and_then(value))
        };
        axes.densities.iter().map(at).collect()
    };
    let lower = points(&StudyCell::lower);
    let upper = points(&|cell| cell.lower().and(cell.bits_per_pixel()));
    for (low, high) in runs(&lower).into_iter().zip(runs(&upper)) {
        let around: Vec<(f64, f64)> = low.into_iter().chain(high.into_iter().rev()).collect();
        chart.draw_series([Polygon::new(around.clone(), BAND.filled())])?;
        // The outline shows the band of a single density too.
        chart.draw_series([PathElement::new(around, BAND.stroke_width(3))])?;
    }
    for run in runs(&points(&|cell| cell.upper_from(BoundMethod::Density))) {
        if let [point] = run[..] {
            chart.draw_series([Circle::new(point, 2, DENSITY.filled())])?;
        } else {
            chart.draw_series(LineSeries::new(run, DENSITY.stroke_width(2)))?;
        }
    }
    // Published densities are fewer than those of the study: the line joins them across the gaps, and marks say where.
    let published = points(&|cell| cell.published.map(|published| published.bits_per_pixel));
    let known: Vec<(f64, f64)> = published.iter().filter_map(|&(density, bits)| Some((density, bits?))).collect();
    chart.draw_series(DashedLineSeries::new(known.iter().copied(), DASH.0, DASH.1, PUBLISHED.stroke_width(2)))?;
    chart.draw_series(known.into_iter().map(|point| Circle::new(point, 3, PUBLISHED.filled())))?;
    Ok(())
}

/// Stretches of neighbouring points that all have a value.
fn runs(points: &[Point]) -> Vec<Vec<(f64, f64)>> {
    let parts = points.split(|point| point.1.is_none());
    let known = parts.map(|part| part.iter().filter_map(|&(density, bits)| Some((density, bits?))).collect());
    known.filter(|run: &Vec<_>| !run.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::studies::Machine;
    use crate::studies::published::Published;
    use crate::studies::settings::StudySettings;
    use crate::studies::tests::bracketed;

    /// Density, lenslets, and lower, upper and density bound.
    type Bounded = (f64, usize, Option<(f64, f64, f64)>);

    fn record(cells: &[Bounded]) -> StudyRecord {
        let mut record = StudyRecord::new(StudySettings::bracket());
        for &(density, lenslets, bounds) in cells {
            record.put(StudyCell {
                objects: format!("beads:{density}"),
                design: format!("heuristic:{lenslets}"),
                patch: Some((32, 32)),
                published: (density == 0.02).then_some(Published { bits_per_pixel: 0.5, interval_95: None }),
                estimate: bounds.map(|(lower, upper, density)| bracketed(lower, upper, density)),
                failure: None,
                machine: Machine::here(),
                patch_information: Vec::new(),
                difference_to_reference: None,
            });
        }
        record
    }

    fn plot(cells: &[Bounded]) -> String {
        bracket_plot(&record(cells)).unwrap()
    }

    #[test]
    fn every_mask_has_a_panel_with_names_and_units() {
        let svg = plot(&[(0.008, 1, Some((0.1, 0.2, 0.3))), (0.02, 1, Some((0.2, 0.3, 0.7)))]);
        for lenslets in 1..=9 {
            let title = if lenslets == 1 { "\n1 lenslet\n".into() } else { format!("\n{lenslets} lenslets\n") };
            assert_eq!(svg.matches(&title).count(), 1, "{title}");
        }
        assert_eq!(svg.matches("information (bits per pixel)").count(), 9);
        assert_eq!(svg.matches("bead density (beads per object pixel)").count(), 9);
        assert!(svg.contains("patch: 32 x 32 px; shot noise") && svg.contains("\npublished\n"));
        assert!(svg.contains("\n0.008\n") && svg.contains("\n0.6\n") && !svg.contains("NaN"));
        // One band, one line of the density model and one published mark, beside those of the legend.
        assert_eq!(svg.matches("<polygon").count(), 1);
        assert_eq!(svg.matches("stroke=\"#08519C\"").count(), 2);
        assert_eq!(svg.matches("<circle").count(), 2);
    }

    #[test]
    fn missing_cells_leave_gaps() {
        let bounds = Some((0.1, 0.2, 0.3));
        let cells = [(0.005, 1, bounds), (0.008, 1, bounds), (0.013, 1, None), (0.02, 1, bounds), (0.03, 1, bounds)];
        assert_eq!(plot(&cells).matches("<polygon").count(), 2);
        let empty = plot(&[]);
        assert!(!empty.contains("\npublished\n") && !empty.contains("NaN") && !empty.contains("<polygon"));
        let single = plot(&cells[..1]);
        assert!(!single.contains("NaN") && single.matches("<polygon").count() == 1);
    }

    #[test]
    fn labels_of_the_density_axis_do_not_crowd() {
        let cells: Vec<Bounded> = (1..=30).map(|step| (f64::from(step) / 500.0, 1, Some((0.1, 0.2, 0.3)))).collect();
        let axes = Axes::of(&record(&cells));
        assert!(axes.densities.len() == 30 && axes.labelled().len() <= MOST_LABELS);
        assert!(axes.ends().contains(&axes.densities[0]) && axes.ends().contains(&axes.densities[29]));
    }
}
