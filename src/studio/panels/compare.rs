//! Snapshots side by side: a table, information against Tamura coefficient, and one image that flips between two.

use std::collections::HashMap;

use egui::{ColorImage, Sense, TextureHandle, TextureOptions, Ui, Vec2};
use egui_plot::{Line, Plot, PlotPoint, PlotPoints, Points, Text, VLine};
use ndarray::{Array2, CowArray};

use crate::information::with_decimals;
use crate::studio::canvas::image_view::{ColourPalettes, ImageContent, ImageVersion};
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::panels::parts::tamura_gauge::TAMURA_GUIDE;
use crate::studio::state::action::Action;
use crate::studio::state::compare::{CompareState, ComparedSide, Quantity};
use crate::studio::state::pane::Pane;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::Request;
use crate::studio::widgets::colours::{DENSITY, ENTROPY_BOUND, GAUSSIAN};
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};
use crate::workbench::{Bits, Colormap, Snapshot, SnapshotNumbers, SnapshotReconstruction, Snapshots};

/// Side of the thumbnails, points.
const THUMBNAIL: f32 = 30.0;
/// Spacing of the table, points.
const SPACING: Vec2 = Vec2::new(6.0, 3.0);

/// Action on a snapshot.
enum SnapshotAction {
    Open(u64),
    Delete(u64),
}

/// Shows the panel.
pub fn show(ui: &mut Ui, state: &mut CompareState, palettes: &ColourPalettes, requests: &mut Vec<Request>) {
    toolbar(ui, |ui| {
        if ui.button("Take snapshot").on_hover_text("Saves the open design with its numbers for comparison").clicked() {
            requests.push(Request::Do(Action::KeepSnapshot));
        }
        if let Some(name) = state.snapshots.gone() {
            let hint = format!("Restores {name}");
            if ui.button("Restore snapshot").on_hover_text(hint).clicked() {
                state.snapshots.bring_back();
            }
        }
        ui.add_enabled_ui(!state.snapshots.entries.is_empty(), |ui| {
            let export = ui.small_button("Export CSV...");
            name_widget(&export, "Export comparison as CSV");
            if export.clicked() {
                let curve = state.snapshots.table();
                requests.push(Request::AskPath(PathPurpose::ExportCurve { curve, name: "designs.csv" }));
            }
            let export = ui.small_button("Image...").on_hover_text("Exports this panel as PNG");
            name_widget(&export, "Export comparison as PNG");
            if export.clicked() {
                requests.push(Request::Capture(Pane::Compare));
            }
        });
    });
    if state.snapshots.entries.is_empty() {
        placeholder(ui, "Take snapshots to compare designs here.");
        return;
    }
    egui::ScrollArea::both().auto_shrink(false).show(ui, |ui| {
        match table(ui, state, palettes) {
            Some(SnapshotAction::Open(number)) => requests.push(Request::OpenSnapshot(number)),
            Some(SnapshotAction::Delete(number)) => state.delete(number),
            None => {}
        }
        ui.separator();
        pair(ui, state, palettes, requests);
        ui.separator();
        scatter(ui, &state.snapshots);
    });
}

