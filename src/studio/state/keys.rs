//! Keys and gestures, as the window lists them with F1. The page `docs/reference/keys.md` is made of the same lists.

use egui::KeyboardShortcut;

use crate::studio::state::action::Action;

/// A gesture and its effect.
#[derive(Clone, Copy, Debug)]
pub struct Gesture {
    /// What the user does.
    pub gesture: &'static str,
    /// What it does.
    pub effect: &'static str,
}

const fn gesture(gesture: &'static str, effect: &'static str) -> Gesture {
    Gesture { gesture, effect }
}

/// Gestures on the image of the mask.
pub const ON_THE_MASK: [Gesture; 12] = [
    gesture("Click", "Select a lenslet; with Shift, add it to the selection or take it out"),
    gesture("Drag a lenslet", "Move the selection"),
    gesture("Drag the image", "Select in a box; with Shift, add to the selection"),
    gesture("Double click", "Add a lenslet"),
    gesture("Arrow keys", "Move the selection by 0.1 px; with Shift, by 1 px"),
    gesture("Wheel on a lenslet", "Weight of the selection"),
    gesture("Alt + wheel", "Width of the selection"),
    gesture("Ctrl + wheel, + and -", "Zoom"),
    gesture("Middle drag, or Space and drag", "Move the image"),
    gesture("0", "Show all"),
    gesture("Right click", "Menu of a lenslet"),
    gesture("Tab", "Next lenslet or control; Space selects"),
];

/// Gestures on every other image.
pub const ON_OTHER_IMAGES: [Gesture; 4] = [
    gesture("Wheel", "Zoom around the pointer"),
    gesture("Drag", "Move the image"),
    gesture("Double click", "Show all"),
    gesture("Right click", "Menu: show all, copy value, export image"),
];

/// Keys of the interface zoom, which are those of egui.
pub const ZOOM_KEYS: Gesture = gesture("Ctrl +, Ctrl -, Ctrl 0", "Interface zoom");

/// Every action with a shortcut, and its shortcuts, the usual one first.
pub fn actions_with_keys() -> impl Iterator<Item = (Action, Vec<KeyboardShortcut>)> {
    let actions = Action::all().chain([Action::Palette]);
    actions
        .map(|action| (action, action.shortcuts().collect::<Vec<_>>()))
        .filter(|(_, shortcuts)| !shortcuts.is_empty())
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;
    use std::path::Path;

    use egui::ModifierNames;

    use super::*;
    use crate::studio::state::pane::Pane;

    const BEGINNING: &str = "\
# Keys and gestures

F1 lists them in the window. Ctrl is Cmd on a Mac. A test keeps this page as the window has them.
";

    const NUMBER_FIELDS: &str = "
## Number fields

A number counts when it is committed: by Enter, Tab or a click elsewhere. Escape cancels. A decimal comma is accepted.

Text that is ambiguous (`1,234`), no number or out of range is refused with a sentence, and the old value stays.
";

    const PANELS: &str = "
## Panels

Drag a panel by its tab. A double click on a tab, or Ctrl+M, maximizes it. *View > Layout* saves and loads two layouts.
";

    fn content(pane: Pane) -> &'static str {
        match pane {
            Pane::Mask => "PSF and lenslets",
            Pane::Lenslets => "lenslets as numbers",
            Pane::Object => "one object",
            Pane::Measurement => "one measurement",
            Pane::Reconstruction => "what a decoder makes of the measurement",
            Pane::Information => "bounds and Tamura coefficient",
            Pane::Scene => "objects and sensor",
            Pane::Optimize => "optimization runs",
            Pane::Estimates => "estimates that take minutes",
            Pane::InformationMap => "information of each pixel of a patch",
            Pane::Mtf => "modulation transfer function and spectrum",
            Pane::History => "bounds of past edits",
            Pane::Compare => "snapshots side by side",
            Pane::Studies => "plans of many estimates",
            Pane::Camera => "calibration, captures and comparison of cameras",
            Pane::Unknown => "a panel of another version",
        }
    }

    fn table(page: &mut String, [left, right]: [&str; 2], rows: impl IntoIterator<Item = (String, String)>) {
        let _ = write!(page, "\n| {left} | {right} |\n|---|---|\n");
        for (left, right) in rows {
            let _ = writeln!(page, "| {left} | {right} |");
        }
    }

    fn row(gesture: Gesture) -> (String, String) {
        (gesture.gesture.into(), gesture.effect.into())
    }

    fn page_of_keys() -> String {
        let mut page = BEGINNING.to_owned();
        let of_action = |(action, shortcuts): (Action, Vec<KeyboardShortcut>)| {
            let names = shortcuts.iter().map(|shortcut| shortcut.format(&ModifierNames::NAMES, false));
            (names.collect::<Vec<_>>().join(", "), action.label().trim_end_matches("...").to_owned())
        };
        page.push_str("\n## Keys\n");
        table(&mut page, ["key", "action"], actions_with_keys().map(of_action).chain([row(ZOOM_KEYS)]));
        page.push_str("\nA text field with the focus keeps Undo, Redo, Select all and Delete for its own text.\n");
        page.push_str("\n## Gestures on the mask\n");
        table(&mut page, ["gesture", "effect"], ON_THE_MASK.map(row));
        page.push_str("\n## Gestures on other images\n");
        table(&mut page, ["gesture", "effect"], ON_OTHER_IMAGES.map(row));
        page.push_str(NUMBER_FIELDS);
        page.push_str(PANELS);
        table(&mut page, ["panel", "shows"], Pane::ALL.map(|pane| (pane.title().into(), content(pane).into())));
        page
    }

    /// With `UPDATE_DOCS` set the page is written.
    #[test]
    fn page_of_keys_is_up_to_date() {
        let (path, page) = (Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/keys.md"), page_of_keys());
        if std::env::var_os("UPDATE_DOCS").is_some() {
            std::fs::write(&path, &page).unwrap();
        }
        let found = std::fs::read_to_string(&path).unwrap();
        assert!(found == page, "docs/reference/keys.md is out of date: run this test with UPDATE_DOCS=1");
    }

    #[test]
    fn no_key_has_two_actions() {
        let mut all: Vec<KeyboardShortcut> = actions_with_keys().flat_map(|(_, shortcuts)| shortcuts).collect();
        let listed = all.len();
        all.sort_by_key(|shortcut| shortcut.format(&ModifierNames::NAMES, false));
        all.dedup();
        assert_eq!(all.len(), listed);
    }
}
