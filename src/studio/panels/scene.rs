//! The scene: objects and sensor.

use egui::Ui;

use crate::forward::Design;
use crate::objects::{ObjectSource, Placement};
use crate::optics::{Diffuser, Encoder, LensletArray};
use crate::sensor::Noise;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::format::format_significant;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::Command;

/// Pixel pitch that is shown first, micrometres: that of common machine-vision sensors.
const USUAL_PITCH_UM: f64 = 3.45;

/// Shows the settings.
pub fn show(ui: &mut Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        objects(ui, view, requests);
        ui.add_space(6.0);
        ui.separator();
        sensor(ui, view.design, requests);
        ui.add_space(6.0);
        ui.separator();
        sizes(ui, view.design, requests);
    });
}

fn objects(ui: &mut Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    let design = view.design;
    ui.strong("Objects");
    ui.add_space(2.0);
    let density = match &design.objects {
        ObjectSource::Beads { density } | ObjectSource::BeadsMax { density } | ObjectSource::Volume { density, .. } => {
            *density
        }
        _ => 0.02,
    };
    let mut chosen = None;
    ui.horizontal_wrapped(|ui| {
        let mut kind = |ui: &mut Ui, selected: bool, text: &str, hint: &str, source: ObjectSource| {
            if ui.selectable_label(selected, text).on_hover_text(hint).clicked() && !selected {
                chosen = Some(source);
            }
        };
        let is = |test: fn(&ObjectSource) -> bool| test(&design.objects);
        kind(
            ui,
            is(|source| matches!(source, ObjectSource::Beads { .. })),
            "Beads",
            "Randomly placed beads; the whole set is scaled to the mean below",
            ObjectSource::Beads { density },
        );
        kind(
            ui,
            is(|source| matches!(source, ObjectSource::BeadsMax { .. })),
            "Equal beads",
            "Randomly placed beads of 2000 photons each",
            ObjectSource::BeadsMax { density },
        );
        kind(
            ui,
            is(|source| matches!(source, ObjectSource::Volume { .. })),
            "Volume",
            "Five independent planes of beads; each lenslet images the plane in its focus",
            ObjectSource::Volume { planes: 5, density },
        );
    });
    if let Some(source) = chosen {
        requests.push(Request::Change(Command::SetObjects(source)));
    }
    let from_file = match &design.objects {
        ObjectSource::Beads { .. } | ObjectSource::BeadsMax { .. } | ObjectSource::Volume { .. } => false,
        ObjectSource::Idx(_) | ObjectSource::Cifar(_) | ObjectSource::Images(_) | ObjectSource::Stack(_) => true,
    };
    ui.horizontal(|ui| {
        if ui
            .button("Open objects...")
            .on_hover_text("IDX, CIFAR-10, NPY, NPZ, TIFF, an image, or a folder of images")
            .clicked()
        {
            requests.push(Request::AskPath(PathPurpose::OpenObjects));
        }
        if from_file {
            let text = design.objects.to_string();
            ui.add(egui::Label::new(&text).truncate()).on_hover_text(text);
        }
    });
    if !from_file {
        labelled(ui, "Density", |ui| {
            let hint = "Share of pixels that hold a bead";
            let field = NumberField::new("Bead density", 0.0002..=1.0).speed(0.0005).decimals(4);
            if let Some(edit) = field.show(ui, density).1 {
                let density = edit.value;
                let source = match &design.objects {
                    ObjectSource::BeadsMax { .. } => ObjectSource::BeadsMax { density },
                    ObjectSource::Volume { planes, .. } => ObjectSource::Volume { planes: *planes, density },
                    _ => ObjectSource::Beads { density },
                };
                requests.push(Request::ChangeBy(edit, Command::SetObjects(source)));
            }
            ui.weak("of pixels").on_hover_text(hint);
        });
    }
    if design.objects.has_mean() {
        labelled(ui, "Mean", |ui| {
            let field = NumberField::new("Mean photons", 0.01..=1e7).decimals(2);
            if let Some(edit) = field.show(ui, design.mean_photons).1 {
                requests.push(Request::ChangeBy(edit, Command::SetMeanPhotons(edit.value)));
            }
            ui.weak("photons per pixel");
        });
    }
    if let Some(throughput) = design.encoder.throughput_unless_unit() {
        ui.weak(format!("Times a throughput of {} on the sensor", format_significant(throughput)));
    }
    understood(ui, view);
}

