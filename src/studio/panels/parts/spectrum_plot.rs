//! Power spectra of the shown measurement and of its noise.

use egui::Ui;
use egui_plot::{Corner, GridInput, GridMark, HLine, HoverPosition, Legend, Line, Plot, PlotPoints};

use crate::information::PowerSpectrum;
use crate::sensor::Noise;
use crate::studio::canvas::overlays::PixelSize;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::Request;
use crate::studio::state::samples::ShownSample;
use crate::studio::state::view::View;
use crate::studio::widgets::colours::ENTROPY_BOUND;
use crate::studio::widgets::controls::{name_widget, placeholder};
use crate::studio::widgets::format::format_significant;
use crate::workbench::{Curve, InspectionKey};

/// Draws the spectrum.
pub fn show(ui: &mut Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    if view.live.measurements.is_none() {
        placeholder(ui, "Computing");
        return;
    }
    requests.push(Request::Inspect);
    let Some(inspection) = &view.live.closer else {
        placeholder(ui, "Computing");
        return;
    };
    let spectrum = &inspection.spectrum;
    let current = is_shown(view, &inspection.key);
    let powers: Vec<[f64; 2]> = spectrum.radial.iter().copied().filter(|[_, power]| *power > 0.0).collect();
    if powers.is_empty() {
        placeholder(ui, "This measurement has no frequencies above 0.");
        return;
    }
    let (name, noise) = noise_level(view.design.noise, spectrum.mean);
    // The noise level belongs to the current measurement.
    let noise = noise.filter(|noise| *noise > 0.0 && current);
    let pitch_um = view.design.pixel_pitch_um;
    let PixelSize { width: scale, unit, .. } = PixelSize::of_frequency(1.0, pitch_um);
    let decimals = if pitch_um.is_some() { 1 } else { 3 };
    // The plot has no logarithmic axis: it draws logarithms and labels powers.
    let points: PlotPoints<'static> =
        powers.iter().map(|&[frequency, power]| [frequency * scale, power.log10()]).collect();
    let mut plot = Plot::new("Power spectrum of the measurement")
        .legend(Legend::default().position(Corner::RightTop))
        .include_x(0.0)
        .include_x(0.5 * scale)
        .allow_scroll(false)
        .y_grid_spacer(decades)
        .y_axis_formatter(|mark: GridMark, _| power_mark(mark.value))
        .label_formatter(move |position| {
            let HoverPosition::NearDataPoint { plot_name, position, .. } = position else { return None };
            let power = format_significant(10.0_f64.powf(position.y));
            Some(format!("{plot_name}\n{:.decimals$} {unit}: {power} photons\u{b2}", position.x))
        })
        .x_axis_label(PixelSize::frequency_label(pitch_um))
        .y_axis_label("power, photons\u{b2}");
    if pitch_um.is_none() {
        plot = plot.x_grid_spacer(tenths).x_axis_formatter(|mark: GridMark, _| format!("{:.1}", mark.value));
    }
    if let Some(noise) = noise {
        // A decade around the noise level is always visible.
        plot = plot.include_y(noise.log10() - 0.5).include_y(noise.log10() + 0.5);
    }
    plot.show(ui, |plot| {
        let line = Line::new(if current { "measurement" } else { "earlier measurement" }, points);
        plot.line(line.width(if current { 2.0 } else { 1.0 }));
        if let Some(noise) = noise {
            plot.hline(HLine::new(name, noise.log10()).color(ENTROPY_BOUND).width(1.5));
        }
    });
}

/// Whether an inspection belongs to the shown measurement.
fn is_shown(view: &View<'_>, key: &InspectionKey) -> bool {
    let shown = ShownSample { index: key.sample, noisy: key.noisy };
    view.is_current(key.revision) && shown == view.shared.sample
}

/// Shows the export button.
pub fn export_button(ui: &mut Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    let shown = view.live.closer.as_ref().filter(|inspection| is_shown(view, &inspection.key));
    let export = ui.add_enabled(shown.is_some(), egui::Button::new("Export CSV...").small());
    name_widget(&export, "Export spectrum as CSV");
    if export.clicked()
        && let Some(inspection) = shown
    {
        let curve = curve(&inspection.spectrum, view.design.noise);
        requests.push(Request::AskPath(PathPurpose::ExportCurve { curve, name: "spectrum.csv" }));
    }
}

/// Name and power of the noise at a mean, photons^2; shot noise for a noiseless sensor.
fn noise_level(noise: Noise, mean: f64) -> (&'static str, Option<f64>) {
    let read = noise.read_sigma().map(|sigma| sigma * sigma);
    match (noise, read) {
        (Noise::Read { .. }, read) => ("read noise", read),
        (Noise::ShotRead { .. }, Some(read)) => ("shot and read noise", Some(mean + read)),
        _ => ("shot noise at this mean", Some(mean)),
    }
}

