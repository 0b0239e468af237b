//! Information of each pixel, overlaid on the shown measurement.

use egui::{Color32, ColorImage, Rect, TextureOptions, Ui};

use crate::studio::canvas::image_view::{Shown, max_texture_side, subsampled};
use crate::studio::state::app_state::State;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::format::format_significant;
use crate::workbench::{Colormap, InspectionKey, SampleInspection};

/// Opacity of the most informative pixel.
const MOST_OPAQUE: f32 = 0.85;

/// Shows the switch and the range of the overlay.
pub fn switch(ui: &mut Ui, state: &mut State) {
    let possible = state.session.is_live() || state.overlay.shown;
    let hint = "Overlays the information that each pixel adds to the pixels above and left of it, by the model of the live estimate";
    let switch = egui::Checkbox::new(&mut state.overlay.shown, "Information");
    let response = ui.add_enabled(possible, switch).on_hover_text(hint);
    let response = response.on_disabled_hover_text("The live estimate is off (View > Live estimate)");
    name_widget(&response, "Information over the measurement");
    if state.overlay.shown && state.overlay.drawn.is_some() {
        ui.weak(format!("up to {} bits", format_significant(f64::from(state.overlay.most))));
    } else if state.overlay.shown {
        let asked = state.closer_asked.filter(|key| key.steps.is_some());
        let none = state.live.closer.as_ref().is_some_and(|closer| Some(closer.key) == asked && closer.map.is_none());
        let text = match state.live_estimate() {
            _ if none => "this measurement is too large for a map",
            Some(_) => "computing",
            None => "waiting for the live estimate",
        };
        ui.weak(text);
    }
}

/// Draws the map over the measurement, and adds the bits under the pointer to the status bar.
pub fn draw(ui: &Ui, state: &mut State, shown: &Shown, closer: Option<&SampleInspection>) {
    let current = |key: &InspectionKey| key.sample == state.sample && state.is_current(key.revision);
    let map = closer.filter(|closer| state.overlay.shown && current(&closer.key));
    let Some((key, map)) = map.and_then(|closer| Some((closer.key, closer.map.as_ref()?))) else {
        state.overlay.drawn = None;
        return;
    };
    let colormap = state.views.information.colormap;
    let overlay = &mut state.overlay;
    if overlay.drawn != Some((key, colormap)) {
        overlay.drawn = Some((key, colormap));
        overlay.most = map.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let palette = state.palettes.of(colormap);
        let colour = |&bits: &f32| {
            let [r, g, b, _] = palette[Colormap::index(bits, (0.0, overlay.most))].to_array();
            let share = (bits / overlay.most).clamp(0.0, 1.0).sqrt();
            Color32::from_rgba_unmultiplied(r, g, b, (255.0 * MOST_OPAQUE * share) as u8)
        };
        let map = subsampled(map.view(), max_texture_side(ui.ctx()));
        let pixels = ColorImage::new([map.ncols(), map.nrows()], map.iter().map(colour).collect());
        match &mut overlay.texture {
            Some(texture) => texture.set(pixels, TextureOptions::NEAREST),
            None => overlay.texture = Some(ui.ctx().load_texture("information", pixels, TextureOptions::NEAREST)),
        }
    }
    if let Some(texture) = &overlay.texture {
        let whole = shown.placement.rect;
        let part = |position: egui::Pos2| ((position - whole.min) / whole.size()).to_pos2();
        let uv = Rect::from_min_max(part(shown.seen.min), part(shown.seen.max));
        ui.painter_at(shown.seen).image(texture.id(), shown.seen, uv, Color32::WHITE);
    }
    let bits = |(x, y): (f64, f64)| map.get((y.round().max(0.0) as usize, x.round().max(0.0) as usize)).copied();
    let pointer = shown.response.hover_pos().map(|position| shown.placement.to_pixels(position));
    if let (Some(bits), Some(hover)) = (pointer.and_then(bits), &mut state.hover) {
        *hover = format!("{hover}, {} bits of information", format_significant(f64::from(bits)));
    }
    ui.ctx().accesskit_node_builder(shown.response.id, |node| {
        node.set_description(format!("information overlay up to {} bits", format_significant(f64::from(overlay.most))));
    });
}