/// What is known of the objects. While they are read or computed, the text keeps its height, so that the fields below stand still.
fn understood(ui: &mut Ui, view: &View<'_>) {
    let place = ui.scope_id().with("height of the objects");
    let scene = view.live.scene.as_ref().filter(|scene| scene.value.serves(view.design));
    let is_known = scene.is_some() || view.failure().is_some();
    let response = ui
        .vertical(|ui| {
            if !is_known {
                let before: Option<f32> = ui.data(|data| data.get_temp(place));
                ui.set_min_height(before.unwrap_or_default());
            }
            if let Some(scene) = scene {
                ui.weak(scene.value.set.describe());
                if let Some(understood) = scene.value.set.understood() {
                    ui.weak(format!("File: {understood}"));
                }
                for notice in scene.value.set.notices() {
                    ui.colored_label(ui.visuals().warn_fg_color, notice);
                }
            } else if let Some(busy) = &view.live.busy {
                ui.weak(busy);
            } else if let Some(failure) = view.failure() {
                ui.colored_label(ui.visuals().error_fg_color, failure);
            } else {
                ui.weak("Computing the objects");
            }
        })
        .response;
    if is_known {
        ui.data_mut(|data| data.insert_temp(place, response.rect.height()));
    }
}

/// Sizes of objects and PSF in pixels, and of a pixel.
fn sizes(ui: &mut Ui, design: &Design, requests: &mut Vec<Request>) {
    ui.strong("Sizes");
    ui.add_space(2.0);
    let (grid, most) = (design.encoder.grid(), Design::MAX_FIELD);
    let is_stack = matches!(design.objects, ObjectSource::Stack(_));
    labelled(ui, "Field", |ui| {
        if is_stack {
            ui.weak("that of the file");
            return;
        }
        let (rows, cols) = design.field;
        let side = |ui: &mut Ui, name: &str, least: usize, value: usize| {
            NumberField::whole(name, least..=most).show(ui, value as f64).1
        };
        if let Some(edit) = side(ui, "Field rows", grid.0, rows) {
            requests.push(Request::ChangeBy(edit, Command::SetField((edit.value as usize, cols))));
        }
        ui.weak("x");
        if let Some(edit) = side(ui, "Field columns", grid.1, cols) {
            requests.push(Request::ChangeBy(edit, Command::SetField((rows, edit.value as usize))));
        }
        ui.weak("px").on_hover_text("Rows and columns of the objects");
    });
    if matches!(design.objects, ObjectSource::Images(_)) {
        labelled(ui, "Images", |ui| {
            for (text, placement) in
                [("Scaled", Placement::Scaled), ("Tiled", Placement::Tiled), ("Cropped", Placement::Cropped)]
            {
                let response = ui.selectable_label(design.placement == placement, text);
                name_widget(&response, &format!("{text} images"));
                if response.on_hover_text("How images larger than half the field get its size").clicked() {
                    requests.push(Request::Change(Command::SetPlacement(placement)));
                }
            }
        });
    }
    labelled(ui, "PSF grid", |ui| {
        let field = |least: usize| NumberField::whole("PSF grid", least..=LensletArray::MAX_SIDE);
        match &design.encoder {
            Encoder::Lenslets(_) => {
                if let Some(edit) = field(1).show(ui, grid.0 as f64).1 {
                    requests.push(Request::ChangeBy(edit, Command::SetGrid(edit.value as usize)));
                }
                ui.weak(format!("x {} px", grid.1))
                    .on_hover_text("Lenslets keep their share of the grid, and their width in pixels");
            }
            Encoder::Diffuser(_) => {
                // A large one takes a second, so that it is typed alone.
                if let Some(edit) = field(*Diffuser::GRIDS.start()).speed(0.0).show(ui, grid.0 as f64).1 {
                    requests.push(Request::ResizeDiffuser(edit.value as usize));
                }
                ui.weak(format!("x {} px", grid.1)).on_hover_text("The aperture keeps its share of the grid");
            }
            Encoder::Image(_) => {
                ui.weak(format!("{} x {} px, that of the image", grid.0, grid.1));
            }
        }
    });
    labelled(ui, "Pixel pitch", |ui| {
        let mut is_known = design.pixel_pitch_um.is_some();
        let known = ui.checkbox(&mut is_known, "").on_hover_text("Shows physical scales of sensor, PSF and MTF");
        name_widget(&known, "Known pixel pitch");
        if known.clicked() {
            requests.push(Request::Change(Command::SetPixelPitch(is_known.then_some(USUAL_PITCH_UM))));
        }
        let Some(pitch) = design.pixel_pitch_um else {
            ui.weak("not known");
            return;
        };
        let field = NumberField::new("Pixel pitch", Design::PIXEL_PITCHES).speed(0.01).decimals(4);
        if let Some(edit) = field.show(ui, pitch).1 {
            requests.push(Request::ChangeBy(edit, Command::SetPixelPitch(Some(edit.value))));
        }
        let (rows, cols) =
            (design.field.0 + 1 - grid.0.min(design.field.0), design.field.1 + 1 - grid.1.min(design.field.1));
        if is_stack {
            ui.weak("\u{b5}m");
        } else {
            let side = |pixels: usize| format_significant(pixels as f64 * pitch / 1000.0);
            ui.weak(format!("\u{b5}m, sensor {} x {} mm", side(rows), side(cols)));
        }
    });
}

