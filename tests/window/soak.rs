//! Random input through assistive technology, with an active run. Nothing panics. In a long test with live estimates, which runs on
//! request, memory does not grow.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use egui::{Key, Modifiers, Pos2, Role, TexturesDelta, Theme, Vec2};
use egui_kittest::TestRenderer;
use egui_kittest::kittest::{NodeT, Queryable};
use lenslet_studio::forward::Design;
use lenslet_studio::workbench::RunStatus;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::waiting::wait_for;
use super::{Window, click, open_drawn_by, studio};

/// A renderer that draws and stores nothing. The default one stores every texture change until an image is requested,
/// which would look like a memory leak of the program.
struct Unseen;

impl TestRenderer for Unseen {
    fn handle_delta(&mut self, delta: &mut TexturesDelta) {
        delta.clear();
    }

    fn render(&mut self, _: &egui::Context, _: &egui::FullOutput) -> Result<image::RgbaImage, String> {
        Err("nothing is drawn here".into())
    }
}

/// Controls that random input must not press: they close the window, wait for the user, or write files.
const LEFT_OUT: [&str; 9] =
    ["Quit", "Browse", "Export", "Save", "Open", "Import", "Start estimate", "Discard", "Recover"];

/// Largest allowed memory growth of the window during a day, MB.
const MOST_GROWTH: f64 = 50.0;
/// Time until the first memory reading, and between readings.
const WARM_UP: Duration = Duration::from_mins(2);
const SAMPLED_EVERY: Duration = Duration::from_secs(10);
/// Time in which unused memory is returned.
const REST: Duration = Duration::from_secs(5);
/// Actions of the short test.
const ACTS: usize = 200;
/// Minutes of the long test, unless this variable sets them.
const MINUTES: f64 = 10.0;
const MINUTES_VARIABLE: &str = "LENSLET_STUDIO_SOAK_MINUTES";
/// Number of reported frames.
const LONGEST: usize = 8;
/// Time between two images of the screen.
const SCREEN: Duration = Duration::from_micros(16_667);

/// Times every frame.
#[derive(Clone, Default)]
struct Clock(Arc<Mutex<Times>>);

#[derive(Default)]
struct Times {
    begun: Option<Instant>,
    longest: Duration,
    frames: u64,
    /// Number of frames that took longer than the refresh interval of the screen.
    late: u64,
}

impl Clock {
    fn watch(&self, ctx: &egui::Context) {
        let (begun, ended) = (self.clone(), self.clone());
        ctx.on_begin_pass("begin of a frame", Arc::new(move |_| begun.0.lock().unwrap().begun = Some(Instant::now())));
        ctx.on_end_pass(
            "end of a frame",
            Arc::new(move |_| {
                let mut times = ended.0.lock().unwrap();
                let took = times.begun.take().map_or(Duration::ZERO, |begun| begun.elapsed());
                times.longest = times.longest.max(took);
                times.frames += 1;
                times.late += u64::from(took > SCREEN);
            }),
        );
    }

    /// The longest frame since the last call.
    fn longest(&self) -> Duration {
        std::mem::take(&mut self.0.lock().unwrap().longest)
    }
}

/// Memory of this process, MB; none if unknown.
fn memory() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: f64 = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * 4096.0 / 1e6)
}

/// Memory of the window at rest, MB: no run, no estimate. Active work may take more.
fn memory_at_rest(window: &mut Window) -> Option<f64> {
    studio(window).set_live(false);
    studio(window).session().stop_run();
    studio(window).session().cancel_estimate();
    wait_for(window, "rest", |window| {
        let session = studio(window).session();
        !session.is_computing() && !session.run().is_some_and(|run| run.is_active())
    });
    // The allocator returns memory by a clock of its own.
    std::thread::sleep(REST);
    studio(window).set_live(true);
    memory()
}

/// Starts a run by its name, with any panel open.
fn start_run(window: &mut Window) {
    for _ in 0..4 {
        window.key_press(Key::Escape);
        window.run_steps(2);
    }
    window.key_press_modifiers(Modifiers::COMMAND, Key::K);
    window.run_steps(2);
    window.event(egui::Event::Text("start a run".into()));
    window.run_steps(2);
    window.key_press(Key::Enter);
    window.run_steps(4);
    if window.query_by_label("Start new run").is_some() {
        click(window, "Start new run");
    }
    println!("a run goes on: {}", studio(window).session().run().is_some_and(|run| run.is_active()));
}

/// A control that may be pressed.
struct Control {
    place: Pos2,
    takes_text: bool,
    label: String,
}

fn controls(window: &Window) -> Vec<Control> {
    let nodes = window.root().children_recursive();
    let found = nodes.filter_map(|node| {
        let inner = node.accesskit_node();
        let text = matches!(inner.role(), Role::TextInput | Role::SpinButton);
        let usable = text
            || matches!(
                inner.role(),
                Role::Button | Role::CheckBox | Role::RadioButton | Role::ComboBox | Role::Slider | Role::Link
            );
        let label = inner.label().unwrap_or_default();
        let left_out = LEFT_OUT.iter().any(|name| label.starts_with(name)) || inner.is_disabled();
        (usable && !left_out).then(|| Control { place: node.rect().center(), takes_text: text, label })
    });
    found.collect()
}

