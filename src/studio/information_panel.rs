//! Information and sparsity: what the design's numbers are and what they rest on.

use egui::{Color32, RichText, Sense, Stroke, Ui, pos2, vec2};

use super::image_view::{placeholder, significant};
use super::state::State;
use crate::workbench::LiveInformation;

/// Sensor Tamura coefficient near which the published optima of bead designs lie (Kabuli et al. 2026).
const TAMURA_GUIDE: f64 = 0.75;

/// Shows the panel.
pub fn show(ui: &mut Ui, state: &mut State) {
    let failure = state.live.failure.clone();
    if let Some((_, failure)) = &failure {
        ui.colored_label(ui.visuals().error_fg_color, failure);
        ui.add_space(4.0);
    }
    let Some(information) = state.live.information.clone() else {
        if failure.is_none() {
            placeholder(ui, "Computing");
        }
        return;
    };
    let current = state.is_current(information.revision);
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        headline(ui, &information.value, current);
        bound_bar(ui, &information.value);
        details(ui, &information.value);
        ui.add_space(4.0);
        ui.separator();
        tamura(ui, state);
    });
}

/// The tightest upper bound, large, and what kind of number it is.
fn headline(ui: &mut Ui, information: &LiveInformation, current: bool) {
    let gaussian = information.gaussian.bits_per_pixel;
    let ceiling = information.ceiling_bits();
    let (upper, name) = match ceiling {
        Some(ceiling) if ceiling < gaussian => (ceiling, "object-entropy ceiling"),
        _ => (gaussian, "Gaussian bound"),
    };
    ui.horizontal_wrapped(|ui| {
        let text = RichText::new(format!("\u{2264} {upper:.3}")).size(30.0).strong();
        let text = if current { text } else { text.weak() };
        ui.label(text);
        ui.vertical(|ui| {
            ui.add_space(4.0);
            ui.label("bits per pixel");
            ui.weak(if current { name.to_owned() } else { format!("{name}, of an earlier edit") });
        });
    });
    let (rows, cols) = information.patch;
    ui.weak(format!("Upper bounds for {rows} x {cols} px patches; no lower bound is known for this estimator."))
        .on_hover_text("The mutual information between scenes and measurements lies at or below both bounds.");
    if ceiling.is_some_and(|ceiling| ceiling < gaussian) {
        let warning = "The Gaussian bound lies above what the objects hold at all: it overstates this design.";
        ui.colored_label(ui.visuals().warn_fg_color, warning);
    }
    ui.add_space(4.0);
}

/// Both bounds on one axis that starts at 0.
fn bound_bar(ui: &mut Ui, information: &LiveInformation) {
    let gaussian = information.gaussian.bits_per_pixel;
    let ceiling = information.ceiling_bits();
    let end = nice_end(gaussian.max(ceiling.unwrap_or(0.0)));
    let (response, painter) = ui.allocate_painter(vec2(ui.available_width(), 34.0), Sense::hover());
    let text = match ceiling {
        Some(ceiling) => format!("Gaussian bound {gaussian:.3}, ceiling {ceiling:.3} bits per pixel"),
        None => format!("Gaussian bound {gaussian:.3} bits per pixel"),
    };
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Meter, true, &text));
    let rect = response.rect;
    let at = |bits: f64| rect.left() + (bits / end) as f32 * rect.width();
    let top = rect.top() + 4.0;
    let bar = |from: f64, to: f64| egui::Rect::from_min_max(pos2(at(from), top), pos2(at(to), top + 12.0));
    let weak = ui.visuals().weak_text_color();
    painter.rect_filled(bar(0.0, end), 2.0, ui.visuals().extreme_bg_color);
    let allowed = gaussian.min(ceiling.unwrap_or(gaussian)).max(0.0);
    painter.rect_filled(bar(0.0, allowed), 2.0, ui.visuals().selection.bg_fill);
    let mark = |bits: f64, colour: Color32| {
        painter.vline(at(bits), top - 3.0..=top + 15.0, Stroke::new(2.0, colour));
    };
    mark(gaussian, GAUSSIAN);
    if let Some(ceiling) = ceiling {
        mark(ceiling, CEILING);
    }
    let font = egui::FontId::proportional(10.0);
    painter.text(pos2(rect.left(), top + 17.0), egui::Align2::LEFT_TOP, "0", font.clone(), weak);
    painter.text(pos2(rect.right(), top + 17.0), egui::Align2::RIGHT_TOP, significant(end), font, weak);
    response.on_hover_text(text);
}

/// Colour of the Gaussian bound.
pub const GAUSSIAN: Color32 = Color32::from_rgb(74, 158, 255);
/// Colour of the ceiling.
pub const CEILING: Color32 = Color32::from_rgb(240, 138, 36);

/// The next round number above `value`.
fn nice_end(value: f64) -> f64 {
    let value = value.max(1e-3);
    let decade = 10_f64.powf(value.log10().floor());
    [1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0]
        .into_iter()
        .map(|step| step * decade)
        .find(|&end| end >= value)
        .unwrap_or(value)
}

