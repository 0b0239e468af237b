//! Plots of a calibration: photon transfer, linearity and signal-to-noise ratio.

use std::ops::RangeInclusive;

use egui::Ui;
use egui_plot::{Corner, GridMark, Legend, Line, LineStyle, Plot, PlotPoints, Points, VLine};

use crate::camera::CameraCalibration;
use crate::studio::widgets::colours::{ENTROPY_BOUND, GAUSSIAN};
use crate::studio::widgets::controls::{name_widget, rest_of_panel};

/// Least height of a plot, points.
const LEAST_HEIGHT: f32 = 150.0;
/// Points of a drawn model.
const STEPS: i32 = 100;

/// A plot that fills the rest of the panel.
fn plot<'a>(ui: &Ui, name: &'a str, x: &str, y: &str) -> Plot<'a> {
    Plot::new(name)
        .height(rest_of_panel(ui, LEAST_HEIGHT))
        .allow_scroll(false)
        .legend(Legend::default().position(Corner::LeftTop))
        .x_axis_label(x.to_owned())
        .y_axis_label(y.to_owned())
}

/// Label of a power of ten on a logarithmic axis.
fn power(mark: GridMark, _: &RangeInclusive<f64>) -> String {
    let is_whole = (mark.value - mark.value.round()).abs() < 1e-6;
    if !is_whole {
        return String::new();
    }
    match mark.value.round() as i32 {
        exponent @ -3..=4 => format!("{}", 10_f64.powi(exponent)),
        exponent => format!("1e{exponent}"),
    }
}

/// Signal and temporal variance of each level, with the fitted range and line.
pub fn photon_transfer(ui: &mut Ui, camera: &CameraCalibration, is_logarithmic: &mut bool) {
    let response = ui.checkbox(is_logarithmic, "Logarithmic axes");
    name_widget(&response, "Logarithmic photon transfer");
    let is_logarithmic = *is_logarithmic;
    let place = |[x, y]: [f64; 2]| if is_logarithmic { [x.log10(), y.log10()] } else { [x, y] };
    let points = |is_fitted: bool| -> Vec<[f64; 2]> {
        let levels = camera.light_levels.iter().filter(|level| level.is_fitted == is_fitted);
        let points = levels.map(|level| [level.signal_dn, level.shot_variance_dn2()]);
        points.filter(|[x, y]| !is_logarithmic || *x > 0.0 && *y > 0.0).map(place).collect()
    };
    let gain = camera.system_gain_dn_per_electron;
    let signals = || camera.light_levels.iter().map(|level| level.signal_dn);
    let most = signals().fold(f64::MIN_POSITIVE, f64::max);
    let least = signals().filter(|signal| *signal > 0.0).fold(most, f64::min);
    let start = if is_logarithmic { least } else { 0.0 };
    let line = vec![place([start, gain * start]), place([most, gain * most])];
    let [fitted_to, _] = place([camera.fitted_signal_dn(), 1.0]);
    let mut plot = plot(ui, "Photon transfer curve", "signal (DN)", "temporal variance (DN\u{b2})");
    if is_logarithmic {
        plot = plot.x_axis_formatter(power).y_axis_formatter(power);
    } else {
        plot = plot.include_x(0.0).include_y(0.0);
    }
    let response = plot.show(ui, |plot| {
        plot.line(Line::new(format!("K = {gain:.4} DN/e-"), PlotPoints::from(line)).color(ENTROPY_BOUND).width(2.0));
        plot.points(Points::new("fitted", points(true)).color(GAUSSIAN).radius(3.5));
        plot.points(Points::new("not fitted", points(false)).color(GAUSSIAN).filled(false).radius(3.5));
        if fitted_to.is_finite() {
            plot.vline(VLine::new("end of the fit", fitted_to).color(ENTROPY_BOUND).style(LineStyle::dashed_loose()));
        }
    });
    name_widget(&response.response, "Photon transfer curve");
}

/// Deviation of each level from the line, per cent.
pub fn linearity(ui: &mut Ui, camera: &CameraCalibration) {
    let Some(curve) = camera.linearity_curve() else {
        ui.weak("No linearity: it needs three or more exposures, in the names of the groups or in a descriptor.");
        return;
    };
    let points = |is_judged: bool| -> Vec<[f64; 2]> {
        let points = curve.points.iter().filter(|point| point.is_judged == is_judged);
        points.map(|point| [point.exposure, point.deviation_percent]).collect()
    };
    // Saturated levels lie far below the line; they set no scale.
    let most = points(true).iter().map(|[_, deviation]| deviation.abs()).fold(0.1, f64::max);
    let last = curve.points.iter().map(|point| point.exposure).fold(0.0, f64::max);
    let plot = plot(ui, "Linearity", curve.unit, "deviation from the line (%)")
        .legend(Legend::default().position(Corner::LeftBottom))
        .default_x_bounds(0.0, 1.05 * last)
        .default_y_bounds(-1.5 * most, 1.5 * most);
    let response = plot.show(ui, |plot| {
        plot.line(Line::new("", vec![[0.0, 0.0], [1.05 * last, 0.0]]).color(ENTROPY_BOUND).width(1.5));
        plot.points(Points::new("5 to 95 % of saturation", points(true)).color(GAUSSIAN).radius(3.5));
        plot.points(Points::new("other levels", points(false)).color(GAUSSIAN).filled(false).radius(3.5));
    });
    name_widget(&response.response, "Linearity deviation");
}

/// Signal-to-noise ratio of the levels and of the linear model.
pub fn signal_to_noise(ui: &mut Ui, camera: &CameraCalibration) {
    let points: Vec<[f64; 2]> =
        camera.snr_of_levels().into_iter().map(|[electrons, ratio]| [electrons.log10(), ratio]).collect();
    let end = camera.saturation_electrons.max(10.0).log10();
    let model = (0..=STEPS).map(|step| {
        let x = end * f64::from(step) / f64::from(STEPS);
        [x, camera.snr_db(10_f64.powf(x))]
    });
    let model: Vec<[f64; 2]> = model.filter(|[_, ratio]| *ratio >= 0.0).collect();
    let plot = plot(ui, "SNR", "electrons", "signal-to-noise ratio (dB)").x_axis_formatter(power);
    let response = plot.show(ui, |plot| {
        plot.line(Line::new("linear sensor", PlotPoints::from(model)).color(ENTROPY_BOUND).width(2.0));
        plot.points(Points::new("measured", points).color(GAUSSIAN).radius(3.5));
        plot.vline(VLine::new("saturation", end).color(ENTROPY_BOUND).style(LineStyle::dashed_loose()));
    });
    name_widget(&response.response, "SNR curve");
}
