//! Editing the mask by pointer and keys.

use egui::accesskit::Role;
use egui::{Key, Modifiers, PointerButton, Vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::Design;
use lenslet_studio::objects::ObjectSource;
use lenslet_studio::optics::{Encoder, Lenslet, heuristic_layout};
use lenslet_studio::sensor::Noise;

use super::runs::{TALL, shorten_run};
use super::waiting::wait_for;
use super::{Window, click, drag, lenslets, menu, open, open_sized, settle, studio, turn, type_number};

#[test]
fn numbers_follow_dragged_lenslet() {
    let mut window = open(Design::default());
    let before = studio(&window).session().live();
    let start = lenslets(&window);
    let from = window.get_by_label("Lenslet 1").rect().center();
    drag(&mut window, from, Vec2::new(40.0, -24.0), PointerButton::Primary);
    settle(&mut window);

    let moved = lenslets(&window);
    assert!(moved[0].x > start[0].x + 1.0 && moved[0].y < start[0].y - 0.5, "{:?} {:?}", start[0], moved[0]);
    assert_eq!(moved[1..], start[1..], "only the dragged lenslet moves");
    let after = studio(&window).session().live();
    assert_ne!(after.optics.unwrap().value.psf, before.optics.unwrap().value.psf);
    assert_ne!(after.measurements.unwrap().value.noisy, before.measurements.unwrap().value.noisy);
    let (after, before) = (after.information.unwrap().value, before.information.unwrap().value);
    assert_ne!(after.gaussian.bits_per_pixel, before.gaussian.bits_per_pixel);
    assert!(studio(&window).session().is_dirty());
}

#[test]
fn fast_drag_moves_pressed_lenslet() {
    let mut window = open(Design::default());
    let start = lenslets(&window);
    let from = window.get_by_label("Lenslet 1").rect().center();
    window.hover_at(from);
    window.step();
    let to = from + Vec2::new(40.0, -24.0);
    let press = |pressed, pos| {
        let (button, modifiers) = (egui::PointerButton::Primary, Modifiers::NONE);
        egui::Event::PointerButton { pos, button, pressed, modifiers }
    };
    // All events of a slow frame at once.
    window.input_mut().events.extend([press(true, from), egui::Event::PointerMoved(to)]);
    window.step();
    window.step();
    window.input_mut().events.push(press(false, to));
    settle(&mut window);
    let moved = lenslets(&window);
    assert!(moved[0].x > start[0].x + 1.0 && moved[0].y < start[0].y - 0.5, "{:?} {:?}", start[0], moved[0]);
    assert_eq!(moved[1..], start[1..]);
}

#[test]
fn drag_of_two_points_is_a_click() {
    let mut window = open(Design::default());
    let start = lenslets(&window);
    let from = window.get_by_label("Lenslet 3").rect().center();
    drag(&mut window, from, Vec2::new(2.0, 0.0), PointerButton::Primary);
    settle(&mut window);
    assert_eq!(lenslets(&window), start);
    window.get_by_label("1 selected");
}

#[test]
fn drag_of_four_points_moves_and_trembling_does_not() {
    let mut window = open(Design::default());
    let start = lenslets(&window);
    let from = window.get_by_label("Lenslet 3").rect().center();
    let press = |pressed| {
        let (button, modifiers) = (PointerButton::Primary, Modifiers::NONE);
        egui::Event::PointerButton { pos: from, button, pressed, modifiers }
    };
    window.hover_at(from);
    window.step();
    window.input_mut().events.push(press(true));
    // Longer than any click.
    for step in 0..90 {
        window.hover_at(from + Vec2::new((step % 2) as f32, 0.0));
        window.step();
    }
    window.input_mut().events.push(press(false));
    settle(&mut window);
    assert_eq!((lenslets(&window), studio(&window).session().undoes()), (start.clone(), None));
    drag(&mut window, from, Vec2::new(4.0, 0.0), PointerButton::Primary);
    settle(&mut window);
    assert!(lenslets(&window)[2].x > start[2].x);
}

#[test]
fn lenslets_are_added_nudged_and_deleted() {
    let mut window = open(Design::default());
    click(&mut window, "Add lenslet");
    settle(&mut window);
    assert_eq!(lenslets(&window).len(), 10);

    // The new lenslet is selected: the arrow keys move it, with Shift ten times as far.
    let before = lenslets(&window)[9];
    window.get_by_label("Lenslet 10").focus();
    window.run_steps(2);
    window.key_press(Key::ArrowRight);
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::SHIFT, Key::ArrowDown);
    settle(&mut window);
    let after = lenslets(&window)[9];
    assert!((after.x - before.x - 0.1).abs() < 1e-9, "{before:?} {after:?}");
    assert!((after.y - before.y - 1.0).abs() < 1e-9, "{before:?} {after:?}");

    window.key_press(Key::Delete);
    settle(&mut window);
    assert_eq!(lenslets(&window).len(), 9);
}