/// Maximal number of marks, about: steps grow by factors of ten when an axis is zoomed out.
const MOST_MARKS: f64 = 100.0;

/// Step and multiples between two bounds; the step is `step` times a power of ten.
fn multiples((low, high): (f64, f64), mut step: f64) -> (f64, impl Iterator<Item = f64>) {
    let span = high - low;
    while span.is_finite() && span / step > MOST_MARKS {
        step *= 10.0;
    }
    let (first, last) =
        if span.is_finite() { ((low / step).ceil() as i64, (high / step).floor() as i64) } else { (0, -1) };
    (step, (first..=last).map(move |multiple| step * multiple as f64))
}

/// Marks at every tenth of a cycle per pixel.
fn tenths(input: GridInput) -> Vec<GridMark> {
    let (step, tenths) = multiples(input.bounds, 0.1);
    tenths.map(|value| GridMark { value, step_size: 2.5 * step }).collect()
}

/// Marks of a logarithmic axis at 1, 2 and 5 times the powers of ten; at powers of ten only on a long axis.
fn decades(input: GridInput) -> Vec<GridMark> {
    let (low, high) = input.bounds;
    let (step, decades) = multiples((low - 1.0, high), 1.0);
    let parts: &[(f64, f64)] =
        if high - low < MOST_MARKS / 3.0 { &[(1.0, 1.0), (2.0, 0.3), (5.0, 0.3)] } else { &[(1.0, 1.0)] };
    decades
        .flat_map(|decade| {
            parts.iter().map(move |(part, size)| GridMark { value: decade + part.log10(), step_size: size * step })
        })
        .filter(|mark| (low..=high).contains(&mark.value))
        .collect()
}

/// Label of a mark, from its logarithm.
fn power_mark(logarithm: f64) -> String {
    let power = 10.0_f64.powf(logarithm);
    match power {
        1.0..1e5 => format!("{power:.0}"),
        0.001..1.0 => format!("{power:.3}").trim_end_matches('0').to_owned(),
        // Extreme powers overflow, so their labels use the logarithm.
        _ if logarithm.fract() == 0.0 => format!("1e{logarithm:.0}"),
        _ => format!("{power:.0e}"),
    }
}

/// The spectrum as a table.
fn curve(spectrum: &PowerSpectrum, noise: Noise) -> Curve {
    let level = noise_level(noise, spectrum.mean).1.unwrap_or(f64::NAN);
    let header = ["cycles_per_px", "power_photons2", "noise_photons2"];
    let rows = spectrum.radial.iter().map(|&[frequency, power]| vec![frequency, power, level]).collect();
    Curve { header: header.map(String::from).to_vec(), rows, names: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_power_is_its_variance() {
        assert_eq!(noise_level(Noise::Shot, 40.0).1, Some(40.0));
        assert_eq!(noise_level(Noise::Read { sigma: 3.0 }, 40.0).1, Some(9.0));
        assert_eq!(noise_level(Noise::ShotRead { sigma: 3.0 }, 40.0).1, Some(49.0));
    }

    #[test]
    fn marks_are_round_powers() {
        let marks = decades(GridInput { bounds: (0.9, 2.4), base_step_size: 0.01 });
        let texts: Vec<String> = marks.iter().map(|mark| power_mark(mark.value)).collect();
        assert_eq!(texts, ["10", "20", "50", "100", "200"]);
        assert_eq!([-1.0, 5.0, 7.0, -400.0].map(power_mark), ["0.1", "1e5", "1e7", "1e-400"]);
    }

    #[test]
    fn marks_stay_few_on_long_axes() {
        let marks = |bounds| {
            let input = || GridInput { bounds, base_step_size: 0.01 };
            [tenths(input()), decades(input())].map(|marks| marks.len())
        };
        assert_eq!(marks((0.0, 0.5)), [6, 2]);
        for bounds in [(-3.0, 30.0), (-1.0, 40.0), (-1e3, 1e3), (-1e12, 1e12), (1e300, 2e300), (-1e300, 1.0)] {
            assert!(
                marks(bounds).into_iter().all(|count| (2..=105).contains(&count)),
                "{bounds:?} {:?}",
                marks(bounds)
            );
        }
        for (low, high) in [(f64::NAN, 1.0), (0.0, f64::NAN), (f64::NEG_INFINITY, f64::INFINITY), (f64::MIN, f64::MAX)]
        {
            assert_eq!(marks((low, high)), [0, 0]);
        }
    }
}
