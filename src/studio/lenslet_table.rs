//! The lenslets as numbers.

use std::cell::Cell;
use std::collections::BTreeSet;

use egui::{DragValue, Ui};

use super::image_view::{name_widget, placeholder};
use super::lenslet_menu;
use super::state::State;
use crate::optics::{Lenslet, LensletArray};
use crate::workbench::{Command, LensletChange};

/// What lenslets are counted, for people.
pub const COUNTS: &str = "Dark lenslets are left out, and those on one spot are taken for one. Effective: as many equal lenslets would \
                          spread the light alike";

/// Shows the table.
pub fn show(ui: &mut Ui, state: &mut State) {
    let design = state.bench.design().clone();
    let Some(array) = design.encoder.lenslets() else {
        placeholder(ui, &format!("{} has no lenslets. The Presets menu has some to edit.", design.encoder.describe()));
        return;
    };
    ui.horizontal(|ui| {
        if ui.button("Add lenslet").on_hover_text("In the middle of the grid; or double-click the mask").clicked() {
            state.add_lenslet();
        }
        let deletable = !state.selection.is_empty() && state.selection.len() < array.lenslets.len();
        let delete = ui.add_enabled(deletable, egui::Button::new("Delete selected"));
        if delete.on_disabled_hover_text("Select lenslets first; one must stay").clicked() {
            state.delete_selection();
        }
        if ui.button("Equal weights").on_hover_text("Gives every lenslet the same share of the light").clicked() {
            let weight = 1.0 / array.lenslets.len() as f64;
            let lenslets = array.lenslets.iter().map(|&lenslet| Lenslet { weight, ..lenslet }).enumerate().collect();
            state.send(&Command::ChangeLenslets { what: LensletChange::Weight, lenslets });
        }
        let count = array.lenslets.len();
        let optics = state.live.optics.as_ref().filter(|optics| state.is_current(optics.revision));
        let text = match optics.and_then(|optics| optics.value.distinct_lenslets) {
            Some((distinct, effective)) if distinct < count => {
                format!("{distinct} of {count} distinct, {effective:.1} effective")
            }
            Some((_, effective)) => format!("{count} lenslets, {effective:.1} effective"),
            None => format!("{count} lenslets"),
        };
        ui.weak(text).on_hover_text(COUNTS);
    });
    ui.add_space(4.0);
    let volumes = array.planes() > 1 || state.live.scene.as_ref().is_some_and(|scene| scene.value.set.planes() > 1);
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        egui::Grid::new("lenslet table").striped(true).spacing([10.0, 3.0]).min_col_width(30.0).show(ui, |ui| {
            for (title, hint) in [
                ("", "Number; click to select"),
                ("x", "Column of the centre, pixels"),
                ("y", "Row of the centre, pixels"),
                ("width", "Standard deviation of the spot, pixels"),
                ("weight", "Share of the light, before all are scaled to sum 1"),
            ] {
                ui.strong(title).on_hover_text(hint);
            }
            if volumes {
                ui.strong("plane").on_hover_text("Depth plane in focus");
            }
            ui.strong("lock").on_hover_text("A run that starts from this design leaves it as it is");
            ui.end_row();
            for index in 0..array.lenslets.len() {
                row(ui, state, array, index, volumes);
                ui.end_row();
            }
        });
    });
}