#[test]
fn double_click_adds_lenslet_at_pointer() {
    let mut window = open(Design::default());
    let place = window.get_by_label("PSF").rect().left_top() + Vec2::new(45.0, 60.0);
    for _ in 0..2 {
        window.hover_at(place);
        window.drag_at(place);
        window.drop_at(place);
        window.step();
    }
    settle(&mut window);
    let added = lenslets(&window);
    assert_eq!(added.len(), 10);
    let handle = window.get_by_label("Lenslet 10").rect().center();
    assert!((handle - place).length() < 1.5, "{handle:?} {place:?}");
}

#[test]
fn shift_click_toggles_selection_and_space_keeps_it() {
    let mut window = open(Design::default());
    let shift_click = |window: &mut Window, name: &str| {
        window.get_by_label(name).click_modifiers(Modifiers::SHIFT);
        window.run_steps(3);
    };
    click(&mut window, "Lenslet 1");
    for name in ["Lenslet 2", "Lenslet 3"] {
        shift_click(&mut window, name);
    }
    window.get_by_label("3 selected");
    shift_click(&mut window, "Lenslet 2");
    window.get_by_label("2 selected");
    shift_click(&mut window, "Lenslet 2");
    window.get_by_label("3 selected");
    // The last one has the keyboard focus.
    window.key_press(Key::Space);
    window.run_steps(3);
    window.get_by_label("3 selected");
    click(&mut window, "Lenslet 1");
    window.get_by_label("1 selected");
}

#[test]
fn right_button_neither_moves_nor_selects() {
    let mut window = open(Design::default());
    let start = lenslets(&window);
    let image = window.get_by_label("PSF").rect();
    drag(&mut window, image.left_top() + Vec2::splat(3.0), image.size() - Vec2::splat(7.0), PointerButton::Secondary);
    let from = window.get_by_label("Lenslet 5").rect().center();
    drag(&mut window, from, Vec2::new(40.0, -24.0), PointerButton::Secondary);
    settle(&mut window);
    assert_eq!(lenslets(&window), start);
    window.get_by_label_contains("Double-click adds a lenslet");
}

#[test]
fn box_selection_moves_together() {
    let mut window = open(Design::default());
    let image = window.get_by_label("PSF").rect();
    drag(&mut window, image.left_top() + Vec2::splat(3.0), image.size() - Vec2::splat(7.0), PointerButton::Primary);
    window.get_by_label("9 selected");
    let before = lenslets(&window);
    let from = window.get_by_label("Lenslet 2").rect().center();
    drag(&mut window, from, Vec2::new(24.0, 0.0), PointerButton::Primary);
    settle(&mut window);
    let shifts: Vec<f64> = lenslets(&window).iter().zip(&before).map(|(after, before)| after.x - before.x).collect();
    assert!(shifts[0] > 0.5, "{shifts:?}");
    assert!(shifts.iter().all(|shift| (shift - shifts[0]).abs() < 1e-9), "{shifts:?}");
}

#[test]
fn table_takes_typed_numbers() {
    let mut window = open(Design::default());
    for (field, text) in [("Lenslet 2 x", "12.25"), ("Lenslet 2 width", "1.5"), ("Lenslet 2 weight", "0.5")] {
        type_number(&mut window, field, text);
        settle(&mut window);
    }
    let changed = lenslets(&window)[1];
    assert_eq!((changed.x, changed.spot.mean_sigma(), changed.weight), (12.25, 1.5, 0.5));
}

