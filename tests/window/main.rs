//! The window, driven by the names that assistive technology sees.

mod cameras;
mod capture;
mod compare;
mod dialogs;
mod estimates;
mod files;
mod golden;
mod home;
mod keyboard;
mod mask;
mod messages;
mod numbers;
mod panics;
mod psf_import;
mod reconstruction;
mod runs;
mod seeing;
mod sizes;
mod soak;
mod studies;
mod training;
mod waiting;
mod work;

use std::path::Path;

use egui::{Key, Modifiers, Pos2, Rect, Role, Theme, Vec2, pos2};
use egui_kittest::kittest::Queryable;
use egui_kittest::{Harness, LazyRenderer, TestRenderer};
use lenslet_studio::forward::Design;
use lenslet_studio::objects::ObjectSource;
use lenslet_studio::optics::{Encoder, Lenslet};
use lenslet_studio::studio::Studio;
use waiting::{collect_frame_requests, settle};

/// The allocator of the program, because the soak test measures its memory.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

type Window = Harness<'static, Option<Studio>>;

fn open(design: Design) -> Window {
    open_sized(design, Vec2::new(1280.0, 800.0))
}

fn open_sized(design: Design, size: Vec2) -> Window {
    open_themed(design, size, Theme::Dark)
}

/// A window without live estimates, whose numbers would never converge.
fn open_themed(design: Design, size: Vec2, theme: Theme) -> Window {
    open_window(design, size, theme, false)
}

fn open_window(design: Design, size: Vec2, theme: Theme, live: bool) -> Window {
    open_drawn_by(LazyRenderer::default(), design, size, theme, live)
}

fn open_drawn_by(
    renderer: impl TestRenderer + 'static,
    design: Design,
    size: Vec2,
    theme: Theme,
    live: bool,
) -> Window {
    let builder = Harness::builder().with_size(size).with_theme(theme).with_max_steps(64).renderer(renderer);
    let mut window = builder.with_step_dt(1.0 / 60.0).build_ui_state(
        move |ui, studio: &mut Option<Studio>| {
            let studio = studio.get_or_insert_with(|| {
                collect_frame_requests(ui.ctx());
                let studio = Studio::new(ui.ctx(), design.clone(), None).expect("a worker thread");
                studio.set_live(live);
                studio
            });
            studio.logic(&ui.ctx().clone());
            studio.ui(ui);
        },
        None,
    );
    settle(&mut window);
    window
}

fn studio(window: &Window) -> &Studio {
    window.state().as_ref().expect("the first frame makes the studio")
}

fn lenslets(window: &Window) -> Vec<Lenslet> {
    studio(window).session().design().encoder.lenslets().map(|array| array.lenslets.clone()).unwrap_or_default()
}

fn click(window: &mut Window, name: &str) {
    window.get_by_label(name).click();
    window.run_steps(8);
}

/// Replaces the number in a field.
fn type_number(window: &mut Window, field: &str, text: &str) {
    window.get_by_label(field).click();
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.get_by_label(field).type_text(text);
    window.run_steps(2);
    window.key_press(Key::Enter);
    window.run_steps(4);
}

/// Answers the open path question.
fn answer(window: &mut Window, path: &Path, button: &str) {
    let field = window.get_by_label("Path");
    field.focus();
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.get_by_label("Path").type_text(&path.display().to_string());
    window.run_steps(2);
    click(window, button);
    settle(window);
}

/// Presses a button, moves in five steps, and releases it.
fn drag(window: &mut Window, from: Pos2, by: Vec2, button: egui::PointerButton) {
    let press = |pressed, pos| egui::Event::PointerButton { pos, button, pressed, modifiers: Modifiers::NONE };
    window.hover_at(from);
    window.step();
    window.input_mut().events.push(press(true, from));
    window.step();
    for step in 1..=5 {
        window.hover_at(from + by * (step as f32 / 5.0));
        window.step();
    }
    window.input_mut().events.push(press(false, from + by));
    window.run_steps(3);
}

