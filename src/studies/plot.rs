//! The plot of a bracket study as SVG: for each mask a panel with the bounds, in bits per pixel, against bead density.

use std::fmt::Write;

use crate::information::BoundMethod;
use crate::studies::record::{StudyCell, StudyRecord};
use crate::studies::settings::{StudyDesign, patch_name};
use crate::studies::tables::density_of;

use crate::plural::counted;

/// Size of a panel's axes, pixels of the drawing.
const PANEL: (f64, f64) = (270.0, 190.0);
/// Space left of and below the axes of a panel for its labels, and between panels.
const GAP: (f64, f64) = (62.0, 66.0);
/// Space above the panels for the legend.
const TOP: f64 = 80.0;
const COLUMNS: usize = 3;
/// Least distance of two labels of the density axis.
const LABEL_DISTANCE: f64 = 34.0;

const BAND: &str = "fill=\"#9ecae1\" stroke=\"#6baed6\" stroke-width=\"1\"";
const DENSITY: &str = "fill=\"none\" stroke=\"#08519c\" stroke-width=\"1.8\"";
const PUBLISHED: &str = "fill=\"none\" stroke=\"#d95f02\" stroke-width=\"1.8\" stroke-dasharray=\"5 3\"";

/// A point of a panel: bead density and bits per pixel, none where a cell is missing.
type Point = (f64, Option<f64>);

/// Returns the plot of all computed cells.
pub(super) fn bracket_plot(record: &StudyRecord) -> String {
    let designs = &record.settings.designs;
    let rows = designs.len().div_ceil(COLUMNS);
    let columns = designs.len().clamp(1, COLUMNS);
    let width = GAP.0 * (columns as f64 + 0.4) + PANEL.0 * columns as f64;
    let height = TOP + rows as f64 * (PANEL.1 + GAP.1);
    let axes = Axes::of(record);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} \
         {height:.0}\" font-family=\"sans-serif\" font-size=\"11\" fill=\"#222\">\n<rect width=\"100%\" height=\"100%\" \
         fill=\"#fff\"/>\n"
    );
    legend(&mut svg, record);
    for (index, design) in designs.iter().enumerate() {
        let left = GAP.0 + (index % COLUMNS) as f64 * (PANEL.0 + GAP.0);
        let top = TOP + (index / COLUMNS) as f64 * (PANEL.1 + GAP.1);
        let _ = writeln!(svg, "<g transform=\"translate({left:.1} {top:.1})\">");
        panel(&mut svg, record, design, &axes);
        svg.push_str("</g>\n");
    }
    svg.push_str("</svg>\n");
    svg
}

fn legend(svg: &mut String, record: &StudyRecord) {
    let band = format!("<rect y=\"-9\" width=\"26\" height=\"10\" {BAND}/>");
    let density = format!("<path d=\"M0 -4H26\" {DENSITY}/>");
    let mut entries = vec![(band, "between lower and upper bound"), (density, "density model (an upper bound)")];
    if record.cells.iter().any(|cell| cell.published.is_some()) {
        let mark = "<circle cx=\"13\" cy=\"-4\" r=\"3\" fill=\"#d95f02\"/>";
        entries.push((format!("<path d=\"M0 -4H26\" {PUBLISHED}/>{mark}"), "published"));
    }
    for (index, (symbol, text)) in entries.iter().enumerate() {
        let left = GAP.0 + index as f64 * 230.0;
        let _ = writeln!(svg, "<g transform=\"translate({left:.0} 24)\">{symbol}<text x=\"34\">{text}</text></g>");
    }
    // Bits per pixel of different patches do not compare, so the patch is named.
    let settings = &record.settings;
    let patches: Vec<String> = settings.patches.iter().map(|&patch| patch_name(patch)).collect();
    let (patches, noise) = (patches.join(", "), settings.noise);
    let _ = writeln!(svg, "<text x=\"{}\" y=\"46\">patch: {patches}; {noise} noise</text>", GAP.0);
}

