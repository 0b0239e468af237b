//! Frame times of the window during a training and during an IDEAL run, the share of frames in time for 60 frames a second, and times
//! from edits to their first live number. wgpu draws the whole window, on the graphics card if there is one.

use std::error::Error;
use std::time::{Duration, Instant};

use eframe::egui_wgpu::{RenderState, ScreenDescriptor, WgpuSetup, WgpuSetupCreateNew, wgpu};
use egui::{TexturesDelta, Theme, Vec2};
use egui_kittest::kittest::Queryable;
use egui_kittest::wgpu::create_render_state;
use egui_kittest::{Harness, TestRenderer};
use image::RgbaImage;
use lenslet_studio::forward::Design;
use lenslet_studio::optics::{Encoder, random_layout};
use lenslet_studio::studio::Studio;
use lenslet_studio::workbench::Session;

/// Allocator of the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Frame interval of a screen.
const FRAME: Duration = Duration::from_nanos(1_000_000_000 / 60);
const WATCHED: Duration = Duration::from_secs(15);
/// Time after which something that was started must have happened.
const LONGEST_WAIT: Duration = Duration::from_mins(2);
/// Edits whose first live numbers are timed.
const EDITS: usize = 3;
const LENSLETS: usize = 25;
/// Size of the window, px.
const SIZE: (u32, u32) = (1440, 900);

/// Draws into a texture, like a window; unlike the renderer of egui's tests it reads nothing back.
struct Screen {
    state: RenderState,
    view: wgpu::TextureView,
}

impl Screen {
    fn new(state: RenderState) -> Self {
        let texture = state.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: SIZE.0, height: SIZE.1, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: state.target_format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        Self { view: texture.create_view(&wgpu::TextureViewDescriptor::default()), state }
    }
}

impl TestRenderer for Screen {
    fn handle_delta(&mut self, delta: &mut TexturesDelta) {
        let (mut renderer, RenderState { device, queue, .. }) = (self.state.renderer.write(), &self.state);
        for (id, images) in delta.set.drain() {
            images.iter().for_each(|image| renderer.update_texture(device, queue, id, image));
        }
        for id in delta.free.drain() {
            renderer.free_texture(&id);
        }
    }

    fn render(&mut self, ctx: &egui::Context, output: &egui::FullOutput) -> Result<RgbaImage, String> {
        let (mut renderer, RenderState { device, queue, .. }) = (self.state.renderer.write(), &self.state);
        let pixels_per_point = ctx.pixels_per_point();
        let screen = ScreenDescriptor { pixels_per_point, size_in_pixels: SIZE.into() };
        let shapes = ctx.tessellate(output.shapes.clone(), pixels_per_point);
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let uploads = renderer.update_buffers(device, queue, &mut encoder, &shapes, &screen);
        let load = wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT);
        let attachment = wgpu::RenderPassColorAttachment {
            view: &self.view,
            resolve_target: None,
            ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
            depth_slice: None,
        };
        let pass = wgpu::RenderPassDescriptor { color_attachments: &[Some(attachment)], ..Default::default() };
        renderer.render(&mut encoder.begin_render_pass(&pass).forget_lifetime(), &shapes, &screen);
        queue.submit(uploads.into_iter().chain([encoder.finish()]));
        device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| error.to_string())?;
        Ok(RgbaImage::new(1, 1))
    }
}

type Window = Harness<'static, Option<Studio>>;

fn open(renderer: impl TestRenderer + 'static) -> Window {
    let design = Design { encoder: Encoder::Lenslets(random_layout(LENSLETS, 1)), ..Design::default() };
    let builder = Harness::builder()
        .with_size(Vec2::new(SIZE.0 as f32, SIZE.1 as f32))
        .with_theme(Theme::Dark)
        .renderer(renderer);
    builder.with_step_dt(FRAME.as_secs_f32()).build_ui_state(
        move |ui, studio: &mut Option<Studio>| {
            let open = || Studio::new(ui.ctx(), design.clone(), None).expect("a worker thread");
            let studio = studio.get_or_insert_with(open);
            studio.logic(&ui.ctx().clone());
            studio.ui(ui);
        },
        None,
    )
}

