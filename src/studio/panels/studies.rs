//! Studies: a plan is chosen or a folder opened, its cells fill, and its plot grows.

use egui::{ComboBox, ProgressBar, RichText, ScrollArea, TextEdit, Ui, vec2};

use crate::evaluation::format_duration;
use crate::plural::counted;
use crate::studio::panels::parts::{study_cells, study_plot};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::{Request, StudyRequest};
use crate::studio::state::studies::StudiesState;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::workbench::{OpenStudy, StudyStatus, StudyView};

/// Size of the texts, points.
const TEXT: f32 = 12.5;
/// Width of the button that pauses and resumes, points.
const PAUSE_WIDTH: f32 = 56.0;

/// Shows the panel.
pub fn show(ui: &mut Ui, state: &mut StudiesState, view: &View<'_>, requests: &mut Vec<Request>) {
    ScrollArea::vertical().id_salt("studies").auto_shrink(false).show(ui, |ui| parts(ui, state, view, requests));
}

fn parts(ui: &mut Ui, state: &mut StudiesState, view: &View<'_>, requests: &mut Vec<Request>) {
    let study = view.study;
    if !study.is_active() {
        ui.horizontal_wrapped(|ui| form(ui, state, requests));
        sets(ui, state);
    }
    match &study.status {
        Some(StudyStatus::Failed(sentence)) => {
            ui.colored_label(ui.visuals().error_fg_color, sentence);
        }
        Some(StudyStatus::Opening) => {
            ui.weak("Reading the folder");
        }
        _ => {}
    }
    let Some(open) = &study.open else {
        ui.add_space(4.0);
        ui.weak(
            "A study answers a question by many estimates: masks, objects, light and noise cross to cells. Choose a plan and a \
             folder for it, or open the folder of a study that a cluster or the command line computed.",
        );
        return;
    };
    ui.separator();
    header(ui, state, open, study, requests);
    if state.cells {
        study_cells::show(ui, open, study.running, requests);
    } else {
        study_plot::show(ui, state.panel, open, requests);
    }
}

/// Form of a new study, and the buttons that open one.
fn form(ui: &mut Ui, state: &mut StudiesState, requests: &mut Vec<Request>) {
    let name = state.base().name.clone();
    let response = ComboBox::from_id_salt("plan")
        .selected_text(if state.from_file.is_some() { format!("{name} (file)") } else { name })
        .width(96.0)
        .height(320.0)
        .show_ui(ui, |ui| {
            for (index, named) in state.named.iter().enumerate() {
                let is_chosen = state.from_file.is_none() && state.chosen == index;
                if ui.selectable_label(is_chosen, &named.plan.name).on_hover_text(named.question).clicked() {
                    (state.chosen, state.from_file) = (index, None);
                }
            }
        })
        .response;
    let question = state.named.get(state.chosen).filter(|_| state.from_file.is_none()).map(|named| named.question);
    name_widget(&response.on_hover_text(question.unwrap_or("A plan of your own")), "Plan");
    let quick = ui.checkbox(&mut state.quick, "Quick");
    name_widget(
        &quick.on_hover_text("A first look: every second value of long axes, and seconds for each cell"),
        "Quick study",
    );
    let new = ui.button("New...").on_hover_text("Asks for the folder of a new study");
    name_widget(&new, "New study");
    if new.clicked() {
        match state.plan() {
            Ok(plan) => requests.push(Request::AskPath(PathPurpose::NewStudy(Box::new(plan)))),
            Err(sentence) => requests.push(Request::Study(StudyRequest::Refused(sentence))),
        }
    }
    let file = ui.button("Plan file...").on_hover_text("A TOML file, as study plan NAME prints it");
    name_widget(&file, "Open plan");
    if file.clicked() {
        requests.push(Request::AskPath(PathPurpose::OpenPlan));
    }
    let open = ui.button("Open folder...").on_hover_text("Opens a study, also one that a cluster fills");
    name_widget(&open, "Open study");
    if open.clicked() {
        requests.push(Request::AskPath(PathPurpose::OpenStudy));
    }
}

/// Fields for the files of image sets that the plan names.
fn sets(ui: &mut Ui, state: &mut StudiesState) {
    for name in state.missing_sets() {
        ui.horizontal(|ui| {
            ui.label(RichText::new(&name).size(TEXT));
            let text = state.sets.entry(name.clone()).or_default();
            let field = TextEdit::singleline(text).hint_text("its IDX file, CIFAR-10 batch or folder of images");
            let response = ui.add(field.desired_width(ui.available_width()));
            name_widget(&response, &format!("File of {name}"));
        });
    }
}

