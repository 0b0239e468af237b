//! The table of lenslets.

use std::collections::BTreeSet;

use egui::Ui;

use crate::optics::{Lenslet, LensletArray};
use crate::plural::counted;
use crate::studio::panels::parts::hints::COUNTS;
use crate::studio::panels::parts::lenslet_menu;
use crate::studio::state::action::Action;
use crate::studio::state::request::Request;
use crate::studio::state::selection::Selection;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{name_widget, placeholder};
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{Command, LensletChange};

/// Shows the table.
pub fn show(ui: &mut Ui, selection: &mut Selection, view: &View<'_>, requests: &mut Vec<Request>) {
    let design = view.design;
    let Some(array) = design.encoder.lenslets() else {
        placeholder(ui, &format!("{} has no lenslets. The Presets menu has some to edit.", design.encoder.describe()));
        return;
    };
    ui.horizontal(|ui| {
        if ui.button("Add lenslet").on_hover_text("Adds a lenslet in the middle of the grid").clicked() {
            requests.push(Request::Do(Action::AddLenslet));
        }
        let deletable = (1..array.lenslets.len()).contains(&selection.indices().len());
        let delete = ui.add_enabled(deletable, egui::Button::new("Delete selected"));
        if delete.on_disabled_hover_text("Select lenslets first; at least one must remain").clicked() {
            requests.push(Request::Do(Action::Delete));
        }
        if ui.button("Equal weights").on_hover_text("Gives every lenslet the same share of the light").clicked() {
            let weight = 1.0 / array.lenslets.len() as f64;
            let lenslets = array.lenslets.iter().map(|&lenslet| Lenslet { weight, ..lenslet }).enumerate().collect();
            requests.push(Request::Change(Command::ChangeLenslets { what: LensletChange::Weight, lenslets }));
        }
        let count = array.lenslets.len();
        let optics = view.live.optics.as_ref().filter(|optics| view.is_current(optics.revision));
        let text = match optics.and_then(|optics| optics.value.distinct_lenslets) {
            Some((distinct, effective)) if distinct < count => {
                format!("{distinct} of {count} distinct, {effective:.1} effective")
            }
            Some((_, effective)) => format!("{}, {effective:.1} effective", counted(count, "lenslet")),
            None => counted(count, "lenslet"),
        };
        // A second line would move the fields below while somebody points at them.
        ui.add(egui::Label::new(egui::RichText::new(text).weak()).truncate()).on_hover_text(COUNTS);
    });
    ui.add_space(4.0);
    let volumes = array.planes() > 1 || view.live.scene.as_ref().is_some_and(|scene| scene.value.set.planes() > 1);
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        egui::Grid::new("lenslet table").striped(true).spacing([10.0, 3.0]).min_col_width(30.0).show(ui, |ui| {
            ui.strong("").on_hover_text("Number; click to select");
            for column in Column::ALL.into_iter().filter(|&column| volumes || column != Column::Plane) {
                ui.strong(column.title()).on_hover_text(column.hint());
            }
            ui.strong("lock").on_hover_text("Locked lenslets stay unchanged in runs");
            ui.end_row();
            for index in 0..array.lenslets.len() {
                row(ui, &Row { array, index, volumes }, selection, view, requests);
                ui.end_row();
            }
        });
    });
}

/// A row of the table.
struct Row<'a> {
    array: &'a LensletArray,
    index: usize,
    /// Whether the plane is shown.
    volumes: bool,
}

fn row(ui: &mut Ui, row: &Row<'_>, selection: &mut Selection, view: &View<'_>, requests: &mut Vec<Request>) {
    let Row { array, index, volumes } = *row;
    let lenslet = array.lenslets[index];
    let number = index + 1;
    let selected = selection.contains(index);
    let chooser = ui.selectable_label(selected, format!("{number:>2}"));
    name_widget(&chooser, &format!("Select lenslet {number}"));
    if chooser.clicked() {
        selection.select(index, ui.input(|input| input.modifiers.shift || input.modifiers.command));
    }
    chooser.context_menu(|ui| lenslet_menu::show(ui, selection, view, index, requests));
    // Width, weight and plane apply to the whole selection, a position to one lenslet.
    let together = selection.indices().len() > 1 && selected;
    for column in Column::ALL.into_iter().filter(|&column| volumes || column != Column::Plane) {
        let name = format!("Lenslet {number} {}", column.title());
        let Some(edit) = column.field(&name, array).show(ui, column.of(lenslet)).1 else { continue };
        let members = if together && !matches!(column, Column::X | Column::Y) {
            selection.of(array)
        } else {
            vec![(index, lenslet)]
        };
        let lenslets = members.into_iter().map(|(member, of)| (member, column.changed(of, edit.value))).collect();
        requests.push(Request::ChangeBy(edit, Command::ChangeLenslets { what: column.change(), lenslets }));
    }
    let mut locked = view.is_locked(index);
    // Locks belong to the open design, not to a preview.
    let lock = ui.add_enabled(!view.preview.is_shown, egui::Checkbox::new(&mut locked, ""));
    name_widget(&lock, &format!("Lock lenslet {number}"));
    if lock.clicked() {
        let lenslets = if together { selection.indices().clone() } else { BTreeSet::from([index]) };
        requests.push(Request::ToggleLocks(lenslets));
    }
}

/// A column of the table.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Column {
    X,
    Y,
    Width,
    Weight,
    Plane,
}

impl Column {
    const ALL: [Self; 5] = [Self::X, Self::Y, Self::Width, Self::Weight, Self::Plane];

    fn title(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Width => "width",
            Self::Weight => "weight",
            Self::Plane => "plane",
        }
    }

    fn hint(self) -> &'static str {
        match self {
            Self::X => "Column of the centre, pixels",
            Self::Y => "Row of the centre, pixels",
            Self::Width => "Standard deviation of the spot, pixels",
            Self::Weight => "Share of the light, before all are scaled to the throughput",
            Self::Plane => "Depth plane in focus",
        }
    }

    fn change(self) -> LensletChange {
        match self {
            Self::X | Self::Y => LensletChange::Position,
            Self::Width => LensletChange::Width,
            Self::Weight => LensletChange::Weight,
            Self::Plane => LensletChange::Plane,
        }
    }

    fn field<'a>(self, name: &'a str, array: &LensletArray) -> NumberField<'a> {
        let place = |side: usize| NumberField::new(name, 0.0..=side as f64 - 1.0).speed(0.05).decimals(2).unit(" px");
        match self {
            Self::X => place(array.cols),
            Self::Y => place(array.rows),
            Self::Width => NumberField::new(name, 0.2..=100.0).speed(0.01).decimals(3).unit(" px"),
            Self::Weight => NumberField::new(name, 0.0..=1e6).speed(0.001).decimals(4),
            Self::Plane => NumberField::whole(name, 0..=63).speed(0.05),
        }
    }

    fn of(self, lenslet: Lenslet) -> f64 {
        match self {
            Self::X => lenslet.x,
            Self::Y => lenslet.y,
            Self::Width => lenslet.spot.mean_sigma(),
            Self::Weight => lenslet.weight,
            Self::Plane => lenslet.plane as f64,
        }
    }

    fn changed(self, lenslet: Lenslet, value: f64) -> Lenslet {
        match self {
            Self::X => Lenslet { x: value, ..lenslet },
            Self::Y => Lenslet { y: value, ..lenslet },
            Self::Width => Lenslet { spot: lenslet.spot.with_mean_sigma(value), ..lenslet },
            Self::Weight => Lenslet { weight: value, ..lenslet },
            Self::Plane => Lenslet { plane: value as usize, ..lenslet },
        }
    }
}
