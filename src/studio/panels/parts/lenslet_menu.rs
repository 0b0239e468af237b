//! Context menu of a lenslet, on the mask and in the table.

use egui::Ui;

use crate::optics::{Lenslet, LensletArray};
use crate::studio::state::action::Action;
use crate::studio::state::request::Request;
use crate::studio::state::selection::Selection;
use crate::studio::state::view::View;
use crate::workbench::{Command, LensletChange};

/// Shows the entries for a lenslet and those selected with it.
pub fn show(ui: &mut Ui, selection: &mut Selection, view: &View<'_>, index: usize, requests: &mut Vec<Request>) {
    let Some(array) = view.design.encoder.lenslets() else { return };
    let Some(&lenslet) = array.lenslets.get(index) else { return };
    if !selection.contains(index) {
        selection.select(index, false);
    }
    if ui.button("Delete").clicked() {
        requests.push(Request::Do(Action::Delete));
        ui.close();
    }
    if ui.button("Duplicate").clicked() {
        let (x, y) = inside((lenslet.x + 1.0, lenslet.y + 1.0), array);
        requests.push(Request::Change(Command::AddLenslet(Lenslet { x, y, ..lenslet })));
        ui.close();
    }
    let lock = if selection.indices().is_subset(view.locks.indices()) { "Unlock" } else { "Lock" };
    // Locks belong to the open design, not to a preview.
    let button = ui.add_enabled(!view.preview.is_shown, egui::Button::new(lock));
    if button.on_hover_text("Locked lenslets stay unchanged in runs").clicked() {
        requests.push(Request::ToggleLocks(selection.indices().clone()));
        ui.close();
    }
    if ui.button("Centre").clicked() {
        let middle = Lenslet { x: (array.cols / 2) as f64, y: (array.rows / 2) as f64, ..lenslet };
        let lenslets = vec![(index, middle)];
        requests.push(Request::Change(Command::ChangeLenslets { what: LensletChange::Position, lenslets }));
        ui.close();
    }
}

/// Nearest point (x, y) inside the PSF grid.
pub fn inside((x, y): (f64, f64), array: &LensletArray) -> (f64, f64) {
    (x.clamp(0.0, array.cols as f64 - 1.0), y.clamp(0.0, array.rows as f64 - 1.0))
}
