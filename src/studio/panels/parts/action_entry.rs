//! A menu entry that does an action.

use crate::studio::state::action::Action;
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;

/// A menu entry for an action.
pub fn entry(ui: &mut egui::Ui, view: &View<'_>, requests: &mut Vec<Request>, action: Action) {
    entry_called(ui, view, requests, action, &action.label());
}

/// The same with another text.
pub fn entry_called(ui: &mut egui::Ui, view: &View<'_>, requests: &mut Vec<Request>, action: Action, text: &str) {
    let mut button = egui::Button::new(text);
    if let Some(shortcut) = action.shortcut() {
        button = button.shortcut_text(ui.ctx().format_shortcut(&shortcut));
    }
    let response = ui.add_enabled(view.can_do(action), button);
    name_widget(&response, text);
    if response.clicked() {
        ui.close();
        requests.push(Request::Do(action));
    }
}
