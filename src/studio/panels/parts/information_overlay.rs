//! Information of each pixel, overlaid on the shown measurement.

use egui::{Color32, ColorImage, Rect, TextureOptions, Ui};

use crate::studio::canvas::image_view::{Shown, max_texture_side, subsampled};
use crate::studio::state::samples::{InformationOverlay, SamplesState};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::format::format_significant;
use crate::workbench::{Colormap, InspectionKey};

/// Opacity of the most informative pixel.
const MOST_OPAQUE: f32 = 0.85;

/// Shows the switch and the range of the overlay.
pub fn switch(ui: &mut Ui, overlay: &mut InformationOverlay, view: &View<'_>) {
    let possible = view.is_live || overlay.shown;
    let hint = "Overlays the information that each pixel adds to the pixels above and left of it, by the model of the live estimate";
    let switch = egui::Checkbox::new(&mut overlay.shown, "Information");
    let response = ui.add_enabled(possible, switch).on_hover_text(hint);
    let response = response.on_disabled_hover_text("The live estimate is off (View > Live estimate)");
    name_widget(&response, "Information over the measurement");
    if overlay.shown && overlay.drawn.is_some() {
        ui.weak(format!("up to {} bits", format_significant(f64::from(overlay.most))));
    } else if overlay.shown {
        let asked = view.inspected.filter(|key| key.steps.is_some());
        let inspection = view.live.closer.as_ref().filter(|inspection| Some(inspection.key) == asked);
        let none = inspection.is_some_and(|inspection| inspection.map.is_none());
        let text = match view.live_estimate() {
            _ if none => "this measurement is too large for a map",
            Some(_) => "computing",
            None => "waiting for the live estimate",
        };
        ui.weak(text);
    }
}

/// Draws the map over the measurement. Returns the bits under the pointer.
pub fn draw(ui: &Ui, samples: &mut SamplesState, view: &View<'_>, shown: &Shown) -> Option<String> {
    let SamplesState { overlay, shown: sample, .. } = samples;
    let current = |key: &InspectionKey| key.sample == sample.index && view.is_current(key.revision);
    let inspection = view.live.closer.as_ref().filter(|inspection| overlay.shown && current(&inspection.key));
    let Some((key, map)) = inspection.and_then(|inspection| Some((inspection.key, inspection.map.as_ref()?))) else {
        overlay.drawn = None;
        return None;
    };
    let colormap = view.shared.map_colours;
    if overlay.drawn != Some((key, colormap)) {
        overlay.drawn = Some((key, colormap));
        overlay.most = map.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let palette = view.palettes.of(colormap);
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
    ui.ctx().accesskit_node_builder(shown.response.id, |node| {
        node.set_description(format!("information overlay up to {} bits", format_significant(f64::from(overlay.most))));
    });
    let bits = pointer.and_then(bits)?;
    Some(format!("{} bits of information", format_significant(f64::from(bits))))
}
