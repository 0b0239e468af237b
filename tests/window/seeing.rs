//! Images: zoom, pan, link, display range, spectrum.

use egui::{Key, Modifiers, Role, Theme, vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::Design;
use lenslet_studio::sensor::Noise;

use super::waiting::wait_for;
use super::{Window, answer, click, drag, lenslets, menu, open, open_window, settle, studio, turn, type_number};

/// Zoom and pixel coordinates (x, y) in the centre of an image, as assistive technology reads them.
fn view_of(window: &Window, name: &str) -> (f64, f64, f64) {
    let text = value_of(window, name);
    let number = |after: &str| {
        let rest = &text[text.find(after).unwrap() + after.len()..];
        rest.split([' ', ',']).next().unwrap().parse::<f64>().unwrap()
    };
    (number("zoom "), number("x "), number("y "))
}

fn value_of(window: &Window, name: &str) -> String {
    window.get_by_role_and_label(Role::Image, name).accesskit_node().value().expect("images tell their view")
}

fn rect_of(window: &Window, name: &str) -> egui::Rect {
    window.get_by_role_and_label(Role::Image, name).rect()
}

/// Text of the status bar about an image.
fn status_of(window: &Window, image: &str) -> String {
    let start = format!("{image}  x ");
    let node = window.get_by_label_contains(&start);
    node.accesskit_node().label().or_else(|| node.accesskit_node().value()).unwrap()
}

/// Column and row of an image in the status bar.
fn pixel_named(text: &str, image: &str) -> (i64, i64) {
    let start = text.find(&format!("{image}  x ")).unwrap() + image.len() + 4;
    let mut numbers = text[start..].split(|c: char| !c.is_ascii_digit() && c != '-').filter(|part| !part.is_empty());
    let mut next = || numbers.next().unwrap().parse().unwrap();
    (next(), next())
}

#[test]
fn wheel_zooms_around_pointer_and_double_click_resets() {
    let mut window = open(Design::default());
    let whole = rect_of(&window, "Object");
    let place = whole.min + whole.size() * vec2(0.255, 0.7);
    assert_eq!(view_of(&window, "Object"), (1.0, 47.5, 47.5));
    window.hover_at(place);
    window.run_steps(2);
    let before = pixel_named(&status_of(&window, "Object"), "Object");
    turn(&mut window, place, 5.0, Modifiers::NONE);
    let (zoom, x, y) = view_of(&window, "Object");
    assert!((zoom - 1.0_f64.exp()).abs() < 0.05, "five notches of 40 points: {zoom}");
    assert!(x < 40.0 && y > 50.0, "towards the pointer: {x} {y}");
    assert_eq!(pixel_named(&status_of(&window, "Object"), "Object"), before, "the pixel under the pointer stays");
    // The button exists only while the image is zoomed.
    click(&mut window, "Fit Object");
    assert_eq!(view_of(&window, "Object"), (1.0, 47.5, 47.5));
    assert!(window.query_by_label("Fit Object").is_none());
    turn(&mut window, place, 3.0, Modifiers::NONE);
    assert!(view_of(&window, "Object").0 > 1.5);
    for _ in 0..2 {
        window.hover_at(place);
        window.drag_at(place);
        window.drop_at(place);
        window.step();
    }
    window.run_steps(3);
    assert_eq!(view_of(&window, "Object"), (1.0, 47.5, 47.5));
}

#[test]
fn drag_and_keys_pan_zoomed_image() {
    let mut window = open(Design::default());
    let whole = rect_of(&window, "Object");
    drag(&mut window, whole.center(), vec2(30.0, 0.0), egui::PointerButton::Primary);
    assert_eq!(view_of(&window, "Object"), (1.0, 47.5, 47.5), "all of it is seen: there is nowhere to go");
    turn(&mut window, whole.center(), 6.0, Modifiers::NONE);
    let (zoom, x, y) = view_of(&window, "Object");
    drag(&mut window, whole.center(), vec2(30.0, -12.0), egui::PointerButton::Primary);
    let after = view_of(&window, "Object");
    let scale = f64::from(whole.width()) / 96.0 * zoom;
    assert!((x - after.1 - 30.0 / scale).abs() < 0.3 && (after.2 - y - 12.0 / scale).abs() < 0.3, "{after:?}");
    // The same by the keyboard alone.
    window.get_by_role_and_label(Role::Image, "Object").focus();
    window.run_steps(2);
    window.key_press(Key::ArrowRight);
    window.run_steps(2);
    assert!(view_of(&window, "Object").1 > after.1 + 1.0);
    window.key_press(Key::Plus);
    window.run_steps(2);
    assert!((view_of(&window, "Object").0 / zoom - 1.22).abs() < 0.02);
    window.key_press(Key::Num0);
    window.run_steps(2);
    assert_eq!(view_of(&window, "Object"), (1.0, 47.5, 47.5));
}

#[test]
fn samples_are_chosen_in_order_and_at_random() {
    let mut window = open(Design::default());
    let shown = |window: &Window, text: &str| window.query_all_by_label(text).count();
    assert_eq!(shown(&window, "1 of 64"), 2, "object and measurement are of one sample");
    click(&mut window, "Next measurement");
    assert_eq!(shown(&window, "2 of 64"), 2);
    click(&mut window, "Random object");
    assert_eq!(shown(&window, "2 of 64"), 0, "chance chooses another one");
}

#[test]
fn object_and_measurement_are_linked_until_unlinked() {
    let mut window = open(Design::default());
    let measured = rect_of(&window, "Measurement");
    let place = measured.min + measured.size() * vec2(0.6, 0.4);
    turn(&mut window, place, 6.0, Modifiers::NONE);
    let (zoom, x, y) = view_of(&window, "Measurement");
    assert!(zoom > 2.0);
    // The centre pixel of the mask maps to the object 15 px further.
    let object = view_of(&window, "Object");
    assert_eq!((object.0, (object.1 - x - 15.0).abs() < 0.02, (object.2 - y - 15.0).abs() < 0.02), (zoom, true, true));
    // The status bar shows both values, at corresponding positions.
    let status = status_of(&window, "Measurement");
    let (col, row) = pixel_named(&status, "Measurement");
    assert_eq!(pixel_named(&status, "Object"), (col + 15, row + 15), "{status}");
    let description = |window: &Window, name: &str| {
        window.get_by_role_and_label(Role::Image, name).accesskit_node().description().unwrap_or_default()
    };
    let cursor = description(&window, "Object");
    assert!(cursor.contains(&format!("x {}.", col + 14)) || cursor.contains(&format!("x {}.", col + 15)), "{cursor}");
    window.get_by_role_and_label(Role::Image, "Object").click_secondary();
    window.run_steps(4);
    click(&mut window, "Show all");
    assert_eq!((view_of(&window, "Object").0, view_of(&window, "Measurement").0), (1.0, 1.0));
    turn(&mut window, place, 6.0, Modifiers::NONE);
    // The same from the object. Beyond the field of the sensor there is no value.
    click(&mut window, "Fit Object");
    assert_eq!(view_of(&window, "Measurement").0, 1.0);
    let whole = rect_of(&window, "Object");
    window.hover_at(whole.center());
    window.run_steps(3);
    let status = status_of(&window, "Object");
    let (col, row) = pixel_named(&status, "Object");
    assert_eq!(pixel_named(&status, "Measurement"), (col - 15, row - 15), "{status}");
    assert!(description(&window, "Measurement").contains("cursor of the other view"));
    window.hover_at(whole.min + vec2(4.0, 4.0));
    window.run_steps(3);
    assert!(status_of(&window, "Object").contains("outside the field"), "{}", status_of(&window, "Object"));
    assert_eq!(description(&window, "Measurement"), "");
    // Unlinked, each image zooms alone.
    click(&mut window, "Link views");
    turn(&mut window, whole.center(), 4.0, Modifiers::NONE);
    assert!(view_of(&window, "Object").0 > 1.5);
    assert_eq!(view_of(&window, "Measurement"), (1.0, 32.0, 32.0));
    assert!(!status_of(&window, "Object").contains("Measurement"));
    click(&mut window, "Link views");
    window.run_steps(2);
    assert_eq!(view_of(&window, "Measurement").0, view_of(&window, "Object").0, "together again at once");
}

#[test]
fn resting_pointer_requests_no_frames() {
    let mut window = open(Design::default());
    let place = rect_of(&window, "Measurement").center();
    turn(&mut window, place, 2.0, Modifiers::NONE);
    window.run_steps(60);
    assert!(status_of(&window, "Measurement").contains("Object"));
    let delay = window.output().viewport_output.values().map(|viewport| viewport.repaint_delay).min().unwrap();
    assert!(delay > std::time::Duration::from_secs(1), "the next frame is asked for in {delay:?}");
}

#[test]
fn link_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("preferences.json"), "{\"welcomed\": true}").unwrap();
    let at_home = || {
        let mut window = open(Design::default());
        let ctx = window.ctx.clone();
        window.state_mut().as_mut().unwrap().keep_data_in(&ctx, folder.path());
        window.state_mut().as_mut().unwrap().set_live(false);
        window.run_steps(4);
        window
    };
    let mut window = at_home();
    click(&mut window, "Link views");
    drop(window);
    let text = std::fs::read_to_string(folder.path().join("preferences.json")).unwrap();
    assert!(text.contains("\"link_views\": false"), "{text}");
    let mut window = at_home();
    let place = rect_of(&window, "Object").center();
    turn(&mut window, place, 4.0, Modifiers::NONE);
    assert_eq!(view_of(&window, "Measurement").0, 1.0);
}

