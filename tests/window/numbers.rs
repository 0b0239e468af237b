//! Number fields: a typed text gives the number of the rules. Otherwise the old number stays and a message gives the
//! reason.

use std::cell::RefCell;

use egui_kittest::kittest::NodeT;
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::{Config, TestRunner};

use super::*;

/// The number that a field shows to assistive technology.
fn number(window: &Window, field: &str) -> f64 {
    window.get_by_role_and_label(Role::SpinButton, field).accesskit_node().numeric_value().unwrap()
}

/// Opens the captures of cameras, whose fields wait for no computation.
fn with_images(design: Design) -> Window {
    let mut window = open(design);
    click(&mut window, "Camera");
    click(&mut window, "Show captures");
    window
}

/// Starts to type over the content of a field. The text is not committed yet, whatever it is.
fn type_half(window: &mut Window, field: &str, text: &str) {
    window.get_by_label(field).click();
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.run_steps(1);
    if text.is_empty() {
        window.key_press(Key::Backspace);
    } else {
        window.get_by_label(field).type_text(text);
    }
    window.run_steps(2);
}

/// Whether a shown text contains `text`.
fn shows(window: &Window, text: &str) -> bool {
    window.query_all_by_label_contains(text).next().is_some()
}

/// Value of a text by the rules, implemented differently from the parser.
fn by_the_rules(text: &str) -> Option<f64> {
    let plain = text.trim().replace('\u{2212}', "-");
    let is_known = |c: char| c.is_ascii_digit() || "+-.,eE".contains(c);
    if !plain.chars().all(is_known) || plain.matches(['.', ',']).count() > 1 {
        return None;
    }
    if let Some((whole, decimals)) = plain.trim_start_matches(['+', '-']).split_once(',') {
        let decimals = decimals.split(['e', 'E']).next().unwrap_or_default();
        if decimals.len() == 3 && (1..=3).contains(&whole.len()) && !whole.starts_with('0') {
            return None;
        }
    }
    plain.replace(',', ".").parse().ok().filter(|number: &f64| number.is_finite())
}

#[test]
fn random_texts_of_three_locales_follow_the_rules() {
    const FIELD: &str = "Captures: offset";
    let window = RefCell::new(with_images(Design::default()));
    let text = proptest::prop_oneof![
        // Anything that starts like a number.
        "[-+\u{2212}]?[0-9., '\u{a0}\u{202f}eE]{0,9}[a-zA-Z%]?",
        // Numbers as written in English, German, and French or Swiss: with thousands and decimals.
        "-?[1-9][0-9]{0,2}(,[0-9]{3}){0,2}(\\.[0-9]{1,4})?",
        "-?[1-9][0-9]{0,2}(\\.[0-9]{3}){0,2}(,[0-9]{1,4})?",
        "-?[1-9][0-9]{0,2}([ '\u{202f}][0-9]{3}){0,2}([.,][0-9]{1,4})?",
        "(nan|NaN|inf|-inf|infinity|0x1F|1e999|1_000|)",
    ];
    let mut runner = TestRunner::new_with_rng(
        Config::default(),
        proptest::test_runner::TestRng::deterministic_rng(proptest::test_runner::RngAlgorithm::ChaCha),
    );
    let mut taken = 0;
    for _ in 0..120 {
        let text = text.new_tree(&mut runner).unwrap().current();
        let window = &mut *window.borrow_mut();
        let old = number(window, FIELD);
        type_half(window, FIELD, &text);
        assert_eq!(number(window, FIELD), old, "{text:?} is not committed");
        window.key_press(Key::Enter);
        window.run_steps(3);
        let new = by_the_rules(&text).filter(|number| number.abs() <= 1e6);
        assert_eq!(number(window, FIELD), new.unwrap_or(old), "{text:?} over {old}");
        taken += usize::from(new.is_some());
    }
    assert!((24..96).contains(&taken), "{taken} of the texts are numbers");
}

