//! Information of each pixel of a patch, by the live estimate.

use egui::Ui;
use ndarray::Axis;

use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::panels::parts::image_menu::{self, View};
use crate::studio::state::app_state::State;
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};

/// Shows the map.
pub fn show(ui: &mut Ui, state: &mut State) {
    let live = state.estimates.live.clone();
    toolbar(ui, |ui| {
        state.views.information.colour_controls(ui, &state.palettes);
        let count = live.as_ref().map_or(0, |live| live.value.maps.len_of(Axis(0)));
        let mean = ui
            .selectable_label(state.map_sample.is_none(), "Mean")
            .on_hover_text("Mean over held-out patches; pixels are scanned row by row, so the first ones carry most");
        name_widget(&mean, "Mean information map");
        if mean.clicked() {
            state.map_sample = None;
        }
        let one = ui
            .selectable_label(state.map_sample.is_some(), "Patch")
            .on_hover_text("Information of each pixel of one patch");
        name_widget(&one, "Information map of a patch");
        if one.clicked() {
            state.map_sample = Some(state.map_sample.unwrap_or(0));
        }
        if let Some(sample) = &mut state.map_sample {
            *sample = (*sample).min(count.saturating_sub(1));
            let next = ui.small_button(">").on_hover_text("Next patch");
            name_widget(&next, "Next patch");
            if next.clicked() {
                *sample = (*sample + 1) % count.max(1);
            }
            ui.weak(format!("{} of {count}", *sample + 1));
        }
    });
    let Some(live) = live else {
        placeholder(ui, if state.session.is_live() { "Computing" } else { "The live estimate is off." });
        return;
    };
    let stale = !state.is_current(live.revision);
    let version = (live.revision, live.value.recipe.steps * 16 + state.map_sample.map_or(0, |sample| sample + 1));
    let chosen = state.map_sample.filter(|sample| *sample < live.value.maps.len_of(Axis(0)));
    let image = match chosen {
        Some(sample) => live.value.maps.index_axis(Axis(0), sample),
        None => live.value.mean_map.view(),
    };
    if image.is_empty() {
        return;
    }
    let view = &mut state.views.information;
    let shown = view.show(ui, &state.palettes, image, version, stale, PointerMode::View);
    if let Some(position) = shown.response.hover_pos() {
        let (x, y) = shown.placement.to_pixels(position);
        let photons = chosen.and_then(|sample| {
            let (row, col) = (y.round().max(0.0) as usize, x.round().max(0.0) as usize);
            live.value.patches.get((sample, row, col)).copied()
        });
        let photons = photons.map_or_else(String::new, |photons| format!(", {photons:.0} photons"));
        state.hover = view.describe_pixel(image, (x, y)).map(|text| text + &photons);
    }
    image_menu::show(ui, state, View::Information, &shown, |_, _, _| {});
}