fn row(ui: &mut Ui, state: &mut State, array: &LensletArray, index: usize, volumes: bool) {
    let lenslet = array.lenslets[index];
    let number = index + 1;
    let selected = state.selection.contains(&index);
    let chooser = ui.selectable_label(selected, format!("{number:>2}"));
    name_widget(&chooser, &format!("Select lenslet {number}"));
    if chooser.clicked() {
        if !ui.input(|input| input.modifiers.shift || input.modifiers.command) {
            state.selection.clear();
        }
        if !state.selection.insert(index) {
            state.selection.remove(&index);
        }
    }
    chooser.context_menu(|ui| lenslet_menu::show(ui, state, array, index));
    // Width, weight and plane of one selected lenslet are set for the whole selection; a place belongs to one alone.
    let together = state.selection.len() > 1 && selected;
    let mut change = |what, of: &dyn Fn(Lenslet) -> Option<Lenslet>| {
        let lenslets: Vec<_> = if together && what != LensletChange::Position {
            let members = state.selected_lenslets();
            members.into_iter().filter_map(|(member, lenslet)| Some((member, of(lenslet)?))).collect()
        } else {
            of(lenslet).map(|changed| (index, changed)).into_iter().collect()
        };
        if !lenslets.is_empty() {
            state.send(&Command::ChangeLenslets { what, lenslets });
        }
    };
    let (last_col, last_row) = (array.cols as f64 - 1.0, array.rows as f64 - 1.0);
    let x = number_field(ui, lenslet.x, 0.0..=last_col, 0.05, 2, " px", &format!("Lenslet {number} x"));
    change(LensletChange::Position, &|lenslet| x.map(|x| Lenslet { x, ..lenslet }));
    let y = number_field(ui, lenslet.y, 0.0..=last_row, 0.05, 2, " px", &format!("Lenslet {number} y"));
    change(LensletChange::Position, &|lenslet| y.map(|y| Lenslet { y, ..lenslet }));
    let sigma = lenslet.spot.mean_sigma();
    let width = number_field(ui, sigma, 0.2..=100.0, 0.01, 3, " px", &format!("Lenslet {number} width"));
    change(LensletChange::Width, &|lenslet| {
        width.map(|sigma| Lenslet { spot: lenslet.spot.with_mean_sigma(sigma), ..lenslet })
    });
    let weight = number_field(ui, lenslet.weight, 0.0..=1e6, 0.001, 4, "", &format!("Lenslet {number} weight"));
    change(LensletChange::Weight, &|lenslet| weight.map(|weight| Lenslet { weight, ..lenslet }));
    if volumes {
        let plane = number_field(ui, lenslet.plane as f64, 0.0..=63.0, 0.05, 0, "", &format!("Lenslet {number} plane"));
        change(LensletChange::Plane, &|lenslet| {
            plane.map(|plane| Lenslet { plane: plane.round() as usize, ..lenslet })
        });
    }
    let mut locked = state.locks.indices().contains(&index) && state.bench.shows_own_lenslets();
    // Locks are of the open design, whatever is shown.
    let lock = ui.add_enabled(!state.bench.is_looking(), egui::Checkbox::new(&mut locked, ""));
    name_widget(&lock, &format!("Lock lenslet {number}"));
    if lock.clicked() {
        state.locks.toggle(&if together { state.selection.clone() } else { BTreeSet::from([index]) });
    }
}

/// A numeric field called `name`; returns the new value where it was changed. Until it is, a value keeps decimals that are
/// not shown.
pub fn number_field(
    ui: &mut Ui,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
    speed: f64,
    decimals: usize,
    suffix: &str,
    name: &str,
) -> Option<f64> {
    let mut edited = value;
    let (least, most) = (*range.start(), *range.end());
    let (formatter, shown) = (ui.style().number_formatter.clone(), Cell::new(None));
    let field = DragValue::new(&mut edited)
        .range(range)
        .clamp_existing_to_range(false)
        .speed(speed)
        .max_decimals(decimals)
        .custom_formatter(|value, decimals| {
            let text = formatter.format(value, decimals);
            shown.set(text.parse::<f64>().ok());
            text
        })
        .suffix(suffix);
    let response = ui.add(field);
    name_widget(&response, name);
    // A field that is left takes its own text for typed, which may have lost decimals.
    let is_own_text = shown.get().is_some_and(|shown| shown.clamp(least, most) == edited);
    let is_left_alone = response.lost_focus() && is_own_text;
    (response.changed() && edited != value && !is_left_alone).then_some(edited)
}
