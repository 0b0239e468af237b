//! Data that outlive the window, and navigation in the window.

use std::path::Path;

use egui::{Key, Modifiers, Role, Theme, Vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::Design;

use super::waiting::{collect_frame_requests, wait_for};
use super::{Window, answer, click, close, lenslets, menu, open, open_sized, open_window, settle, studio, type_number};

/// A window with application data in a folder, not for the first time.
pub fn at_home(folder: &Path) -> Window {
    at_home_sized(folder, Vec2::new(1280.0, 800.0))
}

pub fn at_home_sized(folder: &Path, size: Vec2) -> Window {
    keep_data_of(open_sized(Design::default(), size), folder)
}

/// The window with application data in a folder, not for the first time.
pub fn keep_data_of(window: Window, folder: &Path) -> Window {
    let preferences = folder.join("preferences.json");
    if !preferences.exists() {
        std::fs::write(preferences, "{\"welcomed\": true}").unwrap();
    }
    keep_data(window, folder)
}

fn first_at_home(folder: &Path) -> Window {
    keep_data(open(Design::default()), folder)
}

fn keep_data(mut window: Window, folder: &Path) -> Window {
    let ctx = window.ctx.clone();
    window.state_mut().as_mut().unwrap().keep_data_in(&ctx, folder);
    window.state_mut().as_mut().unwrap().set_live(false);
    window.run_steps(4);
    window
}

/// Presses a key and finds an entry in the dialog that it opens.
fn is_in_reach(window: &mut Window, modifiers: Modifiers, key: Key, name: &str) {
    window.key_press_modifiers(modifiers, key);
    window.run_steps(4);
    let (seen, place) = (window.ctx.content_rect(), window.get_by_label(name).rect());
    assert!(seen.contains_rect(place), "{name}: {place:?} in {seen:?}");
    window.key_press(Key::Escape);
    window.run_steps(4);
}

#[test]
fn dialogs_fit_a_small_window() {
    let mut window = open_sized(Design::default(), Vec2::new(640.0, 360.0));
    is_in_reach(&mut window, Modifiers::NONE, Key::F1, "Close");
    is_in_reach(&mut window, Modifiers::COMMAND, Key::Comma, "Close");
    is_in_reach(&mut window, Modifiers::COMMAND, Key::K, "Find an action");
    // Both columns of keys and gestures, in a window that just fits them.
    let mut wide = open_sized(Design::default(), Vec2::new(905.0, 640.0));
    is_in_reach(
        &mut wide,
        Modifiers::NONE,
        Key::F1,
        "Select a lenslet; with Shift, add it to the selection or take it out",
    );
    // Lower entries are scrolled to.
    window.key_press(Key::F1);
    window.run_steps(4);
    let last = |window: &Window| window.get_by_label("Menu: show all, copy value, export image").rect();
    assert!(last(&window).top() > 360.0);
    window.get_by_label("Menu: show all, copy value, export image").scroll_to_me();
    window.run_steps(40);
    assert!(window.ctx.content_rect().contains_rect(last(&window)), "{:?}", last(&window));
}

pub fn type_and_enter(window: &mut Window, text: &str) {
    window.run_steps(2);
    window.get_by_label("Find an action").type_text(text);
    window.run_steps(2);
    window.key_press(Key::Enter);
    settle(window);
}

/// The data that a power cut would leave: a copy of unsaved changes in their current state, in a folder of its own.
pub fn after_a_power_cut(folder: &Path) -> tempfile::TempDir {
    let later = tempfile::tempdir().unwrap();
    std::fs::create_dir(later.path().join("unsaved")).unwrap();
    for file in std::fs::read_dir(folder.join("unsaved")).unwrap() {
        let file = file.unwrap().path();
        std::fs::copy(&file, later.path().join("unsaved").join(file.file_name().unwrap())).unwrap();
    }
    later
}

fn kept(folder: &Path) -> usize {
    let files = std::fs::read_dir(folder.join("unsaved")).unwrap();
    files.filter(|file| file.as_ref().unwrap().path().extension().is_some_and(|ending| ending == "json")).count()
}

#[test]
fn unsaved_changes_survive_a_crash_and_are_offered() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    assert!(window.query_by_label("Recover").is_none());
    menu(&mut window, &["Presets", "Heuristic lenslets", "3 lenslets"]);
    wait_for(&mut window, "the autosave", |_| kept(folder.path()) == 1);
    let later = after_a_power_cut(folder.path());
    close(&mut window);
    click(&mut window, "Discard");
    drop(window);
    assert_eq!(kept(folder.path()), 0, "a window that was closed leaves nothing behind");

    // The welcome dialog does not cover the recovered design.
    let mut window = first_at_home(later.path());
    assert_eq!(lenslets(&window).len(), 9);
    window.get_by_label_contains("3 lenslets, beads:0.02");
    click(&mut window, "Recover");
    settle(&mut window);
    assert!(window.query_by_label("Welcome to Lenslet Studio").is_none());
    assert_eq!(lenslets(&window).len(), 3);
    assert!(studio(&window).session().is_dirty());
    // It is autosaved again at once, until it is saved.
    wait_for(&mut window, "the autosave", |_| kept(later.path()) == 1);
    menu(&mut window, &["File", "Save design as..."]);
    answer(&mut window, &later.path().join("mine.json"), "Save");
    wait_for(&mut window, "the removal of the autosave", |_| kept(later.path()) == 0);

    // It is among the recent designs of the next window.
    drop(window);
    let mut window = at_home(later.path());
    assert!(window.query_by_label("Recover").is_none());
    menu(&mut window, &["File", "Open recent", "mine.json"]);
    assert_eq!(lenslets(&window).len(), 3);
    menu(&mut window, &["File", "Open recent", "Clear list"]);
    window.run_steps(4);
    drop(window);
    let window = at_home(later.path());
    assert_eq!(lenslets(&window).len(), 9);
}