#[test]
fn ctrl_wheel_zooms_the_mask() {
    let mut window = open(Design::default());
    let start = lenslets(&window);
    let place = window.get_by_label("Lenslet 1").rect().center();
    turn(&mut window, place, 6.0, Modifiers::COMMAND);
    settle(&mut window);
    assert_eq!(lenslets(&window), start, "Ctrl and wheel changes no weight");
    let (zoom, x, y) = view_of(&window, "PSF");
    assert!(zoom > 2.5, "{zoom}");
    assert!((window.get_by_label("Lenslet 1").rect().center() - place).length() < 1.0, "it stays under the pointer");
    // The middle button pans, even from a lenslet.
    drag(&mut window, place, vec2(-40.0, 20.0), egui::PointerButton::Middle);
    let scale = f64::from(rect_of(&window, "PSF").width()) / 32.0;
    let after = view_of(&window, "PSF");
    assert!(after.1 > x + 20.0 / (scale * zoom) && after.2 < y, "{after:?}");
    assert_eq!(lenslets(&window), start, "and no lenslet");
    let moved = window.get_by_label("Lenslet 1").rect().center();
    assert!((moved - place - vec2(-40.0, 20.0)).length() < 8.0, "{moved:?} {place:?}");
    // The left button pans while Space is held.
    let space = |pressed| egui::Event::Key {
        key: Key::Space,
        physical_key: None,
        pressed,
        repeat: false,
        modifiers: Modifiers::NONE,
    };
    window.input_mut().events.push(space(true));
    window.step();
    let corner = rect_of(&window, "PSF").left_bottom() + vec2(30.0, -60.0);
    drag(&mut window, corner, vec2(20.0, 0.0), egui::PointerButton::Primary);
    window.input_mut().events.push(space(false));
    window.step();
    assert!(view_of(&window, "PSF").1 < after.1 - 10.0 / (scale * zoom), "{:?}", view_of(&window, "PSF"));
    let now = window.get_by_label("Lenslet 1").rect().center();
    // Lenslets are dragged as before, by fewer pixels at a larger scale.
    let scale = rect_of(&window, "PSF").width() / 32.0;
    drag(&mut window, now, vec2(50.0, 0.0), egui::PointerButton::Primary);
    settle(&mut window);
    let moved = lenslets(&window)[0].x - start[0].x;
    assert!(moved > 0.2 && moved < f64::from(50.0 / scale), "{moved}: less than where all is seen");
    turn(&mut window, now, 1.0, Modifiers::NONE);
    settle(&mut window);
    assert_eq!(view_of(&window, "PSF").0, after.0, "the wheel alone does not zoom the mask");
    click(&mut window, "Fit PSF");
    assert_eq!(view_of(&window, "PSF").0, 1.0);
    // Keys alone zoom around the selected lenslet.
    let place = window.get_by_label("Lenslet 1").rect().center();
    for _ in 0..4 {
        window.key_press(Key::Plus);
        window.run_steps(2);
    }
    let zoom = view_of(&window, "PSF").0;
    assert!((zoom - 1.22_f64.powi(4)).abs() < 0.05, "{zoom}");
    assert!((window.get_by_label("Lenslet 1").rect().center() - place).length() < 8.0, "it stays where it was");
    window.key_press(Key::Minus);
    window.run_steps(2);
    assert!(view_of(&window, "PSF").0 < zoom);
    window.key_press(Key::Num0);
    window.run_steps(2);
    assert_eq!(view_of(&window, "PSF").0, 1.0);
}