fn sensor(ui: &mut Ui, design: &Design, requests: &mut Vec<Request>) {
    ui.strong("Sensor");
    ui.add_space(2.0);
    let sigma = design.noise.read_sigma().unwrap_or(5.0);
    labelled(ui, "Noise", |ui| {
        for (text, hint, noise) in [
            ("Shot", "Photon counting, Poisson", Noise::Shot),
            ("Read", "Gaussian, the same everywhere", Noise::Read { sigma }),
            ("Both", "Photon counting and read noise", Noise::ShotRead { sigma }),
            ("None", "Noiseless; information is then unbounded", Noise::None),
        ] {
            let selected = std::mem::discriminant(&noise) == std::mem::discriminant(&design.noise);
            let response = ui.selectable_label(selected, text).on_hover_text(hint);
            name_widget(&response, &format!("{text} noise"));
            if response.clicked() && !selected {
                requests.push(Request::Change(Command::SetNoise(noise)));
            }
        }
    });
    if design.noise.read_sigma().is_some() {
        labelled(ui, "Read noise", |ui| {
            let field = NumberField::new("Read noise sigma", 0.05..=1e5).speed(0.1).decimals(2);
            if let Some(edit) = field.show(ui, sigma).1 {
                let sigma = edit.value;
                let noise =
                    if design.noise.has_shot_noise() { Noise::ShotRead { sigma } } else { Noise::Read { sigma } };
                requests.push(Request::ChangeBy(edit, Command::SetNoise(noise)));
            }
            ui.weak("photons, standard deviation");
        });
    }
    labelled(ui, "Background", |ui| {
        let field = NumberField::new("Background photons", 0.0..=1e7).speed(0.5).decimals(2);
        if let Some(edit) = field.show(ui, design.bias_photons).1 {
            requests.push(Request::ChangeBy(edit, Command::SetBias(edit.value)));
        }
        ui.weak("photons per pixel");
    });
    labelled(ui, "Seed", |ui| {
        if let Some(edit) = NumberField::seed("Seed").show(ui, design.seed as f64).1 {
            requests.push(Request::ChangeBy(edit, Command::SetSeed(edit.value as u64)));
        }
        if ui.button("New").on_hover_text("Draws new objects and new noise").clicked() {
            requests
                .push(Request::ChangeInOneStep(Command::SetSeed(design.seed.wrapping_add(1) % 9_000_000_000_000_000)));
        }
    });
}

/// A setting behind its aligned label.
fn labelled(ui: &mut Ui, name: &str, add: impl FnOnce(&mut Ui)) {
    ui.horizontal(|ui| {
        ui.set_min_height(22.0);
        ui.allocate_ui_with_layout(egui::vec2(78.0, 18.0), egui::Layout::left_to_right(egui::Align::Center), |ui| {
            ui.set_min_width(78.0);
            ui.label(name);
        });
        add(ui);
    });
}