#[test]
fn unchanged_numbers_keep_all_decimals() {
    let mut array = heuristic_layout(3);
    for (index, lenslet) in array.lenslets.iter_mut().enumerate() {
        let part = index as f64 / 7.0;
        *lenslet = Lenslet::round(16.234_57 - 3.0 * part, 12.345_67 + part, 1.234_567 + part, 0.123_456_789 + part);
    }
    let design = Design {
        encoder: Encoder::Lenslets(array),
        objects: ObjectSource::Beads { density: 0.012_345_678 },
        mean_photons: 123.456_789,
        bias_photons: 4.567_89,
        noise: Noise::Read { sigma: 2.345_67 },
        ..Design::default()
    };
    let mut window = open(design.clone());
    let tab_on = |window: &mut Window, fields: usize| {
        for _ in 0..fields {
            window.run_steps(3);
            window.key_press(Key::Tab);
            window.run_steps(3);
        }
    };
    let is_as_it_was = |window: &Window| {
        let session = studio(window).session();
        assert_eq!((&**session.design(), session.undoes(), session.is_dirty()), (&design, None, false));
    };
    // Zoom in and out again, by the pointer and by keys.
    for field in ["Lenslet 1 x", "Lenslet 1 weight"] {
        window.get_by_label(field).click();
        window.run_steps(3);
        window.get_by_label("Select lenslet 1").click();
        window.run_steps(3);
        is_as_it_was(&window);
    }
    for field in ["Lenslet 1 x", "Bead density", "Mean photons", "Read noise sigma", "Background photons", "Seed"] {
        window.get_by_role_and_label(Role::SpinButton, field).focus();
        tab_on(&mut window, 5);
        is_as_it_was(&window);
    }
    // With several selected, a lenslet's field does not set its own number for all.
    click(&mut window, "Edit");
    click(&mut window, "Select all lenslets");
    window.get_by_label("3 selected");
    for field in ["Lenslet 2 width", "Lenslet 2 weight"] {
        window.get_by_label(field).focus();
        tab_on(&mut window, 2);
        is_as_it_was(&window);
    }
    // A typed or stepped number is committed.
    type_number(&mut window, "Lenslet 2 weight", "0.5");
    assert!(lenslets(&window).iter().all(|lenslet| lenslet.weight == 0.5));
    type_number(&mut window, "Lenslet 1 x", "16.2346");
    tab_on(&mut window, 1);
    assert_eq!(lenslets(&window)[0].x, 16.2346);
    window.get_by_label("Lenslet 1 x").focus();
    window.run_steps(3);
    window.key_press(Key::ArrowUp);
    tab_on(&mut window, 1);
    assert!((lenslets(&window)[0].x - 16.28).abs() < 1e-9, "{:?}", lenslets(&window)[0]);
}

#[test]
fn presets_replace_the_mask() {
    let mut window = open(Design::default());
    menu(&mut window, &["Presets", "Heuristic lenslets", "4 lenslets"]);
    assert_eq!(lenslets(&window).len(), 4);
    menu(&mut window, &["Presets", "25 random lenslets"]);
    let first = lenslets(&window);
    assert_eq!(first.len(), 25);
    menu(&mut window, &["Presets", "25 random lenslets"]);
    assert_ne!(lenslets(&window), first, "again draws others");
    menu(&mut window, &["Presets", "Diffuser", "Aperture 16 px"]);
    assert!(matches!(studio(&window).session().design().encoder, Encoder::Diffuser(_)));
    assert!(window.query_by_label("Lenslet 1").is_none(), "a diffuser has no handles");
}

#[test]
fn typed_throughput_dims_the_mask_in_one_undo_step() {
    let mut window = open(Design::default());
    let mean = |window: &Window| {
        studio(window).session().live().measurements.unwrap().value.noiseless.mapv(f64::from).mean().unwrap()
    };
    let throughput = |window: &Window| studio(window).session().design().encoder.throughput();
    let (whole, psf) = (mean(&window), studio(&window).session().live().optics.unwrap().value.psf.clone());
    type_number(&mut window, "Throughput", "0.25");
    settle(&mut window);
    assert_eq!(throughput(&window), 0.25);
    let background = Design::default().bias_photons;
    assert!((mean(&window) - background - 0.25 * (whole - background)).abs() < 1e-3 * whole);
    assert_eq!(studio(&window).session().live().optics.unwrap().value.psf, psf.mapv(|light| 0.25 * light));
    window.get_by_label("Times a throughput of 0.250 on the sensor");
    type_number(&mut window, "Throughput", "65");
    window.get_by_label_contains("between 0.000001 and 64");
    assert_eq!(throughput(&window), 0.25, "beyond the range nothing changes");
    menu(&mut window, &["Edit", "Undo set throughput to 0.25"]);
    settle(&mut window);
    assert_eq!((throughput(&window), mean(&window)), (1.0, whole));

    menu(&mut window, &["Presets", "Diffuser", "Aperture 16 px"]);
    let of_aperture = throughput(&window);
    assert!((0.1..0.6).contains(&of_aperture), "an aperture blocks light: {of_aperture}");
    type_number(&mut window, "Throughput", "1");
    assert_eq!(throughput(&window), 1.0, "the light is kept");
}

#[test]
fn typed_number_applies_to_selection() {
    let mut window = open(Design::default());
    click(&mut window, "Edit");
    click(&mut window, "Select all lenslets");
    type_number(&mut window, "Lenslet 4 width", "1.25");
    settle(&mut window);
    assert!(lenslets(&window).iter().all(|lenslet| lenslet.spot.mean_sigma() == 1.25));
}