/// Table with one row per snapshot. Returns the chosen action.
fn table(ui: &mut Ui, state: &mut CompareState, palettes: &ColourPalettes) -> Option<SnapshotAction> {
    let (mut has_drawn, mut chosen_action) = (false, None);
    let CompareState { snapshots, pair, tries_again, thumbnails, .. } = state;
    let scenes: Vec<String> = snapshots.scenes().into_iter().map(String::from).collect();
    let decoders = snapshots.decoders();
    egui::Grid::new("designs").num_columns(9 + decoders.len()).min_col_width(0.0).spacing(SPACING).striped(true).show(
        ui,
        |ui| {
            for title in ["", "A", "B", "Name", "bits/px", "Tamura", "Count"] {
                ui.weak(title);
            }
            for decoder in &decoders {
                let hint = "Peak signal-to-noise ratio of this method on test objects, dB";
                ui.weak(format!("{decoder}, dB")).on_hover_text(hint);
            }
            ui.weak("");
            if scenes.len() > 1 {
                ui.weak("Scene").on_hover_text("Numbers of different scenes are not comparable");
            }
            ui.end_row();
            let seen = ui.clip_rect().expand(SPACING.y + THUMBNAIL);
            for snapshot in &mut snapshots.entries {
                let top = ui.cursor().top();
                if top > seen.bottom() || top + THUMBNAIL < seen.top() {
                    // Hidden rows are skipped: there may be hundreds.
                    ui.allocate_space(Vec2::splat(THUMBNAIL));
                    ui.end_row();
                    continue;
                }
                if !has_drawn && snapshot.draw() {
                    has_drawn = true;
                    ui.ctx().request_repaint();
                }
                let number = snapshot.number;
                thumbnail(ui, thumbnails, palettes, snapshot);
                for (side, letter) in ["A", "B"].into_iter().enumerate() {
                    let chosen = pair[side] == Some(number);
                    let response = ui.radio(chosen, "");
                    name_widget(&response, &format!("{letter} is snapshot {number}"));
                    if response.clicked() {
                        pair[side] = (!chosen).then_some(number);
                        *tries_again = true;
                    }
                }
                let mut name = snapshot.name.clone();
                let response = ui.add_sized([70.0, 20.0], egui::TextEdit::singleline(&mut name));
                name_widget(&response, &format!("Name of snapshot {number}"));
                if response.changed() {
                    snapshot.rename(name);
                }
                let text = egui::RichText::new(information(snapshot)).size(11.0);
                ui.label(text).on_hover_text(bounds(snapshot));
                ui.label(snapshot.numbers.tamura.map_or_else(|| "-".into(), |tamura| format!("{tamura:.3}")));
                let lenslets = snapshot.design.encoder.lenslets();
                ui.label(lenslets.map_or_else(|| "-".into(), |array| array.lenslets.len().to_string()))
                    .on_hover_text(format!("{}, {}", snapshot.design.encoder.describe(), snapshot.design.objects));
                for &decoder in &decoders {
                    let psnr = snapshot.numbers.reconstruction_by(decoder);
                    ui.label(psnr.map_or_else(|| "-".into(), psnr_text));
                }
                let more = ui.menu_button("...", |ui| {
                    for (text, act) in
                        [("Open", SnapshotAction::Open(number)), ("Delete", SnapshotAction::Delete(number))]
                    {
                        if ui.button(text).clicked() {
                            chosen_action = Some(act);
                            ui.close();
                        }
                    }
                });
                name_widget(&more.response, &format!("More of snapshot {number}"));
                if scenes.len() > 1 {
                    ui.label(letter_of(&scenes, &snapshot.scene)).on_hover_text(&snapshot.scene);
                }
                ui.end_row();
            }
        },
    );
    chosen_action
}

fn psnr_text(reconstruction: &SnapshotReconstruction) -> String {
    let [low, high] = reconstruction.interval_95;
    format!("{:.2} \u{b1} {:.2}", reconstruction.psnr_db, 0.5 * (high - low))
}

/// Letter of a scene, or its number beyond the alphabet.
fn letter_of(scenes: &[impl AsRef<str>], scene: &str) -> String {
    let place = scenes.iter().position(|known| known.as_ref() == scene).unwrap_or_default();
    ('a'..='z').nth(place).map_or_else(|| (place + 1).to_string(), String::from)
}

/// Lower and upper bound of a snapshot, one line each.
fn information(snapshot: &Snapshot) -> String {
    let bound = |sign: char, bound: Bits| match bound.half_width() {
        0.0 => format!("{sign} {:.3}", bound.bits),
        half => format!("{sign} {:.3} \u{b1} {half:.3}", bound.bits),
    };
    match (snapshot.numbers.lower, snapshot.upper()) {
        (Some(lower), Some(upper)) => format!("{}\n{}", bound('\u{2265}', lower), bound('\u{2264}', upper)),
        (None, Some(upper)) => bound('\u{2264}', upper),
        (_, None) => snapshot.numbers.gaussian.map_or("-".into(), |approximation| bound('\u{2248}', approximation)),
    }
}