#[test]
fn display_range_is_set_kept_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    let measured = studio(&window).session().live().measurements.unwrap();
    let number = |window: &Window, field: &str| window.get_by_label(field).accesskit_node().numeric_value().unwrap();
    click(&mut window, "Measurement display range");
    let full = number(&window, "Measurement highest value");
    let (low, high) = (number(&window, "Measurement lowest value"), full);
    let image = measured.value.noisy.index_axis(ndarray::Axis(0), 0);
    let brightest = image.iter().copied().fold(0.0_f32, f32::max);
    assert_eq!(high, f64::from(brightest));
    click(&mut window, "Auto Measurement display range");
    assert!(number(&window, "Measurement highest value") < full, "a few bright pixels are left out");
    type_number(&mut window, "Measurement lowest value", "50");
    type_number(&mut window, "Measurement highest value", "100");
    // The limits are also handles on the histogram.
    let handle = window.get_by_label("Measurement high limit").rect();
    drag(&mut window, handle.center(), vec2(-12.0, 0.0), egui::PointerButton::Primary);
    let dragged = number(&window, "Measurement highest value");
    assert!(dragged < 100.0 && dragged > 50.0, "{dragged}");
    type_number(&mut window, "Measurement highest value", "100");
    click(&mut window, "Measurement logarithmic counts");
    click(&mut window, "Measurement display range");
    assert!(window.query_by_label("Measurement highest value").is_none());
    // They stay for the next image, and the exported view has them: values up to 50 are black, values from 100 are white.
    click(&mut window, "Next measurement");
    let file = folder.path().join("view.png");
    menu(&mut window, &["File", "Export view", "Measurement..."]);
    answer(&mut window, &file, "Export");
    let written = image::open(&file).unwrap().to_rgb8();
    let shown = measured.value.noisy.index_axis(ndarray::Axis(0), 1);
    let mut ends = [0; 2];
    for ((row, col), &value) in shown.indexed_iter() {
        let level = written.get_pixel(col as u32, row as u32).0[0];
        assert!(value > 50.0 || level == 0, "{value} is {level}");
        assert!(value < 100.0 || level == 255, "{value} is {level}");
        ends[0] += usize::from(value <= 50.0);
        ends[1] += usize::from(value >= 100.0);
    }
    assert!(ends[0] > 0 && ends[1] > 0, "both happen: {ends:?}");
    // Display never changes data.
    assert_eq!(studio(&window).session().live().measurements.unwrap().value.noisy, measured.value.noisy);
    click(&mut window, "Previous measurement");
    click(&mut window, "Measurement display range");
    assert_eq!(number(&window, "Measurement highest value"), 100.0);
    click(&mut window, "Reset Measurement display range");
    let reset = (number(&window, "Measurement lowest value"), number(&window, "Measurement highest value"));
    assert_eq!(reset, (low, full));
}