/// Turns the wheel at a place.
fn turn(window: &mut Window, place: Pos2, notches: f32, modifiers: Modifiers) {
    window.hover_at(place);
    window.run_steps(2);
    let wheel = egui::Event::MouseWheel {
        unit: egui::MouseWheelUnit::Line,
        delta: Vec2::new(0.0, notches),
        phase: egui::TouchPhase::Move,
        source: egui::MouseWheelSource::Wheel,
        modifiers,
    };
    window.event_modifiers(wheel, modifiers);
    // The turn is spread over some frames.
    window.run_steps(40);
}

fn menu(window: &mut Window, entries: &[&str]) {
    for entry in entries {
        click(window, entry);
    }
    settle(window);
}

#[test]
fn objects_open_by_typed_path_and_broken_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let good = folder.path().join("digits-idx3-ubyte");
    let mut bytes = vec![0, 0, 8, 3, 0, 0, 0, 20, 0, 0, 0, 28, 0, 0, 0, 28];
    bytes.extend((0..20 * 28 * 28).map(|pixel| (pixel * 7 % 251) as u8));
    std::fs::write(&good, &bytes).unwrap();
    let broken = folder.path().join("broken-idx3-ubyte");
    std::fs::write(&broken, &bytes[..500]).unwrap();

    let mut window = open(Design::default());
    click(&mut window, "Open objects...");
    answer(&mut window, &broken, "Open");
    assert_eq!(studio(&window).session().design().objects, ObjectSource::Beads { density: 0.02 });
    assert!(!studio(&window).session().is_dirty());
    assert!(window.query_all_by_label_contains("broken-idx3-ubyte").next().is_some(), "the failure names the file");

    click(&mut window, "Open objects...");
    answer(&mut window, &good, "Open");
    assert_eq!(studio(&window).session().design().objects, ObjectSource::Idx(good.clone()));
    let live = studio(&window).session().live();
    assert!(live.failure.is_none());
    assert!(live.information.unwrap().value.ceiling.is_none(), "the entropy of images is not known");

    // The same file with other images is read again.
    let read = live.scene.unwrap();
    let steps = studio(&window).session().undoes().map(String::from);
    for pixel in &mut bytes[16..] {
        *pixel = 250 - *pixel;
    }
    std::fs::write(&good, &bytes).unwrap();
    click(&mut window, "Open objects...");
    answer(&mut window, &good, "Open");
    let live = studio(&window).session().live();
    let again = live.scene.unwrap();
    assert!(again.revision > read.revision && again.value.set.fingerprint() != read.value.set.fingerprint());
    assert_eq!(live.information.unwrap().revision, studio(&window).session().revision());
    assert_eq!(studio(&window).session().undoes().map(String::from), steps, "the design is the same");
}

#[test]
fn design_is_exported_saved_and_opened() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    menu(&mut window, &["Presets", "25 random lenslets"]);
    click(&mut window, "File");
    click(&mut window, "Export design...");
    answer(&mut window, &folder.path().join("out"), "Export");
    for name in ["psf.npy", "psf.png", "psf16.png", "psf.tiff", "design.json", "lenslets.csv"] {
        assert!(folder.path().join("out").join(name).is_file(), "{name}");
    }
    let exported = Design::open(&folder.path().join("out/design.json")).unwrap();
    assert_eq!(exported, **studio(&window).session().design());

    let file = folder.path().join("mine.json");
    assert!(studio(&window).session().is_dirty());
    click(&mut window, "File");
    click(&mut window, "Save design as...");
    answer(&mut window, &file, "Save");
    assert!(!studio(&window).session().is_dirty());
    assert_eq!(studio(&window).session().path(), Some(file.as_path()));

    click(&mut window, "Add lenslet");
    settle(&mut window);
    assert!(studio(&window).session().is_dirty());
    // Opening asks about the changes first.
    click(&mut window, "File");
    click(&mut window, "Open design...");
    click(&mut window, "Discard");
    answer(&mut window, &file, "Open");
    assert_eq!(**studio(&window).session().design(), exported);
    assert!(!studio(&window).session().is_dirty());
}