/// All bounds of a snapshot.
fn bounds(snapshot: &Snapshot) -> String {
    let line = |what: &str, Bits { bits, interval_95 }: Bits| format!("{what} {}", with_decimals(bits, interval_95, 4));
    let (mut lines, numbers) = (Vec::new(), &snapshot.numbers);
    lines.extend(numbers.lower.map(|bound| line("Lower bound", bound)));
    lines.extend(numbers.sampled.map(|bound| line("AIS upper bound", bound)));
    if let Some([lower, upper]) = numbers.bracket {
        lines.push(format!("{}, {}", line("Bracket from", lower), line("to", upper)));
    }
    lines.extend(numbers.fitted.map(|bound| line("Upper bound of an estimate", bound)));
    if let Some((live, settled)) = numbers.live {
        let state = if settled { "" } else { ", refining" };
        lines.push(line("Density model", live) + state);
    }
    let gaussian = if snapshot.gaussian_is_bound() { "Gaussian bound" } else { "Gaussian approximation" };
    lines.extend(numbers.gaussian.map(|bits| line(gaussian, bits)));
    lines.extend(numbers.ceiling.map(|bits| format!("Entropy bound {bits:.4}")));
    format!("{}\nbits per pixel, 32 x 32 px patches", lines.join("\n"))
}

fn thumbnail(
    ui: &mut Ui,
    thumbnails: &mut HashMap<u64, TextureHandle>,
    palettes: &ColourPalettes,
    snapshot: &Snapshot,
) {
    let Some(optics) = &snapshot.optics else {
        ui.allocate_exact_size(Vec2::splat(THUMBNAIL), Sense::hover());
        return;
    };
    let texture = thumbnails.entry(snapshot.number).or_insert_with(|| {
        let image = &optics.image;
        let peak = image.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let palette = palettes.of(Colormap::Viridis);
        let pixels = image.iter().map(|&value| palette[Colormap::index(value, (0.0, peak))]).collect();
        let pixels = ColorImage::new([image.ncols(), image.nrows()], pixels);
        ui.ctx().load_texture(format!("snapshot {}", snapshot.number), pixels, TextureOptions::NEAREST)
    });
    let image = egui::Image::new((texture.id(), texture.size_vec2())).fit_to_exact_size(Vec2::splat(THUMBNAIL));
    ui.add(image.alt_text(format!("PSF of {}", snapshot.name)));
}