/// Performs a random action, and returns its description.
fn act(window: &mut Window, random: &mut ChaCha8Rng) -> String {
    // The keyboard also reaches questions for a path. No file may be written at a random name.
    if window.query_by_label("Path").is_some() {
        click(window, "Cancel");
        return "Cancel".into();
    }
    let somewhere =
        |random: &mut ChaCha8Rng| Pos2::new(random.random_range(0.0..1280.0), random.random_range(0.0..800.0));
    match random.random_range(0..12) {
        0 => {
            let keys = [Key::Tab, Key::Escape, Key::Delete, Key::ArrowLeft, Key::ArrowDown, Key::Space, Key::F1];
            let key = *keys.choose(random).unwrap();
            window.key_press(key);
            key.name().into()
        }
        1 => {
            let redo = random.random_bool(0.3);
            let modifiers = if redo { Modifiers::COMMAND | Modifiers::SHIFT } else { Modifiers::COMMAND };
            let key = *[Key::Z, Key::Z, Key::A, Key::D, Key::K].choose(random).unwrap();
            window.key_press_modifiers(modifiers, key);
            format!("Ctrl+{}", key.name())
        }
        2 => {
            // A drag, mostly over the mask.
            let from = Pos2::new(random.random_range(10.0..430.0), random.random_range(90.0..510.0));
            window.drag_at(from);
            window.step();
            for step in 1..4 {
                window.hover_at(from + Vec2::new(random.random_range(-40.0..40.0), 9.0 * step as f32));
                window.step();
            }
            window.drop_at(from + Vec2::splat(random.random_range(-60.0..60.0)));
            format!("drag from {from}")
        }
        3 => {
            let place = somewhere(random);
            window.hover_at(place);
            let wheel = egui::Event::MouseWheel {
                unit: egui::MouseWheelUnit::Line,
                delta: Vec2::new(0.0, random.random_range(-3.0..3.0)),
                phase: egui::TouchPhase::Move,
                source: egui::MouseWheelSource::Wheel,
                modifiers: if random.random_bool(0.3) { Modifiers::ALT } else { Modifiers::NONE },
            };
            window.input_mut().events.push(wheel);
            format!("wheel at {place}")
        }
        _ => {
            let controls = controls(window);
            let Some(Control { place, takes_text, label }) = controls.choose(random) else { return "nothing".into() };
            let place = *place;
            window.hover_at(place);
            window.drag_at(place);
            window.drop_at(place);
            window.step();
            // Hidden controls have a place too, where another control may ask for a path.
            if *takes_text && window.query_by_label("Path").is_none() {
                let typed = ["", "0", "-3", "0.05", "12.5", "1e9", "nonsense", "\u{3b1}"].choose(random).unwrap();
                window.key_press_modifiers(Modifiers::COMMAND, Key::A);
                window.input_mut().events.push(egui::Event::Text((*typed).to_owned()));
                window.step();
                window.key_press(Key::Enter);
            }
            label.clone()
        }
    }
}

/// The window under test, and the source of the input.
struct Soak {
    window: Window,
    random: ChaCha8Rng,
    clock: Clock,
    /// Durations of the longest frames, ms, and what was done in them.
    longest: Vec<(u128, String)>,
    acts: usize,
}

impl Soak {
    /// A window with a run.
    fn new(live: bool) -> Self {
        let mut window = open_drawn_by(Unseen, Design::default(), Vec2::new(1280.0, 800.0), Theme::Dark, live);
        click(&mut window, "Optimize");
        click(&mut window, "Start run");
        let clock = Clock::default();
        clock.watch(&window.ctx);
        Self { window, random: ChaCha8Rng::seed_from_u64(20), clock, longest: Vec::new(), acts: 0 }
    }

    /// Performs one random action, and checks that nothing has panicked.
    fn act(&mut self) {
        let window = &mut self.window;
        let what = act(window, &mut self.random);
        // One frame for every key press or release.
        window.step();
        self.acts += 1;
        self.longest.push((self.clock.longest().as_millis(), what));
        self.longest.sort_by(|one, other| other.cmp(one));
        self.longest.truncate(LONGEST);
        let session = studio(window).session();
        let failures = [session.live().failure, session.estimates().live_failure];
        for (_, reason) in failures.into_iter().flatten() {
            assert!(!reason.contains("internal error"), "{reason}");
        }
        if let Some(RunStatus::Failed(reason)) = session.run().map(|run| run.status) {
            assert!(!reason.contains("internal error"), "{reason}");
        }
    }
}

#[test]
fn random_input_does_not_break_the_window() {
    let mut soak = Soak::new(false);
    for _ in 0..ACTS {
        soak.act();
    }
}

#[test]
#[ignore = "takes ten minutes, or as many as LENSLET_STUDIO_SOAK_MINUTES says; run with --ignored --nocapture"]
fn memory_does_not_grow_under_random_input() {
    let minutes = std::env::var(MINUTES_VARIABLE).ok().and_then(|text| text.parse().ok()).unwrap_or(MINUTES);
    let length = Duration::from_secs_f64(60.0 * minutes);
    let (mut soak, started) = (Soak::new(true), Instant::now());
    let (mut used, mut rested) = (Vec::new(), None);
    while started.elapsed() < length {
        soak.act();
        if started.elapsed() > WARM_UP + used.len() as u32 * SAMPLED_EVERY {
            if rested.is_none() {
                rested = memory_at_rest(&mut soak.window);
                start_run(&mut soak.window);
            }
            used.extend(memory());
        }
    }
    let times = soak.clock.0.lock().unwrap();
    println!("{} acts, {} frames, {} of them longer than {SCREEN:?}", soak.acts, times.frames, times.late);
    drop(times);
    println!("longest frames in ms, and what was done: {:?}", soak.longest);
    println!("MB every {} s: {used:.0?}", SAMPLED_EVERY.as_secs());
    if let (Some(before), Some(after)) = (rested, memory_at_rest(&mut soak.window)) {
        println!("MB at rest: {before:.0}, in the end {after:.0}");
        assert!(after - before < MOST_GROWTH, "memory grows by {} MB", after - before);
    }
}
