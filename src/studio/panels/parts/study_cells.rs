//! The cells of a study as a grid that fills: a row for each line of the plot, a column for each place on its x axis.

use egui::{Color32, Sense, Ui, Vec2, WidgetInfo};

use crate::information::Estimate;
use crate::studies::plans::CellState;
use crate::studio::state::request::{Request, StudyRequest};
use crate::studio::widgets::controls::rest_of_panel;
use crate::workbench::OpenStudy;

/// Largest side of a cell, points.
const LARGEST: f32 = 20.0;
/// Smallest side of a cell, points.
const SMALLEST: f32 = 7.0;
/// Least height of the cells, points.
const LEAST_HEIGHT: f32 = 120.0;
/// Gap between two cells, points.
const GAP: f32 = 2.0;

/// Shows the cells. A click opens the design of one.
pub fn show(ui: &mut Ui, open: &OpenStudy, running: Option<usize>, requests: &mut Vec<Request>) {
    legend(ui);
    // Cells come in rows of one mask after another: the fastest axis of a plan.
    let columns = open.folder.plan().axes.mask.len().max(1);
    let side = (ui.available_width() / columns as f32 - GAP).clamp(SMALLEST, LARGEST);
    let height = rest_of_panel(ui, LEAST_HEIGHT);
    egui::ScrollArea::both().id_salt("cells").max_height(height).auto_shrink(false).show(ui, |ui| {
        ui.spacing_mut().item_spacing = Vec2::splat(GAP);
        for first in (0..open.states.len()).step_by(columns) {
            ui.horizontal(|ui| {
                for index in first..(first + columns).min(open.states.len()) {
                    cell(ui, open, index, running == Some(index), side, requests);
                }
            });
        }
    });
}

fn legend(ui: &mut Ui) {
    ui.horizontal_wrapped(|ui| {
        for (look, name) in
            [(Look::Done, "done"), (Look::Running, "running"), (Look::Failed, "failed"), (Look::Waiting, "waiting")]
        {
            let (rect, _) = ui.allocate_exact_size(Vec2::splat(10.0), Sense::hover());
            ui.painter().rect_filled(rect, 2.0, look.colour(ui));
            ui.label(name);
        }
    });
}

#[derive(Clone, Copy)]
enum Look {
    Done,
    Running,
    Failed,
    Waiting,
}

impl Look {
    fn colour(self, ui: &Ui) -> Color32 {
        let visuals = ui.visuals();
        match self {
            Self::Done => Color32::from_rgb(0x2e, 0x9e, 0x6b),
            Self::Running => visuals.selection.bg_fill,
            Self::Failed => visuals.error_fg_color,
            Self::Waiting => visuals.widgets.noninteractive.bg_stroke.color,
        }
    }
}

fn cell(ui: &mut Ui, open: &OpenStudy, index: usize, is_running: bool, side: f32, requests: &mut Vec<Request>) {
    let state = &open.states[index];
    let look = match state {
        _ if is_running => Look::Running,
        CellState::Done(_) => Look::Done,
        CellState::Failed(_) | CellState::Unusable(_) => Look::Failed,
        CellState::Waiting => Look::Waiting,
    };
    let (rect, response) = ui.allocate_exact_size(Vec2::splat(side), Sense::click());
    ui.painter().rect_filled(rect, 2.0, look.colour(ui));
    if response.has_focus() || response.hovered() {
        ui.painter().rect_stroke(rect, 2.0, ui.visuals().widgets.hovered.fg_stroke, egui::StrokeKind::Outside);
    }
    let name = open.folder.plan().name_of(&open.folder.cells()[index]);
    response.widget_info(|| WidgetInfo::labeled(egui::Role::Button, true, format!("Cell {name}")));
    let result = match state {
        CellState::Done(record) => record.estimate.as_ref().map_or(String::new(), Estimate::bounds),
        CellState::Waiting if is_running => "running".into(),
        CellState::Waiting => "waiting".into(),
        failed => failed.failure().unwrap_or("failed").to_owned(),
    };
    if response.on_hover_text(format!("{name}\n{result}\nClick to open its design")).clicked() {
        requests.push(Request::Study(StudyRequest::OpenCell(index)));
    }
}
