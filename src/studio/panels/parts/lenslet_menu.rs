//! Context menu of a lenslet, on the mask and in the table.

use egui::Ui;

use crate::optics::{Lenslet, LensletArray};
use crate::studio::state::app_state::State;
use crate::workbench::{Command, LensletChange};

/// Shows the entries for a lenslet and those selected with it.
pub fn show(ui: &mut Ui, state: &mut State, array: &LensletArray, index: usize) {
    let Some(&lenslet) = array.lenslets.get(index) else { return };
    if !state.selection.contains(&index) {
        select(state, index, false);
    }
    if ui.button("Delete").clicked() {
        state.delete_selection();
        ui.close();
    }
    if ui.button("Duplicate").clicked() {
        let (x, y) = inside((lenslet.x + 1.0, lenslet.y + 1.0), array);
        state.send(&Command::AddLenslet(Lenslet { x, y, ..lenslet }));
        ui.close();
    }
    let lock = if state.selection.is_subset(state.locks.indices()) { "Unlock" } else { "Lock" };
    // Locks belong to the open design, not to a preview.
    let button = ui.add_enabled(!state.session.is_previewing(), egui::Button::new(lock));
    if button.on_hover_text("Locked lenslets stay unchanged in runs").clicked() {
        state.locks.toggle(&state.selection);
        ui.close();
    }
    if ui.button("Centre").clicked() {
        let middle = Lenslet { x: (array.cols / 2) as f64, y: (array.rows / 2) as f64, ..lenslet };
        state.send(&Command::ChangeLenslets { what: LensletChange::Position, lenslets: vec![(index, middle)] });
        ui.close();
    }
}

/// Selects a lenslet; with `add`, toggles it in the selection.
pub fn select(state: &mut State, index: usize, add: bool) {
    if !add {
        state.selection.clear();
    }
    if !state.selection.insert(index) && add {
        state.selection.remove(&index);
    }
}

/// Nearest point (x, y) inside the PSF grid.
pub fn inside((x, y): (f64, f64), array: &LensletArray) -> (f64, f64) {
    (x.clamp(0.0, array.cols as f64 - 1.0), y.clamp(0.0, array.rows as f64 - 1.0))
}
