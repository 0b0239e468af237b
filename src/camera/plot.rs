//! The drawing of a calibration as SVG: photon transfer curve, linearity and signal-to-noise ratio.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::calibration::CameraCalibration;
use super::response::{Linearity, linearity};
use crate::formats::{DRAWING_FONT, use_drawing_font};

/// Size of a panel with its labels, pixels of the drawing.
const PANEL: (u32, u32) = (380, 300);
const LEVEL: RGBColor = RGBColor(0x08, 0x51, 0x9c);
const FITTED: RGBColor = RGBColor(0xd9, 0x5f, 0x02);
const RANGE: RGBColor = RGBColor(0xee, 0xf3, 0xf8);
const GRID: RGBColor = RGBColor(0xdd, 0xdd, 0xdd);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// The drawing; `None` where it cannot be drawn.
pub(super) fn calibration_plot(camera: &CameraCalibration) -> Option<String> {
    use_drawing_font();
    let mut svg = String::new();
    draw(&mut svg, camera).ok()?;
    Some(svg)
}

fn draw(svg: &mut String, camera: &CameraCalibration) -> Drawn {
    let line = linearity(&camera.light_levels, camera.saturation_dn - camera.dark_signal_dn);
    let panels = if line.is_some() { 3 } else { 2 };
    let root = SVGBackend::with_string(svg, (PANEL.0 * panels, PANEL.1)).into_drawing_area();
    root.fill(&WHITE)?;
    let areas = root.split_evenly((1, panels as usize));
    photon_transfer(&areas[0], camera)?;
    signal_to_noise(&areas[1], camera)?;
    if let (Some(line), Some(area)) = (&line, areas.get(2)) {
        response(area, camera, line)?;
    }
    root.present()?;
    Ok(())
}

/// A panel with linear axes from 0.
struct Panel<'a> {
    title: String,
    x: (&'a str, f64),
    y: (&'a str, f64),
    points: Vec<(f64, f64)>,
    line: Vec<(f64, f64)>,
    /// Range of the abscissa that was fitted.
    fitted: Option<(f64, f64)>,
}

impl Panel<'_> {
    fn draw(self, area: &Area<'_>) -> Drawn {
        let mut chart = ChartBuilder::on(area)
            .caption(self.title, (DRAWING_FONT, 14))
            .margin(8)
            .x_label_area_size(38)
            .y_label_area_size(58)
            .build_cartesian_2d(0.0..1.05 * self.x.1, 0.0..1.1 * self.y.1)?;
        if let Some((low, high)) = self.fitted {
            chart.draw_series([Rectangle::new([(low, 0.0), (high, 1.1 * self.y.1)], RANGE.filled())])?;
        }
        chart
            .configure_mesh()
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .x_labels(6)
            .y_labels(6)
            .x_desc(self.x.0)
            .y_desc(self.y.0)
            .label_style((DRAWING_FONT, 11))
            .draw()?;
        chart.draw_series(LineSeries::new(self.line, FITTED.stroke_width(2)))?;
        chart.draw_series(self.points.into_iter().map(|point| Circle::new(point, 3, LEVEL.filled())))?;
        Ok(())
    }
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::MIN_POSITIVE, f64::max)
}

fn photon_transfer(area: &Area<'_>, camera: &CameraCalibration) -> Drawn {
    let levels = &camera.light_levels;
    let points: Vec<(f64, f64)> = levels.iter().map(|level| (level.signal_dn, level.shot_variance_dn2())).collect();
    let (x, y) = (largest(points.iter().map(|point| point.0)), largest(points.iter().map(|point| point.1)));
    let gain = camera.system_gain_dn_per_electron;
    // The line ends where it leaves the panel.
    let end = x.min(1.1 * y / gain);
    let fitted = camera.fitted_signal_dn();
    let panel = Panel {
        title: format!("Photon transfer: K = {gain:.4} DN per electron"),
        x: ("signal (DN)", x),
        y: ("temporal variance (DN^2)", y),
        points,
        line: vec![(0.0, 0.0), (end, gain * end)],
        fitted: Some((0.0, fitted)),
    };
    panel.draw(area)
}

fn signal_to_noise(area: &Area<'_>, camera: &CameraCalibration) -> Drawn {
    let points: Vec<(f64, f64)> =
        camera.snr_of_levels().into_iter().map(|[electrons, ratio]| (electrons.log10(), ratio)).collect();
    let x = camera.saturation_electrons.max(10.0).log10();
    let at = |step: i32| {
        let electrons = 10_f64.powf(x * f64::from(step) / 100.0);
        (electrons.log10(), camera.snr_db(electrons).max(0.0))
    };
    let panel = Panel {
        title: format!("SNR: at most {:.1} dB, range {:.1} dB", camera.snr_max_db, camera.dynamic_range_db),
        x: ("electrons (powers of 10)", x),
        y: (
            "signal-to-noise ratio (dB)",
            largest(points.iter().map(|point| point.1)).min(2.0 * camera.snr_max_db.max(1.0)),
        ),
        points,
        line: (0..=100).map(at).collect(),
        fitted: None,
    };
    panel.draw(area)
}

fn response(area: &Area<'_>, camera: &CameraCalibration, linearity: &Linearity) -> Drawn {
    let signals = camera.light_levels.iter().map(|level| level.signal_dn);
    let points: Vec<(f64, f64)> = linearity.exposures.iter().copied().zip(signals).collect();
    let (x, y) = (largest(points.iter().map(|point| point.0)), largest(points.iter().map(|point| point.1)));
    let line = linearity.line;
    let end = if line.slope > 0.0 { x.min((1.1 * y - line.start) / line.slope) } else { x };
    let panel = Panel {
        title: format!("Linearity error {:.2} %", linearity.error_percent),
        x: (linearity.unit, x),
        y: ("signal (DN)", y),
        points,
        line: vec![(0.0, line.start.max(0.0)), (end, line.start + line.slope * end)],
        fitted: None,
    };
    panel.draw(area)
}

#[cfg(test)]
mod tests {
    use super::super::simulated::SimulatedSensor;
    use super::*;

    #[test]
    fn drawing_has_the_panels_that_are_known() {
        let mut camera = SimulatedSensor { shape: (24, 32), ..SimulatedSensor::default() }.calibrated(8, 2).calibration;
        let svg = calibration_plot(&camera).unwrap();
        for part in ["Photon transfer: K = 0.", "SNR: at most", "Linearity error", "photons per pixel", "(DN^2)"] {
            assert!(svg.contains(part), "{part}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        for level in &mut camera.light_levels {
            (level.photons, level.exposure_ns) = (None, None);
        }
        assert!(!calibration_plot(&camera).unwrap().contains("Linearity"));
    }
}