#[test]
fn undecided_recoveries_are_offered_again() {
    let folder = tempfile::tempdir().unwrap();
    let unsaved = folder.path().join("unsaved");
    std::fs::create_dir(&unsaved).unwrap();
    let design = serde_json::to_value(Design { seed: 5, ..Design::default() }).unwrap();
    let file = serde_json::json!({"design": design, "path": null, "seconds": 1_000_000_000});
    std::fs::write(unsaved.join("1-1.json"), file.to_string()).unwrap();
    let mut window = at_home(folder.path());
    click(&mut window, "Later");
    assert!(window.query_by_label("Recover").is_none());
    drop(window);
    let mut window = at_home(folder.path());
    click(&mut window, "Discard");
    assert_eq!((kept(folder.path()), studio(&window).session().design().seed), (0, 1));
}

#[test]
fn missing_chosen_folder_falls_back_to_default() {
    let folder = tempfile::tempdir().unwrap();
    let (file, preferences) = (folder.path().join("file"), folder.path().join("preferences.json"));
    std::fs::write(&file, b"").unwrap();
    let text = serde_json::json!({"welcomed": true, "unsaved": file.join("not a folder")}).to_string();
    std::fs::write(preferences, text).unwrap();
    let mut window = at_home(folder.path());
    assert!(window.query_all_by_label_contains("not a folder").next().is_some(), "the failure names the folder");
    click(&mut window, "Add lenslet");
    wait_for(&mut window, "the autosave", |_| kept(folder.path()) == 1);
}

#[test]
fn changes_in_default_folder_are_offered_with_chosen_folder() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let leave = |unsaved: &Path, seed: u64, seconds: u64| {
        std::fs::create_dir_all(unsaved).unwrap();
        let design = Design { seed, ..Design::default() };
        let file = serde_json::json!({"design": design, "path": null, "seconds": seconds});
        std::fs::write(unsaved.join("1-1.json"), file.to_string()).unwrap();
    };
    leave(elsewhere.path(), 5, 1_000_000_000);
    leave(&folder.path().join("unsaved"), 6, 1_000_000_001);
    let text = serde_json::json!({"welcomed": true, "unsaved": elsewhere.path()}).to_string();
    std::fs::write(folder.path().join("preferences.json"), text).unwrap();
    let mut window = at_home(folder.path());
    window.get_by_label("1 more after this one");
    click(&mut window, "Recover");
    settle(&mut window);
    assert_eq!(studio(&window).session().design().seed, 6, "the newest first");
    // It is autosaved in the chosen folder afterwards.
    wait_for(&mut window, "the removal of the autosave", |_| kept(folder.path()) == 0);
    let files = std::fs::read_dir(elsewhere.path()).unwrap().map(|file| file.unwrap().path());
    assert_eq!(files.filter(|file| file.extension().is_some_and(|ending| ending == "json")).count(), 2);
}