/// One image that flips between two snapshots, or their difference.
fn pair(ui: &mut Ui, state: &mut CompareState, palettes: &ColourPalettes, requests: &mut Vec<Request>) {
    if state.what == Quantity::Measurement {
        requests.extend(state.missing_measurements().into_iter().map(Request::Submit));
    }
    let CompareState { snapshots, .. } = state;
    let [Some(a), Some(b)] = state.pair.map(|number| snapshots.get(number?)) else {
        ui.weak("Choose A and B to compare their images.");
        return;
    };
    ui.horizontal(|ui| {
        for (side, text) in [
            (ComparedSide::A, a.name.as_str()),
            (ComparedSide::B, b.name.as_str()),
            (ComparedSide::Difference, "A - B"),
        ] {
            let response = ui.selectable_label(state.side == side, text);
            let name = match side {
                ComparedSide::A => "Show A",
                ComparedSide::B => "Show B",
                ComparedSide::Difference => "Show difference",
            };
            name_widget(&response, name);
            if response.clicked() {
                state.side = side;
            }
        }
        if ui.button("Flip").on_hover_text("Switches between A and B").clicked() {
            state.side = if state.side == ComparedSide::A { ComparedSide::B } else { ComparedSide::A };
        }
    });
    toolbar(ui, |ui| {
        for (what, text) in [(Quantity::Psf, "PSF"), (Quantity::Measurement, "Measurement"), (Quantity::Mtf, "MTF")] {
            let response = ui.selectable_label(state.what == what, text);
            name_widget(&response, &format!("Compare {text}"));
            state.tries_again |= response.clicked();
            if response.clicked() && state.what != what {
                state.what = what;
                // A display range belongs to one quantity.
                state.image.reset_display_range();
                state.difference.reset_display_range();
            }
        }
        let shown = if state.side == ComparedSide::Difference { &mut state.difference } else { &mut state.image };
        shown.colour_controls(ui, palettes);
    });
    let (Some(one), Some(other)) = (image_of(a, state.what), image_of(b, state.what)) else {
        let reason = [a, b].into_iter().find_map(|snapshot| snapshot.measurement.as_ref()?.as_ref().err());
        ui.weak(reason.map_or("Simulating", String::as_str));
        return;
    };
    if one.dim() != other.dim() {
        ui.weak("Their images differ in size.");
        return;
    }
    let what = state.what as u64;
    let version = ImageVersion { revision: a.number << 34 | b.number << 4 | what, index: state.side as usize };
    let extent = |image: &Array2<f32>| {
        let finite = image.iter().copied().filter(|value| value.is_finite());
        finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    // All three share zoom and pan.
    let viewport = state.viewport;
    let (view, image) = match state.side {
        ComparedSide::Difference => {
            let image = one - other;
            let (low, high) = extent(&image);
            let most = high.max(-low).max(f32::MIN_POSITIVE);
            state.difference.fix_limits((-most, most));
            (&mut state.difference, CowArray::from(image))
        }
        side => {
            // A common display range makes the flip show differences only.
            let ((low_a, high_a), (low_b, high_b)) = (extent(one), extent(other));
            state.image.fix_limits((low_a.min(low_b), high_a.max(high_b)));
            (&mut state.image, CowArray::from(if side == ComparedSide::A { one } else { other }))
        }
    };
    let side = ui.available_width().clamp(120.0, 340.0);
    ui.allocate_ui(Vec2::new(side, side - 58.0), |ui| {
        view.viewport = viewport;
        let content = ImageContent { values: image.view(), version, is_stale: false };
        let shown = view.show(ui, palettes, content, PointerMode::View);
        if let Some(position) = shown.response.hover_pos() {
            let value = view.describe_pixel(image.view(), shown.placement.to_pixels(position));
            requests.extend(value.map(Request::Describe));
        }
    });
    state.viewport = view.viewport;
}

fn image_of(snapshot: &Snapshot, what: Quantity) -> Option<&Array2<f32>> {
    match what {
        Quantity::Psf => snapshot.optics.as_ref().map(|optics| &optics.image),
        Quantity::Measurement => snapshot.measurement.as_ref()?.as_ref().ok(),
        Quantity::Mtf => snapshot.optics.as_ref().map(|optics| &optics.mtf.map),
    }
}

/// Plot of information against Tamura coefficient.
fn scatter(ui: &mut Ui, all: &Snapshots) {
    let (snapshots, scenes) = (&all.entries, all.scenes());
    let points = |value: &dyn Fn(&Snapshot) -> Option<f64>| -> PlotPoints<'static> {
        snapshots.iter().filter_map(|snapshot| Some([snapshot.numbers.tamura?, value(snapshot)?])).collect()
    };
    Plot::new("Information against Tamura")
        .height(190.0)
        .include_y(0.0)
        .include_x(0.65)
        .include_x(0.95)
        .allow_scroll(false)
        .x_axis_label("sensor Tamura coefficient")
        .y_axis_label("bits per pixel")
        .show(ui, |plot| {
            plot.vline(VLine::new("published optima", TAMURA_GUIDE).color(ENTROPY_BOUND).width(1.0));
            for (name, is_bound) in [("Gaussian bound", true), ("Gaussian approximation", false)] {
                let of = points(&|s| Some(s.numbers.gaussian.filter(|_| s.gaussian_is_bound() == is_bound)?.bits));
                plot.points(Points::new(name, of).color(GAUSSIAN).radius(2.5));
            }
            plot.points(
                Points::new("density model", points(&|s| Some(s.numbers.live?.0.bits))).color(DENSITY).radius(3.5),
            );
            for snapshot in snapshots {
                let SnapshotNumbers { tamura: Some(tamura), lower, live, gaussian, .. } = snapshot.numbers else {
                    continue;
                };
                if let (Some(lower), Some(upper)) = (lower, snapshot.upper()) {
                    let ends: PlotPoints<'_> = vec![[tamura, lower.bits], [tamura, upper.bits]].into();
                    plot.line(Line::new(format!("bounds of {}", snapshot.name), ends).color(ENTROPY_BOUND).width(3.0));
                }
                if let Some(Bits { bits, .. }) = live.map(|live| live.0).or(gaussian) {
                    let text = if scenes.len() > 1 {
                        format!("{} ({})", snapshot.name, letter_of(&scenes, &snapshot.scene))
                    } else {
                        snapshot.name.clone()
                    };
                    let name = Text::new(snapshot.name.clone(), PlotPoint::new(tamura, bits), text);
                    plot.text(name.anchor(egui::Align2::LEFT_BOTTOM));
                }
            }
        });
}