#[test]
fn scale_bars_shrink_as_pixels_grow() {
    let mut window = open(Design::default());
    assert!(value_of(&window, "Object").ends_with("scale bar 20 px"), "{}", value_of(&window, "Object"));
    let place = rect_of(&window, "Object").center();
    turn(&mut window, place, 10.0, Modifiers::NONE);
    assert!(value_of(&window, "Object").ends_with("scale bar 5 px"), "{}", value_of(&window, "Object"));
    menu(&mut window, &["View", "Panel", "Show MTF"]);
    click(&mut window, "Show MTF map");
    assert!(value_of(&window, "MTF map").contains("cycles/px"), "{}", value_of(&window, "MTF map"));
}

#[test]
fn spectrum_is_drawn_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    menu(&mut window, &["View", "Panel", "Show MTF"]);
    click(&mut window, "Show spectrum");
    wait_for(&mut window, "the spectrum", |window| {
        !window.get_by_label("Export spectrum as CSV").accesskit_node().is_disabled()
    });
    let file = folder.path().join("spectrum.csv");
    click(&mut window, "Export spectrum as CSV");
    answer(&mut window, &file, "Export");
    let text = std::fs::read_to_string(&file).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("cycles_per_px,power_photons2,noise_photons2"));
    let rows: Vec<Vec<f64>> = lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), 31, "65 px have rings 2 to 32");
    // The noise level lies at the mean of this measurement. The spots of the lenslets rise above it at low frequencies
    // and transmit nothing near half the sampling rate.
    let measured = studio(&window).session().live().measurements.unwrap();
    let mean = measured.value.noisy.index_axis(ndarray::Axis(0), 0).mapv(f64::from).mean().unwrap();
    assert!((rows[0][2] / mean - 1.0).abs() < 1e-6, "{} {mean}", rows[0][2]);
    assert!(rows[0][1] > 3.0 * mean, "{:?}", rows[0]);
    let last: f64 = rows[24..].iter().map(|row| row[1]).sum::<f64>() / 7.0;
    assert!((last / mean - 1.0).abs() < 0.6, "{last} {mean}");
}