/// Axes that panels share, so that they compare: the densities, and the largest value.
struct Axes {
    /// Bead densities in rising order, beads per object pixel.
    densities: Vec<f64>,
    /// Distance of the lines of the information axis, bits per pixel.
    step: f64,
    /// Steps of the information axis.
    steps: usize,
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
        let largest = values.fold(0.1, f64::max);
        let step = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0].into_iter().find(|step| largest / step <= 6.0);
        let step = step.unwrap_or(largest / 5.0);
        Self { densities, step, steps: (largest / step).ceil() as usize }
    }

    /// Across a panel, by the logarithm of the density; a single density stands in the middle.
    fn x(&self, density: f64) -> f64 {
        let (Some(first), Some(last)) = (self.densities.first(), self.densities.last()) else { return 0.0 };
        let share = if last > first { (density / first).ln() / (last / first).ln() } else { 0.5 };
        PANEL.0 * (0.04 + 0.92 * share)
    }

    fn y(&self, bits: f64) -> f64 {
        PANEL.1 * (1.0 - bits / (self.step * self.steps as f64))
    }
}

fn panel(svg: &mut String, record: &StudyRecord, design: &StudyDesign, axes: &Axes) {
    let (width, height) = PANEL;
    let title = match design.lenslets() {
        Some(count) => counted(count, "lenslet"),
        None => escaped(&design.name),
    };
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"-8\" text-anchor=\"middle\" font-weight=\"bold\">{title}</text>",
        width / 2.0
    );
    for step in 0..=axes.steps {
        let bits = axes.step * step as f64;
        let y = axes.y(bits);
        let _ = writeln!(
            svg,
            "<path d=\"M0 {y:.1}H{width}\" stroke=\"#ddd\"/><text x=\"-6\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            y + 4.0,
            rounded(bits)
        );
    }
    let mut last = f64::NEG_INFINITY;
    for &density in &axes.densities {
        let x = axes.x(density);
        let _ = writeln!(svg, "<path d=\"M{x:.1} {height}v4\" stroke=\"#222\"/>");
        if x - last >= LABEL_DISTANCE {
            let _ =
                writeln!(svg, "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{density}</text>", height + 16.0);
            last = x;
        }
    }
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">bead density (beads per object pixel)</text>\n<text \
         transform=\"translate(-40 {:.1}) rotate(-90)\" text-anchor=\"middle\">information (bits per pixel)</text>",
        width / 2.0,
        height + 32.0,
        height / 2.0
    );
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
    for (low, high) in runs(&lower).iter().zip(&runs(&upper)) {
        let mut around: Vec<(f64, f64)> = low.clone();
        around.extend(high.iter().rev());
        let _ = writeln!(svg, "<path d=\"{}Z\" {BAND}/>", path(axes, &around));
    }
    for run in runs(&points(&|cell| cell.upper_from(BoundMethod::Density))) {
        let _ = writeln!(svg, "<path d=\"{}\" {DENSITY} stroke-linecap=\"round\"/>", path(axes, &run));
    }
    // Published densities are fewer than those of the study: the line joins them across the gaps, and marks say where.
    let published = points(&|cell| cell.published.map(|published| published.bits_per_pixel));
    let known: Vec<(f64, f64)> = published.iter().filter_map(|&(density, bits)| Some((density, bits?))).collect();
    if !known.is_empty() {
        let _ = writeln!(svg, "<path d=\"{}\" {PUBLISHED}/>", path(axes, &known));
    }
    for (density, bits) in known {
        let _ = writeln!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"#d95f02\"/>",
            axes.x(density),
            axes.y(bits)
        );
    }
    let _ = writeln!(svg, "<path d=\"M0 0V{height}H{width}\" fill=\"none\" stroke=\"#222\"/>");
}

/// Stretches of neighbouring points that all have a value.
fn runs(points: &[Point]) -> Vec<Vec<(f64, f64)>> {
    let parts = points.split(|point| point.1.is_none());
    let known = parts.map(|part| part.iter().filter_map(|&(density, bits)| Some((density, bits?))).collect());
    known.filter(|run: &Vec<_>| !run.is_empty()).collect()
}

