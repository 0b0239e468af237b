//! The scatter plots of a study of decoders as SVG: for each set of objects a panel with PSNR against information.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::record::DecoderStudyRecord;
use crate::formats::use_drawing_font;
use crate::studies::error::StudyError;

/// Size of a panel with its labels, pixels of the drawing.
const PANEL: (u32, u32) = (440, 320);
/// Height of the legend above the panels, px.
const LEGEND: u32 = 32;
/// Distance of the entries of the legend, px.
const ENTRY: i32 = 150;
const COLUMNS: usize = 2;
/// Colours of decoders, distinct for colour-blind readers as well (Okabe and Ito 2008); the last is the published U-net.
const COLOURS: [RGBColor; 6] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x66, 0x66, 0x66),
];

type Drawn = Result<(), Box<dyn std::error::Error>>;

/// A mask in a panel.
struct Point {
    /// Information of the whole sensor, bits per pixel.
    bits: f64,
    psnr_db: f64,
    /// Number of lenslets, or the name of the mask.
    name: String,
}

/// A decoder in a panel.
struct Series {
    name: String,
    colour: RGBColor,
    points: Vec<Point>,
}

/// The plot of all computed cells.
///
/// # Errors
/// [`StudyError::Plot`] where it cannot be drawn.
pub(super) fn scatter_plot(record: &DecoderStudyRecord) -> Result<String, StudyError> {
    use_drawing_font();
    let mut svg = String::new();
    draw(&mut svg, record).map_err(|error| StudyError::Plot { reason: error.to_string() })?;
    Ok(svg)
}

/// All decoders, the published U-net last.
fn series(record: &DecoderStudyRecord, objects: usize) -> Vec<Series> {
    let rows = record.rows(objects);
    let points = |psnr: &dyn Fn(usize) -> Option<f64>| -> Vec<Point> {
        let point = |(index, row): (usize, &super::record::MaskRow<'_>)| {
            let name = row.lenslets.map_or(row.design.to_owned(), |count| count.to_string());
            Some(Point { bits: row.information?.best(), psnr_db: psnr(index)?, name })
        };
        rows.iter().enumerate().filter_map(point).collect()
    };
    let decoders = record.settings.decoders.iter().enumerate().map(|(place, decoder)| {
        let found = points(&|row| rows[row].quality[place].map(|quality| quality.psnr_db));
        Series { name: decoder.to_string(), colour: COLOURS[place % (COLOURS.len() - 1)], points: found }
    });
    let published = points(&|row| rows[row].published_psnr_db);
    let published =
        Series { name: "published U-net".to_owned(), colour: COLOURS[COLOURS.len() - 1], points: published };
    decoders.chain([published]).collect()
}

fn draw(svg: &mut String, record: &DecoderStudyRecord) -> Drawn {
    let sets = record.settings.objects.len();
    let (rows, columns) = (sets.div_ceil(COLUMNS).max(1), sets.clamp(1, COLUMNS));
    let entries = record.settings.decoders.len() as u32 + 1;
    let width = (PANEL.0 * columns as u32).max(16 + entries * ENTRY as u32);
    let root = SVGBackend::with_string(svg, (width, LEGEND + PANEL.1 * rows as u32)).into_drawing_area();
    root.fill(&WHITE)?;
    let (legend, panels) = root.split_vertically(LEGEND);
    let text = ("sans-serif", 12).into_font();
    for (index, Series { name, colour, .. }) in series(record, 0).into_iter().enumerate() {
        let left = 16 + index as i32 * ENTRY;
        legend.draw(&Circle::new((left + 4, 19), 4, colour.filled()))?;
        legend.draw(&Text::new(name, (left + 14, 14), text.clone()))?;
    }
    for (index, area) in panels.split_evenly((rows, columns)).iter().enumerate().take(sets) {
        panel(area, record, index)?;
    }
    root.present()?;
    Ok(())
}

fn panel(area: &DrawingArea<SVGBackend<'_>, Shift>, record: &DecoderStudyRecord, objects: usize) -> Drawn {
    let series = series(record, objects);
    let range = |value: &dyn Fn(&Point) -> f64| {
        let values: Vec<f64> = series.iter().flat_map(|series| &series.points).map(value).collect();
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if values.is_empty() {
            return 0.0..1.0;
        }
        let margin = 0.08 * (high - low).max(1e-3);
        low - margin..high + margin
    };
    let source = record.settings.objects[objects].source.to_string();
    // The folder of a file would not fit.
    let title = source.rsplit('/').next().unwrap_or(&source).to_owned();
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 13))
        .margin(8)
        .x_label_area_size(38)
        .y_label_area_size(48)
        .build_cartesian_2d(range(&|point| point.bits), range(&|point| point.psnr_db))?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("information of the whole sensor (bits per pixel)")
        .y_desc("PSNR (dB)")
        .label_style(("sans-serif", 11))
        .draw()?;
    for Series { colour, points, .. } in &series {
        let at = |point: &Point| (point.bits, point.psnr_db);
        chart.draw_series(points.iter().map(|point| Circle::new(at(point), 4, colour.filled())))?;
        let text = ("sans-serif", 10).into_font();
        chart.draw_series(
            points
                .iter()
                .map(|point| EmptyElement::at(at(point)) + Text::new(point.name.clone(), (6, -5), text.clone())),
        )?;
    }
    Ok(())
}