#[test]
fn autosave_stays_until_new_folder_has_it() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut window = at_home(folder.path());
    click(&mut window, "Add lenslet");
    wait_for(&mut window, "the autosave", |_| kept(folder.path()) == 1);
    window.key_press_modifiers(Modifiers::COMMAND, Key::Comma);
    window.run_steps(3);
    click(&mut window, "Choose folder...");
    answer(&mut window, elsewhere.path(), "Use");
    let there = |folder: &Path| {
        let files = std::fs::read_dir(folder).unwrap().filter_map(|file| Some(file.ok()?.path()));
        files.filter(|file| file.extension().is_some_and(|ending| ending == "json")).count()
    };
    wait_for(&mut window, "the autosave", |_| there(elsewhere.path()) == 1);
    wait_for(&mut window, "the removal of the autosave", |_| kept(folder.path()) == 0);
    close(&mut window);
    click(&mut window, "Discard");
    drop(window);
    assert_eq!((kept(folder.path()), there(elsewhere.path())), (0, 0));
}

#[test]
fn theme_and_layout_are_restored_and_reset() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    menu(&mut window, &["View", "Theme", "Light"]);
    menu(&mut window, &["View", "Panel", "Show MTF"]);
    window.get_by_label("Export MTF as CSV");
    drop(window);
    let preferences = std::fs::read_to_string(folder.path().join("preferences.json")).unwrap();
    assert!(preferences.contains("\"Light\""), "{preferences}");
    let layout = std::fs::read_to_string(folder.path().join("layout.json")).unwrap();
    assert!(layout.contains("\"Optimize\""), "{layout}");
    std::fs::write(folder.path().join("layout.json"), "{").unwrap();
    let mut window = at_home(folder.path());
    assert!(window.query_by_label("Recover").is_none());
    assert_eq!(window.ctx.options(|options| options.theme_preference), egui::ThemePreference::Light);
    // A damaged layout is replaced by the default one.
    assert!(window.query_by_label("Export MTF as CSV").is_none());
    menu(&mut window, &["View", "Panel", "Show MTF"]);
    window.get_by_label("Export MTF as CSV");
    menu(&mut window, &["View", "Layout", "Reset layout"]);
    assert!(window.query_by_label("Export MTF as CSV").is_none());
}

#[test]
fn interface_zoom_is_set_and_stored() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    let percent = |window: &Window| (100.0 * window.ctx.zoom_factor()).round();
    let press = |window: &mut Window, key: Key| {
        window.key_press_modifiers(Modifiers::COMMAND, key);
        window.run_steps(4);
    };
    for (key, size) in [
        (Key::Plus, 110.0),
        (Key::Equals, 120.0),
        (Key::Minus, 110.0),
        (Key::Num0, 100.0),
        (Key::Minus, 90.0),
        (Key::Minus, 80.0),
    ] {
        press(&mut window, key);
        assert_eq!(percent(&window), size, "{key:?}");
    }
    drop(window);
    let mut window = at_home(folder.path());
    assert_eq!(percent(&window), 80.0);
    // The settings show the same number and can change it.
    press(&mut window, Key::Comma);
    let slider = window.get_by_role_and_label(Role::Slider, "Zoom");
    assert_eq!(slider.accesskit_node().numeric_value().map(|size| (100.0 * size).round()), Some(80.0));
    slider.focus();
    window.run_steps(2);
    window.key_press(Key::ArrowRight);
    window.run_steps(4);
    assert_eq!(percent(&window), 90.0);
    for typed in ["120", "130 %"] {
        type_number(&mut window, "Zoom in per cent", typed);
        assert!(typed.starts_with(&percent(&window).to_string()), "{typed}: {}", percent(&window));
    }
    window.key_press(Key::Escape);
    window.run_steps(4);
    // The keys stop at the range that the next window accepts.
    for (key, times, size) in [(Key::Minus, 12, 50.0), (Key::Plus, 40, 400.0)] {
        for _ in 0..times {
            press(&mut window, key);
        }
        assert_eq!(percent(&window), size, "{key:?}");
    }
    drop(window);
    assert_eq!(percent(&at_home(folder.path())), 400.0);
}

