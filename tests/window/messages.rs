//! Messages: toasts, failure banner and log.

use egui::accesskit::Live;
use egui::{Shape, vec2};
use egui_kittest::kittest::NodeT;

use super::*;

/// Frames of seven seconds by the clock of these windows. Toasts disappear after five.
const SEVEN_SECONDS: usize = 7 * 60;

/// Number of times a text is painted in the lower right corner.
fn in_the_corner(window: &Window, text: &str) -> usize {
    fn count(shape: &Shape, text: &str, corner: Rect) -> usize {
        match shape {
            Shape::Text(painted) => usize::from(painted.galley.text() == text && corner.contains(painted.pos)),
            Shape::Vec(shapes) => shapes.iter().map(|shape| count(shape, text, corner)).sum(),
            _ => 0,
        }
    }
    let whole = window.ctx.content_rect();
    let corner = Rect::from_min_max(whole.max - vec2(360.0, 200.0), whole.max - vec2(0.0, 30.0));
    window.output().shapes.iter().map(|clipped| count(&clipped.shape, text, corner)).sum()
}

/// Tops of all places of a text, from the highest.
fn tops(window: &Window, text: &str) -> Vec<f32> {
    let mut tops: Vec<f32> = window.query_all_by_label(text).map(|node| node.rect().top()).collect();
    tops.sort_by(f32::total_cmp);
    tops
}

#[test]
fn toasts_disappear_and_stay_in_the_log() {
    let mut window = open(Design::default());
    let message = |number: usize| format!("Saved as layout {number}");
    menu(&mut window, &["View", "Layout", "Save as layout 1"]);
    assert_eq!(in_the_corner(&window, &message(1)), 1);
    // Assistive technology reads the status line.
    assert_eq!(window.get_by_label(&message(1)).accesskit_node().live(), Live::Polite);
    menu(&mut window, &["View", "Layout", "Save as layout 2"]);
    assert_eq!((in_the_corner(&window, &message(1)), in_the_corner(&window, &message(2))), (1, 1));
    window.run_steps(SEVEN_SECONDS);
    assert_eq!((in_the_corner(&window, &message(1)), in_the_corner(&window, &message(2))), (0, 0));

    // A click on the status line shows all of them, the newest first.
    click(&mut window, &message(2));
    let (older, newer) = (tops(&window, &message(1)), tops(&window, &message(2)));
    assert_eq!((older.len(), newer.len()), (1, 2), "the newest stands in the status line, too");
    assert!(newer[0] < older[0], "{newer:?} above {older:?}");
    // A repeated message shows a toast again, but is listed once.
    menu(&mut window, &["View", "Layout", "Save as layout 2"]);
    assert_eq!((in_the_corner(&window, &message(2)), tops(&window, &message(2)).len()), (1, 2));
}

#[test]
fn failure_banner_stays_until_dismissed() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    let fail = |window: &mut Window| {
        click(window, "Open objects...");
        answer(window, &folder.path().join("nothing.npy"), "Open");
    };
    fail(&mut window);
    let message = window.get_all_by_label_contains("nothing.npy").next().and_then(|node| node.value()).unwrap();
    assert_eq!(in_the_corner(&window, &message), 0, "it has a place of its own");
    let strip = |window: &Window| tops(window, &message)[0] < 60.0 && window.query_by_label("Dismiss").is_some();
    assert!(strip(&window));
    let is_alert = |node: egui_kittest::Node<'_>| node.accesskit_node().live() == Live::Assertive;
    assert!(window.query_all_by_label(&message).any(is_alert), "those who listen are interrupted");
    // Neither time nor other work removes the banner.
    window.run_steps(SEVEN_SECONDS);
    click(&mut window, "Add lenslet");
    settle(&mut window);
    assert!(strip(&window));
    click(&mut window, "Dismiss");
    assert!(window.query_by_label("Dismiss").is_none());
    menu(&mut window, &["View", "Messages"]);
    assert_eq!(tops(&window, &message).len(), 2, "in the list and in the status line");
    // The same failure again shows the banner again.
    fail(&mut window);
    assert!(strip(&window));
    assert_eq!(tops(&window, &message).len(), 3);
}
