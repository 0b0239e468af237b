//! Names, toolbars and placeholders that every panel uses.

use egui::accesskit::Live;
use egui::{Response, Ui, Vec2};

/// Gives a control the name by which assistive technology and tests find it.
pub fn name_widget(response: &egui::Response, name: &str) {
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label(name));
}

/// Makes assistive technology announce a text when it changes.
pub fn speak(response: &Response, live: Live) {
    response.ctx.accesskit_node_builder(response.id, |node| node.set_live(live));
}

/// Row of small controls above an image, which wraps.
pub fn toolbar(ui: &mut Ui, add: impl FnOnce(&mut Ui)) {
    ui.horizontal_wrapped(|ui| {
        ui.set_min_height(22.0);
        ui.spacing_mut().item_spacing.x = 6.0;
        add(ui);
    });
    ui.add_space(2.0);
}

/// Centred sentence in place of an image.
pub fn placeholder(ui: &mut Ui, text: &str) {
    let size: Vec2 = ui.available_size();
    ui.allocate_ui_with_layout(size, egui::Layout::centered_and_justified(egui::Direction::TopDown), |ui| {
        ui.weak(text);
    });
}

/// Height from here to the lower end of the panel, at least `least` points. Lower panels are scrolled.
pub fn rest_of_panel(ui: &Ui, least: f32) -> f32 {
    (ui.clip_rect().bottom() - ui.cursor().top() - 4.0).max(least)
}
