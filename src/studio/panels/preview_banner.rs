//! Banner of a preview: a mask of the run is shown in place of the open design. Its buttons accept the mask or end the
//! preview.

use egui::{RichText, Ui};

use crate::studio::state::action::Action;
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::format::file_name;

/// Least width for a third button, points.
const ROOM: f32 = 640.0;

/// Shows the banner during a preview. `can_accept` is true if the mask can replace the open design.
pub fn show(ui: &mut Ui, can_accept: bool, view: &View<'_>, requests: &mut Vec<Request>) {
    if !view.preview.is_shown {
        return;
    }
    let fill = ui.visuals().panel_fill.lerp_to_gamma(ui.visuals().selection.bg_fill, 0.35);
    let frame = egui::Frame::new().fill(fill).inner_margin(egui::Margin::symmetric(8, 4));
    egui::Panel::top("run strip").frame(frame).show(ui, |ui| {
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            // In a narrow window only the Edit menu opens the mask as a new design. Where the design has changed,
            // *Accept* opens a new design itself.
            let has_room = ui.available_width() > ROOM && can_accept;
            let actions = [Action::EndPreview, Action::Accept].into_iter().chain(has_room.then_some(Action::OpenMask));
            for action in actions {
                if ui.button(action.label()).on_hover_text(hint(can_accept, action)).clicked() {
                    requests.push(Request::Do(action));
                }
            }
            ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                let name = file_name(view.path);
                let text = format!("A mask of the run is shown; {name} is as you left it.");
                ui.add(egui::Label::new(RichText::new(text)).truncate());
            });
        });
    });
}

fn hint(can_accept: bool, action: Action) -> &'static str {
    match action {
        Action::Accept if can_accept => "Puts this mask into the design, as one step that can be undone",
        Action::Accept => {
            "Opens this mask as a new design, because the open design has changed since the start of the run"
        }
        Action::OpenMask => "Opens this mask as a new design and leaves the open one unchanged",
        _ => "Shows the open design again. The run continues; Optimize > Newest shows its masks",
    }
}
