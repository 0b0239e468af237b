//! Controls of the length of a fit: a number of steps, which is reproducible, or a time.

use egui::{ComboBox, Ui};

use crate::information::Estimator;
use crate::studio::state::estimates::FitLengthForm;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;

/// Shows the controls; `place` makes their names unique.
pub fn show(ui: &mut Ui, length: &mut FitLengthForm, kind: Estimator, place: &str) {
    if length.counts_steps(kind) {
        let name = format!("Steps {place}");
        NumberField::whole(&name, 1..=10_000_000).speed(50.0).edit_whole(ui, &mut length.steps);
    } else {
        let name = format!("Minutes {place}");
        NumberField::new(&name, 0.1..=600.0).speed(0.2).decimals(1).edit(ui, &mut length.minutes);
    }
    let response = ComboBox::from_id_salt(("length", place))
        .selected_text(if length.counts_steps(kind) { "steps" } else { "min" })
        .width(52.0)
        .show_ui(ui, |ui| {
            ui.selectable_value(&mut length.by_steps, false, "min")
                .on_hover_text("Limits the fit by time; the copied command gives a similar number");
            ui.add_enabled_ui(kind != Estimator::PixelCnn, |ui| {
                ui.selectable_value(&mut length.by_steps, true, "steps")
                    .on_hover_text("Limits the fit by steps; the copied command gives the same number, bit for bit");
            });
        })
        .response;
    name_widget(&response, &format!("Length {place}"));
}