#[test]
fn rejection_message_names_old_number() {
    let mut window = with_images(Design::default());
    type_number(&mut window, "Captures: gain", "0,46");
    assert_eq!(number(&window, "Captures: gain"), 0.46);
    type_number(&mut window, "Captures: offset", "46,5");
    assert_eq!(number(&window, "Captures: offset"), 46.5);
    for (field, text, sentence) in [
        ("Captures: offset", "1,234", "Captures: offset: \"1,234\" may mean 1.234 or 1234; 46.5 stays"),
        ("Captures: offset", "1.234,5", "Captures: offset: \"1.234,5\" is not a number; 46.5 stays"),
        ("Captures: gain", "nan", "Captures: gain: \"nan\" is not a number; 0.46 stays"),
        ("Captures: gain", "inf", "Captures: gain: \"inf\" is not a number; 0.46 stays"),
        ("Captures: gain", "-1", "Captures: gain: \"-1\" is not between 0.000001 and 1000000; 0.46 stays"),
        ("Captures: gain", "", "Captures: gain: no number was typed; 0.46 stays"),
        ("Captures: bin", "2,5", "Captures: bin: \"2,5\" is not a whole number; 1 stays"),
        ("Captures: bin", "65", "Captures: bin: \"65\" is not between 1 and 64; 1 stays"),
        ("Lenslet 1 x", "99 px", "Lenslet 1 x: \"99 px\" is not between 0 and 31; 16.00 px stays"),
        ("Lenslet 1 weight", "-0,1", "Lenslet 1 weight: \"-0,1\" is not between 0 and 1000000; "),
    ] {
        if field == "Lenslet 1 x" {
            // In the same place as the camera.
            click(&mut window, "Lenslets");
        }
        type_half(&mut window, field, text);
        window.key_press(Key::Enter);
        window.run_steps(3);
        let said: Vec<_> = window.query_all_by_label_contains(field).map(|node| node.value()).collect();
        assert!(shows(&window, sentence), "{sentence} in {said:?}");
    }
    // The unit may be typed, with or without its blank.
    for (text, x) in [("12,5 px", 12.5), ("13px", 13.0), ("\u{2212}0 px", 0.0)] {
        type_number(&mut window, "Lenslet 1 x", text);
        assert_eq!(lenslets(&window)[0].x, x, "{text}");
    }
}

#[test]
fn number_counts_when_committed_and_escape_cancels() {
    let mut window = open(Design::default());
    let before = lenslets(&window);
    let undoes = |window: &Window| studio(window).session().undoes().map(str::to_owned);
    // While 0.46 is typed, a weight is 0 at first. Not all lenslets may have weight 0.
    for (index, _) in before.iter().enumerate() {
        type_half(&mut window, &format!("Lenslet {} weight", index + 1), "0");
        window.get_by_label(&format!("Lenslet {} weight", index + 1)).type_text(",46");
        window.run_steps(2);
        assert_eq!((lenslets(&window)[index].weight, shows(&window, "every lenslet")), (before[index].weight, false));
        window.key_press(Key::Escape);
        window.run_steps(3);
        assert_eq!(lenslets(&window)[index], before[index], "it was taken back");
    }
    assert_eq!(undoes(&window), None);
    // Enter, Tab, and a click elsewhere commit, each as one step, however soon the next one comes.
    type_half(&mut window, "Lenslet 1 weight", "0,46");
    window.key_press(Key::Enter);
    window.run_steps(3);
    type_half(&mut window, "Lenslet 1 weight", "0,47");
    window.key_press(Key::Tab);
    window.run_steps(3);
    type_half(&mut window, "Lenslet 1 weight", "0,48");
    window.get_by_label("Select lenslet 2").click();
    window.run_steps(3);
    type_half(&mut window, "Lenslet 1 weight", "0,49");
    // Another panel in its place removes the field.
    click(&mut window, "Estimates");
    let mut weights = vec![lenslets(&window)[0].weight];
    while studio(&window).session().undoes().is_some() {
        window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
        window.run_steps(3);
        weights.push(lenslets(&window)[0].weight);
    }
    assert_eq!(weights, [0.49, 0.48, 0.47, 0.46, before[0].weight]);
    assert!(!shows(&window, "every lenslet"));
}

#[test]
fn drag_changes_number_continuously() {
    let mut window = open(Design::default());
    let before = lenslets(&window)[0].x;
    let place = window.get_by_label("Lenslet 1 x").rect().center();
    drag(&mut window, place, egui::vec2(20.0, 0.0), egui::PointerButton::Primary);
    settle(&mut window);
    let after = lenslets(&window)[0].x;
    assert!(after > before + 0.5, "{before} to {after}");
    let at_the_edge = window.get_by_label("Lenslet 1 x").rect().center();
    drag(&mut window, at_the_edge, egui::vec2(900.0, 0.0), egui::PointerButton::Primary);
    settle(&mut window);
    assert_eq!(lenslets(&window)[0].x, 31.0, "a drag ends at the range's end");
    for x in [after, before] {
        window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
        window.run_steps(3);
        assert_eq!(lenslets(&window)[0].x, x, "a drag is one step");
    }
}