#[test]
fn first_window_offers_samples_and_tour() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = first_at_home(folder.path());
    window.get_by_label("Welcome to Lenslet Studio");
    click(&mut window, "Designed mask");
    settle(&mut window);
    assert_eq!(lenslets(&window).len(), 5);
    assert!(!studio(&window).session().is_dirty());
    drop(window);
    let mut window = first_at_home(folder.path());
    assert!(window.query_by_label("Welcome to Lenslet Studio").is_none());
    menu(&mut window, &["Help", "Take the tour"]);
    window.get_by_label("1. Move a lenslet");
    window.get_by_label("Try it");
    menu(&mut window, &["Presets", "Heuristic lenslets", "2 lenslets"]);
    window.get_by_label("Done");
    for (title, room) in [
        ("2. Read the information", "Information"),
        ("3. Compare designs", "Take snapshot"),
        ("4. Optimize the mask", "Start run"),
    ] {
        click(&mut window, "Next");
        window.get_by_label(title);
        assert!(window.query_all_by_label(room).count() > 0, "the panel of {title}");
    }
    click(&mut window, "Back");
    window.get_by_label("3. Compare designs");
    click(&mut window, "Next");
    click(&mut window, "Next");
    click(&mut window, "Finish");
    assert!(window.query_by_label("End tour").is_none());
    menu(&mut window, &["Help", "Welcome and samples..."]);
    click(&mut window, "Diffuser");
    assert!(window.query_by_label("Save your changes?").is_some(), "what was changed is not lost");
}

#[test]
fn settings_are_stored() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = at_home(folder.path());
    window.key_press_modifiers(Modifiers::COMMAND, Key::Comma);
    window.run_steps(4);
    click(&mut window, "Dark");
    click(&mut window, "wgpu");
    click(&mut window, "Estimate while the design is edited");
    assert!(studio(&window).session().is_live());
    window.get_by_label("Zoom");
    click(&mut window, "Close");
    drop(window);
    let text = std::fs::read_to_string(folder.path().join("preferences.json")).unwrap();
    for entry in ["\"Dark\"", "\"wgpu\"", "\"live\": true"] {
        assert!(text.contains(entry), "{entry} in {text}");
    }
}

#[test]
fn dialogs_list_keys_and_versions() {
    let mut window = open(Design::default());
    window.key_press(Key::F1);
    window.run_steps(4);
    let listed = |window: &Window| window.query_all_by_label("Double click").count();
    assert!(listed(&window) > 0);
    click(&mut window, "Close");
    assert_eq!(listed(&window), 0);
    menu(&mut window, &["Help", "About Lenslet Studio"]);
    window.get_by_label(env!("CARGO_PKG_VERSION"));
    click(&mut window, "Close");
}

#[test]
fn full_disk_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    // A file in place of the folder represents a place that is not writable.
    let place = folder.path().join("place");
    std::fs::write(&place, b"").unwrap();
    let mut window = open_window(Design::default(), Vec2::new(1280.0, 800.0), Theme::Dark, false);
    let ctx = window.ctx.clone();
    window.state_mut().as_mut().unwrap().keep_data_in(&ctx, &place);
    window.run_steps(4);
    window.get_by_label("Dismiss");
    // One sentence suffices, without advice on folders.
    menu(&mut window, &["View", "Messages"]);
    let count = |text: &str| window.query_all_by_label_contains(text).count();
    assert!(count("Nothing is saved when the window closes: ") >= 1);
    assert_eq!((count("make the folder"), count("choose another")), (0, 0));
    menu(&mut window, &["Presets", "Heuristic lenslets", "2 lenslets"]);
    assert_eq!(lenslets(&window).len(), 2);
}

#[test]
fn design_of_command_line_is_recent() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("named.json");
    Design::default().save(&path).unwrap();
    let home = folder.path().join("home");
    let (file, place) = (path.clone(), home.clone());
    let builder = egui_kittest::Harness::builder().with_size(Vec2::new(1280.0, 800.0)).with_max_steps(64);
    let mut window: Window = builder.build_ui_state(
        move |ui, studio: &mut Option<lenslet_studio::studio::Studio>| {
            let studio = studio.get_or_insert_with(|| {
                collect_frame_requests(ui.ctx());
                let design = Design::open(&file).unwrap();
                let mut studio = lenslet_studio::studio::Studio::new(ui.ctx(), design, Some(file.clone())).unwrap();
                studio.keep_data_in(ui.ctx(), &place);
                studio.set_live(false);
                studio
            });
            studio.logic(&ui.ctx().clone());
            studio.ui(ui);
        },
        None,
    );
    settle(&mut window);
    click(&mut window, "File");
    click(&mut window, "Open recent");
    window.get_by_label("named.json");
    drop(window);
    let text = std::fs::read_to_string(home.join("lenslet-studio").join("preferences.json"))
        .or_else(|_| std::fs::read_to_string(home.join("preferences.json")));
    assert!(text.unwrap().contains("named.json"), "it is remembered");
}