#[test]
fn locked_lenslets_stay_locked_and_unmoved() {
    let mut window = open_sized(Design::default(), TALL);
    let is_locked = |window: &Window, number: usize| {
        let name = format!("Lock lenslet {number}");
        let node = window.get_by_label(&name);
        node.accesskit_node().toggled() == Some(egui::accesskit::Toggled::True)
    };
    click(&mut window, "Lock lenslet 3");
    assert!(is_locked(&window, 3) && !is_locked(&window, 2));
    let kept = lenslets(&window)[2];
    click(&mut window, "Select lenslet 1");
    click(&mut window, "Delete selected");
    settle(&mut window);
    assert!(is_locked(&window, 2) && !is_locked(&window, 3), "it is the second one now");
    shorten_run(&mut window, "16 px");
    click(&mut window, "Details");
    window.get_by_label("One locked lenslet stays as it is");
    click(&mut window, "Start run");
    wait_for(&mut window, "some steps", |window| studio(window).session().run().is_some_and(|run| run.step >= 2));
    let run = studio(&window).session().run().unwrap();
    assert_eq!(run.settings.locked, [1]);
    assert_eq!((run.array.lenslets[1].x, run.array.lenslets[1].y), (kept.x, kept.y));
    assert_ne!(run.array.lenslets[0].x, run.start.encoder.lenslets().unwrap().lenslets[0].x);
}

#[test]
fn undo_resets_selection_and_restores_locks() {
    let mut window = open(Design::default());
    let is_locked = |window: &Window| {
        let node = window.get_by_label("Lock lenslet 1");
        node.accesskit_node().toggled() == Some(egui::accesskit::Toggled::True)
    };
    let undo = |window: &mut Window| {
        window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
        settle(window);
    };
    for _ in 0..2 {
        menu(&mut window, &["Presets", "25 random lenslets"]);
    }
    click(&mut window, "Lenslet 1");
    click(&mut window, "Lock lenslet 1");
    window.key_press(Key::ArrowRight);
    settle(&mut window);
    // A moved lenslet keeps its identity.
    undo(&mut window);
    window.get_by_label("1 selected");
    assert!(is_locked(&window));
    undo(&mut window);
    assert_eq!(lenslets(&window).len(), 25);
    assert!(!is_locked(&window));
    window.get_by_label_contains("Double-click adds a lenslet");
    // A deleted lenslet returns to its old place in the list, and the others move on.
    click(&mut window, "Select lenslet 1");
    click(&mut window, "Delete selected");
    click(&mut window, "Select lenslet 1");
    let selected = lenslets(&window)[0];
    undo(&mut window);
    assert_eq!(lenslets(&window)[1], selected);
    window.get_by_label_contains("Double-click adds a lenslet");
}

#[test]
fn new_document_has_no_locks() {
    let mut window = open(Design::default());
    let is_locked = |window: &Window| {
        let node = window.get_by_label("Lock lenslet 3");
        node.accesskit_node().toggled() == Some(egui::accesskit::Toggled::True)
    };
    click(&mut window, "Lock lenslet 3");
    assert!(is_locked(&window));
    menu(&mut window, &["File", "New design"]);
    assert_eq!(lenslets(&window).len(), 9);
    assert!(!is_locked(&window));
}

#[test]
fn wheel_changes_weight_and_alt_wheel_width() {
    let mut window = open(Design::default());
    let turned = |window: &mut Window, modifiers: Modifiers| {
        let place = window.get_by_label("Lenslet 5").rect().center();
        turn(window, place, 1.0, modifiers);
        settle(window);
    };
    let before = lenslets(&window)[4];
    turned(&mut window, Modifiers::NONE);
    let heavier = lenslets(&window)[4];
    assert!(heavier.weight > 1.02 * before.weight && heavier.spot == before.spot, "{before:?} {heavier:?}");
    turned(&mut window, Modifiers::ALT);
    let wider = lenslets(&window)[4];
    assert!(wider.spot.mean_sigma() > 1.02 * before.spot.mean_sigma(), "{heavier:?} {wider:?}");
    assert_eq!(wider.weight, heavier.weight);
}

#[test]
fn deleting_a_dragged_lenslet_moves_no_other() {
    let mut window = open(Design::default());
    let mut left = lenslets(&window);
    left.remove(2);
    let from = window.get_by_label("Lenslet 3").rect().center();
    let press = egui::Event::PointerButton {
        pos: from,
        button: PointerButton::Primary,
        pressed: true,
        modifiers: Modifiers::NONE,
    };
    window.hover_at(from);
    window.step();
    window.input_mut().events.push(press);
    window.step();
    for step in 1..=8 {
        window.hover_at(from + Vec2::new(3.0 * step as f32, 0.0));
        window.step();
        if step == 4 {
            assert_ne!(lenslets(&window)[2], Design::default().encoder.lenslets().unwrap().lenslets[2], "it is held");
            window.key_press(Key::Delete);
            window.step();
        }
    }
    settle(&mut window);
    assert_eq!(lenslets(&window), left);
}
