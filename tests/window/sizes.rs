//! Field, PSF grid and pixel pitch in the *Scene* panel.

use super::*;

fn design_of(window: &Window) -> &Design {
    studio(window).session().design()
}

fn value_of(window: &Window, name: &str) -> String {
    window.get_by_role_and_label(Role::Image, name).value().unwrap_or_default()
}

/// A window so high that the whole panel is in sight.
fn open_high(design: Design) -> Window {
    open_sized(design, Vec2::new(1280.0, 1200.0))
}

/// Replaces the number in a field, whose label has the same text.
fn type_size(window: &mut Window, field: &str, text: &str) {
    window.get_by_role_and_label(Role::SpinButton, field).click();
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.get_by_role_and_label(Role::SpinButton, field).type_text(text);
    window.run_steps(2);
    window.key_press(Key::Enter);
    // The text above the fields changes with the objects, and moves them.
    settle(window);
}

/// Whether a shown text contains `text`.
fn shows(window: &Window, text: &str) -> bool {
    window.query_all_by_label_contains(text).next().is_some()
}

#[test]
fn typed_sizes_change_field_and_grid_in_one_undo_step_each() {
    let mut window = open_high(Design::default());
    click(&mut window, "Scene");
    type_size(&mut window, "Field rows", "192");
    type_size(&mut window, "Field columns", "160");
    assert_eq!(design_of(&window).field, (192, 160));
    let before = lenslets(&window);
    type_size(&mut window, "PSF grid", "64");
    let after = lenslets(&window);
    assert_eq!(design_of(&window).encoder.grid(), (64, 64));
    assert_eq!((before[0].x, after[0].x, after[0].spot), (16.0, 32.5, before[0].spot));
    settle(&mut window);
    let live = studio(&window).session().live();
    assert_eq!(live.measurements.unwrap().value.noisy.dim().1, 192 - 63);
    assert_eq!(live.scene.unwrap().value.objects.dim().2, 192);
    // A preset has the grid of the mask that it replaces.
    menu(&mut window, &["Presets", "Heuristic lenslets", "4 lenslets"]);
    assert_eq!((lenslets(&window).len(), design_of(&window).encoder.grid()), (4, (64, 64)));
    for grid in [64, 32] {
        window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
        settle(&mut window);
        assert_eq!((lenslets(&window).len(), design_of(&window).encoder.grid().0), (9, grid));
    }
    assert_eq!(lenslets(&window), before);
}

#[test]
fn the_field_has_room_for_the_grid() {
    let mut window = open_high(Design::default());
    click(&mut window, "Scene");
    type_size(&mut window, "Field rows", "31");
    assert!(shows(&window, "Field rows: \"31\" is not between 32 and 1024; 96 stays"));
    assert_eq!(*design_of(&window), Design::default());
    type_size(&mut window, "PSF grid", "100");
    assert_eq!(design_of(&window).field, (300, 300));
    window.key_press_modifiers(Modifiers::COMMAND, Key::Z);
    settle(&mut window);
    assert_eq!(*design_of(&window), Design::default());
}

#[test]
fn a_pixel_pitch_gives_physical_scales() {
    let mut window = open_high(Design::default());
    click(&mut window, "Scene");
    let before = value_of(&window, "Measurement");
    assert!(before.contains("scale bar") && !before.contains('\u{b5}'), "{before}");
    click(&mut window, "Known pixel pitch");
    assert_eq!(design_of(&window).pixel_pitch_um, Some(3.45));
    type_size(&mut window, "Pixel pitch", "2,5");
    assert_eq!(design_of(&window).pixel_pitch_um, Some(2.5));
    settle(&mut window);
    for image in ["Measurement", "PSF"] {
        let value = value_of(&window, image);
        let (pixels, physical) = value.split_once("scale bar ").unwrap().1.split_once(" px, ").unwrap();
        let physical = physical.split(' ').next().unwrap();
        assert_eq!(pixels.parse::<f64>().unwrap() * 2.5, physical.parse::<f64>().unwrap(), "{value}");
    }
    click(&mut window, "Known pixel pitch");
    assert_eq!(design_of(&window).pixel_pitch_um, None);
}

#[test]
fn whole_images_are_placed_as_chosen() {
    let folder = tempfile::tempdir().unwrap();
    let pixels = ndarray::Array3::from_shape_fn((4, 70, 90), |(n, row, col)| (1 + (n + row * col) % 17) as f32);
    let file = folder.path().join("images.npy");
    lenslet_studio::formats::write_array(&file, pixels.view()).unwrap();
    let mut window = open_high(Design { objects: ObjectSource::Images(file), ..Design::default() });
    click(&mut window, "Scene");
    for (name, text) in
        [("Tiled images", "70 x 90 px repeated to 96 x 96 px"), ("Cropped images", "in the middle of 96 x 96 px")]
    {
        click(&mut window, name);
        settle(&mut window);
        assert!(shows(&window, text), "{text}");
    }
}

#[test]
fn fields_of_the_scene_stand_still_while_objects_are_computed() {
    let mut window = open(Design::default());
    let place = |window: &Window| window.get_by_label("Background photons").rect().top();
    let before = place(&window);
    type_number(&mut window, "Bead density", "0.03");
    while studio(&window).session().is_computing() {
        window.step();
        assert_eq!(place(&window), before);
    }
    settle(&mut window);
    assert_eq!(place(&window), before);
}

#[test]
fn words_of_the_headline_stay_whole_in_a_small_window() {
    let window = open_sized(Design::default(), Vec2::new(800.0, 600.0));
    let units: Vec<f32> = window.query_all_by_label("bits per pixel").map(|node| node.rect().height()).collect();
    assert!(!units.is_empty() && units.iter().all(|height| *height < 24.0), "one line: {units:?}");
}
