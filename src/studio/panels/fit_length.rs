//! How long a fit is to be: a number of steps, which can be repeated, or a time.

use std::time::Duration;

use egui::{ComboBox, Ui};

use crate::information::{EngineChoice, Estimator};
use crate::studio::canvas::image_view::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::DensityModel;

/// The length of a fit, and how it is told.
pub struct FitLengthForm {
    minutes: f64,
    steps: usize,
    /// Whether a fit takes so many steps, or so much time.
    by_steps: bool,
}

impl FitLengthForm {
    /// What suits an estimator, in steps where it counts them.
    pub fn usual(kind: Estimator) -> Self {
        let minutes = kind.usual_budget().map_or(1.0, |budget| budget.as_secs_f64() / 60.0);
        // Steps that take about as long on two cores.
        let steps = if kind == Estimator::Full { 60_000 } else { 2_000 };
        Self { minutes, steps, by_steps: true }
    }

    /// The same for another estimator, told as this is.
    pub fn turn_to(&mut self, kind: Estimator) {
        *self = Self { by_steps: self.by_steps, ..Self::usual(kind) };
    }

    /// Whether the fit takes so many steps; that of the published model is ended by its protocol or by time.
    fn counts_steps(&self, kind: Estimator) -> bool {
        self.by_steps && kind != Estimator::PixelCnn
    }

    /// The model of a fit of this length.
    pub fn model(&self, kind: Estimator, engine: EngineChoice) -> DensityModel {
        let model = DensityModel::new(kind, Some(Duration::from_secs_f64(60.0 * self.minutes)), engine);
        if self.counts_steps(kind) { model.of_steps(self.steps) } else { model }
    }

    /// Shows it; `place` tells its controls from others of the same kind.
    pub fn show(&mut self, ui: &mut Ui, kind: Estimator, place: &str) {
        if self.counts_steps(kind) {
            let name = format!("Steps {place}");
            NumberField::whole(&name, 1..=10_000_000).speed(50.0).edit_whole(ui, &mut self.steps);
        } else {
            let name = format!("Minutes {place}");
            NumberField::new(&name, 0.1..=600.0).speed(0.2).decimals(1).edit(ui, &mut self.minutes);
        }
        let response = ComboBox::from_id_salt(("length", place))
            .selected_text(if self.counts_steps(kind) { "steps" } else { "min" })
            .width(52.0)
            .show_ui(ui, |ui| {
                ui.selectable_value(&mut self.by_steps, false, "min").on_hover_text(
                    "The fit gets as far as the machine does, so that the copied command gives a similar number",
                );
                ui.add_enabled_ui(kind != Estimator::PixelCnn, |ui| {
                    ui.selectable_value(&mut self.by_steps, true, "steps")
                        .on_hover_text("The copied command gives the same number again, bit for bit");
                });
            })
            .response;
        name_widget(&response, &format!("Length {place}"));
    }
}
