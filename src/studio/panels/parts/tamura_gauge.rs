//! Tamura coefficients of sensor and objects beside the published guide.

use egui::{RichText, Sense, Stroke, Ui, pos2, vec2};

use crate::plural::counted;
use crate::studio::state::view::View;
use crate::studio::widgets::colours::{ENTROPY_BOUND, GAUSSIAN};

/// Sensor Tamura coefficient near which the published optima of bead designs lie (Kabuli et al. 2026).
pub const TAMURA_GUIDE: f64 = 0.75;

/// Tamura coefficients of sensor and objects on one scale, with the published guide.
pub fn show(ui: &mut Ui, view: &View<'_>) {
    const RANGE: (f64, f64) = (0.5, 1.5);
    let Some(measurements) = &view.live.measurements else { return };
    let (sensor, current) =
        (measurements.value.tamura, view.is_current(measurements.revision) || view.preview.is_following);
    let objects = view.live.scene.as_ref().map(|scene| scene.value.tamura);
    let stage = if current { "" } else { ", of an earlier edit" };
    ui.horizontal(|ui| {
        ui.label("Sensor Tamura");
        let mean = RichText::new(format!("{:.3}", sensor.mean));
        ui.label(if current { mean.strong() } else { mean.weak() });
        ui.weak(if current { format!("sd {:.3}", sensor.sd) } else { "of an earlier edit".into() });
        if let Some(objects) = objects {
            ui.label(format!("objects {:.3}", objects.mean));
        }
    })
    .response
    .on_hover_text(format!(
        "Mean over {}; published bead optima lie near {TAMURA_GUIDE}, designs from random starts at 0.84 to 0.88, pure noise near 0.72",
        counted(sensor.count, "noisy measurement patch")
    ));
    let (response, mut painter) = ui.allocate_painter(vec2(ui.available_width(), 32.0), Sense::hover());
    if !current {
        painter.multiply_opacity(0.5);
    }
    response.widget_info(|| {
        egui::WidgetInfo::labeled(egui::Role::Meter, true, format!("Sensor Tamura {:.3}{stage}", sensor.mean))
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
    painter.vline(at(TAMURA_GUIDE), axis - 8.0..=axis + 8.0, Stroke::new(1.5, ENTROPY_BOUND));
    painter.text(pos2(at(TAMURA_GUIDE), axis + 8.0), egui::Align2::CENTER_TOP, "0.75", font, ENTROPY_BOUND);
    let band =
        egui::Rect::from_x_y_ranges(at(sensor.mean - sensor.sd)..=at(sensor.mean + sensor.sd), axis - 3.0..=axis + 3.0);
    painter.rect_filled(band, 2.0, GAUSSIAN.gamma_multiply(0.4));
    painter.circle_filled(pos2(at(sensor.mean), axis), 5.0, GAUSSIAN);
    if let Some(objects) = objects {
        painter.circle_stroke(pos2(at(objects.mean), axis), 4.5, Stroke::new(1.5, weak));
    }
}