/// A line through points; a single one is drawn as a short stroke.
fn path(axes: &Axes, points: &[(f64, f64)]) -> String {
    let mut text = String::new();
    for (index, &(density, bits)) in points.iter().enumerate() {
        let command = if index == 0 { 'M' } else { 'L' };
        let _ = write!(text, "{command}{:.1} {:.1}", axes.x(density), axes.y(bits));
    }
    if points.len() == 1 {
        text.push_str("h0.1");
    }
    text
}

/// A number of the information axis, without the digits that binary fractions add.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::studies::Machine;
    use crate::studies::published::Published;
    use crate::studies::settings::StudySettings;
    use crate::studies::tests::bracketed;

    /// Density, lenslets, and lower, upper and density bound.
    type Drawn = (f64, usize, Option<(f64, f64, f64)>);

    fn record(cells: &[Drawn]) -> StudyRecord {
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

    #[test]
    fn every_mask_has_a_panel_with_names_and_units() {
        let svg = bracket_plot(&record(&[(0.008, 1, Some((0.1, 0.2, 0.3))), (0.02, 1, Some((0.2, 0.3, 0.7)))]));
        for lenslets in 1..=9 {
            let title = if lenslets == 1 { "1 lenslet<".into() } else { format!("{lenslets} lenslets<") };
            assert_eq!(svg.matches(&title).count(), 1, "{title}");
        }
        assert_eq!(svg.matches("information (bits per pixel)").count(), 9);
        assert_eq!(svg.matches("bead density (beads per object pixel)").count(), 9);
        assert!(svg.contains("patch: 32 x 32 px; shot noise") && svg.contains(">published<"));
        assert!(svg.contains(">0.008<") && svg.contains(">0.6<") && !svg.contains("NaN"));
        // Every element is closed.
        for name in ["g", "text", "svg"] {
            let opened = svg.matches(&format!("<{name} ")).count() + svg.matches(&format!("<{name}>")).count();
            assert_eq!(opened, svg.matches(&format!("</{name}>")).count(), "{name}");
        }
        // One band, one line of the density model and one published mark, beside those of the legend.
        assert_eq!(svg.matches("#9ecae1").count(), 2);
        assert_eq!(svg.matches("#08519c").count(), 2);
        assert_eq!(svg.matches("<circle").count(), 2);
    }

    #[test]
    fn missing_cells_leave_gaps() {
        let bounds = Some((0.1, 0.2, 0.3));
        let cells = [(0.005, 1, bounds), (0.008, 1, bounds), (0.013, 1, None), (0.02, 1, bounds), (0.03, 1, bounds)];
        assert_eq!(bracket_plot(&record(&cells)).matches("#9ecae1").count(), 3);
        let empty = bracket_plot(&record(&[]));
        assert!(!empty.contains(">published<") && !empty.contains("NaN") && empty.matches("#9ecae1").count() == 1);
        let single = bracket_plot(&record(&cells[..1]));
        assert!(!single.contains("NaN") && single.matches("#9ecae1").count() == 2);
    }

    #[test]
    fn greater_density_lies_right_and_more_information_above() {
        let axes = Axes::of(&record(&[(0.005, 1, Some((0.1, 0.2, 0.3))), (0.05, 1, Some((0.1, 0.2, 0.3)))]));
        assert!(axes.x(0.005) < axes.x(0.02) && axes.x(0.02) < axes.x(0.05) && axes.x(0.05) < PANEL.0);
        assert!(axes.y(0.3) < axes.y(0.1) && axes.y(0.0) == PANEL.1 && axes.y(0.3) >= 0.0);
        // Equal ratios are equal distances.
        assert!((axes.x(0.02) - axes.x(0.01) - (axes.x(0.04) - axes.x(0.02))).abs() < 1e-9);
    }
}
