//! Designs side by side.

use egui::{Key, Modifiers};
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::Design;
use lenslet_studio::objects::ObjectSource;

use super::home::at_home;
use super::{Window, answer, click, lenslets, menu, open, settle, studio, turn};

#[test]
fn approximations_are_not_called_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    let is_bound = |window: &Window| studio(window).session().live().information.unwrap().value.gaussian_is_bound;
    settle(&mut window);
    assert!(is_bound(&window), "beads are the same everywhere");
    // Images of the size of the field are whole objects.
    let whole = folder.path().join("whole.npy");
    let pixels = ndarray::Array3::from_shape_fn((12, 96, 96), |(n, r, c)| ((n * 7 + r * c) % 101) as f32);
    lenslet_studio::formats::write_array(&whole, pixels.view()).unwrap();
    click(&mut window, "Open objects...");
    answer(&mut window, &whole, "Open");
    assert!(!is_bound(&window));
    menu(&mut window, &["View", "Panel", "Show Compare"]);
    click(&mut window, "Take snapshot");
    settle(&mut window);
    let gaussian = studio(&window).session().live().information.unwrap().value.gaussian.bits_per_pixel;
    let text = format!("\u{2248} {gaussian:.3}");
    assert_eq!(window.query_all_by_label_contains(&text).count(), 2, "in the table and as the headline");
    let file = folder.path().join("designs.csv");
    click(&mut window, "Export comparison as CSV");
    answer(&mut window, &file, "Export");
    let text = std::fs::read_to_string(&file).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let value = |name: &str| rows[1][rows[0].iter().position(|known| *known == name).unwrap()];
    assert_eq!((value("gaussian_is_bound"), value("upper_bound_bits_per_pixel")), ("0.0", "NaN"));
}

#[test]
fn snapshots_are_compared_exported_and_opened() {
    let mut window = open(Design::default());
    menu(&mut window, &["View", "Panel", "Show Compare"]);
    window.get_by_label("Take snapshots to compare designs here.");
    click(&mut window, "Take snapshot");
    menu(&mut window, &["Presets", "Heuristic lenslets", "4 lenslets"]);
    window.key_press_modifiers(Modifiers::COMMAND, Key::D);
    settle(&mut window);
    // Both have their numbers: the bound of nine and of four lenslets, and the entropy of the objects.
    let bound = studio(&window).session().live().information.unwrap().value.ceiling_bits().unwrap();
    assert_eq!(window.query_all_by_label(&format!("\u{2264} {bound:.3}")).count(), 2, "here and as the headline");
    window.get_by_label("\u{2264} 0.442");
    // The first two are A and B. The image flips between them and shows their difference.
    window.get_by_label("Comparison");
    click(&mut window, "Flip");
    window.get_by_label("Comparison");
    click(&mut window, "Show difference");
    window.get_by_label("Difference");
    for what in ["Compare Measurement", "Compare MTF", "Compare PSF"] {
        click(&mut window, what);
        window.get_by_label("Difference");
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("designs.csv");
    click(&mut window, "Export comparison as CSV");
    answer(&mut window, &file, "Export");
    let text = std::fs::read_to_string(&file).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].starts_with("name,lenslets,") && lines[0].ends_with(",sensor_tamura,scene"), "{text}");
    assert!(lines[1].starts_with("Design 1,9.0,") && lines[2].starts_with("Design 2,4.0,"), "{text}");
    // Opening is one step, which can be undone.
    menu(&mut window, &["More of snapshot 1", "Open"]);
    assert_eq!(lenslets(&window).len(), 9);
    assert_eq!(studio(&window).session().undoes(), Some("Open Design 1"));
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    settle(&mut window);
    assert_eq!(lenslets(&window).len(), 4);
    menu(&mut window, &["More of snapshot 1", "Delete"]);
    window.get_by_label("Choose A and B to compare their images.");
    assert!(window.query_by_label("More of snapshot 1").is_none());
    click(&mut window, "Restore snapshot");
    window.get_by_label("More of snapshot 1");
    assert!(window.query_by_label("Restore snapshot").is_none());
    menu(&mut window, &["More of snapshot 1", "Delete"]);
    window.get_by_label("More of snapshot 2");
    // Numbers of another scene are marked as such.
    assert!(window.query_by_label("b").is_none());
    click(&mut window, "Scene");
    click(&mut window, "New");
    settle(&mut window);
    menu(&mut window, &["View", "Panel", "Show Compare"]);
    click(&mut window, "Take snapshot");
    window.get_by_label("a");
    window.get_by_label("b");
}

#[test]
fn failed_measurement_is_repeated_when_chosen_again() {
    let folder = tempfile::tempdir().unwrap();
    let objects = folder.path().join("objects.npy");
    let design = Design { objects: ObjectSource::Stack(objects.clone()), ..Design::default() };
    let kept = serde_json::json!({ "name": "Of a disk that is not there", "design": design });
    std::fs::create_dir(folder.path().join("kept")).unwrap();
    std::fs::write(folder.path().join("kept/1.json"), kept.to_string()).unwrap();
    let mut window = at_home(folder.path());
    window.key_press_modifiers(Modifiers::COMMAND, Key::D);
    settle(&mut window);
    for name in ["A is snapshot 1", "B is snapshot 2", "Compare Measurement"] {
        click(&mut window, name);
    }
    settle(&mut window);
    assert!(window.query_by_label("Comparison").is_none() && window.query_by_label("Simulating").is_none());
    let pixels = ndarray::Array3::from_shape_fn((12, 96, 96), |(n, r, c)| ((n * 7 + r * c) % 101) as f32);
    lenslet_studio::formats::write_array(&objects, pixels.view()).unwrap();
    click(&mut window, "Compare Measurement");
    settle(&mut window);
    window.get_by_label("Comparison");
}

#[test]
fn hidden_rows_are_skipped_until_scrolled_to() {
    let mut window = open(Design::default());
    menu(&mut window, &["View", "Panel", "Show Compare"]);
    for _ in 0..60 {
        window.key_press_modifiers(Modifiers::COMMAND, Key::D);
        window.step();
    }
    window.run_steps(3);
    let numbers = |window: &Window| -> Vec<u64> {
        let names = window.query_all_by_label_contains("Name of snapshot ");
        let number = |label: String| label.trim_start_matches("Name of snapshot ").parse().unwrap();
        names.filter_map(|node| node.accesskit_node().label()).map(number).collect()
    };
    let first = numbers(&window);
    assert!(first.len() < 40 && first.windows(2).all(|pair| pair[0] + 1 == pair[1]), "{first:?}");
    let place = window.get_by_label(&format!("Name of snapshot {}", first[1])).rect().center();
    turn(&mut window, place, -40.0, Modifiers::NONE);
    window.run_steps(30);
    let later = numbers(&window);
    assert!(!later.contains(&first[0]) && later.last() > first.last(), "{later:?}");
}