#[test]
fn export_asks_before_replacing_files() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let psf = out.join("psf.npy");
    let mut window = open(Design::default());
    menu(&mut window, &["File", "Export design..."]);
    answer(&mut window, &out, "Export");
    let first = std::fs::read(&psf).unwrap();
    click(&mut window, "Add lenslet");
    menu(&mut window, &["File", "Export design..."]);
    answer(&mut window, &out, "Export");
    assert_eq!(std::fs::read(&psf).unwrap(), first);
    window.get_by_label(&format!("{} and 5 more already exist. Replace them?", psf.display()));
    click(&mut window, "Replace");
    settle(&mut window);
    assert_ne!(std::fs::read(&psf).unwrap(), first);
    // The name of an image gets its extension, and the question names it.
    let image = folder.path().join("measured.png");
    for written in [false, true] {
        assert_eq!(image.is_file(), written);
        menu(&mut window, &["File", "Export view", "Measurement..."]);
        answer(&mut window, &folder.path().join("measured"), "Export");
        assert!(image.is_file());
    }
    window.get_by_label(&format!("{} already exists. Replace it?", image.display()));
}

#[test]
fn save_asks_before_replacing_another_design() {
    let folder = tempfile::tempdir().unwrap();
    let (file, free) = (folder.path().join("other.json"), folder.path().join("free.json"));
    let other = Design { seed: 77, ..Design::default() };
    other.save(&file).unwrap();
    let mut window = open(Design::default());
    for typed in ["other", "other.json"] {
        menu(&mut window, &["File", "Save design as..."]);
        answer(&mut window, &folder.path().join(typed), "Save");
        assert_eq!(Design::open(&file).unwrap(), other, "{typed}");
        window.get_by_label(&format!("{} already exists. Replace it?", file.display()));
        click(&mut window, "Cancel");
    }
    menu(&mut window, &["File", "Save design as..."]);
    answer(&mut window, &file, "Save");
    // Another name gives another question, or none.
    answer(&mut window, &free, "Save");
    assert_eq!(studio(&window).session().path(), Some(free.as_path()));
    // The design's own file gives no question.
    click(&mut window, "Add lenslet");
    menu(&mut window, &["File", "Save design as..."]);
    answer(&mut window, &free, "Save");
    assert!(!studio(&window).session().is_dirty());
    menu(&mut window, &["File", "Save design as..."]);
    answer(&mut window, &file, "Save");
    click(&mut window, "Replace");
    settle(&mut window);
    assert_eq!(Design::open(&file).unwrap(), **studio(&window).session().design());
}

#[test]
fn scene_panel_sets_noise_and_photons() {
    let mut window = open(Design::default());
    let live = |window: &Window| studio(window).session().live();
    click(&mut window, "Read noise");
    settle(&mut window);
    window.get_by_label("Read noise sigma");
    let read = live(&window).information.unwrap().value.gaussian;
    assert!(
        (read.entropy_y_given_x - 0.5 * (2.0 * std::f64::consts::PI * std::f64::consts::E * 25.0).log2()).abs() < 1e-9
    );
    click(&mut window, "None noise");
    settle(&mut window);
    let failure = live(&window).failure.expect("information is unbounded without noise");
    assert!(failure.1.contains("unbounded"), "{}", failure.1);
    window.get_by_label("No results");
    click(&mut window, "Both noise");
    settle(&mut window);
    assert!(live(&window).failure.is_none());
    click(&mut window, "Volume");
    settle(&mut window);
    assert!(live(&window).failure.is_none());
    assert_eq!(live(&window).scene.unwrap().value.set.planes(), 5);
}

