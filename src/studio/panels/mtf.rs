//! Spatial frequencies: the modulation transfer function, as cuts through frequency 0 or as a map, and the power
//! spectrum of the measurement.

use egui::Ui;
use egui_plot::{Corner, HLine, Legend, Line, Plot, PlotPoints};

use crate::evaluation::Optics;
use crate::optics::{Mtf, PhotographQuality};
use crate::studio::canvas::image_view::{ImageContent, ImageVersion, ImageView};
use crate::studio::canvas::overlays::PixelSize;
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::panels::parts::image_menu::{self, MenuImage};
use crate::studio::panels::parts::spectrum_plot;
use crate::studio::state::mtf_and_map::{MtfMode, MtfState};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::colours::ENTROPY_BOUND;
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};
use crate::workbench::{Curve, Revisioned};

/// Shows the transfer function or the spectrum.
pub fn show(ui: &mut Ui, state: &mut MtfState, view: &View<'_>, requests: &mut Vec<Request>) {
    let Some(optics) = &view.live.optics else {
        placeholder(ui, "Rendering the PSF");
        return;
    };
    let mtf = &optics.value.mtf;
    toolbar(ui, |ui| {
        for (mode, text, name, hint) in [
            (MtfMode::Cuts, "Cuts", "Show MTF cuts", "Transfer function along the horizontal and the vertical"),
            (MtfMode::Map, "Map", "Show MTF map", "The whole transfer function"),
            (
                MtfMode::Spectrum,
                "Spectrum",
                "Show spectrum",
                "Power spectrum of the shown measurement, and that of its noise",
            ),
        ] {
            let response = ui.selectable_value(&mut state.mode, mode, text).on_hover_text(hint);
            name_widget(&response, name);
        }
        match state.mode {
            MtfMode::Cuts => {
                let export = ui.small_button("Export CSV...");
                name_widget(&export, "Export MTF as CSV");
                if export.clicked() {
                    requests.push(Request::AskPath(PathPurpose::ExportCurve { curve: curve(mtf), name: "mtf.csv" }));
                }
            }
            MtfMode::Map => state.image.colour_controls(ui, view.palettes),
            MtfMode::Spectrum => spectrum_plot::export_button(ui, view, requests),
        }
    });
    match state.mode {
        MtfMode::Cuts => {
            let photograph = view.design.encoder.photograph();
            mean(ui, optics, photograph);
            cuts(ui, mtf, view.design.pixel_pitch_um, photograph.map(|quality| quality.noise_floor));
        }
        MtfMode::Map => show_map(ui, &mut state.image, optics, view, requests),
        MtfMode::Spectrum => spectrum_plot::show(ui, view, requests),
    }
}

fn show_map(
    ui: &mut Ui,
    map: &mut ImageView,
    optics: &Revisioned<Optics>,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    let is_current = view.is_current(optics.revision);
    let image = optics.value.mtf.map.view();
    let (rows, cols) = image.dim();
    let pitch = view.design.pixel_pitch_um;
    map.set_pixel(PixelSize::of_frequency(1.0 / cols.max(1) as f64, pitch));
    let version = ImageVersion { revision: optics.revision, index: 0 };
    let content = ImageContent { values: image, version, is_stale: !is_current };
    let shown = map.show(ui, view.palettes, content, PointerMode::View);
    if let Some(position) = shown.response.hover_pos() {
        let (x, y) = shown.placement.to_pixels(position);
        if let Some(&value) = image.get((y.round().max(0.0) as usize, x.round().max(0.0) as usize)) {
            let by_x = (x.round() - (cols / 2) as f64) / cols as f64;
            let by_y = (y.round() - (rows / 2) as f64) / rows as f64;
            let text = match pitch {
                None => format!("MTF  fx {by_x:.3}, fy {by_y:.3} cycles/px: {value:.3}"),
                Some(pitch) => {
                    let [by_x, by_y] =
                        [by_x, by_y].map(|frequency| PixelSize::of_frequency(frequency, Some(pitch)).width);
                    format!("MTF  fx {by_x:.1}, fy {by_y:.1} cycles/mm: {value:.3}")
                }
            };
            requests.push(Request::Describe(text));
        }
    }
    let menu = MenuImage { image, is_current, shown: &shown };
    image_menu::show(ui, map, &menu, requests, |_, _, _| {});
}

/// The mean modulation, and what a photograph limits.
fn mean(ui: &mut Ui, optics: &Revisioned<Optics>, photograph: Option<PhotographQuality>) {
    ui.horizontal_wrapped(|ui| {
        let mean = ui.label(format!("Mean MTF below Nyquist {:.3}", optics.value.mean_mtf));
        mean.on_hover_text("Mean over all frequencies above 0, up to half the sampling rate of the pixels");
        if let Some(PhotographQuality { saturated_share, .. }) = photograph
            && saturated_share > 0.0
        {
            let text = format!("{:.2} % of the photograph is saturated: the MTF is too low", 100.0 * saturated_share);
            ui.colored_label(ui.visuals().warn_fg_color, text);
        }
    });
}

fn cuts(ui: &mut Ui, mtf: &Mtf, pitch_um: Option<f64>, noise_floor: Option<f64>) {
    let unit = PixelSize::of_frequency(1.0, pitch_um).width;
    let line = |cut: &[[f64; 2]]| -> PlotPoints<'static> {
        cut.iter().map(|&[frequency, value]| [frequency * unit, value]).collect()
    };
    Plot::new("MTF cuts")
        .legend(Legend::default().position(Corner::RightTop))
        .include_y(0.0)
        .include_y(1.0)
        .include_x(0.0)
        .include_x(0.5 * unit)
        .allow_scroll(false)
        .x_axis_label(PixelSize::frequency_label(pitch_um))
        .y_axis_label("modulation")
        .show(ui, |plot| {
            plot.line(Line::new("horizontal", line(&mtf.horizontal)).width(2.0));
            plot.line(Line::new("vertical", line(&mtf.vertical)).width(2.0));
            if let Some(floor) = noise_floor.filter(|floor| *floor > 0.0) {
                plot.hline(HLine::new("noise of the photograph", floor).color(ENTROPY_BOUND).width(1.5));
            }
        });
}

/// Both cuts as columns; the shorter one ends with empty (NaN) cells.
fn curve(mtf: &Mtf) -> Curve {
    let cell = |cut: &[[f64; 2]], index: usize, entry: usize| cut.get(index).map_or(f64::NAN, |point| point[entry]);
    let rows = (0..mtf.horizontal.len().max(mtf.vertical.len()))
        .map(|index| {
            vec![
                cell(&mtf.horizontal, index, 0),
                cell(&mtf.horizontal, index, 1),
                cell(&mtf.vertical, index, 0),
                cell(&mtf.vertical, index, 1),
            ]
        })
        .collect();
    let header = ["horizontal_cycles_per_px", "horizontal_modulation", "vertical_cycles_per_px", "vertical_modulation"];
    Curve { header: header.map(String::from).to_vec(), rows, names: Vec::new() }
}