fn session(window: &Window) -> &Session {
    window.state().as_ref().expect("an open window").session()
}

fn run_steps(window: &Window) -> usize {
    session(window).run().map_or(0, |run| run.step)
}

fn training_steps(window: &Window) -> usize {
    session(window).trainings().newest.map_or(0, |training| training.steps)
}

fn click(window: &mut Window, name: &str) {
    window.get_by_label(name).click();
    window.run_steps(8);
}

/// Lays frames out, at the pace of a screen, until something has happened.
fn wait(window: &mut Window, name: &str, happened: impl Fn(&Window) -> bool) -> Result<(), String> {
    let begun = Instant::now();
    while !happened(window) {
        if begun.elapsed() > LONGEST_WAIT {
            return Err(format!("no {name} within {LONGEST_WAIT:?}"));
        }
        window.step();
        std::thread::sleep(FRAME);
    }
    Ok(())
}

/// Adds lenslets; prints the times to their first live numbers.
fn edit(window: &mut Window, name: &str) -> Result<(), String> {
    let mut seconds = Vec::new();
    for _ in 0..EDITS {
        let edited = Instant::now();
        click(window, "Add lenslet");
        wait(window, "live number", |window| {
            let session = session(window);
            session.estimates().live.is_some_and(|live| live.revision == session.revision())
        })?;
        seconds.push(format!("{:.2}", edited.elapsed().as_secs_f64()));
    }
    println!("{name:24} s from edits to first numbers: {}", seconds.join(", "));
    Ok(())
}

/// Draws frame after frame, at the pace of a screen, while nothing but the background work happens; prints what they cost.
fn watch(window: &mut Window, name: &str, steps: impl Fn(&Window) -> usize) -> Result<(), String> {
    let (begun, first_step) = (Instant::now(), steps(window));
    let (mut costs, mut layouts) = (Vec::new(), Vec::new());
    let mut due = begun;
    while begun.elapsed() < WATCHED {
        let start = Instant::now();
        window.step();
        layouts.push(start.elapsed());
        window.render()?;
        costs.push(start.elapsed());
        due = Instant::now().max(due + FRAME);
        std::thread::sleep(due - Instant::now());
    }
    let seconds = begun.elapsed().as_secs_f64();
    let in_time = costs.iter().filter(|&&cost| cost <= FRAME).count() as f64 / costs.len() as f64;
    let rate = costs.len() as f64 / seconds;
    for times in [&mut costs, &mut layouts] {
        times.sort();
    }
    let at = |times: &[Duration], share: f64| times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3;
    println!(
        "{name:24} {rate:5.1} frames/s, {:5.1} % in time; ms a frame: median {:.1}, 99 % {:.1}, most {:.1}; of which before it is \
         drawn: median {:.1}, 99 % {:.1}; {:.1} steps/s",
        in_time * 100.0,
        at(&costs, 0.5),
        at(&costs, 0.99),
        at(&costs, 1.0),
        at(&layouts, 0.5),
        at(&layouts, 0.99),
        (steps(window) - first_step) as f64 / seconds
    );
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let setup = WgpuSetup::CreateNew(WgpuSetupCreateNew::without_display_handle());
    let state = create_render_state(setup, eframe::egui_wgpu::RendererOptions::default());
    let wgpu::AdapterInfo { name, driver, backend, .. } = state.adapter.get_info();
    println!("{} x {} px on {name} ({driver}, {backend})", SIZE.0, SIZE.1);
    let mut window = open(Screen::new(state));
    window.run_steps(8);
    watch(&mut window, "live estimate", |_| 0)?;
    edit(&mut window, "live estimate")?;
    click(&mut window, "Reconstruction method");
    click(&mut window, "Trained network");
    click(&mut window, "Train");
    wait(&mut window, "step of the training", |window| training_steps(window) > 0)?;
    watch(&mut window, "training", training_steps)?;
    edit(&mut window, "training")?;
    click(&mut window, "Stop training");
    click(&mut window, "Optimize");
    click(&mut window, "Start run");
    wait(&mut window, "step of the run", |window| run_steps(window) > 0)?;
    watch(&mut window, "run up the posterior", run_steps)?;
    Ok(())
}