fn details(ui: &mut Ui, information: &LiveInformation) {
    let bound = &information.gaussian;
    let [low, high] = information.interval_95;
    egui::Grid::new("information details").num_columns(2).spacing([14.0, 3.0]).show(ui, |ui| {
        let mut line = |name: &str, value: String, colour: Option<Color32>, hint: &str| {
            ui.horizontal(|ui| {
                if let Some(colour) = colour {
                    let (rect, _) = ui.allocate_exact_size(vec2(8.0, 8.0), Sense::hover());
                    ui.painter().rect_filled(rect, 2.0, colour);
                }
                ui.label(name).on_hover_text(hint);
            });
            ui.label(value).on_hover_text(hint);
            ui.end_row();
        };
        line(
            "Gaussian bound",
            format!("{:.3}  [{low:.3}, {high:.3}]", bound.bits_per_pixel),
            Some(GAUSSIAN),
            "Entropy of the Gaussian with the measurements' covariance, less the noise entropy; 95 % interval. \
             It needs no samples but for the noise entropy, and is loose for sparse objects.",
        );
        match information.ceiling_bits() {
            Some(ceiling) => line(
                "Ceiling",
                format!("{ceiling:.3}"),
                Some(CEILING),
                "What the objects hold and this PSF can tell apart one bead at a time: no measurement can carry more.",
            ),
            None => line("Ceiling", "unknown".into(), None, "The entropy of these objects is not known."),
        }
        line(
            "Infinite patch",
            format!("{:.3}", information.infinite_patch_bits()),
            None,
            "The Gaussian bound of an infinitely large sensor (spectral integral)",
        );
        line(
            "H(Y)  -  H(Y|X)",
            format!("{:.3}  -  {:.3}", bound.entropy_y, bound.entropy_y_given_x),
            None,
            "Entropy of measurements under the Gaussian model, and of the noise alone; bits per pixel",
        );
    });
}

/// Tamura coefficients of sensor and objects on one scale, with the published guide.
fn tamura(ui: &mut Ui, state: &State) {
    const RANGE: (f64, f64) = (0.5, 1.5);
    let sensor = state.live.measurements.as_ref().map(|measurements| measurements.value.tamura);
    let objects = state.live.scene.as_ref().map(|scene| scene.value.tamura);
    let Some(sensor) = sensor else { return };
    ui.horizontal(|ui| {
        ui.label("Sensor Tamura");
        ui.strong(format!("{:.3}", sensor.mean));
        ui.weak(format!("sd {:.3}", sensor.sd));
        if let Some(objects) = objects {
            ui.label(format!("objects {:.3}", objects.mean));
        }
    })
    .response
    .on_hover_text(format!(
        "Mean over {} noisy measurement patches. Published bead optima lie near {TAMURA_GUIDE}; designs found from random \
         starts lie at 0.84 to 0.88: a guide, not a law. Pure noise has about 0.72.",
        sensor.count
    ));
    let (response, painter) = ui.allocate_painter(vec2(ui.available_width(), 32.0), Sense::hover());
    response.widget_info(|| {
        egui::WidgetInfo::labeled(egui::Role::Meter, true, format!("Sensor Tamura {:.3}", sensor.mean))
    });
    let rect = response.rect.shrink2(vec2(4.0, 0.0));
    let at = |tamura: f64| {
        let share = ((tamura - RANGE.0) / (RANGE.1 - RANGE.0)).clamp(0.0, 1.0);
        rect.left() + share as f32 * rect.width()
    };
    let axis = rect.top() + 10.0;
    let weak = ui.visuals().weak_text_color();
    painter.hline(rect.x_range(), axis, Stroke::new(2.0, ui.visuals().extreme_bg_color));
    let font = egui::FontId::proportional(10.0);
    for tick in [0.5, 1.0, 1.5] {
        painter.vline(at(tick), axis - 2.0..=axis + 2.0, Stroke::new(1.0, weak));
        let align = if tick == 0.5 {
            egui::Align2::LEFT_TOP
        } else if tick == 1.5 {
            egui::Align2::RIGHT_TOP
        } else {
            egui::Align2::CENTER_TOP
        };
        painter.text(pos2(at(tick), axis + 8.0), align, format!("{tick:.1}"), font.clone(), weak);
    }
    painter.vline(at(TAMURA_GUIDE), axis - 8.0..=axis + 8.0, Stroke::new(1.5, CEILING));
    painter.text(pos2(at(TAMURA_GUIDE), axis + 8.0), egui::Align2::CENTER_TOP, "0.75", font, CEILING);
    let band =
        egui::Rect::from_x_y_ranges(at(sensor.mean - sensor.sd)..=at(sensor.mean + sensor.sd), axis - 3.0..=axis + 3.0);
    painter.rect_filled(band, 2.0, GAUSSIAN.gamma_multiply(0.4));
    painter.circle_filled(pos2(at(sensor.mean), axis), 5.0, GAUSSIAN);
    if let Some(objects) = objects {
        painter.circle_stroke(pos2(at(objects.mean), axis), 4.5, Stroke::new(1.5, weak));
    }
}