/// Closes the window by its title bar.
fn close(window: &mut Window) {
    let viewport = window.input().viewport_id;
    let info = window.input_mut().viewports.entry(viewport).or_default();
    info.events.push(egui::ViewportEvent::Close);
    window.step();
    window.input_mut().viewports.entry(viewport).or_default().events.clear();
    window.run_steps(8);
}

#[test]
fn closing_asks_about_unsaved_changes() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("kept.json");
    let mut window = open(Design::default());
    click(&mut window, "Add lenslet");
    settle(&mut window);
    close(&mut window);
    window.get_by_label_contains("has unsaved changes.");
    click(&mut window, "Cancel");
    assert!(studio(&window).session().is_dirty(), "nothing is lost by asking");

    close(&mut window);
    click(&mut window, "Save");
    // A cancelled path leaves the design dirty and the question open.
    click(&mut window, "Cancel");
    assert!(studio(&window).session().is_dirty());
    click(&mut window, "Save");
    answer(&mut window, &file, "Save");
    assert!(!studio(&window).session().is_dirty());
    assert_eq!(Design::open(&file).unwrap(), **studio(&window).session().design());
}

#[test]
fn cancelled_save_asks_again() {
    let mut window = open(Design::default());
    menu(&mut window, &["Presets", "Diffuser", "Aperture 16 px"]);
    // Another job is open meanwhile. It takes much longer than the frames in which the save is cancelled.
    studio(&window).session().fit_lenslets();
    close(&mut window);
    click(&mut window, "Save");
    click(&mut window, "Cancel");
    assert!(studio(&window).session().has_open_jobs(), "the fits were too fast");
    window.get_by_label("Save your changes?");
    click(&mut window, "Cancel");
    assert!(window.query_by_label("Save your changes?").is_none());
}

#[test]
fn window_matches_snapshot() {
    let drivers = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d"];
    if !drivers.iter().any(|folder| std::fs::read_dir(folder).is_ok_and(|mut files| files.next().is_some())) {
        println!("skipped: there is no Vulkan driver to draw snapshots with");
        return;
    }
    let mut results = egui_kittest::SnapshotResults::new();
    for (theme, name) in [(Theme::Dark, "window-dark"), (Theme::Light, "window-light")] {
        let mut window = open_themed(Design::default(), Vec2::new(1280.0, 800.0), theme);
        waiting::wait_for(&mut window, "the reconstruction", |window| {
            studio(window).session().reconstructions().shown.is_some_and(|shown| shown.iterations.is_none())
        });
        // Random numbers, rounding and time differ between processors, so these places are covered.
        let measured = window.get_by_role_and_label(Role::Image, "Measurement").rect();
        window.mask(measured.expand(2.0));
        window.mask(Rect::from_min_max(measured.right_top(), measured.right_bottom() + Vec2::new(62.0, 2.0)));
        window.mask(Rect::from_min_max(pos2(594.0, 482.0), pos2(872.0, 766.0)));
        window.mask(Rect::from_min_max(pos2(1060.0, 770.0), pos2(1272.0, 792.0)));
        window.mask(Rect::from_min_max(pos2(880.0, 58.0), pos2(1272.0, 446.0)));
        window.snapshot(name);
        results.extend(window.take_snapshot_results());
    }
}

#[test]
fn a_small_window_still_works() {
    let mut window = open_sized(Design::default(), Vec2::new(400.0, 300.0));
    menu(&mut window, &["Presets", "Heuristic lenslets", "2 lenslets"]);
    assert_eq!(lenslets(&window).len(), 2);
}

#[test]
fn idle_window_requests_no_frames() {
    let mut window = open(Design::default());
    // Animations of the first frames end. Then nothing may request another frame.
    window.run_steps(60);
    let delay = window.output().viewport_output.values().map(|viewport| viewport.repaint_delay).min().unwrap();
    assert!(delay > std::time::Duration::from_secs(1), "the next frame is asked for in {delay:?}");
}
