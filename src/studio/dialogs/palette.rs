//! The command palette.

use egui::Key;

use crate::studio::state::action::Action;
use crate::studio::state::dialogs::ActionPalette;
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::modal;

/// Maximal number of listed actions.
const LISTED: usize = 12;
/// Actions whose names contain all words of the query. Names that begin with the query come first.
fn found(query: &str, view: &View<'_>) -> Vec<Action> {
    let query = query.trim().to_lowercase();
    let words: Vec<&str> = query.split_whitespace().collect();
    let mut found: Vec<(bool, Action)> = Action::all()
        .filter(|action| view.can_do(*action))
        .filter_map(|action| {
            let label = action.label().to_lowercase();
            words.iter().all(|word| label.contains(word)).then(|| (!label.starts_with(&query), action))
        })
        .collect();
    found.sort_by_key(|(later, _)| *later);
    found.into_iter().map(|(_, action)| action).collect()
}

/// Draws the palette where it is open.
pub fn show(ctx: &egui::Context, open: &mut Option<ActionPalette>, view: &View<'_>, requests: &mut Vec<Request>) {
    let Some(palette) = open else { return };
    let mut chosen = None;
    // As many as fit below the field.
    let listed = ((ctx.content_rect().height() - 120.0) / 24.0).clamp(1.0, LISTED as f32) as usize;
    let response = modal::show(ctx, "palette", 420.0, |ui| {
        // Before the text field sees these keys.
        let (down, up, enter) = ui.input_mut(|input| {
            let mut pressed = |key| input.consume_key(egui::Modifiers::NONE, key);
            (pressed(Key::ArrowDown), pressed(Key::ArrowUp), pressed(Key::Enter))
        });
        let field = egui::TextEdit::singleline(&mut palette.query).hint_text("What do you want to do?");
        let response = ui.add(field.desired_width(f32::INFINITY));
        name_widget(&response, "Find an action");
        response.request_focus();
        let actions = found(&palette.query, view);
        if response.changed() {
            palette.marked = 0;
        }
        let last = actions.len().saturating_sub(1);
        palette.marked = (palette.marked + usize::from(down)).saturating_sub(usize::from(up)).min(last);
        let first = (palette.marked + 1).saturating_sub(listed);
        ui.add_space(4.0);
        ui.with_layout(egui::Layout::top_down_justified(egui::Align::LEFT), |ui| {
            for (index, action) in actions.iter().enumerate().skip(first).take(listed) {
                let mut button = egui::Button::selectable(index == palette.marked, action.label());
                if let Some(shortcut) = action.shortcut() {
                    button = button.shortcut_text(ui.ctx().format_shortcut(&shortcut));
                }
                if ui.add(button).clicked() {
                    chosen = Some(*action);
                }
            }
        });
        if actions.is_empty() {
            ui.weak("No action has this name.");
        }
        if enter {
            chosen = actions.get(palette.marked).copied();
        }
    });
    if chosen.is_some() || response.should_close() {
        *open = None;
    }
    requests.extend(chosen.map(Request::Do));
}