#[test]
fn information_is_overlaid_on_measurement() {
    let mut window = open_window(Design::default(), vec2(1280.0, 800.0), Theme::Dark, true);
    let overlay = |window: &Window| {
        let node = window.get_by_role_and_label(Role::Image, "Measurement");
        node.accesskit_node().description().filter(|text| text.starts_with("information overlay up to "))
    };
    assert_eq!(overlay(&window), None);
    click(&mut window, "Information over the measurement");
    wait_for(&mut window, "the map", |window| overlay(window).is_some());
    let closer = studio(&window).session().live().closer.unwrap();
    let map = closer.map.as_ref().unwrap();
    assert_eq!(map.dim(), (65, 65), "all of the measurement, not one patch of it");
    window.hover_at(rect_of(&window, "Measurement").center());
    window.run_steps(3);
    window.get_by_label_contains(" bits of information");
    // The map belongs to the shown measurement.
    click(&mut window, "Next measurement");
    wait_for(&mut window, "the map of the next one", |window| {
        overlay(window).is_some() && studio(window).session().live().closer.unwrap().key.sample == 1
    });
    click(&mut window, "Information over the measurement");
    assert_eq!(overlay(&window), None);
}

#[test]
fn images_have_a_context_menu() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    let place = rect_of(&window, "Measurement");
    let place = place.min + place.size() * vec2(0.3, 0.6);
    turn(&mut window, place, 5.0, Modifiers::NONE);
    assert!(view_of(&window, "Measurement").0 > 1.5);
    window.get_by_role_and_label(Role::Image, "Measurement").click_secondary();
    window.run_steps(4);
    click(&mut window, "Show all");
    assert_eq!(view_of(&window, "Measurement").0, 1.0);
    window.get_by_role_and_label(Role::Image, "Measurement").click_secondary();
    window.run_steps(4);
    let file = folder.path().join("measurement.png");
    click(&mut window, "Export image...");
    answer(&mut window, &file, "Export");
    assert_eq!(image::open(&file).unwrap().to_rgb8().dimensions(), (65, 65));
    // The mask is edited at the clicked place.
    let corner = rect_of(&window, "PSF").min + vec2(30.0, 30.0);
    drag(&mut window, corner, vec2(0.0, 0.0), egui::PointerButton::Secondary);
    click(&mut window, "Add a lenslet here");
    assert_eq!(lenslets(&window).len(), 10);
    // A row of the table has the menu of its lenslet.
    window.get_by_label("Select lenslet 2").click_secondary();
    window.run_steps(4);
    click(&mut window, "Delete");
    assert_eq!(lenslets(&window).len(), 9);
}

#[test]
fn long_failure_wraps_in_its_row() {
    // More light than the model can count. The Gaussian bound has no such limit.
    let design = Design { bias_photons: 1e7, noise: Noise::Read { sigma: 0.05 }, ..Design::default() };
    let mut window = open_window(design, vec2(1280.0, 800.0), Theme::Dark, true);
    let failure = "photon counts up to";
    wait_for(&mut window, "the failure", |window| window.query_by_label_contains(failure).is_some());
    window.run_steps(4);
    let row = window.get_by_label_contains(failure).rect();
    let gauge = window.get_by_role_and_label(Role::Meter, &meter_name(&window)).rect();
    let seen = window.ctx.content_rect();
    let line = window.get_by_label("Gaussian bound").rect().height();
    assert!(row.height() > 1.5 * line && seen.contains_rect(row), "{row:?} in {seen:?}, lines of {line}");
    assert!(seen.contains_rect(gauge) && gauge.right() > row.left(), "{gauge:?} in {seen:?}");
}

/// The name of the gauge of the Tamura coefficient, which holds its value.
fn meter_name(window: &Window) -> String {
    let meters = window.query_all_by_role(Role::Meter);
    let names = meters.filter_map(|meter| meter.accesskit_node().label());
    names.into_iter().find(|name| name.starts_with("Sensor Tamura")).unwrap()
}
