//! Modulation transfer function: cuts through frequency 0, or the whole map.

use egui::{Sense, Ui};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoints};

use super::dialogs::Purpose;
use super::image_view::{name_widget, placeholder, toolbar};
use super::state::State;
use crate::optics::Mtf;
use crate::workbench::Curve;

/// Shows the transfer function.
pub fn show(ui: &mut Ui, state: &mut State) {
    let Some(optics) = state.live.optics.clone() else {
        placeholder(ui, "Rendering the PSF");
        return;
    };
    let mtf = &optics.value.mtf;
    toolbar(ui, |ui| {
        ui.selectable_value(&mut state.mtf_as_map, false, "Cuts");
        ui.selectable_value(&mut state.mtf_as_map, true, "Map");
        if state.mtf_as_map {
            state.views.mtf.colormap_menu(ui);
        } else {
            let export = ui.small_button("Export CSV...");
            name_widget(&export, "Export MTF as CSV");
            if export.clicked() {
                state.dialogs.ask(Purpose::ExportCurve { curve: curve(mtf), name: "mtf.csv" }, state.bench.path());
            }
        }
    });
    if state.mtf_as_map {
        let stale = !state.is_current(optics.revision);
        let image = mtf.map.view();
        let version = (optics.revision, 0);
        let (placement, response) = state.views.mtf.show(ui, &state.palettes, image, version, stale, Sense::hover());
        if let Some(position) = response.hover_pos() {
            let (x, y) = placement.to_pixels(position);
            let (rows, cols) = image.dim();
            if let Some(&value) = image.get((y.round().max(0.0) as usize, x.round().max(0.0) as usize)) {
                let by_x = (x.round() - (cols / 2) as f64) / cols as f64;
                let by_y = (y.round() - (rows / 2) as f64) / rows as f64;
                state.hover = Some(format!("MTF  fx {by_x:.3}, fy {by_y:.3} cycles/px: {value:.3}"));
            }
        }
        return;
    }
    Plot::new("MTF cuts")
        .legend(Legend::default().position(Corner::RightTop))
        .include_y(0.0)
        .include_y(1.0)
        .include_x(0.0)
        .include_x(0.5)
        .allow_scroll(false)
        .x_axis_label("cycles per pixel")
        .y_axis_label("modulation")
        .show(ui, |plot| {
            plot.line(Line::new("horizontal", PlotPoints::from(mtf.horizontal.clone())).width(2.0));
            plot.line(Line::new("vertical", PlotPoints::from(mtf.vertical.clone())).width(2.0));
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
