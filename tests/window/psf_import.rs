//! The dialog that makes a PSF of a photograph.

use std::path::{Path, PathBuf};

use egui::{Key, Vec2};
use egui_kittest::kittest::Queryable;
use lenslet_studio::forward::Design;
use lenslet_studio::optics::import_psf;

use super::waiting::wait_for;
use super::{Encoder, Window, answer, click, drag, menu, open, open_sized, settle, studio, type_number};

/// A colour photograph of 400 x 480 px: a grid of spots on a dark level.
fn write_photograph(folder: &Path) -> PathBuf {
    let path = folder.join("photo.png");
    let photo = image::RgbImage::from_fn(480, 400, |x, y| {
        let is_lit = (200..320).contains(&x) && (120..240).contains(&y) && (x / 8 + 2 * (y / 8)) % 5 == 0;
        let level = 10 + ((x * 31 + y * 17) % 3) as u8;
        if is_lit { image::Rgb([100, 160 + level, 70]) } else { image::Rgb([level + 20, level, level + 5]) }
    });
    photo.save(&path).unwrap();
    path
}

/// Types a path into the open dialog.
pub fn type_psf_path(window: &mut Window, path: &Path) {
    window.get_by_label("Path of the PSF").focus();
    window.run_steps(2);
    window.get_by_label("Path of the PSF").type_text(&path.display().to_string());
    window.run_steps(2);
}

/// Imports the path of the dialog by Enter, whether the preview is there or not. A click would miss the button where the preview comes at
/// that moment and moves it.
pub fn import_typed(window: &mut Window) {
    window.run_steps(2);
    window.key_press(Key::Enter);
    window.run_steps(2);
}

/// Waits until an imported PSF is the mask, and its numbers are there.
pub fn wait_for_image(window: &mut Window) {
    let is_image = |window: &Window| matches!(studio(window).session().design().encoder, Encoder::Image(_));
    wait_for(window, "the imported PSF", is_image);
    settle(window);
}

/// Opens the dialog and types a path.
fn import(window: &mut Window, path: &Path) {
    menu(window, &["File", "Import PSF..."]);
    type_psf_path(window, path);
}

fn is_shown(window: &Window, part: &str) -> bool {
    window.query_all_by_label_contains(part).next().is_some()
}

fn choose(window: &mut Window, list: &str, choice: &str) {
    click(window, list);
    click(window, choice);
}

#[test]
fn photograph_becomes_the_psf_that_the_preview_shows() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_photograph(folder.path());
    let mut window = open(Design::default());
    import(&mut window, &path);
    // A dark level, the light and bins are proposed.
    wait_for(&mut window, "the preview", |window| is_shown(window, "The dark level of 11 from the corners"));
    wait_for(&mut window, "the PSF", |window| is_shown(window, "in sums of 3 x 3 px hold"));
    choose(&mut window, "PSF: channel", "Red");
    wait_for(&mut window, "another channel", |window| is_shown(window, "The dark level of 31 from the corners"));
    choose(&mut window, "PSF: channel", "Green");
    // Advice names the controls of the dialog.
    choose(&mut window, "PSF: dark level", "None");
    wait_for(&mut window, "the doubt", |window| is_shown(window, "choose Median of the corners as dark level"));
    assert!(!is_shown(&window, "?dark"));
    choose(&mut window, "PSF: dark level", "Median of the corners");
    choose(&mut window, "PSF: dark level", "Grey value");
    type_number(&mut window, "PSF: dark grey value", "10,5");
    wait_for(&mut window, "another dark level", |window| is_shown(window, "The dark level of 10.5 is subtracted"));
    choose(&mut window, "PSF: window", "Central square");
    wait_for(&mut window, "the square", |window| is_shown(window, "Rows 0 to 399, columns 40 to 439 in sums of"));
    type_number(&mut window, "PSF: top", "100");
    type_number(&mut window, "PSF: rows", "160");
    choose(&mut window, "PSF: pixels", "Averages, longer side");
    type_number(&mut window, "PSF: grid", "40");
    choose(&mut window, "PSF: turn counter-clockwise", "90\u{b0}");
    click(&mut window, "Mirror left to right");
    wait_for(&mut window, "the rectangle", |window| is_shown(window, "PSF of 40 x 16 px"));
    assert!(is_shown(&window, "Rows 100 to 259, columns 40 to 439 in areas of 10 x 10 px"));
    assert!(is_shown(&window, "Turned by 90 degrees counter-clockwise, mirrored left to right"));
    click(&mut window, "Save settings...");
    let settings = folder.path().join("import.toml");
    answer(&mut window, &settings, "Save");
    click(&mut window, "Import");
    wait_for_image(&mut window);
    let query = "channel=green&dark=10.5&window=100,40,160,400&grid=40&rotate=90&mirror=yes";
    let named = import_psf(Path::new(&format!("{}?{query}", path.display())), None).unwrap();
    let psf = studio(&window).session().design().psf(1).unwrap().index_axis_move(ndarray::Axis(0), 0);
    assert_eq!(psf.mapv(|value| value as f32), named.image.psf);
    assert_eq!(import_psf(&settings, None).unwrap().image.psf, named.image.psf, "the settings repeat the import");
}