/// Title, progress and buttons of the open study.
fn header(ui: &mut Ui, state: &mut StudiesState, open: &OpenStudy, study: &StudyView, requests: &mut Vec<Request>) {
    let plan = open.folder.plan();
    let path = open.folder.path().display().to_string();
    ui.label(RichText::new(&plan.title).strong()).on_hover_text(path);
    let (all, done, failed) = (open.states.len(), open.done(), open.failed());
    ui.add(ProgressBar::new(done as f32 / all.max(1) as f32).desired_height(8.0));
    let failures = if failed > 0 { format!(", {failed} failed") } else { String::new() };
    let left = study.left.map_or(String::new(), |left| format!(", {} left", format_duration(left)));
    ui.label(RichText::new(format!("{done} of {} done{failures}{left}", counted(all, "cell"))).size(TEXT));
    if let Some(sentence) = &open.left_out {
        ui.add(egui::Label::new(RichText::new(sentence).size(TEXT).weak()).truncate()).on_hover_text(sentence);
    }
    ui.horizontal_wrapped(|ui| {
        if study.is_active() {
            let is_paused = study.status == Some(StudyStatus::Paused);
            // As wide in both states: the button beside it stays where it is.
            let pause = egui::Button::new(if is_paused { "Resume" } else { "Pause" }).small();
            let pause = ui.add(pause.min_size(vec2(PAUSE_WIDTH, 0.0)));
            name_widget(&pause, if is_paused { "Resume study" } else { "Pause study" });
            if pause.clicked() {
                requests.push(Request::Study(StudyRequest::Pause(!is_paused)));
            }
            let stop = ui.small_button("Stop").on_hover_text("Finished cells stay; Start resumes the study");
            name_widget(&stop, "Stop study");
            if stop.clicked() {
                requests.push(Request::Study(StudyRequest::Stop));
            }
        } else {
            let start = ui.add_enabled(done < all, egui::Button::new("Start").small());
            let start = start.on_hover_text("Computes the cells without a result; the live estimate has priority");
            name_widget(&start.clone().on_disabled_hover_text("Every cell is done"), "Start study");
            if start.clicked() {
                requests.push(Request::Study(StudyRequest::Start));
            }
            let refresh = ui.small_button("Refresh").on_hover_text("Reads the cells that other machines computed");
            name_widget(&refresh, "Refresh study");
            if refresh.clicked() {
                requests.push(Request::Study(StudyRequest::Open(open.folder.path().to_path_buf())));
            }
        }
        for (cells, text, name, hint) in [
            (
                false,
                "Plot",
                "Show study plot",
                "Lines: estimates. Dashed: lower bounds. Circles: published values. Stars: optima. PSNR against information: points with \
                 intervals. A click opens a design",
            ),
            (true, "Cells", "Show study cells", "One square for each cell. A click opens its design"),
        ] {
            let response = ui.selectable_value(&mut state.cells, cells, text).on_hover_text(hint);
            name_widget(&response, name);
        }
        let export = ui.menu_button("Export", |ui| {
            for (text, purpose) in [
                ("Plot...", PathPurpose::ExportStudyPlot(open.figure.clone())),
                ("Table...", PathPurpose::ExportStudyTable(open.clone())),
            ] {
                if ui.button(text).clicked() {
                    requests.push(Request::AskPath(purpose));
                }
            }
        });
        name_widget(&export.response, "Export study");
        let panels = &open.figure.panels;
        state.panel = state.panel.min(panels.len().saturating_sub(1));
        if panels.len() > 1 && !state.cells {
            let response = ComboBox::from_id_salt("study panel")
                .selected_text(&panels[state.panel].title)
                .show_ui(ui, |ui| {
                    for (index, panel) in panels.iter().enumerate() {
                        ui.selectable_value(&mut state.panel, index, &panel.title);
                    }
                })
                .response;
            name_widget(&response, "Panel of the study");
        }
    });
    // Below the buttons: the row comes and goes with the cells, and the buttons stay where they are.
    if study.is_active() {
        let text = match study.running {
            Some(index) => format!("{}: {}", plan.name_of(&open.folder.cells()[index]), study.step),
            None => "Begins the first cell".into(),
        };
        ui.add(egui::Label::new(RichText::new(text).size(TEXT).weak()).truncate());
    }
}
