//! Work by keyboard alone.

use egui::{Key, Modifiers, Role};
use egui_kittest::kittest::Queryable;
use lenslet_studio::forward::Design;

use super::home::type_and_enter;
use super::{Window, click, lenslets, menu, open, settle, studio};

#[test]
fn palette_works_by_keyboard_alone() {
    let mut window = open(Design::default());
    window.key_press_modifiers(Modifiers::COMMAND, Key::K);
    type_and_enter(&mut window, "4 heur");
    assert_eq!(lenslets(&window).len(), 4);
    window.key_press_modifiers(Modifiers::COMMAND | Modifiers::SHIFT, Key::P);
    type_and_enter(&mut window, "undo");
    assert_eq!(lenslets(&window).len(), 9);
    // A mask can be edited and a run started without a mouse.
    for (text, count) in [("add a lens", 10), ("delete sel", 9)] {
        window.key_press_modifiers(Modifiers::COMMAND, Key::K);
        type_and_enter(&mut window, text);
        assert_eq!(lenslets(&window).len(), count, "{text}");
    }
    window.key_press_modifiers(Modifiers::COMMAND, Key::K);
    type_and_enter(&mut window, "start a run");
    assert!(studio(&window).session().run().is_some());
    window.key_press_modifiers(Modifiers::COMMAND, Key::K);
    type_and_enter(&mut window, "stop the run");
    // The arrows choose, and Escape changes nothing.
    window.key_press_modifiers(Modifiers::COMMAND, Key::K);
    window.run_steps(2);
    window.get_by_label("Find an action").type_text("mask: diffuser");
    window.run_steps(2);
    window.key_press(Key::ArrowDown);
    window.run_steps(2);
    window.key_press(Key::Enter);
    settle(&mut window);
    assert!(studio(&window).session().design().encoder.describe().contains("28 px"));
    window.key_press_modifiers(Modifiers::COMMAND, Key::K);
    window.run_steps(2);
    window.get_by_label("Find an action").type_text("no such thing");
    window.run_steps(2);
    window.get_by_label("No action has this name.");
    window.key_press(Key::Escape);
    window.run_steps(4);
    assert!(window.query_by_label("Find an action").is_none());
}

#[test]
fn design_is_exported_by_keyboard_alone() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    window.key_press_modifiers(Modifiers::COMMAND, Key::E);
    window.run_steps(4);
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.event(egui::Event::Text(folder.path().join("out").display().to_string()));
    window.run_steps(2);
    window.key_press(Key::Enter);
    settle(&mut window);
    assert!(folder.path().join("out/psf.npy").is_file() && folder.path().join("out/design.json").is_file());
}

#[test]
fn keys_do_not_reach_mask_behind_dialog() {
    let mut window = open(Design::default());
    let before = lenslets(&window);
    window.get_by_label("Lenslet 1").click();
    window.run_steps(4);
    for key in [Key::F1, Key::Delete, Key::ArrowRight] {
        window.key_press(key);
        window.run_steps(4);
    }
    assert_eq!(lenslets(&window), before);
    window.key_press(Key::Escape);
    window.run_steps(4);
    window.get_by_label("Lenslet 1").focus();
    window.run_steps(2);
    window.key_press(Key::Delete);
    window.run_steps(4);
    assert_eq!(lenslets(&window), before[1..]);
    // The mask need not be visible.
    window.hover_at(window.get_by_role_and_label(Role::Image, "Object").rect().center());
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::M);
    window.run_steps(4);
    assert!(window.query_by_label("Lenslet 1").is_none());
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.run_steps(2);
    menu(&mut window, &["View", "Panel", "Show Lenslets"]);
    click(&mut window, "Select lenslet 1");
    window.key_press(Key::Backspace);
    window.run_steps(4);
    assert_eq!(lenslets(&window), before[2..]);
}

#[test]
fn text_field_undoes_its_own_text() {
    let mut window = open(Design::default());
    click(&mut window, "Add lenslet");
    window.key_press_modifiers(Modifiers::COMMAND, Key::D);
    window.run_steps(8);
    let name = |window: &Window| window.get_by_label("Name of snapshot 1").value().unwrap_or_default();
    window.get_by_label("Name of snapshot 1").focus();
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.event(egui::Event::Text("Mine".into()));
    window.run_steps(4);
    assert_eq!(name(&window), "Mine");
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    window.run_steps(4);
    assert_ne!(name(&window), "Mine");
    assert_eq!(lenslets(&window).len(), 10, "the mask is as it was");
}