/// Whether the report names a window within two pixels of these rows and columns.
fn is_window_near(window: &Window, expected: [u32; 4]) -> bool {
    let shown = window.query_all_by_label_contains("Rows ").find_map(|node| node.value());
    let Some(shown) = shown else { return false };
    let numbers = shown.split(|c: char| !c.is_ascii_digit()).filter_map(|part| part.parse::<u32>().ok());
    numbers.zip(expected).all(|(found, expected)| found.abs_diff(expected) <= 2)
}

#[test]
fn window_is_dragged_on_the_photograph() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_photograph(folder.path());
    let mut window = open(Design::default());
    import(&mut window, Path::new(&format!("{}?dark=corners&window=100,100,200,240&bin=4", path.display())));
    wait_for(&mut window, "the preview", |window| is_shown(window, "Rows 100 to 299, columns 100 to 339"));
    // The dialog has grown and stands still. The photograph fills the height of its space and stands in the middle.
    window.run_steps(8);
    let space = window.get_by_label("Photograph with its window").rect();
    let scale = space.height() / 400.0;
    let corner = space.center() - Vec2::new(240.0, 200.0) * scale;
    let at = |x: f32, y: f32| corner + Vec2::new(x, y) * scale;
    drag(&mut window, at(200.0, 200.0), Vec2::new(40.0, -40.0) * scale, egui::PointerButton::Primary);
    wait_for(&mut window, "the moved window", |window| is_window_near(window, [60, 259, 140, 379]));
    type_number(&mut window, "PSF: rows", "100");
    wait_for(&mut window, "the advice", |window| is_shown(window, "choose Whole photograph as window to keep all"));
    assert!(!is_shown(&window, "?window"));
}

#[test]
fn import_waits_for_the_preview_and_can_be_cancelled_in_a_small_window() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_photograph(folder.path());
    let mut window = open_sized(Design::default(), Vec2::new(400.0, 300.0));
    import(&mut window, &path);
    for name in ["Import", "Save settings...", "Cancel the import"] {
        let rect = window.get_by_label(name).rect();
        assert!(rect.bottom() <= 300.0 && rect.right() <= 400.0, "{name}: {rect:?}");
    }
    window.key_press(Key::Enter);
    wait_for_image(&mut window);
    assert!(studio(&window).session().design().encoder.grid().0 <= 48, "with the proposed bins");
    menu(&mut window, &["File", "Import PSF..."]);
    window.key_press(Key::Escape);
    window.run_steps(4);
    assert!(window.query_by_label("Save settings...").is_none());
    // What is no PSF is refused in the dialog, which stays open.
    let none = folder.path().join("none.png");
    menu(&mut window, &["File", "Import PSF..."]);
    type_psf_path(&mut window, &none);
    import_typed(&mut window);
    wait_for(&mut window, "the refusal", |window| is_shown(window, "none.png: expected a file, found nothing"));
    settle(&mut window);
    window.get_by_label("Save settings...");
}
