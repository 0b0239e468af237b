//! The dialog that offers unsaved designs of a crashed session.

use std::time::SystemTime;

use crate::evaluation::format_duration;
use crate::studio::state::request::Request;
use crate::studio::widgets::modal;
use crate::workbench::Recovered;

/// Offers the unsaved designs one after the other. Undecided ones are offered again at the next start.
pub fn ask(ctx: &egui::Context, left: &mut Vec<Recovered>, requests: &mut Vec<Request>) {
    let Some(found) = left.first() else { return };
    let age = SystemTime::now().duration_since(found.kept_at).unwrap_or_default();
    let name = found.path.as_ref().map_or_else(|| "A design without a file".into(), |path| path.display().to_string());
    let what = format!("{}, {}", found.design.encoder.describe(), found.design.objects);
    let others = left.len() - 1;
    let mut answer = None;
    modal::show(ctx, "recovery", 400.0, |ui| {
        modal::body(ui, |ui| {
            ui.heading("Recover unsaved changes?");
            ui.label("The program ended unexpectedly. This design has unsaved changes:");
            ui.add_space(4.0);
            ui.strong(name);
            ui.label(what);
            if let Some(network) = &found.network {
                ui.label(network.summary());
            }
            ui.label(format!("Saved {} ago", format_duration(age)));
            if others > 0 {
                ui.weak(format!("{others} more after this one"));
            }
        });
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            for (text, choice) in [("Recover", Answer::Recover), ("Discard", Answer::Discard), ("Later", Answer::Later)]
            {
                if ui.button(text).clicked() {
                    answer = Some(choice);
                }
            }
        });
    });
    match answer {
        Some(Answer::Recover) => {
            requests.push(Request::Recover(Box::new(left.remove(0))));
            // A window holds one design; the others are offered at the next start.
            left.clear();
        }
        Some(Answer::Discard) => left.remove(0).discard(),
        Some(Answer::Later) => left.clear(),
        None => {}
    }
}

/// The user's decision.
#[derive(Clone, Copy)]
enum Answer {
    Recover,
    Discard,
    Later,
}
